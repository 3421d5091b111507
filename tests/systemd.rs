//! The unit file and the rules beside it, held against systemd where it is installed.

mod common;

use std::fs;
use std::process::{Command, Output};

const UNIT: &str = "boards/linux/verge.service";
/// Largest exposure that `systemd-analyze security` may find, in tenths.
const MAX_EXPOSURE: &str = "17";

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
    // systemd verifies that the program exists: one that exists here takes its place.
    let folder = common::folder();
    let unit = folder.path().join("verge.service");
    let text = fs::read_to_string(UNIT).expect("it ships");
    let here = text.replace("/usr/lib/verge/verge run", "/bin/true run");
    assert_ne!(here, text, "the unit starts /usr/lib/verge/verge");
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
}

#[test]
fn a_box_without_parts_of_its_own_gets_no_rights_to_any() {
    let text = fs::read_to_string(UNIT).expect("it ships");
    let given: Vec<_> = text.lines().filter(|line| line.starts_with("DeviceAllow=")).collect();
    assert_eq!(given, ["DeviceAllow=char-video4linux rw"]);
    for line in ["LimitCORE=0", "LimitNOFILE=256", "PrivateMounts=yes", "RuntimeDirectory=verge"] {
        assert!(text.lines().any(|l| l == line), "{line} is missing");
    }
    let board = fs::read_to_string("boards/linux/verge-board.conf").expect("it ships");
    assert_eq!(board.matches("DeviceAllow=").count(), 3, "pins, I2C and watchdog");
    let rules = fs::read_to_string("boards/linux/99-verge.rules").expect("it ships");
    let rules: Vec<_> = rules.lines().filter(|line| !line.starts_with('#')).collect();
    assert!(rules.iter().all(|rule| rule.contains("setfacl -m user:verge:rw $devnode")));
    // Other programs keep what a distribution gives them.
    assert!(!rules.iter().any(|rule| rule.contains("GROUP=") || rule.contains("MODE=")));
    for device in ["/dev/i2c-1", "/dev/i2c-7", "/dev/watchdog0"] {
        let boards = ["raspberry_pi", "jetson", "x86_industrial"]
            .map(|board| fs::read_to_string(format!("boards/{board}.rs")).expect("it ships"));
        assert!(boards.iter().any(|board| board.contains(device)), "{device}");
        let name = device.trim_start_matches("/dev/");
        assert!(rules.iter().any(|rule| rule.contains(name)), "{device}");
    }
}
