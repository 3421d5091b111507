//! Our boxes against ONNX Runtime's, computed independently by `reference_detector.py`.

mod common;

use serde_json::Value;
use std::path::Path;
use std::process::Command;
use verge::daemon::capture::decode;
use verge::daemon::detect::{Detector, Precision, forms};
use verge::daemon::flow::{Picture, PixelBox};

/// How far two boxes of one vehicle may lie apart: overlap and score.
type Apart = (f32, f64);
const FLOAT: Apart = (0.98, 0.01);
/// In int8 a sum that falls on the other side of a step moves all that follows it: ONNX
/// Runtime with and without its optimisations differs from itself by up to 0.1 in score.
const INT8: Apart = (0.85, 0.12);
/// The threshold of both; boxes this close to it may be on either side.
const THRESHOLD: f64 = 0.3;

type Boxes = Vec<(PixelBox, f64)>;

fn boxes(lines: &str) -> Vec<Boxes> {
    let read = |line: &str| {
        let frame: Value = serde_json::from_str(line).expect("JSON Lines");
        let number = |value: &Value| value.as_f64().expect("a number");
        frame["boxes"]
            .as_array()
            .expect("boxes")
            .iter()
            .map(|b| {
                let side = |i: usize| number(&b[i]) as f32;
                let bounds = PixelBox { x0: side(0), y0: side(1), x1: side(2), y1: side(3) };
                (bounds, number(&b[4]))
            })
            .collect()
    };
    lines.lines().map(read).collect()
}

/// Every box of `these` that is clearly over the threshold has its like in `those`.
fn assert_contained(these: &Boxes, those: &Boxes, frame: usize, (iou, apart): Apart) {
    for (bounds, score) in these.iter().filter(|(_, score)| *score > THRESHOLD + apart) {
        let alike = |(other, its): &&(PixelBox, f64)| {
            bounds.iou(other) >= iou && (score - its).abs() <= apart
        };
        assert!(those.iter().find(alike).is_some(), "frame {frame}: {bounds:?} {score}");
    }
}

/// The weights as they ship, in floats.
#[test]
fn our_models_boxes_agree_with_onnx_runtimes() {
    let folder = common::folder();
    let model = folder.path().join("float.onnx");
    let shipped = Path::new("models/verge_nanodet_640x480.onnx");
    std::fs::write(&model, forms(shipped).expect("it ships").float).expect("writing a model");
    agree(common::MODEL, Precision::Float, &model, ("5", "0,1,2,3,4"), FLOAT);
}

#[test]
#[ignore = "a far vehicle of 15x8 px in the first frame differs by more; not understood yet"]
fn our_models_boxes_in_int8_agree_with_onnx_runtimes() {
    let model = Path::new("models/verge_nanodet_640x480.onnx");
    agree(common::MODEL, Precision::AsStored, model, ("5", "0,1,2,3,4"), INT8);
}

#[test]
fn the_coco_models_boxes_agree_with_onnx_runtimes() {
    let model = "models/nanodet_plus_m/nanodet_plus_m_coco_640x480.onnx";
    let Some(model) = common::shared(model) else { return };
    agree(common::COCO_MODEL, Precision::AsStored, &model, ("80", "2,3,5,7"), FLOAT);
}

/// Our boxes of the PNG files in `folder`, in the order of their names.
fn ours(sidecar: &str, precision: Precision, folder: &Path) -> Vec<Boxes> {
    let mut detector = Detector::load_as(Path::new(sidecar), Some(THRESHOLD as f32), precision)
        .expect("a model that is known");
    println!("{sidecar}: {}", detector.runs_on());
    let mut names: Vec<_> = std::fs::read_dir(folder)
        .expect("it was made")
        .map(|entry| entry.expect("an entry").path())
        .collect();
    names.sort();
    let (mut picture, mut found) = (Picture::default(), Vec::new());
    let mut boxes = |path: &std::path::PathBuf| {
        decode(&std::fs::read(path).expect("a frame"), &mut picture).expect("a whole frame");
        detector.detect(&picture, &mut found).expect("inference");
        found.iter().map(|d| (d.bounds, f64::from(d.score))).collect()
    };
    names.iter().map(&mut boxes).collect()
}

/// Both search some frames of the simulated street.
fn agree(
    sidecar: &str,
    precision: Precision,
    model: &Path,
    (columns, vehicles): (&str, &str),
    apart: Apart,
) {
    let has = Command::new("python3").args(["-c", "import onnxruntime, numpy, PIL"]).output();
    if !has.is_ok_and(|output| output.status.success()) {
        common::skip("python3 with onnxruntime, numpy and pillow is not installed");
        return;
    }
    // PNG, so that both decode the same pixels.
    let folder = common::folder();
    let frames = std::fs::read_dir(common::STREET_FRAMES).expect("it ships");
    let mut frames: Vec<_> = frames.map(|entry| entry.expect("an entry").path()).collect();
    frames.sort();
    for path in frames.iter().step_by(13) {
        let picture = image::open(path).expect("a whole frame");
        let name = Path::new(path.file_stem().expect("a name")).with_extension("png");
        picture.save(folder.path().join(name)).expect("writing a frame");
    }
    let folder_name = folder.path().to_str().expect("UTF-8");
    let ours = ours(sidecar, precision, folder.path());
    let theirs = Command::new("python3")
        .args(["tests/reference_detector.py", &model.to_string_lossy(), folder_name])
        .args([columns, vehicles])
        .output()
        .expect("python3 starts");
    assert!(theirs.status.success(), "{}", common::stderr(&theirs));
    let theirs = boxes(std::str::from_utf8(&theirs.stdout).expect("UTF-8"));
    assert_eq!((ours.len(), theirs.len()), (7, 7));
    let total: usize = ours.iter().map(Vec::len).sum();
    assert!(total > 40, "{total} boxes");
    for (frame, (ours, theirs)) in ours.iter().zip(&theirs).enumerate() {
        assert_contained(ours, theirs, frame, apart);
        assert_contained(theirs, ours, frame, apart);
    }
}
