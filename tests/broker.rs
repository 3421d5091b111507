//! What arrives at a broker: the embedded one, and Debian's mosquitto where it is there.
#![cfg(feature = "demo")]

mod common;

use common::folder;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use verge::daemon::publish::loopback::{self, Subscriber};
use verge::daemon::publish::{Format, Identity, MqttSettings, Publisher, payload};
use verge::density::{Aggregator, FrameCounts, Start, WindowReport};
use verge::lane::LaneTable;
use verge::units::{LaneId, UtcMs, VehicleClass};
use verge::wire::{self, ModelRef};

const PATIENCE: Duration = Duration::from_secs(20);
const MINUTE: Duration = Duration::from_secs(60);

fn table() -> LaneTable<Vec<u8>> {
    LaneTable::parse(std::fs::read(common::K109F_TABLE).expect("it ships")).expect("a right table")
}

fn identity() -> Identity {
    let name = verge::lane::Name::try_from("test").expect("short");
    Identity::new("k109f", table().description(), &ModelRef { name, sha256: [7; 32] })
}

/// A window with vehicles in lane 2, and one in which no picture came.
fn windows() -> Vec<WindowReport> {
    let table = table();
    let lanes = &table.description().lanes;
    let mut line = Aggregator::new(lanes, &[MINUTE], MINUTE / 3, 0.5, Start::AtNextWindow)
        .expect("a right configuration");
    let mut counts = FrameCounts::default();
    counts.add(LaneId::new(2).expect("in range"), VehicleClass::Bus);
    let mut closed: Vec<_> = Vec::new();
    for second in [0, 20, 40, 60, 120] {
        let time = UtcMs(1_767_600_000_000 + second * 1000);
        closed.extend(match second {
            0..60 => line.observe(time, &counts),
            _ => line.advance(time),
        });
    }
    assert_eq!(closed.len(), 2);
    closed
}

fn settings(port: u16) -> MqttSettings {
    MqttSettings {
        host: "127.0.0.1".into(),
        port,
        client_id: String::new(),
        credentials: None,
        root: "verge/k109f".into(),
        keep_alive: Duration::from_secs(5),
    }
}

fn validate(schema: &str, message: &Value) {
    let path = format!("docs/schemas/{schema}.schema.json");
    let schema: Value =
        serde_json::from_str(&std::fs::read_to_string(path).expect("it ships")).expect("JSON");
    let validator = jsonschema::validator_for(&schema).expect("a right schema");
    let errors: Vec<_> =
        validator.iter_errors(message).map(|e| format!("{}: {e}", e.instance_path)).collect();
    assert!(errors.is_empty(), "{errors:#?} in {message:#}");
}

fn health() -> payload::Health<'static> {
    payload::Health {
        site: "k109f",
        time: "2026-01-05T08:00:00.000Z".into(),
        version: "0.1.0",
        status: "oK",
        alarm: None,
        uptime_s: 5,
        clock_synced: true,
        frames: payload::Frames::default(),
        stream: payload::Stream::default(),
        messages: payload::Messages::default(),
        board: payload::Board { pace: "full", ..payload::Board::default() },
        stage_faults: 0,
        last_fault: None,
    }
}

#[test]
fn messages_arrive_in_order_and_match_their_schemas() {
    let port = loopback::start_broker().expect("a broker");
    let mut subscriber = Subscriber::connect(port, "verge/#").expect("a subscription");
    let mut publisher = Publisher::start(settings(port), Format::Json, identity());
    for report in windows() {
        publisher.density(&report, true);
    }
    publisher.health(&health());
    publisher.alarm(
        "no_picture",
        &payload::Alarm {
            site: "k109f",
            time: "2026-01-05T08:00:00.000Z".into(),
            name: "no_picture",
            active: true,
        },
    );
    publisher.stop();
    let mut topics = Vec::new();
    let mut seqs = Vec::new();
    while topics.last().is_none_or(|topic| topic != "presence shutdown") {
        let (topic, bytes) = subscriber.next(PATIENCE).expect("all messages arrive");
        let topic = topic.strip_prefix("verge/k109f/").expect("the site's root").to_owned();
        if topic == "presence" {
            let state = String::from_utf8(bytes).expect("text");
            validate("presence", &state.clone().into());
            topics.push(format!("{topic} {state}"));
            continue;
        }
        let message: Value = serde_json::from_slice(&bytes).expect("JSON");
        match topic.split('/').next() {
            Some("density") => {
                validate("density", &message);
                seqs.push(message["seq"].as_u64());
                let empty = message["from"] == "2026-01-05T08:01:00.000Z";
                assert_eq!(message["lanes"][1]["density_veh_km"].is_null(), empty, "{message:#}");
            }
            Some(schema @ ("health" | "alarm")) => validate(schema, &message),
            _ => panic!("unexpected topic {topic}"),
        }
        topics.push(topic);
    }
    assert_eq!(seqs, [Some(1), Some(2)]);
    let expected = [
        "presence online",
        "density/60s",
        "density/60s",
        "health",
        "alarm/no_picture",
        "presence shutdown",
    ];
    assert_eq!(topics, expected);
}

