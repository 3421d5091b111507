//! The net on this processor's vector instructions against the portable kernels.

mod common;

use std::path::{Path, PathBuf};
use verge::daemon::capture::decode;
use verge::daemon::detect::{Detector, LoadOptions, Precision};
use verge::daemon::frame::{Detection, Picture};

/// Low, so that weak cells are compared too.
const SCORE: f32 = 0.05;

fn load(precision: Precision) -> Detector {
    let options = LoadOptions { score: Some(SCORE), precision, ..LoadOptions::default() };
    Detector::load_as(Path::new(common::MODEL), &options).expect("it ships")
}

/// Frames of both recordings of the street.
fn frames() -> Vec<PathBuf> {
    let mut frames: Vec<PathBuf> = ["tests/data/curve/frames", "tests/data/freeway/frames"]
        .into_iter()
        .flat_map(|folder| std::fs::read_dir(folder).expect("it ships"))
        .map(|entry| entry.expect("an entry").path())
        .collect();
    frames.sort();
    frames
}

fn read(path: &Path, picture: &mut Picture) {
    decode(&std::fs::read(path).expect("it ships"), picture).expect("a whole frame");
}

fn found(detector: &mut Detector, picture: &Picture) -> Vec<Detection> {
    let mut found = Vec::new();
    detector.detect(picture, &mut found).expect("inference");
    found
}

#[test]
fn a_hundred_pictures_give_the_same_boxes_as_on_the_portable_kernels() {
    let (mut fast, mut portable) = (load(Precision::AsStored), load(Precision::Portable));
    println!("{} against {}", fast.runs_on(), portable.runs_on());
    assert!(fast.runs_on().starts_with("int8 kernels"), "{}", fast.runs_on());
    assert!(portable.runs_on().ends_with("portable"), "{}", portable.runs_on());
    let mut picture = Picture::default();
    let (mut pictures, mut boxes) = (0, 0);
    for path in frames().iter().take(100) {
        read(path, &mut picture);
        let ours = found(&mut fast, &picture);
        assert_eq!(ours, found(&mut portable, &picture), "{}", path.display());
        (pictures, boxes) = (pictures + 1, boxes + ours.len());
    }
    assert_eq!(pictures, 100);
    assert!(boxes > 1000, "{boxes} boxes");
}
