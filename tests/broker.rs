//! Messages as they arrive at a broker: the embedded one, and Debian's mosquitto where installed.
#![cfg(feature = "demo")]

mod common;

use common::folder;
use common::mosquitto::{Mosquitto, Running};
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use verge::daemon::outlet::Outlet;
use verge::daemon::publish::loopback::{self, Subscriber};
use verge::daemon::publish::{
    Format, Identity, MqttSettings, MqttVersion, Tls, TlsFiles, payload, probe,
};
use verge::density::{Aggregator, Start, WindowReport};
use verge::lane::LaneTable;
use verge::sensor::ClosedWindow;
use verge::units::{LaneId, UtcMs, VehicleClass};
use verge::wire::{self, CalibrationRef, ModelRef};
use verge_desk::free_port;
use verge_messages::{Alarm, Status, Utc};

const PATIENCE: Duration = Duration::from_secs(20);
const MINUTE: Duration = Duration::from_secs(60);

fn table() -> LaneTable<Vec<u8>> {
    LaneTable::parse(std::fs::read(common::K109F_TABLE).expect("it ships")).expect("a right table")
}

fn identity() -> Identity {
    let name = verge::lane::Name::try_from("test").expect("short");
    Identity::new("k109f", &ModelRef { name, sha256: [7; 32] })
}

fn accept(outlet: &mut Outlet, report: &WindowReport, clock_synced: bool) {
    let calibration = &CalibrationRef::of(table().description());
    outlet.density(ClosedWindow { report, calibration }, clock_synced);
}

