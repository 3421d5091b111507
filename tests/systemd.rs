//! The unit file and the rules beside it, held against systemd where it is installed.

mod common;

use std::fs;
use std::process::{Command, Output};

const UNIT: &str = "boards/linux/verge.service";
/// Largest exposure that `systemd-analyze security` may find, in tenths.
const MAX_EXPOSURE: &str = "20";

/// Runs systemd-analyze, or skips.
fn analyze(arguments: &[&str]) -> Option<Output> {
    match Command::new("systemd-analyze").args(arguments).output() {
        Ok(output) => Some(output),
        Err(error) => {
            common::skip(&format!("systemd-analyze: {error}"));
            None
        }
    }
}

#[test]
fn the_unit_says_nothing_that_systemd_does_not_know() {
    // What is not installed here cannot be verified: the program is one that is there.
    let folder = common::folder();
    let unit = folder.path().join("verge.service");
    let text = fs::read_to_string(UNIT).expect("it ships");
    let here = text.replace("/usr/bin/verge run", "/bin/true run");
    assert_ne!(here, text, "the unit starts /usr/bin/verge");
    fs::write(&unit, here).expect("writing it");
    let path = unit.to_str().expect("plain text");
    let Some(output) = analyze(&["verify", "--recursive-errors=no", path]) else { return };
    let said = common::stderr(&output);
    let about_it: Vec<_> = said.lines().filter(|line| line.contains("verge.service")).collect();
    assert!(output.status.success() && about_it.is_empty(), "{said}");
}

#[test]
fn the_units_exposure_is_small() {
    let threshold = format!("--threshold={MAX_EXPOSURE}");
    let Some(output) = analyze(&["security", "--offline=true", &threshold, UNIT]) else { return };
    let said = String::from_utf8_lossy(&output.stdout);
    let last = said.lines().last().unwrap_or_default();
    assert!(output.status.success(), "{last}\n{}", common::stderr(&output));
    assert!(last.contains("Overall exposure level"), "{said}");
}

#[test]
fn the_supervision_that_is_promised_stands_in_the_unit() {
    let text = fs::read_to_string(UNIT).expect("it ships");
    for line in [
        "Type=notify",
        "ExecReload=/bin/kill -HUP $MAINPID",
        "WatchdogSec=30",
        "Restart=always",
        "RestartSec=5",
        "StartLimitIntervalSec=0",
        "User=verge",
        "SystemCallFilter=adjtimex clock_adjtime",
    ] {
        assert!(text.lines().any(|l| l == line), "{line} is missing");
    }
    let users = fs::read_to_string("boards/linux/verge.sysusers").expect("it ships");
    assert!(users.contains("u verge "), "the unit's user is made");
    let rules = fs::read_to_string("boards/linux/99-verge.rules").expect("it ships");
    assert_eq!(rules.matches("GROUP=\"verge\"").count(), 3, "pins, I2C and watchdog are its own");
}
