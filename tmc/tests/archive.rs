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

/// What an archiver says that runs until nothing comes for a second.
fn archive(port: u16, out: &Path) -> String {
    let broker = format!("127.0.0.1:{port}");
    let args = ["archive", "--broker", &broker, "--out", text(out), "--until-idle", "1"];
    let output = tmc(&args);
    assert!(output.status.success(), "{}", stderr(&output));
    stderr(&output)
}

#[test]
fn what_a_box_may_not_send_is_refused_and_stops_no_other() {
    let Some(broker) = mosquitto() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    archive(broker.port, folder.path());
    let honest = messages(&["honest"], 30, &mut Numbers(3));
    let of_evil = |payload: String| ("verge/evil/density/60s".to_owned(), payload);
    let right = message("evil", 1, 0);
    let mut all = vec![
        // Over the limit of one packet that the broker lets through by default.
        of_evil(" ".repeat(1_200_000) + &right),
        // Of another site, before that site's own.
        of_evil(message("honest", 1, 0).replace("0.5", "99.0")),
        of_evil(right.replace("100.0", "1e39")),
        of_evil(right.replace("\"window_s\":60", "\"window_s\":1")),
        of_evil(right.replace("\"from\":\"20", "\"from\":\"-0000")),
        of_evil(message("evil", 1, 9 * 1440)),
        ("verge/<img src=x>/density/60s".to_owned(), message("<img src=x>", 1, 0)),
        ("verge/..%2f/density/60s".to_owned(), message("../evil", 1, 0)),
    ];
    let refused = all.len();
    all.extend(honest);
    publish(broker.port, "boxes", &all, Duration::ZERO);
    let said = archive(broker.port, folder.path());
    assert_whole(folder.path(), &["honest"], 30);
    assert!(!said.contains("the connection broke"), "{said}");
    let counted = format!("evil: {} messages refused", refused - 2);
    assert!(said.contains(&counted), "{said}");
    assert!(!said.contains('\u{1b}') && said.contains("<img src=x>: 1 messages refused"), "{said}");
    let first = &contents(folder.path())["honest"];
    assert_eq!(first.len(), 30);
    for partition in store::partitions(folder.path()).expect("an archive") {
        let rows = store::read(&partition.path(folder.path())).expect("a whole file");
        assert!(rows.iter().all(|row| row.se.is_none_or(|se| se == 0.5)), "believed another");
    }
}

/// The most memory that a process has had, MB.
fn peak_mb(process: u32) -> Option<f64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse::<f64>().ok().map(|kb| kb / 1024.0)
}

/// The largest message that is right: 264 rows from 3 KB, at a minute that many share.
fn large(site: &str, seq: u64, minute: u64) -> String {
    let mut value: serde_json::Value =
        serde_json::from_str(&message(site, seq, minute)).expect("JSON");
    let lane = value["lanes"][0].clone();
    let lanes = (1..=8).map(|number| {
        let mut lane = lane.clone();
        lane["lane"] = number.into();
        lane["cells"]["length_m"] = 3.125.into();
        lane["cells"]["density_veh_km"] = serde_json::Value::Null;
        lane
    });
    value["lanes"] = lanes.collect();
    value.to_string()
}

/// One box sends the largest messages as fast as it can, each twice and some contradicting,
/// beside others; for 4 s, or for a minute with VERGE_LONG=1.
#[test]
fn a_flood_of_one_box_takes_bounded_memory_and_loses_no_window_of_others() {
    let Some(broker) = mosquitto() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    archive(broker.port, folder.path());
    let long = std::env::var_os("VERGE_LONG").is_some_and(|value| value == "1");
    let flood = Duration::from_secs(if long { 60 } else { 4 });
    let sites: Vec<String> =
        (0..if long { 1000 } else { 100 }).map(|n| format!("box{n}")).collect();
    let names: Vec<&str> = sites.iter().map(String::as_str).collect();
    let mut child = archiver(broker.port, folder.path(), "verge-tmc-1", &["--until-idle", "3"]);
    let port = broker.port;
    let evil = std::thread::spawn(move || {
        let (begun, mut sent) = (std::time::Instant::now(), 0u64);
        while begun.elapsed() < flood {
            let batch: Vec<_> = (0..500)
                .map(|n| {
                    let minute = (sent + n) / 3 % 2880;
                    let payload = large("evil", 1 + (sent + n) % 2, minute);
                    ("verge/evil/density/60s".to_owned(), payload)
                })
                .collect();
            publish(port, "evil", &batch, Duration::ZERO);
            sent += 500;
        }
        sent
    });
    let minutes = 5;
    let all = messages(&names, minutes, &mut Numbers(5));
    let pause = flood / (2 * all.len() as u32);
    publish(port, "boxes", &all, pause);
    let mut peak = 0f64;
    while child.try_wait().expect("it runs").is_none() {
        peak = peak.max(peak_mb(child.id()).unwrap_or_default());
        std::thread::sleep(Duration::from_millis(20));
    }
    let sent = evil.join().expect("all was sent");
    eprintln!("{sent} messages of one box, {} of others, {peak:.0} MB", all.len());
    assert!(sent >= 500 && peak > 10.0 && peak < 256.0, "{sent} messages, {peak} MB");
    let found = contents(folder.path());
    for site in names {
        let windows = &found[site];
        assert_eq!(windows.len() as u64, minutes, "{site} has lost windows");
        assert!(windows.values().all(|rows| *rows == ROWS), "{site} has lost or doubled rows");
    }
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
