//! SIGHUP makes `verge run` read its configuration again, as `systemctl reload` does.

mod common;
#[path = "common/fake_broker.rs"]
mod fake_broker;

use common::mosquitto::Running;
use fake_broker::{FakeBroker, Manners};
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const PATIENCE: Duration = Duration::from_secs(120);

/// The daemon's words to the service manager, up to the first that `wanted` accepts.
fn heard(manager: &UnixDatagram, wanted: impl Fn(&str) -> bool) -> Vec<String> {
    let (mut words, begun) = (Vec::new(), Instant::now());
    loop {
        // The watchdog's words go on for ever.
        assert!(begun.elapsed() < PATIENCE, "{words:?}");
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
    write_windows(path, "10", more);
}

/// A right configuration with windows of these lengths, and these lines behind them.
fn write_windows(path: &Path, lengths_s: &str, more: &str) {
    let here = std::env::current_dir().expect("a working directory");
    let here = here.display();
    let text = format!(
        "site = \"reload\"\n[camera]\nid = \"curve\"\ninterval_s = 1\n\
         source = \"{here}/{}\"\n\
         [model]\nfile = \"{here}/{}\"\n[lane_table]\nfile = \"{here}/{}\"\n\
         [windows]\nlengths_s = [{lengths_s}]\n{more}\n",
        common::STREET_FRAMES,
        common::MODEL,
        common::STREET_TABLE
    );
    std::fs::write(path, text).expect("writing the configuration");
}

/// The daemon with this configuration, and what it says to the service manager.
fn start(folder: &Path) -> (Running, UnixDatagram) {
    let socket = folder.join("notify");
    let manager = UnixDatagram::bind(&socket).expect("a socket");
    manager.set_read_timeout(Some(PATIENCE)).expect("a time-out");
    let daemon = Command::new(env!("CARGO_BIN_EXE_verge"))
        .args(["run", "--config", folder.join("verge.toml").to_str().expect("UTF-8")])
        .env("NOTIFY_SOCKET", &socket)
        .stderr(Stdio::null())
        .spawn()
        .map(Running)
        .expect("the daemon starts");
    (daemon, manager)
}

fn hang_up(daemon: &Running) {
    let id = daemon.0.id().to_string();
    assert!(Command::new("kill").args(["-HUP", &id]).status().expect("kill runs").success());
}

#[test]
fn a_hangup_reads_the_configuration_again_and_never_stops_the_daemon() {
    let folder = common::folder();
    let config = folder.path().join("verge.toml");
    write_config(&config, "");
    let (mut daemon, manager) = start(folder.path());
    heard(&manager, |word| word == "READY=1");

    // Ten in a row.
    (0..10).for_each(|_| hang_up(&daemon));
    let words = heard(&manager, |word| word.starts_with("STATUS=oK; new configuration from "));
    let begins = |word: &String| word.starts_with("RELOADING=1\nMONOTONIC_USEC=");
    assert!(words.iter().any(begins), "{words:?}");
    heard(&manager, |word| word == "READY=1");
    heard(&manager, |word| word == "STATUS=oK");

    write_config(&config, "min_completeness = 3");
    hang_up(&daemon);
    let words = heard(&manager, |word| word.contains("windows.min_completeness: 3"));
    assert!(words.last().is_some_and(|word| word.starts_with("STATUS=oK: reload refused")));
    heard(&manager, |word| word == "READY=1");

    write_config(&config, "min_completeness = 0.5");
    hang_up(&daemon);
    heard(&manager, |word| word.starts_with("STATUS=oK; new configuration from "));
    heard(&manager, |word| word == "STATUS=oK");
    assert_eq!(daemon.0.try_wait().expect("ours"), None, "it runs on");
}

#[test]
fn windows_that_only_the_memory_holds_are_said_in_the_state() {
    let folder = common::folder();
    // A file where the spool's folder should be: nothing can be made in it.
    let spool = folder.path().join("spool");
    std::fs::write(&spool, "in the way").expect("written");
    write_config(&folder.path().join("verge.toml"), "");
    let (daemon, manager) = start(folder.path());
    let words =
        heard(&manager, |word| word.starts_with("STATUS=") && word.contains("memory alone"));
    let said = words.last().expect("heard");
    assert!(said.contains("/spool: a file is in its way"), "{said}");
    // From the next window on the disk takes them.
    std::fs::remove_file(&spool).expect("removed");
    heard(&manager, |word| word == "STATUS=oK");
    // Removed while it runs, and nothing can be made in its place.
    std::fs::remove_dir_all(&spool).expect("removed");
    std::fs::write(&spool, "in the way").expect("written");
    let words = heard(&manager, |word| word.contains("memory alone"));
    assert!(words.iter().any(|word| word.contains("a file is in its way")), "{words:?}");
    // A refused configuration is reported beside it.
    write_config(&folder.path().join("verge.toml"), "min_completeness = 3");
    hang_up(&daemon);
    let words = heard(&manager, |word| word.contains("; reload refused: "));
    assert!(words.last().is_some_and(|word| word.contains("memory alone")), "{words:?}");
}

#[test]
fn of_a_window_that_a_reload_removes_nothing_stays() {
    let (broker, folder) = (FakeBroker::start(Manners::default()), common::folder());
    let (config, metrics) = (folder.path().join("verge.toml"), folder.path().join("verge.prom"));
    let more = format!("[mqtt]\nport = {}\n[metrics]\nfile = \"verge.prom\"\n", broker.port);
    write_windows(&config, "10, 20", &more);
    let (daemon, manager) = start(folder.path());
    // The last message on `latest` of a length; one without content takes back what is kept.
    let latest = |length: &str| {
        let topic = format!("verge/reload/latest/{length}");
        broker.seen(|seen| {
            let last = seen.taken.iter().rev().find(|(taken, _)| *taken == topic);
            last.map(|(_, payload)| !payload.is_empty())
        })
    };
    let is_counted = |length: &str| {
        let label = format!("window=\"{length}\"");
        std::fs::read_to_string(&metrics).is_ok_and(|text| text.contains(&label))
    };
    let within = |what: &str, done: &dyn Fn() -> bool| {
        let begun = Instant::now();
        while !done() {
            assert!(begun.elapsed() < PATIENCE, "{what}");
            std::thread::sleep(Duration::from_millis(100));
        }
    };
    within("both are there", &|| {
        ["10s", "20s"].iter().all(|length| latest(length) == Some(true) && is_counted(length))
    });
    write_windows(&config, "20", &more);
    hang_up(&daemon);
    heard(&manager, |word| word.contains("; new configuration from "));
    heard(&manager, |word| word == "STATUS=oK");
    within("the broker forgets it", &|| latest("10s") == Some(false));
    within("and so do the metrics", &|| !is_counted("10s"));
    within("the other one goes on", &|| latest("20s") == Some(true) && is_counted("20s"));
}
