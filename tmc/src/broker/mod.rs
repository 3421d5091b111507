//! The connection to the broker: the door of the crate `rumqttc`.
//!
//! Owns the session, which the broker keeps for an archiver that is away, the subscriptions
//! and the acknowledgements, which are given by hand.

mod arguments;
mod tls;

pub use arguments::BrokerArguments;

use crate::failure::Failure;
use rumqttc::{Client, Connection, Event, MqttOptions, Packet, Publish, QoS};
use rumqttc::{TlsConfiguration, Transport};
use std::time::{Duration, Instant};

/// Largest message of verge, bytes: eight lanes of 32 cells take 7 KB of JSON.
pub const LARGEST: usize = 64 << 10;
/// Longest wait for the broker at the start.
const START: Duration = Duration::from_secs(10);
/// Between two attempts after that.
const RETRY: Duration = Duration::from_millis(500);
const KEEP_ALIVE: Duration = Duration::from_secs(30);
/// Largest packet of MQTT, bytes. One that is refused by its size breaks the connection and comes
/// again with the next: all are taken, and the door refuses what is too large.
const LARGEST_PACKET: usize = 268_435_455;
/// Most messages that are journalled with one flush.
const BATCH: usize = 1000;
/// The same in bytes.
const BATCH_BYTES: usize = 4 << 20;
/// Room for requests: an acknowledgement for each message of a batch, and a few more.
const REQUESTS: usize = 2 * BATCH;
/// Longest wait for the last acknowledgements to leave.
const GOODBYE: Duration = Duration::from_millis(500);

/// Where the broker is, and what is wanted of it.
pub struct Settings {
    host: String,
    port: u16,
    /// Client id: the name of the session.
    name: String,
    credentials: Option<(String, String)>,
    tls: Option<tls::Tls>,
    filters: Vec<String>,
    /// Whether the broker keeps the session while the program is away.
    is_kept: bool,
}

/// A message, and how it is acknowledged.
pub struct Arrived {
    /// Where it was published.
    pub topic: String,
    /// Of one that is too large, its beginning: more than [`LARGEST`] bytes.
    pub payload: Vec<u8>,
    publish: Publish,
}

impl Arrived {
    fn of(mut publish: Publish) -> Self {
        // A copy, so that the buffer it came in can go.
        let payload = publish.payload[..publish.payload.len().min(LARGEST + 1)].to_vec();
        publish.payload.clear();
        Self { topic: std::mem::take(&mut publish.topic), payload, publish }
    }
}

/// A connection with its subscriptions.
pub struct Subscriber {
    client: Client,
    connection: Connection,
    filters: Vec<String>,
    connected: bool,
}

impl Subscriber {
    /// Connects and subscribes.
    ///
    /// # Errors
    /// [`Failure::Broker`].
    pub fn connect(settings: Settings) -> Result<Self, Failure> {
        let Settings { host, port, name, credentials, tls, filters, is_kept } = settings;
        let address = format!("{host}:{port}");
        let mut options = MqttOptions::new(name, host, port);
        options.set_keep_alive(KEEP_ALIVE);
        options.set_clean_session(!is_kept);
        options.set_manual_acks(true);
        options.set_max_packet_size(LARGEST_PACKET, LARGEST);
        if let Some((user, password)) = credentials {
            options.set_credentials(user, password);
        }
        if let Some(tls) = tls {
            options.set_transport(Transport::tls_with_config(TlsConfiguration::Rustls(tls.0)));
        }
        let (client, connection) = Client::new(options, REQUESTS);
        let mut subscriber = Self { client, connection, filters, connected: false };
        let until = Instant::now() + START;
        let mut reason = "no answer".to_owned();
        while !subscriber.connected {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(Failure::Broker { address, reason });
            }
            match subscriber.connection.recv_timeout(left) {
                Ok(Ok(event)) => drop(subscriber.take(event)),
                Ok(Err(error)) => {
                    reason = error.to_string();
                    std::thread::sleep(RETRY.min(left));
                }
                Err(_) => {}
            }
        }
        Ok(subscriber)
    }

    /// The messages that are there, waiting for the first at most so long.
    pub fn receive(&mut self, patience: Duration) -> Vec<Arrived> {
        let (mut messages, mut bytes) = (Vec::<Arrived>::new(), 0);
        let until = Instant::now() + patience;
        while messages.len() < BATCH && bytes < BATCH_BYTES {
            // Once there is one, only those that wait already are taken with it.
            let event = if messages.is_empty() {
                let left = until.saturating_duration_since(Instant::now());
                self.connection.recv_timeout(left).ok()
            } else {
                self.connection.try_recv().ok()
            };
            match event {
                Some(Ok(event)) => {
                    if let Some(publish) = self.take(event) {
                        messages.push(Arrived::of(publish));
                        bytes += messages.last().map_or(0, |message| message.payload.len());
                    }
                }
                Some(Err(error)) => {
                    if std::mem::take(&mut self.connected) {
                        eprintln!("verge-tmc: the connection broke: {error}; trying again");
                    }
                    std::thread::sleep(RETRY);
                    break;
                }
                None => break,
            }
            if messages.is_empty() && Instant::now() >= until {
                break;
            }
        }
        messages
    }

    fn take(&mut self, event: Event) -> Option<Publish> {
        match event {
            Event::Incoming(Packet::ConnAck(_)) => {
                self.connected = true;
                for filter in &self.filters {
                    // There is room: requests of the broken connection went with it.
                    let _ = self.client.try_subscribe(filter, QoS::AtLeastOnce);
                }
                None
            }
            Event::Incoming(Packet::Publish(message)) => Some(message),
            _ => None,
        }
    }

    /// Tells the broker that these are safe.
    ///
    /// Not where the connection has broken since: the numbers of its packets mean nothing to
    /// the next one, on which the broker sends the messages again.
    pub fn acknowledge(&mut self, messages: &[Arrived]) {
        if !self.connected {
            return;
        }
        for message in messages {
            // One that finds no room comes again and is found to be a duplicate.
            let _ = self.client.try_ack(&message.publish);
        }
    }

    /// Whether the connection stands.
    pub const fn is_connected(&self) -> bool {
        self.connected
    }

    /// Sends what is still to be sent and disconnects.
    pub fn leave(mut self) {
        let _ = self.client.try_disconnect();
        let until = Instant::now() + GOODBYE;
        while let Ok(Ok(_)) =
            self.connection.recv_timeout(until.saturating_duration_since(Instant::now()))
        {}
    }
}
