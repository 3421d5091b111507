//! A centre in one command: a broker in this program, three simulated boxes, archive, report.
//!
//! `cargo run --profile centre -p verge-tmc --example centre -- DIR [HOURS]`: three streets run for
//! HOURS (2) as fast as they can, their true densities arrive as messages by lane and cell,
//! and DIR/report/index.html shows what came of them. DIR must not be there yet.

use clap::Parser;
use rumqttc::{Client, Event, MqttOptions, Packet, QoS};
use rumqttd::{Broker, Config, ConnectionSettings, RouterConfig, ServerSettings};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::ffi::OsStr;
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::time::Duration;
use street::scene::Scene;
use street::simulation::Simulation;
use verge_desk::Exit;
use verge_tmc::failure::Failure;
use verge_tmc::{archive, report};

const CELL_M: f64 = 10.0;
const WINDOW_S: u64 = 60;
/// Time between two looks at a street, s.
const FRAME_S: f64 = 2.0;
const BOXES: [(&str, &str, u64); 3] =
    [("curve-north", "curve", 1), ("freeway-east", "freeway", 2), ("freeway-west", "freeway", 3)];

#[derive(Parser)]
struct Arguments {
    folder: PathBuf,
    #[arg(default_value_t = 2)]
    hours: u64,
}

#[derive(Parser)]
struct Archive {
    #[command(flatten)]
    arguments: archive::Arguments,
}

#[derive(Parser)]
struct Report {
    #[command(flatten)]
    arguments: report::Arguments,
}

fn main() {
    let Arguments { folder, hours } = Arguments::parse();
    std::fs::create_dir(&folder).expect("a folder that is not there yet");
    let port = start_broker();
    let (kept, out) = (folder.join("archive"), folder.join("report"));
    let broker = format!("127.0.0.1:{port}");
    let words = ["archive", "--broker", &broker, "--until-idle", "5", "--out"];
    let words = words.map(OsStr::new).into_iter().chain([kept.as_os_str()]);
    let archive = Archive::parse_from(words);
    let archiver = std::thread::spawn(move || archive::run(&archive.arguments));
    let boxes = BOXES.map(|(site, scene, seed)| {
        std::thread::spawn(move || run_box(port, site, scene, seed, hours * 3600 / WINDOW_S))
    });
    for running in boxes {
        running.join().expect("the box publishes all its windows");
    }
    finish(archiver.join().expect("the archiver ends"));
    let words = ["report", "--archive"].map(OsStr::new).into_iter();
    let words = words.chain([kept.as_os_str(), OsStr::new("--out"), out.as_os_str()]);
    finish(report::run(&Report::parse_from(words).arguments));
}

fn finish(result: Result<(), Failure>) {
    if let Err(failure) = result {
        eprintln!("{failure}");
        std::process::exit(failure.exit_code().into());
    }
}

/// One street and the messages of its box.
fn run_box(port: u16, site: &str, scene: &str, seed: u64, windows: u64) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../street/scenes/{scene}.toml"));
    let scene = Scene::read(&path, &[]).expect("it ships");
    let mut street = Simulation::new(&scene, seed).expect("a right scene");
    let options = MqttOptions::new(site, "127.0.0.1", port);
    let (client, mut connection) = Client::new(options, 100);
    let topic = format!("verge/{site}/density/60s");
    let name = site.to_owned();
    // The last of its windows ends now.
    let length_ms = (WINDOW_S * 1000) as i64;
    let now_ms = jiff::Timestamp::now().as_millisecond();
    let begin_ms = now_ms - now_ms.rem_euclid(length_ms) - windows as i64 * length_ms;
    let sender = std::thread::spawn(move || {
        // The archiver subscribes before the first window ends.
        std::thread::sleep(Duration::from_secs(2));
        for window in 0..windows {
            let payload = measure(&mut street, &name, begin_ms, window).to_string();
            client.publish(&topic, QoS::AtLeastOnce, false, payload).expect("a connection");
        }
        client
    });
    let mut acknowledged = 0;
    while acknowledged < windows {
        match connection.recv_timeout(Duration::from_secs(60)).expect("an answer in a minute") {
            Ok(Event::Incoming(Packet::PubAck(_))) => acknowledged += 1,
            Ok(_) => {}
            Err(error) => panic!("{error}"),
        }
    }
    drop(sender.join());
}

