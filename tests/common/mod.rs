//! Shared by the end-to-end tests: where data lies, and running the program.
#![allow(dead_code, reason = "each test file uses its own part")]

pub mod mosquitto;
pub mod packets;

use std::path::PathBuf;
use std::process::{Command, Output};
pub use verge_desk::{shared, skip};

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

/// The recorded frames of the paper's camera.
pub fn k109f_frames() -> Option<PathBuf> {
    shared("data/k109f/camera_calibration/K109F/images")
}

/// Runs verge in the project's folder.
pub fn verge(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_verge")).args(args).output().expect("the program starts")
}

/// The standard error of a finished program.
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
