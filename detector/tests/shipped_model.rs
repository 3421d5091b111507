//! The model that ships: small enough, as its sidecar says, and the same numbers in tract as in
//! ONNX Runtime.
//!
//! The comparison runs where python3 (or VERGE_PYTHON) has onnxruntime; else it says so and
//! passes, and fails under VERGE_NO_SKIP=1.

use std::path::{Path, PathBuf};
use std::process::Command;
use tract_onnx::prelude::*;

const MODEL: &str = "verge_nanodet_640x480";
const SIZE_LIMIT: u64 = 2_000_000;

fn model() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../models").join(format!("{MODEL}.onnx"))
}

/// A made street: grey road, a gradient, bright rectangles; 3 x 480 x 640, normalised.
fn input() -> Vec<f32> {
    let mut values = Vec::with_capacity(3 * 480 * 640);
    for channel in 0..3 {
        for v in 0..480 {
            for u in 0..640 {
                let road = 90.0 + v as f32 / 8.0;
                let car = (u / 40 + v / 30) % 5 == 0 && u % 40 > 8 && v % 30 > 8;
                let value = if car { 230.0 - 60.0 * channel as f32 } else { road };
                values.push((value - 114.0) / 57.0);
            }
        }
    }
    values
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

#[test]
fn tract_computes_what_onnx_runtime_computes() {
    let values = input();
    let tensor = tract_ndarray::Array4::from_shape_vec((1, 3, 480, 640), values.clone()).unwrap();
    let plan = tract_onnx::onnx()
        .model_for_path(model())
        .unwrap()
        .into_optimized()
        .unwrap()
        .into_runnable()
        .unwrap();
    let outputs = plan.run(tvec!(tensor.into_tensor().into())).unwrap();
    let output = outputs[0].to_plain_array_view::<f32>().unwrap();
    assert_eq!(output.shape(), [1, 6380, 5 + 32]);
    let scores =
        output.rows().into_iter().flat_map(|row| row.iter().take(5).copied().collect::<Vec<_>>());
    assert!(scores.clone().all(|score| (0.0..=1.0).contains(&score)));

    let python = std::env::var("VERGE_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let has = Command::new(&python).args(["-c", "import onnxruntime, numpy"]).output();
    if !has.is_ok_and(|output| output.status.success()) {
        let reason = "python3 has no onnxruntime (pip install onnxruntime)";
        assert!(std::env::var_os("VERGE_NO_SKIP").is_none(), "VERGE_NO_SKIP is set, but {reason}");
        eprintln!("SKIPPED: {reason}");
        return;
    }
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let (from, to) = (folder.join("input.f32"), folder.join("output.f32"));
    std::fs::write(&from, values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>())
        .unwrap();
    let script = "import sys, numpy as np, onnxruntime as ort\n\
        x = np.fromfile(sys.argv[2], '<f4').reshape(1, 3, 480, 640)\n\
        s = ort.InferenceSession(sys.argv[1], providers=['CPUExecutionProvider'])\n\
        s.run(None, {'data': x})[0].astype('<f4').tofile(sys.argv[3])\n";
    let run =
        Command::new(python).args(["-c", script]).args([&model(), &from, &to]).output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let bytes = std::fs::read(&to).unwrap();
    let reference = bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b));
    let far = output.iter().zip(reference).map(|(a, b)| (a - b).abs()).fold(0.0f32, f32::max);
    assert!(far < 2e-3, "largest difference {far}");
}
