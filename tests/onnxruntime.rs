//! Our boxes against ONNX Runtime's, computed independently by `reference_detector.py`.

mod common;

use serde_json::Value;
use std::path::Path;
use std::process::Command;
use verge::daemon::capture::decode;
use verge::daemon::detect::{Detector, LoadOptions, Precision};
use verge::daemon::frame::{Picture, PixelBox};

/// How far two boxes of one vehicle may lie apart in floats: overlap and score.
const OVERLAP: f32 = 0.98;
const APART: f64 = 0.01;
/// The threshold of both; boxes this close to it may be on either side.
const THRESHOLD: f64 = 0.3;

/// Score columns, which of them are vehicles, and the overlaps from which the better box stays:
/// over the union and over the smaller.
type Reading = [&'static str; 4];
const OURS: Reading = ["5", "0,1,2,3,4", "0.5", "0.8"];
const COCO: Reading = ["80", "2,3,5,7", "0.6", "1"];

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

/// The box of `those` that covers the most of `bounds`, with the overlap.
fn nearest(bounds: &PixelBox, those: &Boxes) -> (f32, f64) {
    those
        .iter()
        .map(|(other, score)| (bounds.iou(other), *score))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .unwrap_or((0.0, 0.0))
}

/// Boxes of `these` that are clearly over the threshold, each beside its like in `those`:
/// overlap, score, score of the other.
fn paired(these: &[Boxes], those: &[Boxes], margin: f64) -> Vec<(f32, f64, f64)> {
    let clear = move |(_, score): &&(PixelBox, f64)| *score > THRESHOLD + margin;
    let frames = these.iter().zip(those);
    frames
        .flat_map(|(these, those)| {
            these.iter().filter(clear).map(|(bounds, score)| {
                let (overlap, other) = nearest(bounds, those);
                (overlap, *score, other)
            })
        })
        .collect()
}

/// Every box of each has its like in the other.
fn assert_alike(ours: &[Boxes], theirs: &[Boxes]) {
    for (overlap, score, other) in
        [paired(ours, theirs, APART), paired(theirs, ours, APART)].concat()
    {
        assert!(
            overlap >= OVERLAP && (score - other).abs() <= APART,
            "a box of score {score}: its like has score {other} and overlaps by {overlap}"
        );
    }
}

/// The weights as they ship, in floats.
#[test]
fn our_models_boxes_agree_with_onnx_runtimes() {
    let folder = common::folder();
    let model = folder.path().join("float.onnx");
    if !has("onnxruntime, numpy, PIL, onnx") {
        return;
    }
    let written = Command::new("python3")
        .args(["src/daemon/commands/forms.py", "models/verge_nanodet_640x480.onnx"])
        .args([&model, &folder.path().join("early.onnx")])
        .output()
        .expect("python3 starts");
    assert!(written.status.success(), "{}", common::stderr(&written));
    let Some((ours, theirs)) = both(common::MODEL, Precision::Float, &model, OURS) else {
        return;
    };
    assert_alike(&ours, &theirs);
}

/// In int8 two runtimes never agree box by box: a sum that lies between two steps falls to
/// either side, and each layer doubles the bytes that differ (docs/measured/inference.md). What
/// must hold is that ours scatter about theirs, without leaning to one side.
#[test]
fn our_models_boxes_in_int8_scatter_about_onnx_runtimes() {
    let model = Path::new("models/verge_nanodet_640x480.onnx");
    let Some((ours, theirs)) = both(common::MODEL, Precision::AsStored, model, OURS) else {
        return;
    };
    for (these, those) in [(&ours, &theirs), (&theirs, &ours)] {
        let pairs = paired(these, those, 0.1);
        let mean = |of: fn(&(f32, f64, f64)) -> f64| {
            pairs.iter().map(of).sum::<f64>() / pairs.len() as f64
        };
        let (lean, apart) = (mean(|p| p.1 - p.2), mean(|p| (p.1 - p.2).abs()));
        let overlap = mean(|p| f64::from(p.0));
        println!("{} boxes: score {lean:+.4}, apart {apart:.4}, overlap {overlap:.3}", pairs.len());
        assert!(lean.abs() < 0.01 && apart < 0.02 && overlap > 0.9);
        assert!(pairs.iter().all(|p| p.0 > 0.5), "a vehicle that the other did not find");
    }
}

#[test]
fn the_coco_models_boxes_agree_with_onnx_runtimes() {
    let model = "models/nanodet_plus_m/nanodet_plus_m_coco_640x480.onnx";
    let Some(model) = common::shared(model) else { return };
    let Some((ours, theirs)) = both(common::COCO_MODEL, Precision::AsStored, &model, COCO) else {
        return;
    };
    assert_alike(&ours, &theirs);
}

/// A graph that our kernels do not know runs in tract.
#[test]
fn a_model_in_tract_finds_the_boxes_of_onnx_runtime() {
    let Some(model) = common::shared("models/yolox_nano/yolox_nano_coco_640x480.onnx") else {
        return;
    };
    let sidecar = "models/yolox_nano_coco_640x480.toml";
    let Some((ours, theirs)) = both(sidecar, Precision::AsStored, &model, COCO) else {
        return;
    };
    assert_alike(&ours, &theirs);
}

/// Our boxes of the PNG files in `folder`, in the order of their names.
fn ours(sidecar: &str, precision: Precision, folder: &Path) -> Vec<Boxes> {
    let score = Some(THRESHOLD as f32);
    let options = LoadOptions { score, precision, ..LoadOptions::default() };
    let mut detector =
        Detector::load_as(Path::new(sidecar), &options).expect("a model that is known");
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

/// Whether python3 has these packages; says so where it lacks one.
fn has(packages: &str) -> bool {
    let has = Command::new("python3").args(["-c", &format!("import {packages}")]).output();
    let has = has.is_ok_and(|output| output.status.success());
    if !has {
        common::skip(&format!("python3 lacks one of {packages}"));
    }
    has
}

/// Both search some frames of the simulated street; `None` without ONNX Runtime.
fn both(
    sidecar: &str,
    precision: Precision,
    model: &Path,
    reading: Reading,
) -> Option<(Vec<Boxes>, Vec<Boxes>)> {
    if !has("onnxruntime, numpy, PIL") {
        return None;
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
        .args(reading)
        .output()
        .expect("python3 starts");
    assert!(theirs.status.success(), "{}", common::stderr(&theirs));
    let theirs = boxes(std::str::from_utf8(&theirs.stdout).expect("UTF-8"));
    assert_eq!((ours.len(), theirs.len()), (7, 7));
    let total: usize = ours.iter().map(Vec::len).sum();
    assert!(total > 40, "{total} boxes");
    Some((ours, theirs))
}
