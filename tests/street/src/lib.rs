//! Shared by the tests on the simulated street: scenes, lane tables, the program.
//!
//! A package of its own, so that the daemon's tests build neither the simulator nor calibration.

use mvcalib::files::calibration::{Calibration, Sha256};
use mvcalib::files::labelme::LabelFile;
use mvcalib::road::drawn_lane::lanes;
use mvcalib::road::lane_table::table;
use mvcalib::road::scene_reference::{pictures, reference};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use street::recording::{Recorder, calibration};
use street::scene::Scene;
use verge_desk::skip;

/// The model that tests use, through its sidecar.
pub const MODEL: &str = "models/verge_nanodet_640x480.toml";
/// A recording of the simulated street.
pub const STREET_FRAMES: &str = "tests/data/curve/frames";

/// A path of the project.
#[must_use]
pub fn at(path: &str) -> PathBuf {
    let project = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).expect("two above");
    project.join(path)
}

/// A scene as it ships, with changes.
///
/// # Panics
/// On a change that no scene takes.
#[must_use]
pub fn scene(name: &str, changes: &[&str]) -> Scene {
    let path = at(&format!("street/scenes/{name}.toml"));
    let text = std::fs::read_to_string(&path).expect("it ships");
    let changes: Vec<String> = changes.iter().map(|&change| change.to_owned()).collect();
    Scene::parse(&text, &path.to_string_lossy(), &changes).expect("a right scene")
}

/// Parts of a lane table of the street beside its lanes.
#[derive(Clone, Copy, Default)]
pub struct Extras {
    /// Pictures that its reference of the scene is made of; without any it has none.
    pub reference: usize,
    /// Stands for the calibration's hash.
    pub hash: u8,
}

/// The lane table that `mvcalib table` makes for a scene, with cells of about 10 m, as FILE of a
/// folder.
///
/// # Panics
/// Where the scene's lanes make no table.
pub fn write_table(scene: &Scene, folder: &Path, file: &str, extras: Extras) -> PathBuf {
    let camera = folder.join("calibration.json");
    std::fs::write(&camera, calibration(scene).to_string()).expect("writing a file");
    let camera = Calibration::read(&camera, None).expect("a right calibration");
    let mut recorder = Recorder::new(scene, 3).expect("a street");
    let drawn = folder.join("lanes.json");
    let outlines = street::measured::labelme(scene, recorder.street().measured(), "a.jpg");
    std::fs::write(&drawn, outlines.to_string()).expect("writing a file");
    let drawn = LabelFile::read(&drawn).expect("labelme");
    let drawn = lanes(&drawn, "lanes", &camera.camera()).expect("lanes on the road");
    let seen = (extras.reference > 0).then(|| {
        let frames = tempfile::tempdir().expect("a temporary folder");
        for number in 0..extras.reference {
            let jpeg = recorder.next_frame().picture.jpeg(90, "frame").expect("encoding");
            let path = frames.path().join(format!("{number}.jpg"));
            std::fs::write(path, jpeg).expect("writing a frame");
        }
        reference(&pictures(frames.path()).expect("frames"), &[]).expect("a clear scene").1
    });
    let hash = Sha256([extras.hash; 32]);
    let bytes = table(&camera, &drawn, hash, "street", seen.as_ref(), 10.0).expect("a right table");
    let path = folder.join(file);
    std::fs::write(&path, bytes).expect("writing the table");
    path
}

/// Runs the `verge` that cargo has built beside this test, in the project's folder; `None`, and
/// the test skips, where it is not built.
///
/// # Panics
/// Under `VERGE_NO_SKIP=1` where it is not built.
pub fn verge(args: &[&str]) -> Option<Output> {
    let test = std::env::current_exe().expect("a path");
    let program = test.ancestors().nth(2).expect("two above").join("verge");
    if !program.is_file() {
        skip("the program `verge` is not built beside this test: run `cargo build` first");
        return None;
    }
    Some(Command::new(program).args(args).current_dir(at("")).output().expect("the program starts"))
}
