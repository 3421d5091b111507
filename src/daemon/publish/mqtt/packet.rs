//! Packets of MQTT 3.1.1 and 5 as bytes, in the same few words for both: the door of the crate
//! `rumqttc`, of which only the packets are used.
//!
//! Owns the packets that may come from a broker and their length; `written` has those that are sent
//! to it, `link` the socket.

mod written;

pub(super) use written::{acknowledge, connect, disconnect, ping, publish, subscribe, unsubscribe};

use crate::daemon::foreign::shown;
use bytes::BytesMut;
use rumqttc::mqttbytes::{QoS, v4};
use rumqttc::v5::mqttbytes::{QoS as QoS5, v5};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Largest packet that is read, bytes: one of our own windows that comes back.
pub(super) const MAX_INCOMING: usize = 64 << 10;

/// The protocol that a connection speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Spoken {
    V3,
    V5,
}

/// Limits of a broker in this session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Limits {
    /// Largest packet that it takes, bytes.
    pub(super) packet: usize,
    /// Messages that may wait for their acknowledgement.
    pub(super) in_flight: usize,
    /// Whether it keeps retained messages.
    pub(super) retains: bool,
    /// Silence after which it drops us, where it says so, s.
    pub(super) keep_alive_s: Option<u16>,
}

impl Limits {
    /// Of a broker that says nothing: 3.1.1 has no words for it.
    const NONE: Self =
        Self { packet: usize::MAX, in_flight: usize::MAX, retains: true, keep_alive_s: None };
}

/// Why a broker does not let us in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Denial {
    /// It does not speak this version.
    Version,
    /// It keeps no retained messages, and so takes no will that is one.
    Retain,
    /// User and password, or the right to leave the will.
    Login,
    /// The client id.
    ClientId,
    /// Anything else, in its words.
    Other(String),
}

/// The outcome of a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Acknowledged {
    Taken,
    /// Nobody has subscribed to it: the broker has thrown it away (MQTT 5).
    Unheard,
    Refused(String),
}

/// A packet from the broker.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Incoming {
    Accepted(Limits),
    Denied(Denial),
    Acknowledged(u16, Acknowledged),
    Subscribed {
        granted: bool,
    },
    Echo {
        topic: String,
        payload: Vec<u8>,
        packet: Option<u16>,
    },
    Pong,
    Closing(String),
    /// Nothing that concerns us.
    Other,
}

/// Takes the next packet from `bytes`; `None` while it is not whole.
///
/// # Errors
/// Bytes that are not a packet, or a packet longer than any we asked for.
pub(super) fn read(spoken: Spoken, bytes: &mut BytesMut) -> Result<Option<Incoming>, String> {
    let read = || match spoken {
        Spoken::V3 => read_3(bytes),
        Spoken::V5 => read_5(bytes),
    };
    let broken = || Err("it sends what is no MQTT".to_owned());
    catch_unwind(AssertUnwindSafe(read)).unwrap_or_else(|_| broken())
}

fn read_3(bytes: &mut BytesMut) -> Result<Option<Incoming>, String> {
    use rumqttc::mqttbytes::Error;
    let packet = match v4::Packet::read(bytes, MAX_INCOMING) {
        Ok(packet) => packet,
        Err(Error::InsufficientBytes(_)) => return Ok(None),
        Err(error) => return Err(format!("it sends what is no MQTT 3.1.1: {error}")),
    };
    Ok(Some(match packet {
        v4::Packet::ConnAck(ack) => {
            use v4::ConnectReturnCode as Code;
            match ack.code {
                Code::Success => Incoming::Accepted(Limits::NONE),
                Code::RefusedProtocolVersion => Incoming::Denied(Denial::Version),
                Code::BadClientId => Incoming::Denied(Denial::ClientId),
                Code::BadUserNamePassword | Code::NotAuthorized => Incoming::Denied(Denial::Login),
                Code::ServiceUnavailable => {
                    Incoming::Denied(Denial::Other("it is not available".to_owned()))
                }
            }
        }
        v4::Packet::PubAck(ack) => Incoming::Acknowledged(ack.pkid, Acknowledged::Taken),
        v4::Packet::SubAck(ack) => {
            let failed = ack.return_codes.contains(&v4::SubscribeReasonCode::Failure);
            Incoming::Subscribed { granted: !failed }
        }
        v4::Packet::Publish(publish) => Incoming::Echo {
            packet: (publish.qos != QoS::AtMostOnce).then_some(publish.pkid),
            payload: publish.payload.to_vec(),
            topic: publish.topic,
        },
        v4::Packet::PingResp => Incoming::Pong,
        v4::Packet::UnsubAck(_) => Incoming::Other,
        _ => return Err("it sends what only clients send".to_owned()),
    }))
}

