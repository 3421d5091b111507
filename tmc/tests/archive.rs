//! `verge-tmc archive` at a real broker: killed again and again it loses and doubles nothing,
//! and two of them share one archive.

#[path = "common/broker.rs"]
mod broker;
mod common;

use broker::{free_port, message, mosquitto, mosquitto_with, publish};
use common::{Numbers, failure, stderr, text, tmc};
use std::collections::BTreeMap;
use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;
use verge_tmc::store;

fn archiver(port: u16, out: &Path, name: &str, more: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_verge-tmc"))
        .args(["archive", "--broker", &format!("127.0.0.1:{port}"), "--out", text(out)])
        .args(["--compact-every", "1", "--name", name])
        .args(more)
        .stderr(Stdio::null())
        .spawn()
        .expect("the program starts")
}

/// How often each window and row of the archive stands there: by site, then by minute.
fn contents(root: &Path) -> BTreeMap<String, BTreeMap<i64, usize>> {
    let mut found: BTreeMap<String, BTreeMap<i64, usize>> = BTreeMap::new();
    for partition in store::partitions(root).expect("an archive") {
        let rows = store::read(&partition.path(root)).expect("a whole file");
        let mut keys: Vec<_> = rows.iter().map(store::Row::key).collect();
        let all = keys.len();
        keys.sort_unstable();
        keys.dedup();
        assert_eq!(keys.len(), all, "rows are doubled");
        for row in rows {
            assert_eq!(row.from_ms.div_euclid(store::DAY_MS), partition.day);
            *found.entry(partition.site.clone()).or_default().entry(row.from_ms).or_default() += 1;
        }
    }
    found
}

/// Two lanes and two cells in each.
const ROWS: usize = 6;

fn assert_whole(root: &Path, sites: &[&str], minutes: u64) {
    let found = contents(root);
    assert_eq!(found.len(), sites.len());
    for site in sites {
        let windows = &found[*site];
        assert_eq!(windows.len() as u64, minutes, "{site} has lost windows");
        assert!(windows.values().all(|rows| *rows == ROWS), "{site} has lost or doubled rows");
    }
}

/// Messages of so many minutes: some twice, some as replay, in an order that varies.
fn messages(sites: &[&str], minutes: u64, numbers: &mut Numbers) -> Vec<(String, String)> {
    let mut all = Vec::new();
    for minute in 0..minutes {
        for site in sites {
            let payload = message(site, minute + 1, minute);
            let chance = numbers.uniform();
            let kind = if chance < 0.2 { "replay/density" } else { "density" };
            all.push((format!("verge/{site}/{kind}/60s"), payload.clone()));
            if chance > 0.9 {
                all.push((format!("verge/{site}/replay/density/60s"), payload));
            }
        }
    }
    all
}

#[test]
fn killed_a_hundred_times_it_loses_and_doubles_nothing() {
    let Some(broker) = mosquitto() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    // The session, which the broker keeps from now on, begins with the first run.
    let first = archiver(broker.port, folder.path(), "a", &["--until-idle", "1"]).wait();
    assert!(first.expect("it ran").success());
    let (sites, minutes) = (["north", "south", "west"], 1500);
    let mut numbers = Numbers(42);
    let all = messages(&sites, minutes, &mut numbers);
    let port = broker.port;
    let sender = std::thread::spawn(move || publish(port, "boxes", &all, Duration::from_millis(2)));
    for _ in 0..100 {
        let mut child = archiver(broker.port, folder.path(), "a", &[]);
        std::thread::sleep(Duration::from_millis(20 + (130.0 * numbers.uniform()) as u64));
        child.kill().expect("it runs until it is killed");
        child.wait().expect("it ended");
    }
    sender.join().expect("all was published");
    let last = archiver(broker.port, folder.path(), "a", &["--until-idle", "2"]).wait();
    assert!(last.expect("it ran").success());
    assert_whole(folder.path(), &sites, minutes);
}

