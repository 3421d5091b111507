//! `docs/reference/asyncapi.json` says what is published: every topic that comes, and no schema
//! that is not used. That it is the one generated from the types is `messages/tests`'s to check.
#![cfg(feature = "demo")]

use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::time::Duration;
use verge::daemon::outlet::Outlet;
use verge::daemon::publish::loopback::{self, Subscriber};
use verge::daemon::publish::{Format, Identity, MqttSettings, payload};
use verge::density::{Cells, DensityError, LaneReport, SampleZoneStatus, WindowReport};
use verge::lane::{LaneTable, Name};
use verge::sensor::ClosedWindow;
use verge::units::{Direction, LaneId, UtcMs};
use verge::wire::{CalibrationRef, ModelRef};
use verge_messages::Alarm;

const ROOT: &str = "verge/k109f";

fn document() -> Value {
    let text = fs::read_to_string("docs/reference/asyncapi.json").expect("it ships");
    serde_json::from_str(&text).expect("JSON")
}

/// Follows a `$ref` inside the document; any other value is returned as it is.
fn resolved<'a>(document: &'a Value, value: &'a Value) -> &'a Value {
    match value.get("$ref").and_then(Value::as_str).and_then(|path| path.strip_prefix('#')) {
        Some(path) => document.pointer(path).unwrap_or_else(|| panic!("nothing at {path}")),
        None => value,
    }
}

fn entries<'a>(value: &'a Value, key: &str) -> impl Iterator<Item = (&'a String, &'a Value)> {
    value[key].as_object().unwrap_or_else(|| panic!("{key} is an object")).iter()
}

/// The file with a message's schema.
fn schema_file(message: &Value) -> &str {
    let file = message["payload"]["schema"]["$ref"].as_str().expect("a schema of its own");
    file.strip_prefix("./").expect("beside the document")
}

#[test]
fn the_document_is_whole() {
    let document = document();
    assert_eq!(document["asyncapi"], "3.0.0");
    for field in ["title", "version"] {
        assert!(document["info"][field].is_string(), "info.{field} is required");
    }
    let mut used = BTreeSet::new();
    for (name, channel) in entries(&document, "channels") {
        let address = channel["address"].as_str().expect("an address");
        let named: BTreeSet<&str> = address
            .split('/')
            .filter_map(|part| part.strip_prefix('{')?.strip_suffix('}'))
            .collect();
        let described = entries(channel, "parameters").map(|(name, _)| name.as_str()).collect();
        assert_eq!(named, described, "{name}: the address's parameters");
        for (_, parameter) in entries(channel, "parameters") {
            assert!(resolved(&document, parameter)["description"].is_string(), "{name}");
        }
        for (_, message) in entries(channel, "messages") {
            used.insert(schema_file(resolved(&document, message)).to_owned());
        }
    }
    let there: BTreeSet<String> = fs::read_dir("docs/reference/schemas")
        .expect("it ships")
        .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
        .map(|name| format!("schemas/{name}"))
        .collect();
    assert_eq!(used, there, "schemas that channels use, and schemas that are there");
    let mut sent = BTreeSet::new();
    for (name, operation) in entries(&document, "operations") {
        assert_eq!(operation["action"], "send", "{name}: the sensor subscribes to nothing");
        let binding = &resolved(&document, &operation["bindings"])["mqtt"];
        assert_eq!(binding["qos"], 1, "{name}");
        assert!(binding["retain"].is_boolean(), "{name}");
        sent.insert(operation["channel"]["$ref"].as_str().expect("a channel").to_owned());
    }
    let channels: BTreeSet<_> =
        entries(&document, "channels").map(|(name, _)| format!("#/channels/{name}")).collect();
    assert_eq!(sent, channels, "every channel has its operation");
}

/// The channel that a topic belongs to.
fn channel_of(document: &Value, topic: &str) -> String {
    let topic = topic.strip_prefix(ROOT).expect("the site's root");
    let matches = |address: &str| {
        let address = address.strip_prefix("{root}").expect("all stand under the root");
        let (mut address, mut topic) = (address.split('/'), topic.split('/'));
        address.by_ref().zip(topic.by_ref()).all(|(a, t)| a == t || a.starts_with('{'))
            && address.next().is_none()
            && topic.next().is_none()
    };
    let mut found =
        entries(document, "channels").filter(|(_, c)| matches(c["address"].as_str().expect("one")));
    let (name, _) = found.next().unwrap_or_else(|| panic!("no channel for {topic}"));
    assert!(found.next().is_none(), "two channels for {topic}");
    name.clone()
}

