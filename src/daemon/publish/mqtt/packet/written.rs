//! The packets that this client sends.

use super::super::{Message, MqttSettings};
use super::{MAX_INCOMING, Spoken};
use bytes::BytesMut;
use rumqttc::mqttbytes::{QoS, v4};
use rumqttc::v5::mqttbytes::{QoS as QoS5, v5};

/// The first packet of a connection.
pub(in super::super) fn connect(
    spoken: Spoken,
    settings: &MqttSettings,
    client_id: &str,
    will: Message,
) -> Option<BytesMut> {
    let keep_alive = u16::try_from(settings.keep_alive.as_secs()).unwrap_or(u16::MAX);
    let Message { topic, payload, retain } = will;
    match spoken {
        Spoken::V3 => {
            let mut connect = v4::Connect::new(client_id);
            connect.keep_alive = keep_alive;
            connect.clean_session = true;
            connect.last_will = Some(v4::LastWill::new(topic, payload, QoS::AtLeastOnce, retain));
            if let Some((user, password)) = &settings.credentials {
                connect.set_login(user, password);
            }
            bytes_3(&v4::Packet::Connect(connect))
        }
        Spoken::V5 => {
            let mut properties = v5::ConnectProperties::new();
            properties.max_packet_size = u32::try_from(MAX_INCOMING).ok();
            properties.receive_maximum = Some(16);
            let connect = v5::Connect {
                keep_alive,
                client_id: client_id.to_owned(),
                clean_start: true,
                properties: Some(properties),
            };
            let will = v5::LastWill::new(topic, payload, QoS5::AtLeastOnce, retain, None);
            let login = settings.credentials.as_ref();
            let login = login.map(|(user, password)| v5::Login::new(user, password));
            bytes_5(&v5::Packet::Connect(connect, Some(will), login))
        }
    }
}

/// A message of QoS 1.
pub(in super::super) fn publish(
    spoken: Spoken,
    packet: u16,
    message: &Message,
) -> Option<BytesMut> {
    let Message { topic, payload, retain } = message.clone();
    match spoken {
        Spoken::V3 => {
            let mut publish = v4::Publish::new(topic, QoS::AtLeastOnce, payload);
            (publish.pkid, publish.retain) = (packet, retain);
            bytes_3(&v4::Packet::Publish(publish))
        }
        Spoken::V5 => {
            let mut publish = v5::Publish::new(topic, QoS5::AtLeastOnce, payload, None);
            (publish.pkid, publish.retain) = (packet, retain);
            bytes_5(&v5::Packet::Publish(publish))
        }
    }
}

/// Asks for what is published on a topic.
pub(in super::super) fn subscribe(spoken: Spoken, packet: u16, topic: &str) -> Option<BytesMut> {
    match spoken {
        Spoken::V3 => {
            let mut subscribe = v4::Subscribe::new(topic, QoS::AtLeastOnce);
            subscribe.pkid = packet;
            bytes_3(&v4::Packet::Subscribe(subscribe))
        }
        Spoken::V5 => {
            let filter = v5::Filter::new(topic, QoS5::AtLeastOnce);
            let mut subscribe = v5::Subscribe::new(filter, None);
            subscribe.pkid = packet;
            bytes_5(&v5::Packet::Subscribe(subscribe))
        }
    }
}

/// Asks for it no more.
pub(in super::super) fn unsubscribe(spoken: Spoken, packet: u16, topic: &str) -> Option<BytesMut> {
    match spoken {
        Spoken::V3 => {
            let mut unsubscribe = v4::Unsubscribe::new(topic);
            unsubscribe.pkid = packet;
            bytes_3(&v4::Packet::Unsubscribe(unsubscribe))
        }
        Spoken::V5 => {
            let mut unsubscribe = v5::Unsubscribe::new(topic, None);
            unsubscribe.pkid = packet;
            bytes_5(&v5::Packet::Unsubscribe(unsubscribe))
        }
    }
}

/// Acknowledges what came back.
pub(in super::super) fn acknowledge(spoken: Spoken, packet: u16) -> Option<BytesMut> {
    match spoken {
        Spoken::V3 => bytes_3(&v4::Packet::PubAck(v4::PubAck::new(packet))),
        Spoken::V5 => bytes_5(&v5::Packet::PubAck(v5::PubAck::new(packet, None))),
    }
}

/// Asks whether the broker is there.
pub(in super::super) fn ping() -> BytesMut {
    // The same two bytes in both versions.
    BytesMut::from(&[0xc0, 0][..])
}

/// Says goodbye, so that no will is published.
pub(in super::super) fn disconnect() -> BytesMut {
    // MQTT 5, 3.14.2.1: without a reason it is a normal one.
    BytesMut::from(&[0xe0, 0][..])
}

fn bytes_3(packet: &v4::Packet) -> Option<BytesMut> {
    let mut bytes = BytesMut::new();
    packet.write(&mut bytes, usize::MAX).ok().map(|_| bytes)
}

fn bytes_5(packet: &v5::Packet) -> Option<BytesMut> {
    let mut bytes = BytesMut::new();
    packet.write(&mut bytes, None).ok().map(|_| bytes)
}