fn read_5(bytes: &mut BytesMut) -> Result<Option<Incoming>, String> {
    use rumqttc::v5::mqttbytes::Error;
    if let Some(&[0xe0, 1, code]) = bytes.get(..3) {
        // A goodbye with a reason alone (MQTT 5, 3.14.2.2.1), for which the crate waits for more.
        *bytes = BytesMut::from(&[0xe0, 2, code, 0][..]);
    }
    match bytes.get(..4) {
        // A broker of 3.1.1 answers in its own way, CONNACK of two bytes, even where it takes the
        // session or denies the login: it is spoken to in its version, and says which then.
        Some([0x20, 2, ..]) => return Ok(Some(Incoming::Denied(Denial::Version))),
        // A goodbye without a reason.
        Some([0xe0, 0, ..]) => return Ok(Some(Incoming::Closing("no reason given".to_owned()))),
        _ => {}
    }
    let limit = u32::try_from(MAX_INCOMING).ok();
    let packet = match v5::Packet::read(bytes, limit) {
        Ok(packet) => packet,
        Err(Error::InsufficientBytes(_)) => return Ok(None),
        Err(error) => return Err(format!("it sends what is no MQTT 5: {error}")),
    };
    Ok(Some(match packet {
        v5::Packet::ConnAck(ack) => answer_5(&ack),
        v5::Packet::PubAck(ack) => {
            use v5::PubAckReason as Reason;
            let said = ack.properties.and_then(|properties| properties.reason_string);
            let outcome = match ack.reason {
                Reason::Success => Acknowledged::Taken,
                Reason::NoMatchingSubscribers => Acknowledged::Unheard,
                Reason::NotAuthorized => Acknowledged::Refused(with("not authorised", said)),
                Reason::QuotaExceeded => Acknowledged::Refused(with("its quota is used up", said)),
                Reason::TopicNameInvalid => Acknowledged::Refused(with("not this topic", said)),
                reason => Acknowledged::Refused(with(&plainly(&reason), said)),
            };
            Incoming::Acknowledged(ack.pkid, outcome)
        }
        v5::Packet::SubAck(ack) => {
            let granted = |code: &v5::SubscribeReasonCode| {
                matches!(code, v5::SubscribeReasonCode::Success(_))
            };
            Incoming::Subscribed { granted: ack.return_codes.iter().all(granted) }
        }
        v5::Packet::Publish(publish) => {
            let alias = publish.properties.as_ref().and_then(|properties| properties.topic_alias);
            if alias.is_some() {
                return Err("it uses topic aliases, which were not offered".to_owned());
            }
            Incoming::Echo {
                packet: (publish.qos != QoS5::AtMostOnce).then_some(publish.pkid),
                payload: publish.payload.to_vec(),
                topic: String::from_utf8_lossy(&publish.topic).into_owned(),
            }
        }
        v5::Packet::PingResp(_) => Incoming::Pong,
        v5::Packet::UnsubAck(_) => Incoming::Other,
        v5::Packet::Disconnect(end) => {
            use v5::DisconnectReasonCode as Code;
            let said = end.properties.and_then(|properties| properties.reason_string);
            Incoming::Closing(match end.reason_code {
                Code::SessionTakenOver => with(TAKEN_OVER, said),
                Code::NotAuthorized => with("not authorised", said),
                Code::PacketTooLarge => with("a message is too large for it", said),
                Code::ServerShuttingDown => with("it shuts down", said),
                Code::KeepAliveTimeout => with("it has heard nothing for too long", said),
                Code::QoSNotSupported => with(NO_ACKNOWLEDGEMENTS, said),
                code => with(&plainly(&code), said),
            })
        }
        _ => return Err("it sends what only clients send".to_owned()),
    }))
}

/// A second client has our id.
pub(super) const TAKEN_OVER: &str = "another client came with our client id: two boxes of one \
    site, or of one mqtt.client_id? Give each its own";

