//! `verge-detector check` on the model that ships: what it says, and that the sidecar which it
//! writes is one that verge takes.

use std::path::{Path, PathBuf};
use std::process::Command;
use verge::daemon::detect::Detector;

/// The shipped model alone, in a folder of its own.
fn model() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("model_check");
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder");
    let shipped =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/verge_nanodet_640x480.onnx");
    let model = folder.join("brought.onnx");
    std::fs::copy(shipped, &model).expect("the model that ships");
    model
}

fn check(model: &Path) -> String {
    let done = Command::new(env!("CARGO_BIN_EXE_verge-detector"))
        .arg("check")
        .arg(model)
        .output()
        .expect("verge-detector starts");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    String::from_utf8(done.stdout).expect("UTF-8")
}

#[test]
fn it_says_what_it_recognises_and_its_sidecar_loads() {
    let model = model();
    let said = check(&model);
    for part in ["640x480 px", "nanodet-plus with 5 classes", "int8 kernels", "100.0 %"] {
        assert!(said.contains(part), "{part:?} is not in\n{said}");
    }
    assert!(!said.contains("in tract"), "the kernels know all of it:\n{said}");
    let sidecar = model.with_extension("toml");
    let detector = Detector::load(&sidecar, None).expect("a sidecar to start from");
    assert_eq!(detector.input_size(), [640, 480]);

    std::fs::write(&sidecar, "mine").expect("a sidecar of somebody's");
    assert!(check(&model).contains("there is one beside the model"));
    assert_eq!(std::fs::read_to_string(&sidecar).expect("it stays"), "mine");
}