fn report() -> WindowReport {
    let lane = LaneReport {
        lane: LaneId::new(1).expect("in range"),
        direction: Direction::Away,
        density_veh_km: Some(20.0),
        density_se: Some(2.0),
        vehicles_mean: Some(2.0),
        by_class: Some([0.0; 6]),
        space_occupancy: Some(0.1),
        length_m: 100.0,
        frames_used: 60,
        frames_expected: 60,
        status: SampleZoneStatus::Ok,
        cells: Some(Cells {
            length_m: 50.0,
            density_veh_km: Some([40.0, 0.0].into_iter().collect()),
        }),
        error: Some(DensityError { calibration: 1.0, counting: 2.0, ci90: [15.0, 25.0] }),
        traffic: None,
    };
    let (from, to) = (UtcMs(1_767_600_000_000), UtcMs(1_767_600_060_000));
    WindowReport { from, to, lanes: [lane].into_iter().collect() }
}

/// The port of a door to `broker`, and what opens it: until then nobody gets an answer there.
fn door(broker: u16) -> (u16, impl FnOnce()) {
    let listener = TcpListener::bind(("127.0.0.1", 0)).expect("a free port");
    let port = listener.local_addr().expect("bound").port();
    let copy = |mut from: TcpStream, mut to: TcpStream| {
        std::thread::spawn(move || std::io::copy(&mut from, &mut to));
    };
    let open = move || {
        std::thread::spawn(move || {
            for visitor in listener.incoming().map_while(Result::ok) {
                let inside = TcpStream::connect(("127.0.0.1", broker)).expect("it listens");
                let twin = |stream: &TcpStream| stream.try_clone().expect("a second handle");
                copy(twin(&visitor), twin(&inside));
                copy(inside, visitor);
            }
        });
    };
    (port, open)
}

#[test]
fn what_is_published_stands_in_the_document() {
    let document = document();
    let port = loopback::start_broker().expect("a broker");
    let mut subscriber = Subscriber::connect(port, "#").expect("a subscription");
    let table = fs::read("tests/data/k109f.lut").expect("it ships");
    let table = LaneTable::parse(table).expect("a right table");
    let model = ModelRef { name: Name::try_from("test").expect("short"), sha256: [7; 32] };
    let identity = Identity::new("k109f", &model);
    let calibration = &CalibrationRef::of(table.description());
    let window = ClosedWindow { report: &report(), calibration };
    let (door, open) = door(port);
    let mut outlet = Outlet::in_memory(MqttSettings::local(door, ROOT), Format::Json, identity);
    // Before there is a session, and in one: replayed and live.
    outlet.density(window, true);
    open();
    while outlet.counts().waiting > 0 {
        outlet.tend();
        std::thread::sleep(Duration::from_millis(10));
    }
    outlet.density(window, true);
    let publisher = outlet.publisher();
    let time = verge_messages::Utc(1_767_600_000_000);
    publisher.health(&payload::Health {
        schema: payload::Schema::default(),
        site: "k109f".into(),
        time,
        version: "0.1.0".into(),
        status: verge_messages::Status::Ok,
        alarm: None,
        uptime_s: 5,
        clock_synced: true,
        frames: payload::Frames::default(),
        stream: payload::Stream::default(),
        camera: None,
        traffic: None,
        board: payload::Board {
            enclosure_c: None,
            pace: payload::Pace::Full,
            faults: payload::BoardFaults::default(),
            last_fault: None,
        },
        stage_faults: 0,
        messages: payload::Messages::default(),
        certificate_days: Some(300),
        node_windows_lost: Some(0),
        last_fault: None,
    });
    publisher.alarm(&payload::AlarmMessage {
        schema: payload::Schema::default(),
        site: "k109f".into(),
        time,
        name: Alarm::NoPicture,
        active: true,
    });
    outlet.stop();
    let mut seen = BTreeSet::new();
    loop {
        let (topic, bytes) = subscriber.next(Duration::from_secs(20)).expect("all messages arrive");
        let name = channel_of(&document, &topic);
        let (_, message) =
            entries(&document["channels"][&name], "messages").next().expect("one message");
        let file = schema_file(resolved(&document, message));
        let schema = fs::read_to_string(Path::new("docs/reference").join(file)).expect("it ships");
        let schema = serde_json::from_str(&schema).expect("JSON");
        let text = String::from_utf8(bytes).expect("text");
        let payload = if name == "presence" {
            Value::from(text.clone())
        } else {
            serde_json::from_str(&text).expect("JSON")
        };
        let validator = jsonschema::validator_for(&schema).expect("a right schema");
        let errors: Vec<_> = validator.iter_errors(&payload).map(|e| e.to_string()).collect();
        assert!(errors.is_empty(), "{topic}: {errors:#?}");
        seen.insert(name);
        if text == "shutdown" {
            break;
        }
    }
    let seen: Vec<_> = seen.iter().map(String::as_str).collect();
    assert_eq!(seen, ["alarm", "density", "health", "presence", "replay"]);
}
