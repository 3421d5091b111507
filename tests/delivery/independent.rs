//! The audit: boxes and brokers are killed at random, and what was accepted is read from the
//! boxes' spools, by a parser of its own that shares no code with the program.
//!
//! A proxy lets boxes to the broker only while the auditor is subscribed there, so that every
//! window that a broker acknowledges has gone to the auditor before. Each window that ever stood
//! in a spool must have reached the auditor, no number may be missing, and none may belong to two
//! windows.

use super::common::mosquitto::{Mosquitto, Running};
use super::{PATIENCE, common, listen, name, repetitions, window};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use verge::daemon::outlet::Outlet;
use verge::daemon::publish::{Format, Identity, MqttSettings};
use verge::daemon::spool::Spool;
use verge::sensor::ClosedWindow;
use verge::wire::{CalibrationRef, ModelRef};
use verge_desk::free_port;

/// A process with this in its environment runs [`box_process`].
const BOX: &str = "VERGE_AUDITED_BOX";
/// Windows that one life of a box has numbers for; it is killed long before.
const LIFE: i64 = 10_000;

/// The life of a box: accepts a window each 10 ms, the n-th of its life at a minute of its own,
/// until its input ends; then delivers what waits.
#[test]
fn box_process() {
    let Ok(argument) = std::env::var(BOX) else { return };
    let words: Vec<&str> = argument.split(' ').collect();
    let [port, root, life, folder] = words[..] else { panic!("{argument}") };
    let model = ModelRef { name: name("test"), sha256: [7; 32] };
    let local = MqttSettings::local(port.parse().expect("a port"), root);
    let settings = MqttSettings { replay_per_s: 1000.0, ..local };
    let spool = Spool::open(Path::new(folder), 7 * 1440).expect("the earlier life is over");
    let mut outlet = Outlet::start(settings, Format::Json, Identity::new("audit", &model), spool);
    let calibration = &CalibrationRef { id: name("joint"), sha256: [8; 32], rel_err: None };
    let ended = Arc::new(AtomicU64::new(0));
    let end = Arc::clone(&ended);
    std::thread::spawn(move || {
        let _ = io::stdin().read_line(&mut String::new());
        end.store(1, Ordering::SeqCst);
    });
    let mut minute = life.parse::<i64>().expect("a number") * LIFE;
    while ended.load(Ordering::SeqCst) == 0 {
        minute += 1;
        outlet.density(ClosedWindow { report: &window(minute), calibration }, true);
        outlet.tend();
        std::thread::sleep(Duration::from_millis(10));
    }
    let until = Instant::now() + PATIENCE;
    while outlet.counts().waiting > 0 {
        assert!(Instant::now() < until, "what waits is not delivered");
        outlet.tend();
        std::thread::sleep(Duration::from_millis(10));
    }
    outlet.stop();
}

/// A window as the spool or a message names it: its number and its beginning, ms since 1970.
type Window = (u64, i64);

/// Lets connections through to the broker while its gate is open.
struct Proxy {
    port: u16,
    /// Rises when the gate opens, when it is odd, and when it closes.
    gate: Arc<AtomicU64>,
}

impl Proxy {
    fn start(broker: u16) -> Self {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
        let port = listener.local_addr().expect("an address").port();
        let gate = Arc::new(AtomicU64::new(0));
        let seen = Arc::clone(&gate);
        std::thread::spawn(move || {
            for client in listener.incoming().map_while(Result::ok) {
                let before = seen.load(Ordering::SeqCst);
                let Ok(server) = TcpStream::connect((Ipv4Addr::LOCALHOST, broker)) else {
                    continue;
                };
                // Not one byte passes to a broker that came while the gate was closed.
                if before % 2 == 1 && seen.load(Ordering::SeqCst) == before {
                    join(client, server);
                }
            }
        });
        Self { port, gate }
    }

    fn turn(&self) {
        self.gate.fetch_add(1, Ordering::SeqCst);
    }
}

/// Carries bytes both ways until one side ends, and ends the other.
fn join(client: TcpStream, server: TcpStream) {
    let pair = |from: &TcpStream, to: &TcpStream| (from.try_clone(), to.try_clone());
    for (from, to) in [pair(&client, &server), pair(&server, &client)] {
        let (mut from, mut to) = (from.expect("a handle"), to.expect("a handle"));
        std::thread::spawn(move || {
            let _ = io::copy(&mut from, &mut to);
            let _ = to.shutdown(Shutdown::Both);
        });
    }
}

/// A box: its spool, the process while it lives, and what was found of it.
struct Audited {
    number: usize,
    folder: tempfile::TempDir,
    lives: usize,
    process: Option<Running>,
    accepted: BTreeSet<Window>,
    last_seq: u64,
}

impl Audited {
    fn new(number: usize) -> Self {
        let (process, accepted) = (None, BTreeSet::new());
        Self { number, folder: common::folder(), lives: 0, process, accepted, last_seq: 0 }
    }

    fn start(&mut self, port: u16) {
        let (root, life) = (format!("verge/box{}", self.number), self.lives);
        let argument = format!("{port} {root} {life} {}", self.folder.path().display());
        self.lives += 1;
        let child = Command::new(std::env::current_exe().expect("this program"))
            .args(["--exact", "independent::box_process", "--nocapture"])
            .env(BOX, argument)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts");
        self.process = Some(Running(child));
    }

    fn kill(&mut self) {
        self.process.take().expect("it lives").kill();
        self.read_spool();
    }

    /// Lets it deliver what waits.
    fn end(&mut self) {
        let mut process = self.process.take().expect("it lives");
        drop(process.0.stdin.take());
        let status = process.0.wait().expect("it ends");
        assert!(status.success(), "box {} has not delivered what waited", self.number);
    }

