//! Each head that verge knows, on a tiny net of `reference_heads.py`, against ONNX Runtime.

mod common;

use std::path::Path;
use std::process::Command;
use verge::daemon::detect::Detector;
use verge::daemon::frame::{Detection, Picture, PixelBox};
use verge::units::VehicleClass;

const SIZE: [usize; 2] = [128, 64];

/// A picture with something in it everywhere.
fn picture() -> Picture {
    let [width, height] = SIZE;
    let value = |u: usize, v: usize, c: usize| ((u * 7 + v * 13 + c * 50) ^ (u * v / 9)) as u8;
    let pixel = |i: usize| [0, 1, 2].map(|c| value(i % width, i / width, c));
    Picture { width, height, rgb: (0..width * height).flat_map(pixel).collect() }
}

fn expected(path: &Path) -> Vec<(PixelBox, f32, VehicleClass)> {
    let text = std::fs::read_to_string(path).expect("it was written");
    let rows: Vec<[f32; 6]> = serde_json::from_str(&text).expect("rows");
    let classes = [VehicleClass::Car, VehicleClass::Van, VehicleClass::Bus];
    let one = |row: [f32; 6]| {
        let [x0, y0, x1, y1, score, class] = row;
        (PixelBox { x0, y0, x1, y1 }, score, classes[class as usize])
    };
    rows.into_iter().map(one).collect()
}

/// Every box has its like, with the same class.
fn assert_alike(name: &str, found: &[Detection], expected: &[(PixelBox, f32, VehicleClass)]) {
    // Half precision rounds scores, and may lift one over the threshold.
    let (apart, off, missing) = if name == "half" { (0.01, 0.5, 2) } else { (1e-4, 0.02, 0) };
    let near = |a: &PixelBox, b: &PixelBox| {
        [(a.x0, b.x0), (a.y0, b.y0), (a.x1, b.x1), (a.y1, b.y1)]
            .iter()
            .all(|(a, b)| (a - b).abs() < off)
    };
    let lonely = expected.iter().filter(|(bounds, score, class)| {
        !found.iter().any(|d| {
            near(&d.bounds, bounds) && (d.score - score).abs() < apart && d.class == *class
        })
    });
    let lonely: Vec<_> = lonely.collect();
    assert!(lonely.len() <= missing, "{name}: not found {lonely:?} in {found:?}");
    assert!(found.len().abs_diff(expected.len()) <= missing, "{name}: {}", found.len());
}

#[test]
fn each_head_finds_the_boxes_of_onnx_runtime() {
    let folder = common::folder();
    let (picture, path) = (picture(), folder.path().join("picture.png"));
    let [width, height] = SIZE.map(|side| side as u32);
    image::save_buffer(&path, &picture.rgb, width, height, image::ColorType::Rgb8)
        .expect("writing a picture");
    let packages = ["-c", "import onnx, onnxruntime, numpy, PIL"];
    let has = Command::new("python3").args(packages).output();
    if !has.is_ok_and(|output| output.status.success()) {
        common::skip("python3 with onnx, onnxruntime, numpy and pillow is not installed");
        return;
    }
    let made = Command::new("python3")
        .arg("tests/reference_heads.py")
        .args([folder.path(), &path])
        .output()
        .expect("python3 starts");
    assert!(made.status.success(), "{}", common::stderr(&made));
    for name in [
        "nanodet",
        "guessed",
        "external",
        "dynamic",
        "half",
        "picodet",
        "yolox",
        "yolox_decoded",
        "yolov5",
        "yolov8",
        "end2end",
    ] {
        let mut detector = Detector::load(&folder.path().join(name).with_extension("toml"), None)
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        let mut found = Vec::new();
        detector.detect(&picture, &mut found).expect(name);
        let expected = expected(&folder.path().join(name).with_extension("json"));
        println!("{name}: {} boxes, {}", found.len(), detector.runs_on());
        assert!(expected.len() > 3, "{name}: {}", expected.len());
        assert_alike(name, &found, &expected);
    }
}
