//! The command line: exit codes and messages.

mod support;

use std::process::Command;

fn street(arguments: &[&str]) -> (Option<i32>, String) {
    let output =
        Command::new(env!("CARGO_BIN_EXE_street")).args(arguments).output().expect("it runs");
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn exit_codes_follow_sysexits() {
    let base = support::scratch("exit_codes");
    let tiny = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/tiny.toml");
    let out = base.join("out").display().to_string();
    assert_eq!(street(&["record"]).0, Some(64));
    assert_eq!(street(&["--help"]).0, Some(0));
    let (code, said) =
        street(&["record", "--scene", "nowhere.toml", "--frames", "1", "--out", &out]);
    assert_eq!(code, Some(66), "{said}");
    assert!(said.contains("nowhere.toml"), "{said}");
    let bad =
        ["record", "--scene", tiny, "--frames", "1", "--set", "camera.height_m=0", "--out", &out];
    let (code, said) = street(&bad);
    assert_eq!(code, Some(65), "{said}");
    assert!(said.contains("camera.height_m"), "{said}");
    let good = ["record", "--scene", tiny, "--frames", "1", "--out", &out];
    assert_eq!(street(&good), (Some(0), String::new()));
    let (code, said) = street(&good);
    assert_eq!(code, Some(73), "{said}");
    assert!(said.contains("not empty"), "{said}");
}