/// A window with vehicles in lane 2, and one in which no picture came.
fn windows() -> Vec<WindowReport> {
    let table = table();
    let (lanes, cell_m) = (&table.description().lanes, table.description().cell_length_m);
    let mut line: Aggregator =
        Aggregator::new(lanes, cell_m, &[MINUTE], MINUTE / 3, 0.5, Start::AtNextWindow)
            .expect("a right configuration");
    let mut counts = line.counts();
    counts.add(LaneId::new(2).expect("in range"), 12.0, VehicleClass::Bus);
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

fn outlet(port: u16, format: Format, version: MqttVersion) -> Outlet {
    let settings = MqttSettings { version, ..MqttSettings::local(port, "verge/k109f") };
    Outlet::in_memory(settings, format, identity())
}

/// Tends the outlet until `done`.
fn tend(outlet: &mut Outlet, what: &str, done: impl Fn(&Outlet) -> bool) {
    let started = Instant::now();
    while !done(outlet) {
        assert!(started.elapsed() < PATIENCE, "{what}");
        outlet.tend();
        std::thread::sleep(Duration::from_millis(10));
    }
}

fn validate(schema: &str, message: &Value) {
    let path = format!("docs/reference/schemas/{schema}.schema.json");
    let schema: Value =
        serde_json::from_str(&std::fs::read_to_string(path).expect("it ships")).expect("JSON");
    let validator = jsonschema::validator_for(&schema).expect("a right schema");
    let errors: Vec<_> =
        validator.iter_errors(message).map(|e| format!("{}: {e}", e.instance_path)).collect();
    assert!(errors.is_empty(), "{errors:#?} in {message:#}");
}

fn health() -> payload::Health {
    payload::Health {
        schema: payload::Schema::default(),
        site: "k109f".into(),
        time: Utc(1_767_600_000_000),
        version: "0.1.0".into(),
        status: Status::Ok,
        alarm: None,
        uptime_s: 5,
        clock_synced: true,
        camera: Some(payload::Camera {
            aim: payload::Aim::InPlace,
            preset: "joint-01020304".into(),
            shift_px: Some([0.4, -1.2]),
            light: Some(payload::Light::Day),
            road_age_s: Some(12),
        }),
        traffic: Some(payload::Following {
            longest_interval_s: 0.5,
            density_difference_veh_km: Some(-0.25),
        }),
        frames: payload::Frames::default(),
        stream: payload::Stream::default(),
        messages: payload::Messages::default(),
        board: payload::Board {
            enclosure_c: None,
            pace: payload::Pace::Full,
            faults: payload::BoardFaults::default(),
            last_fault: None,
        },
        stage_faults: 0,
        certificate_days: Some(300),
        node_windows_lost: Some(0),
        last_fault: None,
    }
}

#[test]
fn messages_arrive_in_order_and_match_their_schemas() {
    let port = loopback::start_broker().expect("a broker");
    let mut subscriber = Subscriber::connect(port, "verge/#").expect("a subscription");
    let mut outlet = outlet(port, Format::Json, MqttVersion::V3);
    tend(&mut outlet, "a session", Outlet::is_open);
    for report in windows() {
        accept(&mut outlet, &report, true);
    }
    outlet.publisher().health(&health());
    outlet.publisher().alarm(&payload::AlarmMessage {
        schema: payload::Schema::default(),
        site: "k109f".into(),
        time: Utc(1_767_600_000_000),
        name: Alarm::NoPicture,
        active: true,
    });
    outlet.stop();
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
    let mut outlet = outlet(port, Format::Postcard, MqttVersion::V3);
    tend(&mut outlet, "a session", Outlet::is_open);
    let reports = windows();
    for report in &reports {
        accept(&mut outlet, report, false);
    }
    for report in &reports {
        let (_, bytes) = subscriber.next(PATIENCE).expect("it arrives");
        assert_eq!(&wire::decode(&bytes).expect("a right message").report, report);
    }
    outlet.stop();
}

/// A window as it arrived: its number, and whether it closed a replay.
fn arrival(subscriber: &mut Subscriber) -> (String, u64, Option<bool>) {
    let (topic, bytes) = loop {
        let (topic, bytes) = subscriber.next(PATIENCE).expect("it arrives");
        if !topic.ends_with("presence") {
            break (topic, bytes);
        }
    };
    let message: Value = serde_json::from_slice(&bytes).expect("JSON");
    validate("density", &message);
    let topic = topic.strip_prefix("verge/k109f/").expect("the site's root").to_owned();
    (topic, message["seq"].as_u64().expect("a number"), message["done"].as_bool())
}

#[test]
fn an_outage_is_replayed_on_its_own_topic() {
    for version in [MqttVersion::V3, MqttVersion::V5] {
        let Some(mosquitto) = Mosquitto::installed() else { return };
        let port = free_port();
        let mut outlet = outlet(port, Format::Json, version);
        let reports = windows();
        accept(&mut outlet, &reports[0], true);
        accept(&mut outlet, &reports[1], true);
        std::thread::sleep(Duration::from_millis(500));
        let mut broker = mosquitto.start(port);
        let mut subscriber = Subscriber::connect(port, "verge/#").expect("a subscription");
        tend(&mut outlet, "replay", |outlet| outlet.counts().waiting == 0);
        let replay = |seq, done| ("replay/density/60s".to_owned(), seq, Some(done));
        assert_eq!(arrival(&mut subscriber), replay(1, false));
        assert_eq!(arrival(&mut subscriber), replay(2, true));
        // Live again, and once more away: what is taken once is not sent again.
        accept(&mut outlet, &reports[0], true);
        tend(&mut outlet, "an acknowledgement", |outlet| outlet.counts().waiting == 0);
        assert_eq!(arrival(&mut subscriber), ("density/60s".to_owned(), 3, None));
        broker.kill();
        tend(&mut outlet, "the end of the session", |outlet| !outlet.is_open());
        accept(&mut outlet, &reports[1], true);
        let _broker = mosquitto.start(port);
        let mut subscriber = Subscriber::connect(port, "verge/#").expect("a subscription");
        tend(&mut outlet, "replay", |outlet| outlet.counts().waiting == 0);
        assert_eq!(arrival(&mut subscriber), replay(4, true));
        outlet.stop();
    }
}

/// A key with a certificate for `name` that the authority has signed, as PEM files.
fn signed(
    folder: &Path,
    name: &str,
    authority: &rcgen::Issuer<'_, rcgen::KeyPair>,
) -> (PathBuf, PathBuf) {
    let key = rcgen::KeyPair::generate().expect("a key");
    let parameters = rcgen::CertificateParams::new([name.to_owned()]).expect("a name");
    let certificate = parameters.signed_by(&key, authority).expect("a certificate");
    let paths = (folder.join(format!("{name}.pem")), folder.join(format!("{name}.key")));
    std::fs::write(&paths.0, certificate.pem()).expect("writing it");
    std::fs::write(&paths.1, key.serialize_pem()).expect("writing it");
    paths
}

/// A certificate authority, and its certificate as a PEM file.
fn authority(folder: &Path, name: &str) -> (rcgen::Issuer<'static, rcgen::KeyPair>, PathBuf) {
    let mut parameters = rcgen::CertificateParams::new([name.to_owned()]).expect("a name");
    parameters.is_ca = rcgen::IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
    parameters.distinguished_name.push(rcgen::DnType::CommonName, name);
    let key = rcgen::KeyPair::generate().expect("a key");
    let certificate = parameters.self_signed(&key).expect("a certificate");
    let path = folder.join(format!("{name}.pem"));
    std::fs::write(&path, certificate.pem()).expect("writing it");
    (rcgen::Issuer::new(parameters, key), path)
}

#[test]
fn tls_with_certificates_of_both_sides() {
    let Some(mosquitto) = Mosquitto::installed() else { return };
    let folder = folder();
    let (ours, ca) = authority(folder.path(), "authority");
    let (_, stranger) = authority(folder.path(), "stranger");
    let (certificate, key) = signed(folder.path(), "localhost", &ours);
    let identity = signed(folder.path(), "box", &ours);
    let port = free_port();
    let text = format!(
        "listener {port} 127.0.0.1\nallow_anonymous true\nrequire_certificate true\n\
         cafile {}\ncertfile {}\nkeyfile {}\n",
        ca.display(),
        certificate.display(),
        key.display()
    );
    let config = folder.path().join("mosquitto.conf");
    std::fs::write(&config, text).expect("writing it");
    // Debian's broker gives up root, and must read its key still.
    #[cfg(unix)]
    for path in [folder.path(), key.as_path()] {
        use std::os::unix::fs::PermissionsExt;
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755)).expect("chmod");
    }
    let _broker = mosquitto.start_with(port, &config);
    for (ca, identity, accepted) in
        [(&ca, Some(&identity), true), (&ca, None, false), (&stranger, Some(&identity), false)]
    {
        for version in [MqttVersion::V3, MqttVersion::V5] {
            let files = TlsFiles { ca: Some(ca.clone()), identity: identity.cloned() };
            let tls = Some(Tls::load(&files).expect("right files"));
            let host = "localhost".into();
            let local = MqttSettings::local(port, "verge/k109f");
            let outcome = probe(&MqttSettings { host, tls, version, ..local }, &[], 2000);
            assert_eq!(outcome.is_ok(), accepted, "{outcome:?}");
        }
    }
    let files = TlsFiles { ca: Some(key.clone()), identity: None };
    let error = Tls::load(&files).expect_err("a key is no certificate").to_string();
    assert!(error.contains("mqtt.ca_file") && error.contains("localhost.key"), "{error}");
}