/// The broker takes messages of QoS 0 alone.
const NO_ACKNOWLEDGEMENTS: &str = "it takes no QoS 1, and without acknowledgements nobody knows whether \
    a window has arrived: allow QoS 1 there (mosquitto: max_qos 1)";

/// A reason's name in the standard as words: `ServerBusy` is "server busy".
fn plainly(reason: &impl std::fmt::Debug) -> String {
    let mut words = String::new();
    for letter in format!("{reason:?}").chars() {
        if letter.is_uppercase() && !words.is_empty() {
            words.push(' ');
        }
        words.extend(letter.to_lowercase());
    }
    words
}

fn answer_5(ack: &v5::ConnAck) -> Incoming {
    use v5::ConnectReturnCode as Code;
    let properties = ack.properties.as_ref();
    let said = properties.and_then(|properties| properties.reason_string.clone());
    let elsewhere = properties.and_then(|properties| properties.server_reference.as_deref());
    match ack.code {
        Code::Success => {
            let mut limits = Limits::NONE;
            if let Some(properties) = &ack.properties {
                let size = properties.max_packet_size.and_then(|size| usize::try_from(size).ok());
                limits.packet = size.unwrap_or(usize::MAX);
                limits.in_flight = properties.receive_max.map_or(usize::MAX, usize::from);
                limits.retains = properties.retain_available != Some(0);
                // 0: it drops nobody for silence.
                limits.keep_alive_s = properties.server_keep_alive.filter(|&seconds| seconds > 0);
                if properties.max_qos == Some(0) {
                    return Incoming::Denied(Denial::Other(NO_ACKNOWLEDGEMENTS.to_owned()));
                }
            }
            if limits.in_flight == 0 {
                return Incoming::Closing("it takes no message (receive maximum 0)".to_owned());
            }
            Incoming::Accepted(limits)
        }
        Code::RefusedProtocolVersion | Code::UnsupportedProtocolVersion => {
            Incoming::Denied(Denial::Version)
        }
        Code::RetainNotSupported => Incoming::Denied(Denial::Retain),
        Code::BadUserNamePassword | Code::NotAuthorized | Code::BadAuthenticationMethod => {
            Incoming::Denied(Denial::Login)
        }
        Code::BadClientId | Code::ClientIdentifierNotValid => Incoming::Denied(Denial::ClientId),
        Code::QoSNotSupported => Incoming::Denied(Denial::Other(with(NO_ACKNOWLEDGEMENTS, said))),
        Code::UseAnotherServer | Code::ServerMoved => {
            let there = elsewhere.map_or("another host".to_owned(), shown);
            let meant = format!("it sends us to {there}: set mqtt.host and mqtt.port");
            Incoming::Denied(Denial::Other(with(&meant, said)))
        }
        code => Incoming::Denied(Denial::Other(with(&plainly(&code), said))),
    }
}

