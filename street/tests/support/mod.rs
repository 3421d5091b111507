//! Shared by the tests: the tiny scene, scratch folders, and loud skips.

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

/// Says that a test was skipped; with VERGE_NO_SKIP=1 that is a failure.
#[allow(dead_code)] // not every test binary skips
pub fn skip(why: &str) {
    eprintln!("skipped: {why}");
    assert!(std::env::var_os("VERGE_NO_SKIP").is_none_or(|v| v != "1"), "VERGE_NO_SKIP=1: {why}");
}
