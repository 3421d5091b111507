//! What the end-to-end tests share: where data lies, and how a test says that it is skipped.
#![allow(dead_code, reason = "each test file uses its own part")]

pub mod mosquitto;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The model that tests use, through its sidecar.
pub const MODEL: &str = "models/verge_nanodet_640x480.toml";
/// The COCO model that it is compared with, through its sidecar.
pub const COCO_MODEL: &str = "models/nanodet_plus_m_coco_640x480.toml";
/// A recording of the simulated street, and its lane table.
pub const STREET_FRAMES: &str = "tests/data/curve/frames";
/// See [`STREET_FRAMES`].
pub const STREET_TABLE: &str = "tests/data/curve.lut";
/// The lane table of the paper's camera.
pub const K109F_TABLE: &str = "tests/data/k109f.lut";

/// Says that a test is skipped. With `VERGE_NO_SKIP=1`, as in CI, that is a failure.
pub fn skip(reason: &str) {
    eprintln!("skipped: {reason}");
    let refused = std::env::var_os("VERGE_NO_SKIP").is_some_and(|value| value == "1");
    assert!(!refused, "VERGE_NO_SKIP=1, and this test was skipped: {reason}");
}

/// The shared data beside the project, or a skip. Never a failure: it is not part of the
/// project and no machine can install it.
pub fn shared(path: &str) -> Option<PathBuf> {
    let path = Path::new("../shared").join(path);
    if path.exists() {
        return Some(path);
    }
    eprintln!("skipped: {} is not there", path.display());
    None
}

/// The recorded frames of the paper's camera.
pub fn k109f_frames() -> Option<PathBuf> {
    shared("data/k109f/camera_calibration/K109F/images")
}

/// Runs verge in the project's folder.
pub fn verge(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_verge")).args(args).output().expect("the program starts")
}

/// What a program wrote to standard error.
pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A folder for a test, removed with the value.
pub fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// A JPEG of stripes around one level: a picture that has something to see.
pub fn jpeg(width: u32, height: u32, grey: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    let stripe = |u: u32, v: u32| if (u / 8 + v / 16).is_multiple_of(2) { 0 } else { 60 };
    let level = |u, v| image::Rgb([grey.saturating_add(stripe(u, v)); 3]);
    let picture = image::RgbImage::from_fn(width, height, level);
    image::codecs::jpeg::JpegEncoder::new(&mut bytes)
        .encode_image(&picture)
        .expect("encoding to memory");
    bytes
}