/// The meaning, and the broker's own words.
fn with(meant: &str, said: Option<String>) -> String {
    said.map_or_else(|| meant.to_owned(), |said| format!("{meant} (\"{}\")", shown(&said)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(spoken: Spoken, bytes: &[u8]) -> Vec<Result<Incoming, String>> {
        let mut bytes = BytesMut::from(bytes);
        let mut found = Vec::new();
        loop {
            match read(spoken, &mut bytes) {
                Ok(Some(incoming)) => {
                    let ends = matches!(incoming, Incoming::Closing(_) | Incoming::Denied(_));
                    found.push(Ok(incoming));
                    if ends {
                        return found;
                    }
                }
                Ok(None) => return found,
                Err(error) => {
                    found.push(Err(error));
                    return found;
                }
            }
        }
    }

    #[test]
    fn answers_of_both_versions_in_the_same_words() {
        let limits = Limits { packet: 500, in_flight: 3, retains: false, keep_alive_s: Some(9) };
        let v5 = b"\x20\x10\x00\x00\x0d\x27\x00\x00\x01\xf4\x21\x00\x03\x25\x00\x13\x00\x09";
        assert_eq!(all(Spoken::V5, v5), [Ok(Incoming::Accepted(limits))]);
        let accepted = all(Spoken::V3, b"\x20\x02\x00\x00\x40\x02\x00\x07");
        let taken = Incoming::Acknowledged(7, Acknowledged::Taken);
        assert_eq!(accepted, [Ok(Incoming::Accepted(Limits::NONE)), Ok(taken)]);
        for (bytes, denial) in [
            (&b"\x20\x02\x00\x01"[..], Denial::Version),
            (b"\x20\x03\x00\x84\x00", Denial::Version),
            (b"\x20\x03\x00\x9a\x00", Denial::Retain),
            (b"\x20\x03\x00\x87\x00", Denial::Login),
        ] {
            assert_eq!(all(Spoken::V5, bytes), [Ok(Incoming::Denied(denial))]);
        }
        let unheard = Incoming::Acknowledged(5, Acknowledged::Unheard);
        assert_eq!(all(Spoken::V5, b"\x40\x03\x00\x05\x10"), [Ok(unheard)]);
        let told = all(Spoken::V5, b"\xe0\x09\x8e\x07\x1f\x00\x04a\x1bb\n");
        let Some(Ok(Incoming::Closing(text))) = told.first() else { panic!("{told:?}") };
        assert!(text.contains("client id") && text.contains("a\\u{1b}b"), "{text}");
        assert!(!text.contains(['\u{1b}', '\n']));
    }

    #[test]
    fn refusals_of_version_5_are_words_with_what_to_do() {
        for (answer, expected) in [
            // Maximum QoS 0, granted and refused.
            (&b"\x20\x05\x00\x00\x02\x24\x00"[..], "allow QoS 1"),
            (b"\x20\x03\x00\x9b\x00", "allow QoS 1"),
            (b"\x20\x03\x00\x89\x00", "server busy"),
            (b"\x20\x03\x00\x8a\x00", "banned"),
            (b"\x20\x03\x00\x97\x00", "quota exceeded"),
            (b"\x20\x03\x00\x9d\x00", "set mqtt.host"),
            (b"\x20\x08\x00\x9c\x05\x1c\x00\x02b2", "sends us to b2: set mqtt.host"),
            (b"\x20\x03\x00\x9f\x00", "connection rate exceeded"),
        ] {
            let heard = all(Spoken::V5, answer);
            let Some(Ok(Incoming::Denied(Denial::Other(said)))) = heard.first() else {
                panic!("{answer:?}: {heard:?}")
            };
            assert!(said.contains(expected), "{said}");
        }
        let heard = all(Spoken::V5, b"\xe0\x01\x9b");
        assert!(format!("{heard:?}").contains("allow QoS 1"), "{heard:?}");
        let heard = all(Spoken::V5, b"\x40\x03\x00\x05\x99");
        assert!(format!("{heard:?}").contains("payload format invalid"), "{heard:?}");
    }

    #[test]
    fn a_keep_alive_of_zero_is_none() {
        let heard = all(Spoken::V5, b"\x20\x06\x00\x00\x03\x13\x00\x00");
        assert_eq!(heard, [Ok(Incoming::Accepted(Limits::NONE))]);
    }

    #[test]
    fn what_was_not_asked_for_ends_the_connection() {
        // A publish with alias 1, as floods of them fill a client's table.
        let alias = b"\x30\x09\x00\x01t\x03\x23\x00\x01hi";
        assert!(all(Spoken::V5, alias)[0].is_err());
        // A packet of 256 MB.
        for spoken in [Spoken::V3, Spoken::V5] {
            assert!(all(spoken, b"\x30\xff\xff\xff\x7f\x00")[0].is_err());
            assert!(all(spoken, b"\x00\x00\x00\x00")[0].is_err());
        }
    }

    #[test]
    fn no_bytes_make_the_reader_panic() {
        let mut random = fastrand::Rng::with_seed(3);
        let seeds: [&[u8]; 4] = [
            b"\x20\x10\x00\x00\x0d\x27\x00\x00\x01\xf4\x21\x00\x03\x25\x00\x13\x00\x09",
            b"\x40\x06\x00\x05\x10\x02\x1f\x00",
            b"\xe0\x09\x8e\x07\x1f\x00\x04a\x1bb\n",
            b"\x32\x0b\x00\x01t\x00\x05\x03\x23\x00\x01hi",
        ];
        for _ in 0..20_000 {
            let mut bytes = seeds[random.usize(..seeds.len())].to_vec();
            for _ in 0..random.usize(1..4) {
                let at = random.usize(..bytes.len());
                bytes[at] = random.u8(..);
            }
            for spoken in [Spoken::V3, Spoken::V5] {
                let _ = all(spoken, &bytes);
            }
        }
    }
}