#[test]
fn postcard_messages_decode_to_what_was_measured() {
    let port = loopback::start_broker().expect("a broker");
    let mut subscriber = Subscriber::connect(port, "verge/+/density/#").expect("a subscription");
    let mut publisher = Publisher::start(settings(port), Format::Postcard, identity());
    let reports = windows();
    for report in &reports {
        publisher.density(report, false);
    }
    for report in &reports {
        let (_, bytes) = subscriber.next(PATIENCE).expect("it arrives");
        assert_eq!(&wire::decode(&bytes).expect("a right message").report, report);
    }
    publisher.stop();
}

#[test]
fn what_was_measured_while_the_broker_was_away_arrives_later() {
    let free = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
    let port = free.local_addr().expect("its address").port();
    drop(free);
    let Some(mosquitto) = Mosquitto::installed() else { return };
    let mut publisher = Publisher::start(settings(port), Format::Json, identity());
    let reports = windows();
    publisher.density(&reports[0], true);
    std::thread::sleep(Duration::from_millis(500));
    let mut broker = mosquitto.start(port);
    let mut subscriber = Subscriber::connect(port, "verge/+/density/#").expect("a subscription");
    let seq = |subscriber: &mut Subscriber| {
        let (_, bytes) = subscriber.next(PATIENCE).expect("it arrives");
        let message: Value = serde_json::from_slice(&bytes).expect("JSON");
        message["seq"].as_u64().expect("a number")
    };
    assert_eq!(seq(&mut subscriber), 1);
    broker.kill();
    publisher.density(&reports[1], true);
    std::thread::sleep(Duration::from_millis(500));
    let _broker = mosquitto.start(port);
    let mut subscriber = Subscriber::connect(port, "verge/+/density/#").expect("a subscription");
    // The first may come again: its acknowledgement can have died with the broker.
    let mut arrived = seq(&mut subscriber);
    if arrived == 1 {
        arrived = seq(&mut subscriber);
    }
    assert_eq!(arrived, 2);
    publisher.stop();
}

/// Debian's broker, on a port of this machine, ended with the value.
struct Mosquitto {
    program: &'static str,
}

impl Mosquitto {
    fn installed() -> Option<Self> {
        let program = ["/usr/sbin/mosquitto", "/usr/local/sbin/mosquitto"]
            .into_iter()
            .find(|path| Path::new(path).exists());
        if program.is_none() {
            common::skip("mosquitto is not installed");
        }
        program.map(|program| Self { program })
    }

    fn start(&self, port: u16) -> Running {
        let child = Command::new(self.program)
            .args(["-p", &port.to_string()])
            .stderr(Stdio::null())
            .spawn()
            .expect("mosquitto starts");
        let running = Running(child);
        let started = Instant::now();
        while TcpStream::connect((Ipv4Addr::LOCALHOST, port)).is_err() {
            assert!(started.elapsed() < PATIENCE, "mosquitto does not listen");
            std::thread::sleep(Duration::from_millis(20));
        }
        running
    }
}

struct Running(Child);

impl Running {
    fn kill(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.kill();
    }
}

#[test]
fn mosquitto_sub_receives_what_the_daemon_publishes() {
    let Some(mosquitto) = Mosquitto::installed() else { return };
    let free = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
    let port = free.local_addr().expect("its address").port();
    drop(free);
    let _broker = mosquitto.start(port);
    let mut subscription = Command::new("mosquitto_sub")
        .args(["-p", &port.to_string(), "-v", "-t", "verge/k109f/#"])
        .stdout(Stdio::piped())
        .spawn()
        .map(Running)
        .expect("mosquitto_sub starts");
    let folder = folder();
    let config = folder.path().join("verge.toml");
    let here = std::env::current_dir().expect("a working directory");
    let here = here.display();
    let text = format!(
        "site = \"k109f\"\n[camera]\nid = \"curve\"\ninterval_s = 1\n\
         source = \"{here}/{}\"\n\
         [model]\nfile = \"{here}/{}\"\n[lane_table]\nfile = \"{here}/{}\"\n\
         [windows]\nlengths_s = [10]\n[mqtt]\nport = {port}\n",
        common::STREET_FRAMES,
        common::MODEL,
        common::STREET_TABLE
    );
    std::fs::write(&config, text).expect("writing the configuration");
    let daemon = Command::new(env!("CARGO_BIN_EXE_verge"))
        .args(["run", "--config", config.to_str().expect("UTF-8")])
        .stderr(Stdio::null())
        .spawn()
        .map(Running)
        .expect("the daemon starts");
    let lines = BufReader::new(subscription.0.stdout.take().expect("piped")).lines();
    let mut seen = Vec::new();
    for line in lines.map(|line| line.expect("UTF-8")) {
        let (topic, message) = line.split_once(' ').expect("topic and message");
        match topic.strip_prefix("verge/k109f/").expect("the site's root") {
            "presence" => validate("presence", &message.into()),
            "health" => validate("health", &serde_json::from_str(message).expect("JSON")),
            "density/10s" => {
                let message: Value = serde_json::from_str(message).expect("JSON");
                validate("density", &message);
                let lane = &message["lanes"][0];
                assert!(lane["frames_used"].as_u64() >= Some(8), "{message:#}");
                seen.push("density");
                // The daemon is told to stop and says goodbye.
                let id = daemon.0.id().to_string();
                Command::new("kill").args(["-TERM", &id]).status().expect("kill runs");
            }
            other => panic!("unexpected topic {other}"),
        }
        seen.push(if message == "shutdown" { "shutdown" } else { "message" });
        if message == "shutdown" {
            break;
        }
    }
    assert!(seen.contains(&"density") && seen.contains(&"shutdown"), "{seen:?}");
}