#[test]
fn two_archivers_share_the_load_and_one_archive() {
    let Some(broker) = mosquitto() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let names = ["a", "b"];
    let children =
        names.map(|name| archiver(broker.port, folder.path(), name, &["--until-idle", "3"]));
    std::thread::sleep(Duration::from_secs(1));
    let sites = ["north", "south"];
    let all = messages(&sites, 400, &mut Numbers(7));
    publish(broker.port, "boxes", &all, Duration::ZERO);
    for mut child in children {
        assert!(child.wait().expect("it ran").success());
    }
    assert_whole(folder.path(), &sites, 400);
}

/// An authority and its certificate, and a certificate and key for localhost that it signed.
fn certificates(folder: &Path) -> [PathBuf; 3] {
    let key = || rcgen::KeyPair::generate().expect("a key");
    let parameters = |name: &str| rcgen::CertificateParams::new([name.to_owned()]).expect("a name");
    let (mut authority, authority_key) = (parameters("authority"), key());
    authority.is_ca = rcgen::IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
    let ca = authority.self_signed(&authority_key).expect("a certificate").pem();
    let (issuer, server_key) = (rcgen::Issuer::new(authority, authority_key), key());
    let server = parameters("localhost").signed_by(&server_key, &issuer).expect("a certificate");
    let files = [("ca", ca), ("server", server.pem()), ("key", server_key.serialize_pem())];
    files.map(|(name, text)| {
        let path = folder.join(format!("{name}.pem"));
        std::fs::write(&path, text).expect("writing a file");
        // Debian's broker gives up root, and must read its key still.
        for path in [folder, &path] {
            std::fs::set_permissions(path, Permissions::from_mode(0o755)).expect("chmod");
        }
        path
    })
}

#[test]
fn through_tls_it_takes_from_a_broker_that_the_authority_knows() {
    let folder = tempfile::tempdir().expect("a folder");
    let [ca, certificate, key] = certificates(folder.path());
    let port = free_port();
    let (certificate, key) = (text(&certificate), text(&key));
    let lines = format!(
        "listener {port} 127.0.0.1\nallow_anonymous true\ncertfile {certificate}\nkeyfile {key}\n"
    );
    let Some(broker) = mosquitto_with(&lines) else { return };
    let out = folder.path().join("archive");
    let address = format!("localhost:{port}");
    let archive = |ca: &str, more: &[&str]| {
        let args = ["archive", "--broker", &address, "--ca", ca, "--out", text(&out)];
        tmc(&[&args[..], more].concat())
    };
    // The session begins with the first run, and what is published then waits in it.
    assert!(archive(text(&ca), &["--until-idle", "1"]).status.success());
    let all = messages(&["north"], 5, &mut Numbers(1));
    publish(broker.port, "boxes", &all, Duration::ZERO);
    let output = archive(text(&ca), &["--until-idle", "2"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_whole(&out, &["north"], 5);
    let stranger = tempfile::tempdir().expect("a folder");
    let [other, ..] = certificates(stranger.path());
    let output = archive(text(&other), &[]);
    assert_eq!(output.status.code(), Some(69), "{}", stderr(&output));
    let output = archive(key, &[]);
    assert_eq!(output.status.code(), Some(65), "{}", stderr(&output));
    assert!(stderr(&output).contains("give PEM certificates"), "{}", stderr(&output));
}

#[test]
fn without_a_broker_it_says_so() {
    let folder = tempfile::tempdir().expect("a folder");
    // Port 9 is that of the discard service, which no test machine runs.
    let (code, error) =
        failure(&["archive", "--broker", "127.0.0.1:9", "--out", text(folder.path())]);
    assert_eq!(code, 69, "{error}");
    assert!(error.contains("broker 127.0.0.1:9"), "{error}");
    let (code, error) = failure(&["archive", "--broker", "here", "--out", text(folder.path())]);
    assert_eq!(code, 64, "{error}");
    let taken = folder.path().join("file");
    std::fs::write(&taken, "").expect("writing a file");
    let (code, error) = failure(&["archive", "--out", text(&taken)]);
    assert_eq!(code, 73, "{error}");
}
