//! Mosquitto for a test, and a publisher to it.
#![allow(dead_code, reason = "each test file uses its own part")]

use rumqttc::{Client, Event, MqttOptions, NetworkOptions, Packet, QoS};
use std::io::Write;
use std::net::{Ipv4Addr, TcpStream};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use verge_desk::free_port;

/// A broker that ends with the value.
pub struct Mosquitto {
    pub port: u16,
    child: Child,
    _folder: tempfile::TempDir,
}

impl Drop for Mosquitto {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Starts mosquitto on a free port, or says that it is not installed.
pub fn mosquitto() -> Option<Mosquitto> {
    mosquitto_with("")
}

/// Starts mosquitto with more lines in its configuration.
pub fn mosquitto_with(lines: &str) -> Option<Mosquitto> {
    let program = ["/usr/sbin/mosquitto", "/usr/local/sbin/mosquitto", "/usr/bin/mosquitto"]
        .into_iter()
        .find(|path| std::path::Path::new(path).exists());
    let Some(program) = program else {
        verge_desk::skip("mosquitto is not installed");
        return None;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let port = free_port();
    let config = folder.path().join("mosquitto.conf");
    let text = format!(
        "listener {port} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 0\npersistence false\n{lines}"
    );
    std::fs::write(&config, &text).expect("writing a file");
    let mut child = Command::new(program)
        .arg("-c")
        .arg(&config)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("mosquitto starts");
    let until = Instant::now() + Duration::from_secs(20);
    while TcpStream::connect((Ipv4Addr::LOCALHOST, port)).is_err() {
        assert!(Instant::now() < until, "mosquitto listens");
        assert_eq!(child.try_wait().expect("a child"), None, "mosquitto goes on: {text}");
        std::thread::sleep(Duration::from_millis(20));
    }
    Some(Mosquitto { port, child, _folder: folder })
}

/// Publishes messages at QoS 1 and returns when the broker has all; waits `pause` after each.
pub fn publish(port: u16, name: &str, messages: &[(String, String)], pause: Duration) {
    let mut options = MqttOptions::new(name, "127.0.0.1", port);
    options.set_keep_alive(Duration::from_secs(30));
    options.set_max_packet_size(1 << 20, 1 << 28);
    let (client, mut connection) = Client::new(options, 64);
    let mut patience = NetworkOptions::new();
    patience.set_connection_timeout(60);
    connection.eventloop.set_network_options(patience);
    let wanted = messages.len();
    let all = messages.to_vec();
    let sender = client.clone();
    let thread = std::thread::spawn(move || {
        for (topic, payload) in all {
            sender.publish(topic, QoS::AtLeastOnce, false, payload).expect("a running connection");
            std::thread::sleep(pause);
        }
    });
    let mut acknowledged = 0;
    while acknowledged < wanted {
        match connection.recv_timeout(Duration::from_mins(1)).expect("an answer") {
            Ok(Event::Incoming(Packet::PubAck(_))) => acknowledged += 1,
            Ok(_) => {}
            Err(error) => panic!("{error}"),
        }
    }
    thread.join().expect("all was sent");
    // Nothing is left to say.
    let _ = client.try_disconnect();
}

/// Publishes one message after the other at QoS 1, from the first again after the last, as fast
/// as the broker reads and the line of so many bytes a second carries, for that long; how many.
pub fn flood(port: u16, topic: &str, payloads: &[Vec<u8>], time: Duration, line: f64) -> u64 {
    let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).expect("a connection");
    // MQTT 3.1.1: CONNECT as "evil" with a clean session and no keep-alive.
    stream.write_all(b"\x10\x10\x00\x04MQTT\x04\x02\x00\x00\x00\x04evil").expect("sent");
    let mut answers = stream.try_clone().expect("a second handle");
    let reader = std::thread::spawn(move || std::io::copy(&mut answers, &mut std::io::sink()));
    let packets: Vec<Vec<u8>> = payloads.iter().map(|payload| packet(topic, payload)).collect();
    let (begun, mut sent, mut bytes) = (Instant::now(), 0, 0.0);
    while begun.elapsed() < time {
        let packet = &packets[sent as usize % packets.len()];
        stream.write_all(packet).expect("a broker that reads");
        (sent, bytes) = (sent + 1, bytes + packet.len() as f64);
        let due = Duration::from_secs_f64(bytes / line);
        std::thread::sleep(due.saturating_sub(begun.elapsed()));
    }
    // DISCONNECT: the broker has read all that stands before it when it ends the connection.
    stream.write_all(b"\xe0\x00").expect("sent");
    reader.join().expect("it only reads").expect("an end");
    sent
}

/// A PUBLISH packet of QoS 1; its number may be always the same, for it is free once answered,
/// and a broker that has not answered takes it for another message all the same.
fn packet(topic: &str, payload: &[u8]) -> Vec<u8> {
    let mut packet = vec![0x32];
    let mut rest = 2 + topic.len() + 2 + payload.len();
    while rest >= 0x80 {
        packet.push(rest as u8 | 0x80);
        rest >>= 7;
    }
    packet.push(rest as u8);
    packet.extend((topic.len() as u16).to_be_bytes());
    packet.extend(topic.as_bytes());
    packet.extend(1u16.to_be_bytes());
    packet.extend(payload);
    packet
}

/// A density message of two lanes with two cells each; `minute` from 0 two days ago at midnight
/// UTC, so that some windows are long past and none is to come.
pub fn message(site: &str, seq: u64, minute: u64) -> String {
    let from = time(minute);
    let lane = |number: u64| {
        let density = (minute % 50) as f64 + number as f64;
        serde_json::json!({"lane": number, "direction": "away", "density_veh_km": density,
            "density_se": 0.5, "vehicles_mean": density / 10.0, "by_class": null,
            "space_occupancy": 0.1, "length_m": 100.0, "frames_used": 30, "frames_expected": 30,
            "status": "oK", "cells": {"length_m": 50.0, "density_veh_km": [density, density]}})
    };
    serde_json::json!({"schema": 1, "site": site, "seq": seq, "window_s": 60, "from": from,
        "to": time(minute + 1), "clock_synced": true, "lanes": [lane(1), lane(2)],
        "calibration": {"id": "a", "sha256": "0".repeat(64), "rel_err": 0.02},
        "model": {"name": "m", "sha256": "0".repeat(64)}})
    .to_string()
}

fn time(minute: u64) -> String {
    const DAY_MS: i64 = 86_400_000;
    let now = jiff::Timestamp::now().as_millisecond();
    let begin = now - now.rem_euclid(DAY_MS) - 2 * DAY_MS;
    verge_messages::rfc3339(begin + minute as i64 * 60_000)
}
