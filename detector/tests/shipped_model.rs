//! The model that ships: small enough, and the file that its sidecar names. That tract computes
//! what ONNX Runtime computes is the daemon's to test, which owns tract.

use std::path::{Path, PathBuf};
use std::process::Command;

const MODEL: &str = "verge_nanodet_640x480";
const SIZE_LIMIT: u64 = 2_000_000;

fn model() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../models").join(format!("{MODEL}.onnx"))
}

#[test]
fn it_is_small_and_sealed() {
    let path = model();
    let size = std::fs::metadata(&path).unwrap().len();
    assert!(size <= SIZE_LIMIT, "{size} bytes");
    let sidecar = std::fs::read_to_string(path.with_extension("toml")).unwrap();
    let digest = Command::new("sha256sum").arg(&path).output().unwrap();
    let digest = String::from_utf8(digest.stdout).unwrap();
    let digest = digest.split_whitespace().next().unwrap();
    assert!(sidecar.contains(&format!("sha256 = \"{digest}\"")), "the file is {digest}");
}
