//! Shared by the tests: the tiny scene and scratch folders.

use std::path::PathBuf;

use street::scene::Scene;

/// The scene for fast tests.
#[allow(dead_code)] // not every test binary parses it
pub fn tiny(changes: &[&str]) -> Scene {
    let changes: Vec<String> = changes.iter().map(|change| (*change).to_owned()).collect();
    Scene::parse(include_str!("../../scenes/tiny.toml"), "tiny.toml", &changes)
        .expect("the tiny scene is valid")
}

/// An empty folder of this test, under the target folder.
#[allow(dead_code)] // not every test binary writes files
pub fn scratch(test: &str) -> PathBuf {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(test);
    if path.exists() {
        std::fs::remove_dir_all(&path).expect("an old scratch folder can be removed");
    }
    std::fs::create_dir_all(&path).expect("a scratch folder can be made");
    path
}
