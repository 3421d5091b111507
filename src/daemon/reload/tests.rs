//! A new configuration takes over in the running sensor.
#![cfg(feature = "demo")]

use super::*;
use crate::daemon::assemble::open_line;
use crate::daemon::clock;
use crate::daemon::line::Line;
use crate::daemon::publish::loopback::start_broker;
use crate::daemon::sensor::rig::{Arrived, Bench, TABLE, subscribe, write_config};
use crate::lane::{self, LaneTable, Name};
use crate::units::ImagePoint;
use std::fs;

/// The table of the recording under another calibration's name.
fn other_table() -> Vec<u8> {
    other_table_from(0)
}

/// The same with no lane above that row.
fn other_table_from(row: u16) -> Vec<u8> {
    let table = LaneTable::parse(fs::read(TABLE).expect("it ships")).expect("a right table");
    let mut description = table.description().clone();
    description.calibration_id = Name::try_from("second").expect("short");
    let mut bytes = vec![0; lane::encoded_len(&description, None)];
    let cell = |u: u16, v: u16| {
        let point = ImagePoint { u: f32::from(u) + 0.5, v: f32::from(v) + 0.5 };
        table.place(point).filter(|_| v >= row)
    };
    let len = lane::encode(&description, None, cell, &mut bytes).expect("a right table");
    bytes.truncate(len);
    bytes
}

#[test]
fn every_window_is_measured_whole_by_the_old_or_by_the_new_configuration() {
    let port = start_broker().expect("a broker");
    let mut subscriber = subscribe(port);
    let mut bench = Bench::start(port);
    bench.pass(90);
    // In the middle of windows of both lengths, and not of the same picture.
    fs::write(bench.folder.path().join("table.lut"), other_table()).expect("writing it");
    write_config(bench.folder.path(), port, "[home_assistant]\ndiscovery = true\n");
    bench.reload().expect("it is right");
    let at = bench.sensor.pending().expect("it waits").at();
    assert_eq!(at, UtcMs(1_767_600_120_000), "the end of the minute");
    bench.pass(100);
    assert!(bench.sensor.pending().is_none() && bench.sensor.config().home_assistant.discovery);
    let end = clock::now();
    bench.stop();
    let mut arrived = Arrived::default();
    arrived.read(&mut subscriber);
    assert_eq!(arrived.check(end), Some(at));
    assert!(arrived.health.iter().all(|health| health["last_fault"].is_null()));
}

#[test]
fn what_is_broken_is_refused_and_changes_nothing() {
    let port = start_broker().expect("a broker");
    let mut subscriber = subscribe(port);
    let mut bench = Bench::start(port);
    bench.pass(30);
    let folder = bench.folder.path().to_owned();
    let (config, table) = (folder.join("verge.toml"), folder.join("table.lut"));
    let right = fs::read_to_string(&config).expect("it was written");
    let mut damaged = fs::read(&table).expect("it was written");
    let middle = damaged.len() / 2;
    damaged[middle] ^= 1;
    let changed = |from: &str, to: &str| {
        let text = right.replacen(from, to, 1);
        assert_ne!(text, right, "{from}");
        text
    };
    for (text, bytes, expected) in [
        (changed("[camera]", "[camera"), None, "verge.toml"),
        (changed("lengths_s = [20, 60]", "lengths_s = [7]"), None, "windows.lengths_s"),
        (changed("id = \"curve\"", "id = \"other\""), None, "give the table of this camera"),
        (changed("640x480.toml", "1x1.toml"), None, "1x1.toml"),
        (changed("table.lut", "none.lut"), None, "none.lut"),
        (changed("curve/frames", "curve/nothing"), None, "curve/nothing"),
        (changed("\"bench\"", "\"other\""), None, "restart verge"),
        (changed("[mqtt]", "[mqtt]\nroot = \"a/b\""), None, "mqtt.root"),
        (changed("[mqtt]", "[spool]\nfolder = \"b\"\n[mqtt]"), None, "spool.folder"),
        (changed("[mqtt]", "[mqtt]\ntls = true\nca_file = \"ca.pem\""), None, "ca.pem"),
        (right.clone(), Some(damaged), "table.lut"),
    ] {
        fs::write(&config, text).expect("writing it");
        if let Some(bytes) = bytes {
            fs::write(&table, bytes).expect("writing it");
        }
        let reason = bench.reload().expect_err(expected);
        assert!(reason.contains(expected), "{expected}: {reason}");
        bench.pass(5);
        assert!(bench.sensor.pending().is_none());
    }
    bench.pass(60);
    fs::copy(TABLE, &table).expect("it ships");
    bench.reload().expect("mended");
    bench.pass(60);
    let end = clock::now();
    bench.stop();
    let mut arrived = Arrived::default();
    arrived.read(&mut subscriber);
    assert_eq!(arrived.check(end), None, "never another calibration");
    let told = arrived.health.iter().filter_map(|health| health["last_fault"].as_str());
    let told: Vec<_> = told.collect();
    assert!(told.iter().any(|fault| fault.contains("table.lut")), "{told:?}");
    let last = arrived.health.last().expect("there were some");
    assert!(last["last_fault"].is_null(), "mended: {last:#}");
}

