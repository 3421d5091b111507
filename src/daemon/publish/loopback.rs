//! A broker inside the program and a subscriber to it, for `verge demo`.
//!
//! The door of the crate `rumqttd`. Listens on the loopback address only.

use rumqttc::{Client, Event, MqttOptions, Packet, QoS};
use rumqttd::{Broker, Config, ConnectionSettings, RouterConfig, ServerSettings};
use std::collections::HashMap;
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

/// Longest wait for the broker to listen, and for a subscription to stand.
const START: Duration = Duration::from_secs(20);

/// Between two attempts at a subscription.
const RETRY: Duration = Duration::from_millis(50);

/// Why there is no broker or no subscription.
#[derive(Debug, thiserror::Error)]
pub enum LoopbackError {
    /// No free port.
    #[error("no port on 127.0.0.1: {0}")]
    Port(std::io::Error),
    /// The broker did not come up.
    #[error("the embedded broker does not listen on 127.0.0.1:{port}")]
    Broker {
        /// Its port.
        port: u16,
    },
    /// The subscriber got no answer.
    #[error("the embedded broker does not take a subscription: {0}")]
    Subscribe(String),
}

/// Starts a broker in threads of its own, until the program ends, and returns its port.
///
/// # Errors
/// [`LoopbackError`] where it does not listen in 20 s.
pub fn start_broker() -> Result<u16, LoopbackError> {
    let free = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).map_err(LoopbackError::Port)?;
    let address = free.local_addr().map_err(LoopbackError::Port)?;
    drop(free);
    let port = address.port();
    let mut broker = Broker::new(config(address));
    std::thread::Builder::new()
        .name("broker".into())
        .spawn(move || {
            if let Err(error) = broker.start() {
                log::error!("the embedded broker ended: {error}");
            }
        })
        .map_err(LoopbackError::Port)?;
    let started = Instant::now();
    while TcpStream::connect(address).is_err() {
        if started.elapsed() > START {
            return Err(LoopbackError::Broker { port });
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    Ok(port)
}

fn config(listen: SocketAddr) -> Config {
    let router = RouterConfig {
        max_connections: 10,
        max_outgoing_packet_count: 200,
        max_segment_size: 1 << 20,
        max_segment_count: 10,
        ..RouterConfig::default()
    };
    let connections = ConnectionSettings {
        connection_timeout_ms: 5000,
        max_payload_size: 1 << 16,
        max_inflight_count: 100,
        auth: None,
        external_auth: None,
        dynamic_filters: true,
    };
    let server = ServerSettings {
        name: "loopback".into(),
        listen,
        tls: None,
        next_connection_delay_ms: 1,
        connections,
    };
    Config {
        id: 0,
        router,
        v4: Some(HashMap::from([("loopback".into(), server)])),
        ..Config::default()
    }
}

/// A client that has subscribed.
pub struct Subscriber {
    // The connection ends with its client.
    _client: Client,
    connection: rumqttc::Connection,
}

impl Subscriber {
    /// Subscribes to `filter` at the broker on that port. A connection that breaks before
    /// the subscription stands is made again, as any client would.
    ///
    /// # Errors
    /// [`LoopbackError::Subscribe`] where none stands in 20 s.
    pub fn connect(port: u16, filter: &str) -> Result<Self, LoopbackError> {
        let until = Instant::now() + START;
        loop {
            match Self::attempt(port, filter, until) {
                Err(_) if Instant::now() < until => std::thread::sleep(RETRY),
                result => return result.map_err(LoopbackError::Subscribe),
            }
        }
    }

    fn attempt(port: u16, filter: &str, until: Instant) -> Result<Self, String> {
        let options = MqttOptions::new("traffic-management-centre", "127.0.0.1", port);
        let (client, mut connection) = Client::new(options, 10);
        client.subscribe(filter, QoS::AtLeastOnce).map_err(|e| e.to_string())?;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            match connection.recv_timeout(left) {
                Ok(Ok(Event::Incoming(Packet::SubAck(_)))) => break,
                Ok(Ok(_)) => {}
                Ok(Err(error)) => return Err(error.to_string()),
                Err(_) => return Err("no answer".into()),
            }
        }
        Ok(Self { _client: client, connection })
    }

    /// The next message, topic and payload; `None` when none comes within `patience` or
    /// the broker is gone.
    pub fn next(&mut self, patience: Duration) -> Option<(String, Vec<u8>)> {
        let until = Instant::now() + patience;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            match self.connection.recv_timeout(left) {
                Ok(Ok(Event::Incoming(Packet::Publish(message)))) => {
                    return Some((message.topic, message.payload.to_vec()));
                }
                Ok(Ok(_)) => {}
                Ok(Err(_)) | Err(_) => return None,
            }
        }
    }
}
