//! `verge-tmc archive` at a real broker: killed again and again it loses and doubles nothing,
//! and two of them share one archive.

#[path = "common/broker.rs"]
mod broker;
mod common;

use broker::{flood, message, mosquitto, mosquitto_with, publish};
use common::{Numbers, failure, stderr, text, tmc};
use std::collections::{BTreeMap, VecDeque};
use std::fs::Permissions;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use std::time::Duration;
use verge_desk::free_port;
use verge_tmc::store;

fn archiver(port: u16, out: &Path, name: &str, more: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_verge-tmc"))
        .args(["archive", "--broker", &format!("127.0.0.1:{port}"), "--out", text(out)])
        .args(["--name", name])
        .args(if more.contains(&"--compact-every") { &[][..] } else { &["--compact-every", "1"] })
        .args(more)
        .stderr(Stdio::piped())
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
    // One that signs has another name than what it signs, or OpenSSL takes that for self-signed.
    authority.distinguished_name.push(rcgen::DnType::CommonName, "authority");
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
    let authority = text(&ca);
    let asking = free_port();
    let lines = [
        (port, "allow_anonymous true".to_owned()),
        (asking, format!("cafile {authority}\nrequire_certificate true")),
    ]
    .map(|(port, more)| {
        format!("listener {port} 127.0.0.1\ncertfile {certificate}\nkeyfile {key}\n{more}\n")
    });
    let Some(broker) = mosquitto_with(&lines.concat()) else { return };
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
    // A broker that asks who is there.
    let address = format!("localhost:{asking}");
    let shown = folder.path().join("own.pem");
    std::fs::copy(key, &shown).expect("copying a file");
    std::fs::set_permissions(&shown, Permissions::from_mode(0o600)).expect("chmod");
    let asked = |more: &[&str]| {
        let args = ["archive", "--broker", &address, "--ca", authority, "--out", text(&out)];
        tmc(&[&args[..], more, &["--until-idle", "1"]].concat())
    };
    assert_eq!(asked(&[]).status.code(), Some(69));
    let output = asked(&["--cert", certificate, "--key", text(&shown)]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(asked(&["--cert", certificate, "--key", key]).status.code(), Some(65));
    let stranger = tempfile::tempdir().expect("a folder");
    let [other, ..] = certificates(stranger.path());
    let output = archive(text(&other), &[]);
    assert_eq!(output.status.code(), Some(69), "{}", stderr(&output));
    let output = archive(key, &[]);
    assert_eq!(output.status.code(), Some(65), "{}", stderr(&output));
    assert!(stderr(&output).contains("give PEM certificates"), "{}", stderr(&output));
}

/// The log of an archiver that runs until nothing comes for a second.
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
fn large(site: &str, seq: u64, minute: u64) -> Vec<u8> {
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
    value.to_string().into_bytes()
}

/// Yesterday's, in minutes as [`message`] has them.
const NOON: u64 = 1440 + 720;

/// Counts the compactions that a program tells of.
fn count_compactions(child: &mut Child) -> Arc<AtomicUsize> {
    let count = Arc::new(AtomicUsize::new(0));
    let (lines, counted) = (BufReader::new(child.stderr.take().expect("piped")), count.clone());
    std::thread::spawn(move || {
        for line in lines.lines().map_while(Result::ok) {
            let is_one = line.contains("windows archived") && !line.contains("later ones");
            counted.fetch_add(usize::from(is_one), Ordering::SeqCst);
            eprintln!("{line}");
        }
    });
    count
}

/// One box sends the largest messages as fast as it can, each many times and some contradicting,
/// and some of 50 MB, beside 1,000 others; for 3 s on loopback, or with VERGE_LONG=1 for two minutes
/// over a line of 100 Mbit/s, for a broker on the same two cores does not stand more that long.
#[test]
fn a_flood_of_one_box_takes_bounded_memory_and_delays_no_window_of_others() {
    let Some(broker) = mosquitto_with("max_inflight_messages 1000\n") else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let (root, port) = (folder.path(), broker.port);
    archive(port, root);
    let is_long = std::env::var_os("VERGE_LONG").is_some_and(|value| value == "1");
    let (time, minutes) = if is_long { (120, 40) } else { (3, 2) };
    let time = Duration::from_secs(time);
    let sites: Vec<String> = (0..1000).map(|n| format!("box{n}")).collect();
    let (idle, every) = if is_long { ("15", "10") } else { ("4", "1") };
    let more = ["--until-idle", idle, "--compact-every", every];
    let mut child = archiver(port, root, "verge-tmc-1", &more);
    let compactions = count_compactions(&mut child);
    let evil = std::thread::spawn(move || {
        let mut payloads: Vec<_> =
            (0..5000).map(|n| large("evil", 1 + n % 2, n / 3 % 2880)).collect();
        payloads.insert(500, vec![b'x'; 50 << 20]);
        let line = if is_long { 12.5e6 } else { f64::INFINITY };
        flood(port, "verge/evil/density/60s", &payloads, time, line)
    });
    // When the broker had a minute's last window, in compactions.
    let (told, minutes_sent) = mpsc::channel();
    let (counted, names) = (compactions.clone(), sites.clone());
    let honest = std::thread::spawn(move || {
        for minute in 0..minutes {
            let all: Vec<_> = names
                .iter()
                .map(|site| {
                    (format!("verge/{site}/density/60s"), message(site, minute + 1, NOON + minute))
                })
                .collect();
            publish(port, "boxes", &all, Duration::ZERO);
            let _ = told.send(counted.load(Ordering::SeqCst));
            std::thread::sleep(time / (minutes as u32 + 1));
        }
    });
    let (mut peak, mut waiting, mut latest) = (0f64, VecDeque::new(), 0);
    let mut seen = 0;
    while child.try_wait().expect("it runs").is_none() {
        peak = peak.max(peak_mb(child.id()).unwrap_or_default());
        waiting.extend(minutes_sent.try_iter());
        // All of a minute is there when the last that was sent is.
        let there = windows(root, sites.last().expect("there are some"));
        let now = compactions.load(Ordering::SeqCst);
        while seen < there {
            let Some(sent) = waiting.pop_front() else { break };
            latest = latest.max(now - sent);
            seen += 1;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let sent = evil.join().expect("all was sent");
    honest.join().expect("all was sent");
    eprintln!("{sent} messages of one box, {peak:.0} MB, {latest} compactions until a window");
    assert!(sent >= 500 && peak > 10.0 && peak < 512.0, "{sent} messages, {peak} MB");
    // The one that runs when a window comes, the one that takes it, and one more.
    assert!(seen as u64 == minutes && latest <= 3, "{seen} minutes, {latest} compactions");
    let found = contents(root);
    for site in &sites {
        let windows = &found[site];
        assert_eq!(windows.len() as u64, minutes, "{site} has lost windows");
        assert!(windows.values().all(|rows| *rows == ROWS), "{site} has lost or doubled rows");
    }
}

/// How many windows of a site are archived.
fn windows(root: &Path, site: &str) -> usize {
    let Ok(days) = store::site_partitions(root, site) else { return 0 };
    let rows = |day: &store::Partition| store::read(&day.path(root)).expect("a whole file").len();
    days.iter().map(rows).sum::<usize>() / ROWS
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
    let password = folder.path().join("password");
    std::fs::write(&password, "secret").expect("writing a file");
    std::fs::set_permissions(&password, Permissions::from_mode(0o644)).expect("chmod");
    let with = ["archive", "--out", text(folder.path()), "--user", "a", "--password-file"];
    let (code, error) = failure(&[&with[..], &[text(&password)]].concat());
    assert_eq!(code, 65, "{error}");
    assert!(error.contains("others may read it: chmod 600"), "{error}");
    let taken = folder.path().join("file");
    std::fs::write(&taken, "").expect("writing a file");
    let (code, error) = failure(&["archive", "--out", text(&taken)]);
    assert_eq!(code, 73, "{error}");
}
