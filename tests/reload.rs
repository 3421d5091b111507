//! SIGHUP makes `verge run` read its configuration again, as `systemctl reload` does.

mod common;

use common::mosquitto::Running;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

const PATIENCE: Duration = Duration::from_secs(120);

/// The daemon's words to the service manager, up to the first that `wanted` accepts.
fn heard(manager: &UnixDatagram, wanted: impl Fn(&str) -> bool) -> Vec<String> {
    let mut words = Vec::new();
    loop {
        let mut buffer = [0; 2000];
        let len = manager.recv(&mut buffer).unwrap_or_else(|error| panic!("{error}: {words:?}"));
        let word = String::from_utf8_lossy(&buffer[..len]).into_owned();
        if word == "WATCHDOG=1" {
            continue;
        }
        words.push(word);
        if words.last().is_some_and(|word| wanted(word)) {
            return words;
        }
    }
}

fn write_config(path: &Path, more: &str) {
    let here = std::env::current_dir().expect("a working directory");
    let here = here.display();
    let text = format!(
        "site = \"reload\"\n[camera]\nid = \"curve\"\ninterval_s = 1\n\
         source = \"{here}/{}\"\n\
         [model]\nfile = \"{here}/{}\"\n[lane_table]\nfile = \"{here}/{}\"\n\
         [windows]\nlengths_s = [10]\n{more}\n",
        common::STREET_FRAMES,
        common::MODEL,
        common::STREET_TABLE
    );
    std::fs::write(path, text).expect("writing the configuration");
}

#[test]
fn a_hangup_reads_the_configuration_again_and_never_stops_the_daemon() {
    let folder = common::folder();
    let (config, socket) = (folder.path().join("verge.toml"), folder.path().join("notify"));
    write_config(&config, "");
    let manager = UnixDatagram::bind(&socket).expect("a socket");
    manager.set_read_timeout(Some(PATIENCE)).expect("a time-out");
    let mut daemon = Command::new(env!("CARGO_BIN_EXE_verge"))
        .args(["run", "--config", config.to_str().expect("UTF-8")])
        .env("NOTIFY_SOCKET", &socket)
        .stderr(Stdio::null())
        .spawn()
        .map(Running)
        .expect("the daemon starts");
    let id = daemon.0.id().to_string();
    let hang_up = || {
        assert!(Command::new("kill").args(["-HUP", &id]).status().expect("kill runs").success());
    };
    heard(&manager, |word| word == "READY=1");

    // Ten in a row.
    (0..10).for_each(|_| hang_up());
    let words = heard(&manager, |word| word.starts_with("STATUS=oK; new configuration from "));
    let begins = |word: &String| word.starts_with("RELOADING=1\nMONOTONIC_USEC=");
    assert!(words.iter().any(begins), "{words:?}");
    heard(&manager, |word| word == "READY=1");
    heard(&manager, |word| word == "STATUS=oK");

    write_config(&config, "min_completeness = 3");
    hang_up();
    let words = heard(&manager, |word| word.contains("windows.min_completeness: 3"));
    assert!(words.last().is_some_and(|word| word.starts_with("STATUS=oK: reload refused")));
    heard(&manager, |word| word == "READY=1");

    write_config(&config, "min_completeness = 0.5");
    hang_up();
    heard(&manager, |word| word.starts_with("STATUS=oK; new configuration from "));
    heard(&manager, |word| word == "STATUS=oK");
    assert_eq!(daemon.0.try_wait().expect("ours"), None, "it runs on");
}
