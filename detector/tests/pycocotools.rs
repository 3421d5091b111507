//! The figures of `eval` against pycocotools, on a made fixture with every hard case in it:
//! ties, crowd boxes, more than 100 detections in a frame, every size, empty frames.
//!
//! Runs where python3 (or VERGE_PYTHON) has pycocotools; else says so and passes, and fails
//! under VERGE_NO_SKIP=1.

use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use verge_desk::skip;

struct Random(u64);

impl Random {
    fn share(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.share()
    }
}

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

fn fixture(folder: &Path) {
    let mut random = Random(20260101);
    let (mut truth, mut detections) = (String::new(), String::new());
    for frame in 0..40 {
        let name = format!("f{frame:02}.png");
        image::RgbImage::from_pixel(640, 480, image::Rgb([120; 3]))
            .save(folder.join(&name))
            .unwrap();
        let vehicle_count = if frame % 7 == 0 { 0 } else { 1 + (random.share() * 12.0) as usize };
        let (mut vehicles, mut boxes) = (Vec::new(), Vec::new());
        for _ in 0..vehicle_count {
            let side = random.within(2.0, 5.3).exp();
            let (x, y) = (random.within(0.0, 440.0), random.within(0.0, 280.0));
            let bounds = [x, y, x + side, y + side * random.within(0.6, 1.2)];
            let crowd = random.share() < 0.1;
            vehicles.push(json!({"class": "car", "box": bounds, "crowd": crowd}));
            for _ in 0..(random.share() * 3.0) as usize {
                let mut near = bounds;
                for value in &mut near {
                    *value += random.within(-0.13, 0.13) * side;
                }
                if near[2] > near[0] && near[3] > near[1] {
                    // Two digits, so that scores tie across frames.
                    let score = (random.within(0.2, 1.0) * 100.0).round() / 100.0;
                    boxes.push(json!([near[0], near[1], near[2], near[3], score, "car"]));
                }
            }
        }
        let stray_count = if frame == 5 { 150 } else { (random.share() * 8.0) as usize };
        for _ in 0..stray_count {
            let (x, y) = (random.within(0.0, 500.0), random.within(0.0, 400.0));
            let side = random.within(4.0, 120.0);
            let score = (random.within(0.0, 0.8) * 100.0).round() / 100.0;
            boxes.push(json!([x, y, x + side, y + side, score, "truck"]));
        }
        truth += &format!("{}\n", json!({"frame": name, "vehicles": vehicles}));
        detections += &format!("{}\n", json!({"frame": name, "boxes": boxes}));
    }
    fs::write(folder.join("truth.jsonl"), truth).unwrap();
    fs::write(folder.join("detections.jsonl"), detections).unwrap();
}

#[test]
fn eval_equals_pycocotools() {
    let folder = folder("pycocotools");
    fixture(&folder);
    let python = std::env::var("VERGE_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let has = Command::new(&python).args(["-c", "import pycocotools"]).output();
    if !has.is_ok_and(|output| output.status.success()) {
        return skip("python3 has no pycocotools (pip install pycocotools)");
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/reference_eval.py");
    let reference = Command::new(python)
        .arg(script)
        .args([folder.join("truth.jsonl"), folder.join("detections.jsonl")])
        .output()
        .unwrap();
    assert!(reference.status.success(), "{}", String::from_utf8_lossy(&reference.stderr));
    let reference: Value = serde_json::from_slice(&reference.stdout).unwrap();
    let ours = Command::new(env!("CARGO_BIN_EXE_verge-detector"))
        .args(["eval", "--json", "--at-precision", "0"])
        .args([Path::new("--truth"), &folder, Path::new("--detections")])
        .arg(folder.join("detections.jsonl"))
        .output()
        .unwrap();
    assert!(ours.status.success(), "{}", String::from_utf8_lossy(&ours.stderr));
    let ours: Value = serde_json::from_slice(&ours.stdout).unwrap();
    for slice in ["all", "small", "medium", "large"] {
        for (field, theirs) in
            [("ap50", "ap50"), ("ap50_95", "ap50_95"), ("recall_at_precision", "largest_recall")]
        {
            let (a, b) = (&ours[slice][field], &reference[slice][theirs]);
            let (a, b) = (a.as_f64().unwrap(), b.as_f64().unwrap());
            assert!((a - b).abs() < 1e-6, "{slice} {field}: {a}, pycocotools {b}");
            assert!(b > 0.05 && b < 0.99, "{slice} {field}: the fixture is too easy: {b}");
        }
    }
}