#[test]
fn another_broker_gets_what_the_old_one_did_not() {
    let (port, other) = (start_broker().expect("a broker"), start_broker().expect("a broker"));
    let (mut first, mut second) = (subscribe(port), subscribe(other));
    let mut bench = Bench::start(port);
    bench.pass(90);
    write_config(bench.folder.path(), other, "keep_alive_s = 20\nreplay_per_s = 100\n");
    bench.reload().expect("it is right");
    bench.pass(150);
    let end = clock::now();
    bench.stop();
    let mut arrived = Arrived::default();
    arrived.read(&mut first);
    let before = arrived.windows["20s"].len();
    arrived.read(&mut second);
    arrived.check(end);
    assert!((1..arrived.windows["20s"].len()).contains(&before), "both have had windows");
}

/// The configuration with views of the road.
fn config_with_views(folder: &Path) -> (PathBuf, Config) {
    write_config(folder, 1, "");
    let path = folder.join("verge.toml");
    let text = fs::read_to_string(&path).expect("it was written");
    let text = text.replacen("[model]\n", "[model]\nviews = \"auto\"\n", 1);
    fs::write(&path, text).expect("writing it");
    let config = Config::read(&path).expect("a right configuration");
    (path, config)
}

#[test]
fn a_new_table_brings_new_views() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let table = folder.path().join("table.lut");
    let (path, config) = config_with_views(folder.path());
    let load = || Candidate::load(&path, &config).expect("it can take over").assembly.line;
    let before = load();
    fs::write(&table, other_table_from(185)).expect("writing it");
    let after = load();
    let regions = |line: &Line| line.parts().of((320, 240));
    let (before, after) = (regions(&before), regions(&after));
    assert_eq!((before.len(), after.len()), (2, 1), "{after:?}: no far part is left");
    assert!(after[0].y > before[0].y, "{before:?} {after:?}");
}

#[test]
fn views_that_are_too_slow_for_the_interval_become_one() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (_, config) = config_with_views(folder.path());
    let mut line = open_line(&config).expect("what it names is there");
    line.keep_within(Duration::from_secs(3600)).expect("inference");
    assert_eq!(line.parts().count(), 2);
    line.keep_within(Duration::from_micros(10)).expect("inference");
    assert_eq!(line.parts().count(), 1);
}

#[test]
fn a_storm_of_requests_is_one_reload() {
    let port = start_broker().expect("a broker");
    let mut bench = Bench::start(port);
    bench.asked.store(true, Ordering::Relaxed);
    let begun = bench.reload.outcome(bench.sensor.config());
    assert!(matches!(begun, Some(Outcome::Begun)));
    (0..9).for_each(|_| bench.asked.store(true, Ordering::Relaxed));
    let (begun_again, outcome) = bench.await_outcome();
    assert_eq!((begun_again, outcome), (1, Ok(())), "the files may have changed in between");
    assert!(bench.reload.outcome(bench.sensor.config()).is_none());
    // A later one replaces the one that waits; a broken one does not.
    let at = bench.sensor.pending().map(Pending::at);
    fs::write(bench.folder.path().join("verge.toml"), "nonsense").expect("writing it");
    bench.reload().expect_err("broken");
    assert_eq!(bench.sensor.pending().map(Pending::at), at);
    bench.stop();
}

#[test]
fn the_change_comes_when_all_windows_end() {
    for (lengths_s, seconds) in [
        (&[60, 900][..], 900),
        (&[10], 10),
        (&[300, 900, 60], 900),
        (&[600, 900], 1800),
        (&[20, 30], 60),
    ] {
        assert_eq!(common_period(lengths_s), Duration::from_secs(seconds), "{lengths_s:?}");
    }
}
