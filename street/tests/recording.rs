//! A recording on disk: the same seed gives the same bytes, and it is whole or absent.

mod support;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use street::error::Error;
use street::recording;
use verge_desk::{Exit, Failure};

fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry")) {
        let name = entry.file_name().to_string_lossy().into_owned();
        if entry.path().is_dir() {
            for (inner, bytes) in files(&entry.path()) {
                found.insert(format!("{name}/{inner}"), bytes);
            }
        } else {
            found.insert(name, fs::read(entry.path()).expect("a file"));
        }
    }
    found
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let base = support::scratch("same_seed");
    let scene = support::tiny(&["light.rain=0.5", "light.daylight=dusk", "faults.shake_px=2.0"]);
    for (name, seed) in [("a", 5), ("b", 5), ("c", 6)] {
        recording::write(&scene, 3, seed, &base.join(name)).expect("a recording");
    }
    let (a, b, c) = (files(&base.join("a")), files(&base.join("b")), files(&base.join("c")));
    assert_eq!(a.len(), 3 + 4, "{:?}", a.keys());
    assert!(a == b, "the same seed gave other bytes");
    for name in ["truth.jsonl", "frames/20260105T080001.000Z.jpg"] {
        assert_ne!(a[name], c[name], "{name} does not depend on the seed");
    }
    assert_eq!(a["calibration.json"], c["calibration.json"]);
}

#[test]
fn a_folder_with_something_in_it_is_refused_and_left_alone() {
    let base = support::scratch("not_empty");
    fs::write(base.join("precious"), "1").expect("a file");
    let fault = recording::write(&support::tiny(&[]), 1, 1, &base).expect_err("not empty");
    assert!(matches!(fault, Error::Desk(Failure::Occupied { .. })), "{fault}");
    assert_eq!(fault.exit_code(), 73);
    assert_eq!(files(&base).len(), 1);
}

#[test]
fn a_failed_recording_leaves_nothing() {
    let base = support::scratch("nowhere");
    let out = base.join("missing").join("out");
    let fault = recording::write(&support::tiny(&[]), 1, 1, &out).expect_err("no parent");
    assert!(matches!(fault, Error::Desk(Failure::Write { .. })), "{fault}");
    assert!(files(&base).is_empty());
}
