//! Models that must not measure: damaged files, numbers that run away, another net.

mod common;

use std::fs;
use std::path::PathBuf;
use verge::daemon::detect::Detector;

const NAME: &str = "verge_nanodet_640x480";

/// The shipped model and its sidecar in a folder of their own, the sidecar changed.
fn model(folder: &std::path::Path, from: &str, to: &str) -> PathBuf {
    let text = fs::read_to_string(common::MODEL).expect("it ships");
    let changed = text.replacen(from, to, 1);
    assert!(from == to || changed != text, "{from}");
    fs::copy(format!("models/{NAME}.onnx"), folder.join(format!("{NAME}.onnx"))).expect("a copy");
    let path = folder.join(format!("{NAME}.toml"));
    fs::write(&path, changed).expect("writing a sidecar");
    path
}

fn refusal(from: &str, to: &str) -> String {
    let folder = common::folder();
    let path = model(folder.path(), from, to);
    match Detector::load(&path, None) {
        Ok(_) => panic!("{to} passed"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn a_sidecar_that_blinds_the_net_fails_the_known_picture() {
    // Each of these loads, and finds nothing or nonsense.
    for (from, to) in [
        ("mean = [103.53, 116.28, 123.675]", "mean = [100000.0, 100000.0, 100000.0]"),
        ("std = [57.375, 57.12, 58.395]", "std = [0.5, 0.5, 0.5]"),
        ("strides = [8, 16, 32, 64]", "strides = [8, 16, 32, 32]"),
    ] {
        let error = refusal(from, to);
        assert!(error.contains("failed its test") || error.contains("has the shape"), "{error}");
    }
}

#[test]
fn numbers_that_are_none_are_refused() {
    let error = refusal("mean = [103.53", "mean = [nan");
    assert!(error.contains("input.mean"), "{error}");
}

#[test]
fn a_hash_in_capitals_is_the_same_hash() {
    let folder = common::folder();
    let text = fs::read_to_string(common::MODEL).expect("it ships");
    let start = text.find("sha256 = \"").expect("a hash") + 10;
    let hash = &text[start..start + 64];
    let path = model(folder.path(), hash, &hash.to_uppercase());
    Detector::load(&path, None).expect("the same model");
}

/// Damage that the hash would find is let through, so that the reader of files is met.
#[test]
fn a_damaged_file_is_refused_or_passes_the_known_picture() {
    let bytes = fs::read(format!("models/{NAME}.onnx")).expect("it ships");
    let text = fs::read_to_string(common::MODEL).expect("it ships");
    let start = text.find("sha256 = \"").expect("a hash") + 10;
    let mut refused = 0;
    for (place, bit) in [(20, 1), (1000, 7), (40_000, 6), (300_000, 7), (1_363_000, 6)] {
        let folder = common::folder();
        let mut damaged = bytes.clone();
        damaged[place] ^= 1 << bit;
        fs::write(folder.path().join(format!("{NAME}.onnx")), &damaged).expect("writing a model");
        let digest =
            verge::daemon::detect::inspect(&folder.path().join(format!("{NAME}.onnx")), None);
        let Ok(inspection) = digest else {
            refused += 1;
            continue;
        };
        let mut changed = text.clone();
        changed.replace_range(start..start + 64, &inspection.sha256);
        let path = folder.path().join(format!("{NAME}.toml"));
        fs::write(&path, changed).expect("writing a sidecar");
        refused += usize::from(Detector::load(&path, None).is_err());
    }
    println!("{refused} of 5 refused");
    assert!(refused > 0);
}
