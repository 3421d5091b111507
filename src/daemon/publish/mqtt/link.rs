//! One connection in MQTT 3.1.1 or 5, with the same few words for both.
//!
//! Owns the clients of `rumqttc`; what is sent when is `worker`'s. Every connection starts
//! clean: rumqttc forgets what it was sending when the broker has forgotten the session, so
//! what was not acknowledged is ours to send again.

use super::{Message, MqttSettings, MqttVersion};
use rumqttc::{Event, LastWill, MqttOptions, Outgoing, Packet, QoS, v5};
use std::time::Duration;
use v5::mqttbytes::v5::{LastWill as LastWill5, Packet as Packet5, PubAckReason};

/// Most messages that may be sent ahead of their acknowledgements.
pub(super) const IN_FLIGHT: usize = 16;
/// Room in the client's queue: presence messages come on top of what is in flight.
const QUEUE: usize = 2 * IN_FLIGHT;

/// Largest packet, bytes: ten times a window of eight lanes with 32 cells in JSON.
const MAX_PACKET: usize = 64 << 10;

/// What a connection says.
#[derive(Debug)]
pub(super) enum Signal {
    /// The broker has accepted us.
    Accepted,
    /// The next message that was given to the link has left, with this packet id.
    Sent(u16),
    /// The broker has taken the message.
    Taken(u16),
    /// The broker will not take the message.
    Refused(u16, String),
    /// The connection is over.
    Ended(String),
    /// Nothing happened in the time given.
    Quiet,
    /// Something that needs no answer.
    Other,
}

/// One connection.
pub(super) enum Link {
    V3(rumqttc::Client, Box<rumqttc::Connection>),
    V5(v5::Client, Box<v5::Connection>),
}

impl Link {
    /// Begins a connection; `will` is what the broker says when it breaks.
    pub(super) fn open(
        settings: &MqttSettings,
        client_id: &str,
        will: Option<Message>,
    ) -> Result<Self, String> {
        let (host, port) = (&settings.host, settings.port);
        Ok(match settings.version {
            MqttVersion::V3 => {
                let mut options = MqttOptions::new(client_id, host, port);
                options.set_keep_alive(settings.keep_alive);
                options.set_clean_session(true);
                options.set_inflight(QUEUE as u16);
                options.set_max_packet_size(MAX_PACKET, MAX_PACKET);
                if let Some(tls) = &settings.tls {
                    options.set_transport(tls.transport());
                }
                if let Some(Message { topic, payload, retain }) = will {
                    options.set_last_will(LastWill::new(topic, payload, QoS::AtLeastOnce, retain));
                }
                if let Some((user, password)) = &settings.credentials {
                    options.set_credentials(user, password);
                }
                let (client, connection) = rumqttc::Client::new(options, QUEUE);
                Self::V3(client, Box::new(connection))
            }
            MqttVersion::V5 => {
                let mut options = v5::MqttOptions::new(client_id, host, port);
                options.set_keep_alive(settings.keep_alive);
                options.set_clean_start(true);
                options.set_outgoing_inflight_upper_limit(QUEUE as u16);
                if let Some(tls) = &settings.tls {
                    options.set_transport(tls.transport());
                }
                if let Some(Message { topic, payload, retain }) = will {
                    let qos = v5::mqttbytes::QoS::AtLeastOnce;
                    options.set_last_will(LastWill5::new(topic, payload, qos, retain, None));
                }
                if let Some((user, password)) = &settings.credentials {
                    options.set_credentials(user, password);
                }
                let (client, connection) = v5::Client::new(options, QUEUE);
                Self::V5(client, Box::new(connection))
            }
        })
    }

    /// Gives a message to the link; false when its queue is full.
    pub(super) fn publish(&self, message: &Message) -> bool {
        let Message { topic, payload, retain } = message.clone();
        match self {
            Self::V3(client, _) => {
                client.try_publish(topic, QoS::AtLeastOnce, retain, payload).is_ok()
            }
            Self::V5(client, _) => {
                let qos = v5::mqttbytes::QoS::AtLeastOnce;
                client.try_publish(topic, qos, retain, payload).is_ok()
            }
        }
    }

    /// Asks for the end of the connection, behind everything that was given to the link.
    pub(super) fn disconnect(&self) {
        let _ = match self {
            Self::V3(client, _) => client.try_disconnect().is_ok(),
            Self::V5(client, _) => client.try_disconnect().is_ok(),
        };
    }

    /// What happens next, within `patience`.
    pub(super) fn next(&mut self, patience: Duration) -> Signal {
        match self {
            Self::V3(_, connection) => match connection.recv_timeout(patience) {
                Ok(Ok(event)) => signal_3(&event),
                Ok(Err(error)) => Signal::Ended(error.to_string()),
                Err(_) => Signal::Quiet,
            },
            Self::V5(_, connection) => match connection.recv_timeout(patience) {
                Ok(Ok(event)) => signal_5(event),
                Ok(Err(error)) => Signal::Ended(error.to_string()),
                Err(_) => Signal::Quiet,
            },
        }
    }
}

fn signal_3(event: &Event) -> Signal {
    match event {
        Event::Incoming(Packet::ConnAck(_)) => Signal::Accepted,
        Event::Incoming(Packet::PubAck(ack)) => Signal::Taken(ack.pkid),
        Event::Outgoing(outgoing) => signal_out(outgoing),
        Event::Incoming(_) => Signal::Other,
    }
}

fn signal_5(event: v5::Event) -> Signal {
    match event {
        v5::Event::Incoming(Packet5::ConnAck(_)) => Signal::Accepted,
        v5::Event::Incoming(Packet5::PubAck(ack)) => match ack.reason {
            PubAckReason::Success | PubAckReason::NoMatchingSubscribers => Signal::Taken(ack.pkid),
            reason => {
                let said = ack.properties.and_then(|properties| properties.reason_string);
                let said = said.map_or(String::new(), |said| format!(": {said}"));
                Signal::Refused(ack.pkid, format!("{reason:?}{said}"))
            }
        },
        v5::Event::Incoming(Packet5::Disconnect(end)) => {
            Signal::Ended(format!("the broker ends the session: {:?}", end.reason_code))
        }
        v5::Event::Outgoing(outgoing) => signal_out(&outgoing),
        v5::Event::Incoming(_) => Signal::Other,
    }
}

fn signal_out(outgoing: &Outgoing) -> Signal {
    match outgoing {
        Outgoing::Publish(packet) => Signal::Sent(*packet),
        Outgoing::Disconnect => Signal::Ended("stopped".to_owned()),
        _ => Signal::Other,
    }
}
