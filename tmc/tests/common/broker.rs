//! Mosquitto for a test, and a publisher to it.
#![allow(dead_code, reason = "each test file uses its own part")]

use rumqttc::{Client, Event, MqttOptions, Packet, QoS};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

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

/// A port of this machine that is free now.
pub fn free_port() -> u16 {
    let free = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    free.local_addr().expect("an address").port()
}

/// Starts mosquitto with more lines in its configuration.
pub fn mosquitto_with(lines: &str) -> Option<Mosquitto> {
    let program = ["/usr/sbin/mosquitto", "/usr/local/sbin/mosquitto", "/usr/bin/mosquitto"]
        .into_iter()
        .find(|path| std::path::Path::new(path).exists());
    let Some(program) = program else {
        crate::common::skip("mosquitto is not installed");
        return None;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let port = free_port();
    let config = folder.path().join("mosquitto.conf");
    let text = format!(
        "listener {port} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 0\npersistence false\n{lines}"
    );
    std::fs::write(&config, text).expect("writing a file");
    let child = Command::new(program)
        .arg("-c")
        .arg(&config)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("mosquitto starts");
    let until = Instant::now() + Duration::from_secs(20);
    while TcpStream::connect((Ipv4Addr::LOCALHOST, port)).is_err() {
        assert!(Instant::now() < until, "mosquitto listens");
        std::thread::sleep(Duration::from_millis(20));
    }
    Some(Mosquitto { port, child, _folder: folder })
}

/// Publishes messages at QoS 1 and returns when the broker has all; waits `pause` after each.
pub fn publish(port: u16, name: &str, messages: &[(String, String)], pause: Duration) {
    let mut options = MqttOptions::new(name, "127.0.0.1", port);
    options.set_keep_alive(Duration::from_secs(30));
    let (client, mut connection) = Client::new(options, 64);
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
        match connection.recv_timeout(Duration::from_secs(20)).expect("an answer") {
            Ok(Event::Incoming(Packet::PubAck(_))) => acknowledged += 1,
            Ok(_) => {}
            Err(error) => panic!("{error}"),
        }
    }
    thread.join().expect("all was sent");
    // Nothing is left to say.
    let _ = client.try_disconnect();
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