#[test]
fn mosquitto_sub_receives_what_the_daemon_publishes() {
    let Some(mosquitto) = Mosquitto::installed() else { return };
    let port = free_port();
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
                // The daemon is stopped and disconnects.
                let id = daemon.0.id().to_string();
                Command::new("kill").args(["-TERM", &id]).status().expect("kill runs");
            }
            "latest/10s" => {
                validate("density", &serde_json::from_str(message).expect("JSON"));
                seen.push("latest");
            }
            other => panic!("unexpected topic {other}"),
        }
        seen.push(if message == "shutdown" { "shutdown" } else { "message" });
        if message == "shutdown" {
            break;
        }
    }
    for kind in ["density", "latest", "shutdown"] {
        assert!(seen.contains(&kind), "{kind} is missing: {seen:?}");
    }
    // Who comes later sees the latest window, and no other one.
    let late = Command::new("mosquitto_sub")
        .args(["-p", &port.to_string(), "-v", "-W", "2", "-t", "verge/k109f/#"])
        .output()
        .expect("mosquitto_sub runs");
    let late = String::from_utf8(late.stdout).expect("UTF-8");
    assert!(late.contains("verge/k109f/latest/10s {"), "{late}");
    assert!(!late.contains("/density/"), "{late}");
}

#[test]
fn another_broker_gets_what_the_old_one_did_not() {
    let ports = [(); 2].map(|()| loopback::start_broker().expect("a broker"));
    let mut subscribers =
        ports.map(|port| Subscriber::connect(port, "verge/#").expect("a subscription"));
    let mut outlet = outlet(ports[0], Format::Json, MqttVersion::V3);
    tend(&mut outlet, "a session", Outlet::is_open);
    let reports = windows();
    accept(&mut outlet, &reports[0], true);
    tend(&mut outlet, "delivered", |outlet| outlet.counts().waiting == 0);
    let other = MqttSettings::local(ports[1], "verge/k109f");
    let session = outlet.publisher().session();
    outlet.change(other, Format::Json, identity(), 1000);
    // Until the old broker has heard goodbye, windows still go there.
    tend(&mut outlet, "the other session", |outlet| {
        let now = outlet.publisher().session();
        now.is_some() && now != session
    });
    accept(&mut outlet, &reports[1], true);
    tend(&mut outlet, "delivered", |outlet| outlet.counts().waiting == 0);
    outlet.stop();
    let arrived = subscribers.each_mut().map(|subscriber| {
        let mut numbers = Vec::new();
        while let Some((topic, payload)) = subscriber.next(PATIENCE) {
            if topic.contains("density/") {
                let message: Value = serde_json::from_slice(&payload).expect("JSON");
                numbers.push(message["seq"].as_u64().expect("a number"));
            }
            if payload == b"shutdown" {
                break;
            }
        }
        numbers
    });
    assert_eq!(arrived, [vec![1], vec![2]]);
}
