//! How a test says that it cannot run here. For tests alone.

use std::path::{Path, PathBuf};

/// Says that a test is skipped. Under `VERGE_NO_SKIP=1`, as in CI, that is a failure; any other
/// value, and none, lets tests skip.
///
/// # Panics
/// Under `VERGE_NO_SKIP=1`.
pub fn skip(reason: &str) {
    eprintln!("skipped: {reason}");
    let refused = std::env::var_os("VERGE_NO_SKIP").is_some_and(|value| value == "1");
    assert!(!refused, "VERGE_NO_SKIP=1, and this test cannot run here: {reason}");
}

/// A file or folder of the shared data beside the project, or a [`skip`].
///
/// # Panics
/// As [`skip`].
pub fn shared(path: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared");
    let found = folder.canonicalize().ok().map(|folder| folder.join(path)).filter(|p| p.exists());
    if found.is_none() {
        skip(&format!("../shared/{path} is not there"));
    }
    found
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    /// The test that skips, in a process of its own: the environment is the process's.
    #[test]
    fn only_1_forbids_a_skip() {
        for (value, passes) in
            [(None, true), (Some("0"), true), (Some(""), true), (Some("1"), false)]
        {
            let mut child = Command::new(std::env::current_exe().unwrap());
            child.args(["--exact", "skip::tests::child_skips", "--ignored"]);
            child.env_remove("VERGE_NO_SKIP");
            if let Some(value) = value {
                child.env("VERGE_NO_SKIP", value);
            }
            let output = child.output().unwrap();
            let said = String::from_utf8_lossy(&output.stdout);
            assert!(said.contains("running 1 test"), "{said}");
            assert_eq!(output.status.success(), passes, "VERGE_NO_SKIP={value:?}: {said}");
        }
    }

    #[test]
    #[ignore = "run by only_1_forbids_a_skip"]
    fn child_skips() {
        assert_eq!(super::shared("no/such/file"), None);
    }
}