    fn read_spool(&mut self) {
        for entry in std::fs::read_dir(self.folder.path()).expect("a spool") {
            let path = entry.expect("an entry").path();
            if path.extension().is_some_and(|ending| ending == "spool") {
                let bytes = std::fs::read(&path).expect("a segment");
                let (windows, last_seq) = parse(&bytes);
                self.accepted.extend(windows);
                self.last_seq = self.last_seq.max(last_seq);
            }
        }
    }
}

/// The windows in a segment's bytes, and the last number that it names.
fn parse(bytes: &[u8]) -> (Vec<Window>, u64) {
    let (mut windows, mut last, mut at) = (Vec::new(), 0, 4);
    while at + 9 <= bytes.len() {
        let length = usize::from(u16::from_le_bytes([bytes[at + 3], bytes[at + 4]]));
        let end = at + 5 + length;
        let checked = bytes.get(at + 2..end).filter(|_| bytes[at..].starts_with(b"VR"));
        let stored = bytes.get(end..end + 4);
        let Some((checked, _)) = checked
            .zip(stored)
            .filter(|(checked, stored)| crc32(checked).to_le_bytes() == **stored)
        else {
            at += 1;
            continue;
        };
        match (checked[0], &checked[3..]) {
            // Key, version of the message, site, number, whether the clock is set, beginning.
            (1, body) => {
                let mut rest = &body[9..];
                let site = varint(&mut rest) as usize;
                rest = &rest[site..];
                let seq = varint(&mut rest);
                rest = &rest[1..];
                let zigzag = varint(&mut rest);
                windows.push((seq, (zigzag >> 1) as i64 ^ -((zigzag & 1) as i64)));
                last = last.max(seq);
            }
            // Next key, then pairs of length and last number.
            (3, body) => {
                for pair in body[8..].chunks_exact(12) {
                    last = last.max(u64::from_le_bytes(pair[4..].try_into().expect("8 bytes")));
                }
            }
            _ => {}
        }
        at = end + 4;
    }
    (windows, last)
}

/// The next number of seven bits a byte, the lowest first.
fn varint(rest: &mut &[u8]) -> u64 {
    let length = 1 + rest.iter().take_while(|byte| **byte >= 0x80).count();
    let (number, behind) = rest.split_at(length);
    *rest = behind;
    number.iter().rev().fold(0, |sum, byte| sum << 7 | u64::from(byte & 0x7f))
}

/// CRC-32 as in Ethernet, bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32| if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 };
    !bytes.iter().fold(!0, |crc, byte| (0..8).fold(crc ^ u32::from(*byte), |crc, _| step(crc)))
}

/// Notes the windows of messages by their box, with how often each came.
#[derive(Default)]
struct Auditor(BTreeMap<usize, BTreeMap<Window, usize>>);

impl Auditor {
    fn note(&mut self, topic: &str, payload: &[u8]) {
        let Some(number) = topic.strip_prefix("verge/box").filter(|_| topic.contains("/density/"))
        else {
            return;
        };
        let number = number.split('/').next().expect("a name").parse().expect("a number");
        let message: Value = serde_json::from_slice(payload).expect("JSON");
        let from: jiff::Timestamp = message["from"].as_str().expect("a time").parse().expect("UTC");
        let window = (message["seq"].as_u64().expect("a number"), from.as_millisecond());
        *self.0.entry(number).or_default().entry(window).or_default() += 1;
    }
}

#[test]
fn what_the_spools_accepted_has_reached_the_auditor() {
    let Some(mosquitto) = Mosquitto::installed() else { return };
    let broker_port = free_port();
    let proxy = Proxy::start(broker_port);
    let mut random = fastrand::Rng::with_seed(20);
    let (brokers, kills_a_broker) = (repetitions(3, 100), repetitions(5, 10));
    let mut boxes: Vec<_> = (0..repetitions(3, 8)).map(Audited::new).collect();
    boxes.iter_mut().for_each(|audited| audited.start(proxy.port));
    let mut auditor = Auditor::default();
    for round in 0..=brokers {
        let mut broker = mosquitto.start(broker_port);
        let heard = listen(broker_port);
        proxy.turn();
        if round < brokers {
            for _ in 0..kills_a_broker {
                let index = random.usize(..boxes.len());
                std::thread::sleep(Duration::from_millis(random.u64(30..500)));
                boxes[index].kill();
                boxes[index].start(proxy.port);
            }
            std::thread::sleep(Duration::from_millis(random.u64(0..500)));
        } else {
            boxes.iter_mut().for_each(Audited::end);
        }
        broker.kill();
        proxy.turn();
        // All that the broker had sent, to the end of the connection.
        heard.iter().for_each(|(topic, payload)| auditor.note(&topic, &payload));
    }
    let (mut accepted, mut twice) = (0, 0);
    for audited in &mut boxes {
        audited.read_spool();
        let Audited { number, accepted: windows, last_seq, .. } = audited;
        let arrived = auditor.0.remove(number).unwrap_or_default();
        let lost: Vec<_> = windows.iter().filter(|it| !arrived.contains_key(it)).collect();
        assert!(lost.is_empty(), "box {number} has lost {lost:?}");
        // One window a number, and each number up to the last.
        let numbers: Vec<u64> = arrived.keys().map(|(seq, _)| *seq).collect();
        assert!(numbers.iter().copied().eq(1..=*last_seq), "box {number}: {numbers:?}");
        accepted += numbers.len();
        twice += arrived.values().filter(|times| **times > 1).count();
        assert!(!windows.is_empty(), "the spool of box {number} was never read");
    }
    let kills = brokers * kills_a_broker;
    println!(
        "{kills} kills of {} boxes, {brokers} of brokers: {accepted} windows accepted, all arrived, {twice} more than once",
        boxes.len()
    );
}
