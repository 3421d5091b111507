//! What the training does to pictures, checked by `training_pictures.py`.
//!
//! Runs where python3 (or VERGE_PYTHON) has OpenCV and ONNX Runtime; else says so and passes, and
//! fails under VERGE_NO_SKIP=1.

use std::path::Path;
use std::process::Command;
use verge_desk::skip;

#[test]
fn training_pictures_are_what_their_boxes_say() {
    let python = std::env::var("VERGE_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let has = Command::new(&python).args(["-c", "import cv2, numpy, onnx, onnxruntime"]).output();
    if !has.is_ok_and(|output| output.status.success()) {
        return skip(
            "python3 has no OpenCV or ONNX Runtime (pip install opencv-python-headless onnxruntime onnx)",
        );
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/training_pictures.py");
    let done = Command::new(python).arg(script).output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
}
