//! `verge check` on whole configurations: it opens what `verge run` opens.

mod common;
#[path = "common/fake_broker.rs"]
mod fake_broker;

use fake_broker::{FakeBroker, Manners};
use std::path::Path;
use std::process::Output;

/// A configuration that is right, with these lines at its end.
fn configuration(folder: &Path, port: u16, more: &str) -> String {
    let here = std::env::current_dir().expect("a working directory");
    let here = here.display();
    let text = format!(
        "site = \"checked\"\n[camera]\nid = \"curve\"\ninterval_s = 1\nwatch = false\n\
         source = \"{here}/{}\"\n[model]\nfile = \"{here}/{}\"\n[lane_table]\nfile = \"{here}/{}\"\n\
         [windows]\nlengths_s = [10]\n[mqtt]\nport = {port}\n{more}",
        common::STREET_FRAMES,
        common::MODEL,
        common::STREET_TABLE
    );
    let path = folder.join("verge.toml");
    std::fs::write(&path, text).expect("written");
    path.to_str().expect("UTF-8").to_owned()
}

fn check(configuration: &str) -> (Output, String) {
    let output = common::verge(&["check", "--config", configuration]);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    (output, said)
}

#[test]
fn what_is_right_passes_and_leaves_nothing_behind() {
    let (broker, folder) = (FakeBroker::start(Manners::default()), common::folder());
    let more = format!("[metrics]\nfile = \"{}/verge.prom\"\n", folder.path().display());
    let (output, said) = check(&configuration(folder.path(), broker.port, &more));
    assert!(output.status.success(), "{said}{}", common::stderr(&output));
    assert!(said.contains("(lane 1 of 82 m one each 0.50 s, "), "{said}");
    for line in ["ok    spool:", "ok    metrics:", "ok    broker:", "MQTT 5", "as this user"] {
        assert!(said.contains(line), "{line} in {said}");
    }
    let left: Vec<_> = std::fs::read_dir(folder.path())
        .expect("the folder")
        .map(|entry| entry.expect("an entry").file_name())
        .collect();
    assert_eq!(left, ["verge.toml"]);
    // An empty message on each density topic, and `presence` as it was: not there.
    let taken = broker.seen(|seen| seen.taken.clone());
    let last = taken.iter().rev().find(|(topic, _)| topic.ends_with("presence"));
    assert_eq!(last.map(|(_, payload)| payload.len()), Some(0), "{taken:?}");
    assert_eq!(broker.windows(), 0);
}

#[test]
fn what_run_could_not_write_or_send_fails() {
    let reason = Some(("density/", 0x87));
    let (broker, folder) =
        (FakeBroker::start(Manners { reason, ..Manners::default() }), common::folder());
    std::fs::write(folder.path().join("spool"), "in the way").expect("written");
    let more = "[metrics]\nfile = \"/no/such/folder/verge.prom\"\n";
    let (output, said) = check(&configuration(folder.path(), broker.port, more));
    assert_eq!(output.status.code(), Some(73), "{said}");
    for line in ["FAIL  spool:", "in its way", "FAIL  metrics:", "make its folder", "FAIL  broker:"]
    {
        assert!(said.contains(line), "{line} in {said}");
    }
    assert!(common::stderr(&output).contains("3 of"), "{}", common::stderr(&output));
}