/// Looks at the street through one window and tells its mean densities.
fn measure(street: &mut Simulation, site: &str, begin_ms: i64, window: u64) -> Value {
    let frames = (WINDOW_S as f64 / FRAME_S) as u32;
    let measured = street.measured().to_vec();
    let cells = |length_m: f64| (length_m / CELL_M).round().max(1.0) as usize;
    let mut counts: Vec<Vec<u32>> =
        measured.iter().map(|lane| vec![0; cells(lane.length_m())]).collect();
    for _ in 0..frames {
        street.step(FRAME_S);
        for vehicle in street.snapshot().vehicles {
            let lane = &measured[vehicle.lane];
            if lane.contains(vehicle.lane_s_m) {
                let lane_counts = &mut counts[vehicle.lane];
                let share = (vehicle.lane_s_m - lane.near_m) / lane.length_m();
                let cell = (share * lane_counts.len() as f64) as usize;
                lane_counts[cell.min(cells(lane.length_m()) - 1)] += 1;
            }
        }
    }
    let lanes: Vec<Value> = measured
        .iter()
        .zip(&counts)
        .map(|(lane, counts)| {
            let length_m = lane.length_m();
            let mean = f64::from(counts.iter().sum::<u32>()) / f64::from(frames);
            let cell_m = length_m / counts.len() as f64;
            let density = |count: &u32| f64::from(*count) / f64::from(frames) / cell_m * 1000.0;
            let by_cell: Vec<f64> = counts.iter().map(density).collect();
            json!({"lane": lane.number, "direction": "unknown",
                "density_veh_km": mean / length_m * 1000.0, "density_se": null,
                "vehicles_mean": mean, "by_class": null, "space_occupancy": null,
                "length_m": length_m, "frames_used": frames, "frames_expected": frames,
                "status": "oK", "cells": {"length_m": cell_m, "density_veh_km": by_cell}})
        })
        .collect();
    let minutes =
        |window: u64| verge_messages::rfc3339(begin_ms + (window * WINDOW_S * 1000) as i64);
    let unknown = "0".repeat(64);
    json!({"schema": 1, "site": site, "seq": window + 1, "window_s": WINDOW_S, "from": minutes(window),
        "to": minutes(window + 1), "clock_synced": true, "lanes": lanes,
        "calibration": {"id": "street", "sha256": unknown, "rel_err": null},
        "model": {"name": "truth", "sha256": unknown}})
}

/// A broker on a free port of the loopback address, until the program ends.
fn start_broker() -> u16 {
    let free = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let listen: SocketAddr = free.local_addr().expect("an address");
    drop(free);
    let connections = ConnectionSettings {
        connection_timeout_ms: 5000,
        max_payload_size: 1 << 20,
        max_inflight_count: 100,
        auth: None,
        external_auth: None,
        dynamic_filters: true,
    };
    let server = ServerSettings {
        name: "centre".into(),
        listen,
        tls: None,
        next_connection_delay_ms: 1,
        connections,
    };
    let router = RouterConfig {
        max_connections: 10,
        max_outgoing_packet_count: 200,
        max_segment_size: 1 << 20,
        max_segment_count: 100,
        ..RouterConfig::default()
    };
    let v4 = Some(HashMap::from([("centre".into(), server)]));
    let mut broker = Broker::new(Config { id: 0, router, v4, ..Config::default() });
    std::thread::spawn(move || {
        if let Err(error) = broker.start() {
            eprintln!("the broker ended: {error}");
        }
    });
    while TcpStream::connect(listen).is_err() {
        std::thread::sleep(Duration::from_millis(20));
    }
    listen.port()
}
