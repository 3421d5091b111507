//! An upgrade from 0.1.0 keeps its configuration, its lane table (format 1) and the windows in its
//! spool (wire format 1). `tests/data/v0.1.0` is as 0.1.0 wrote it.

mod common;
#[path = "common/fake_broker.rs"]
mod fake_broker;

use fake_broker::{FakeBroker, Manners};
use serde_json::Value;
use std::fs;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const PATIENCE: Duration = Duration::from_secs(60);

#[test]
fn configuration_table_and_spool_of_0_1_0_go_on() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name);
    let broker = FakeBroker::start(Manners::default());

    // The keys that a site must set; all others are as 0.1.0 shipped them.
    let configuration = fs::read_to_string("tests/data/v0.1.0/verge.toml").expect("it ships");
    let here = env!("CARGO_MANIFEST_DIR");
    let mut set = configuration.clone();
    for (from, to) in [
        ("site = \"k109f\"", "site = \"old\"".to_owned()),
        ("http://127.0.0.1:8080/snapshot.jpg", format!("{here}/tests/data/curve/frames")),
        ("interval_s = 120", "interval_s = 1".to_owned()),
        ("\"k109f.lut\"", format!("\"{here}/tests/data/k109f.lut\"")),
        ("lengths_s = [300, 900]", "lengths_s = [60, 900]".to_owned()),
        ("#port = 1883", format!("port = {}", broker.port)),
    ] {
        let next = set.replacen(from, &to, 1);
        assert_ne!(next, set, "{from}");
        set = next;
    }
    fs::write(path("verge.toml"), set).expect("written");
    fs::create_dir(path("spool")).expect("a folder");
    for entry in fs::read_dir("tests/data/v0.1.0/spool").expect("it ships") {
        let from = entry.expect("an entry").path();
        let to = path("spool").join(from.file_name().expect("a name"));
        let mut bytes = fs::read(&from).expect("a segment");
        // A segment is written with zeros to its end, which are left out here.
        bytes.resize(256 * 1024, 0);
        fs::write(to, bytes).expect("written");
    }

    let mut sensor = Command::new(env!("CARGO_BIN_EXE_verge"))
        .args(["run", "--config"])
        .arg(path("verge.toml"))
        .env_remove("STATE_DIRECTORY")
        .stderr(Stdio::piped())
        .spawn()
        .expect("verge");
    // Two windows of 0.1.0 were acknowledged, three wait.
    let began = Instant::now();
    while broker.windows() < 3 && began.elapsed() < PATIENCE {
        assert_eq!(sensor.try_wait().expect("a child"), None, "it has ended");
        std::thread::sleep(Duration::from_millis(50));
    }
    sensor.kill().expect("it runs");
    let output = sensor.wait_with_output().expect("it ended");
    let said = String::from_utf8_lossy(&output.stderr);

    let mut arrived: Vec<(String, u64, Value)> = broker.seen(|seen| {
        let windows = seen.taken.iter().filter(|(topic, payload)| {
            topic.starts_with("verge/old/replay/density/") && !payload.is_empty()
        });
        let read = |(topic, payload): &(String, Vec<u8>)| {
            let message: Value = serde_json::from_slice(payload).expect("JSON");
            (topic.clone(), message["seq"].as_u64().expect("a number"), message)
        };
        windows.map(read).collect()
    });
    arrived.sort_by(|a, b| (&a.0, a.1).cmp(&(&b.0, b.1)));
    let numbers: Vec<(&str, u64)> = arrived
        .iter()
        .map(|(topic, seq, _)| (topic.rsplit('/').next().unwrap_or(""), *seq))
        .collect();
    assert_eq!(numbers, [("15min", 2), ("60s", 9), ("60s", 10)], "{said}");
    let lane = |index: usize, lane: usize| &arrived[index].2["lanes"][lane];
    assert_eq!(lane(1, 0)["density_veh_km"], 14.5);
    assert_eq!(lane(1, 1)["density_veh_km"], Value::Null, "what was not known stays so");
    assert_eq!(lane(1, 1)["status"], "sensorFailure");
    assert_eq!(lane(2, 1)["density_veh_km"], 100.0);
    for added in ["cells", "density_ci90"] {
        assert_eq!(lane(2, 1)[added], Value::Null, "0.1.0 did not measure {added}");
    }
}
