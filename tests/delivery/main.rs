//! Delivery without loss, against Debian's mosquitto and a subscriber that checks `seq`.
//!
//! A daemon's end of the line runs as a process of its own: it accepts windows as fast as a
//! test needs them, says which ones it has accepted, and is killed. What it has accepted
//! must arrive. `VERGE_LONG=1` runs the numbers of the product's claim, some minutes each.
#![cfg(feature = "demo")]

#[path = "../common/mod.rs"]
mod common;
mod crowd;
mod disk;
mod independent;

use common::mosquitto::{Mosquitto, Running};
use common::packets::packet;
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::net::{Ipv4Addr, TcpStream};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration, Instant};
use verge::daemon::outlet::Outlet;
use verge::daemon::publish::loopback::Subscriber;
use verge::daemon::publish::{Format, Identity, MqttSettings};
use verge::daemon::spool::Spool;
use verge::density::{Cells, DensityError, LaneReport, SampleZoneStatus, WindowReport};
use verge::lane::Name;
use verge::sensor::ClosedWindow;
use verge::units::{Direction, LaneId, UtcMs, VehicleClass};
use verge::wire::{CalibrationRef, ModelRef};
use verge_desk::free_port;

const PATIENCE: Duration = Duration::from_secs(30);
const ROOT: &str = "verge/delivery";
/// A process with this in its environment runs [`child`].
const CHILD: &str = "VERGE_DELIVERY_CHILD";

fn is_long() -> bool {
    std::env::var_os("VERGE_LONG").is_some()
}

fn repetitions(short: usize, long: usize) -> usize {
    if is_long() { long } else { short }
}

/// A one-minute window of four lanes that ends at the `n`-th minute.
fn window(n: i64) -> WindowReport {
    let lane = |number| LaneReport {
        lane: LaneId::new(number).expect("in range"),
        direction: Direction::Toward,
        density_veh_km: Some(21.5),
        density_se: Some(3.25),
        vehicles_mean: Some(2.75),
        by_class: Some([0.5; VehicleClass::COUNT]),
        space_occupancy: Some(0.1),
        length_m: 125.0,
        frames_used: 6,
        frames_expected: 6,
        status: SampleZoneStatus::Ok,
        cells: Some(Cells {
            length_m: 12.5,
            density_veh_km: Some([21.5; 10].into_iter().collect()),
        }),
        error: Some(DensityError { calibration: 0.5, counting: 1.5, ci90: [14.5, 28.5] }),
        traffic: None,
    };
    let (from, to) = (UtcMs((n - 1) * 60_000), UtcMs(n * 60_000));
    WindowReport { from, to, lanes: (1..=4).map(lane).collect() }
}

fn outlet(port: u16, folder: &Path, replay_per_s: f64) -> Outlet {
    let model = ModelRef { name: name("test"), sha256: [7; 32] };
    let identity = Identity::new("delivery", &model);
    let settings = MqttSettings { replay_per_s, ..MqttSettings::local(port, ROOT) };
    let spool = Spool::open(folder, 7 * 1440).expect("the earlier one is dead");
    Outlet::start(settings, Format::Json, identity, spool)
}

fn name(text: &str) -> Name {
    Name::try_from(text).expect("short")
}

/// Gives the outlet window `n`.
fn accept(outlet: &mut Outlet, n: i64) {
    let calibration =
        &CalibrationRef { id: name("joint-01020304"), sha256: [8; 32], rel_err: Some(0.02) };
    outlet.density(ClosedWindow { report: &window(n), calibration }, true);
}

/// Tends the outlet until `done`.
fn tend(outlet: &mut Outlet, what: &str, done: impl Fn(&Outlet) -> bool) {
    let until = Instant::now() + PATIENCE;
    while !done(outlet) {
        assert!(Instant::now() < until, "{what}: {:?}", outlet.counts());
        outlet.tend();
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// The life of a process that is to be killed: accepts a window each 10 ms for as long as
/// its input is open, and says so; then delivers what is left and ends.
#[test]
fn child() {
    let Ok(argument) = std::env::var(CHILD) else { return };
    let (port, folder) = argument.split_once(' ').expect("port and folder");
    let mut outlet = outlet(port.parse().expect("a port"), folder.as_ref(), 1000.0);
    let (closed, ended) = mpsc::channel();
    std::thread::spawn(move || {
        let _ = std::io::stdin().read_line(&mut String::new());
        let _ = closed.send(());
    });
    let mut stdout = std::io::stdout();
    while ended.try_recv() == Err(mpsc::TryRecvError::Empty) {
        accept(&mut outlet, 1);
        writeln!(stdout, "\naccepted").expect("the parent reads");
        outlet.tend();
        std::thread::sleep(Duration::from_millis(10));
    }
    let until = Instant::now() + PATIENCE;
    while outlet.counts().waiting > 0 && Instant::now() < until {
        outlet.tend();
        std::thread::sleep(Duration::from_millis(10));
    }
    assert_eq!(outlet.counts().dropped + outlet.counts().damaged, 0);
    outlet.stop();
}

/// Starts [`child`].
fn start_child(port: u16, folder: &Path) -> Running {
    Command::new(std::env::current_exe().expect("this program"))
        .args(["--exact", "child", "--nocapture"])
        .env(CHILD, format!("{port} {}", folder.display()))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .map(Running)
        .expect("the program starts")
}

/// How often the process has said that a window was accepted; read to its end.
fn accepted(child: &mut Running) -> usize {
    let stdout = child.0.stdout.take().expect("piped");
    let lines = BufReader::new(stdout).lines().map_while(Result::ok);
    lines.filter(|line| line == "accepted").count()
}

/// How often each `seq` has arrived, and the time from now to the last of each kind.
#[derive(Default)]
struct Arrived {
    times: BTreeMap<u64, usize>,
    done: usize,
}

impl Arrived {
    fn note(&mut self, topic: &str, payload: &[u8]) {
        let Some(topic) = topic.strip_prefix(ROOT).filter(|topic| topic.ends_with("/60s")) else {
            return;
        };
        let message: Value = serde_json::from_slice(payload).expect("JSON");
        *self.times.entry(message["seq"].as_u64().expect("a number")).or_default() += 1;
        assert_eq!(topic.starts_with("/replay/"), message["done"].is_boolean(), "{message:#}");
        self.done += usize::from(message["done"] == true);
    }

    /// No number up to `last` is missing.
    fn assert_complete(&self, last: u64) {
        let missing: Vec<_> = (1..=last).filter(|seq| !self.times.contains_key(seq)).collect();
        assert!(missing.is_empty(), "{} of {last} are missing: {missing:?}", missing.len());
    }
}

/// Reads in a thread of its own until nothing has come for two seconds after `stop`.
fn collect(mut subscriber: Subscriber) -> (mpsc::Sender<()>, Receiver<Arrived>) {
    let (stop, stopped) = mpsc::channel::<()>();
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || {
        let mut arrived = Arrived::default();
        loop {
            match subscriber.next(Duration::from_secs(2)) {
                Some((topic, payload)) => arrived.note(&topic, &payload),
                None if stopped.try_recv() != Err(mpsc::TryRecvError::Empty) => break,
                None => {}
            }
        }
        let _ = sender.send(arrived);
    });
    (stop, receiver)
}

#[test]
fn killed_at_random_the_daemon_loses_no_accepted_window() {
    let Some(mosquitto) = Mosquitto::installed() else { return };
    let port = free_port();
    let _broker = mosquitto.start(port);
    let (stop, arrived) = collect(Subscriber::connect(port, "verge/#").expect("a subscription"));
    let folder = common::folder();
    let mut random = fastrand::Rng::with_seed(8);
    let kills = repetitions(15, 1000);
    let mut total = 0;
    for _ in 0..kills {
        let mut child = start_child(port, folder.path());
        std::thread::sleep(Duration::from_millis(random.u64(30..300)));
        child.kill();
        total += accepted(&mut child);
    }
    let mut last = start_child(port, folder.path());
    std::thread::sleep(Duration::from_millis(200));
    drop(last.0.stdin.take());
    total += accepted(&mut last);
    drop(stop);
    let arrived = arrived.recv_timeout(PATIENCE).expect("the subscriber ends");
    let last = arrived.times.keys().next_back().copied().unwrap_or_default();
    arrived.assert_complete(last);
    assert!(last >= total as u64, "{total} were accepted, {last} arrived");
    let twice = arrived.times.values().filter(|&&times| times > 1).count();
    println!("{kills} kills: {total} windows said to be accepted, {last} arrived, {twice} twice");
}

/// Hears every message that the broker has sent before it was killed: a subscriber of
/// thirty lines, since a client library gives up what it has read when the connection ends.
fn listen(port: u16) -> Receiver<(String, Vec<u8>)> {
    let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).expect("a connection");
    // MQTT 3.1.1: CONNECT as "ear" with a clean session and no keep-alive; SUBSCRIBE to
    // "verge/#" with QoS 0.
    stream.write_all(b"\x10\x0f\x00\x04MQTT\x04\x02\x00\x00\x00\x03ear").expect("sent");
    stream.write_all(b"\x82\x0c\x00\x01\x00\x07verge/#\x00").expect("sent");
    let mut stream = BufReader::new(stream);
    let (kind, _) = packet(&mut stream).expect("an answer");
    assert_eq!(kind, 0x20, "CONNACK");
    let (kind, _) = packet(&mut stream).expect("an answer");
    assert_eq!(kind, 0x90, "SUBACK");
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || {
        while let Some((kind, body)) = packet(&mut stream) {
            if kind & 0xf0 == 0x30 {
                let (length, rest) = body.split_first_chunk::<2>().expect("a topic");
                let (topic, payload) = rest.split_at(usize::from(u16::from_be_bytes(*length)));
                let topic = String::from_utf8(topic.to_vec()).expect("UTF-8");
                let _ = sender.send((topic, payload.to_vec()));
            }
        }
    });
    receiver
}

#[test]
fn a_killed_broker_costs_no_accepted_window() {
    let Some(mosquitto) = Mosquitto::installed() else { return };
    let port = free_port();
    let folder = common::folder();
    let mut outlet = outlet(port, folder.path(), 1000.0);
    let mut arrived = Arrived::default();
    let kills = repetitions(3, 100);
    let mut sent = 0;
    for _ in 0..kills {
        let mut broker = mosquitto.start(port);
        let listener = listen(port);
        // Whoever comes to a new broker before the subscriber speaks to nobody: this session
        // begins with what is waiting.
        let until = Instant::now() + PATIENCE;
        while outlet.counts().waiting > 0 || !outlet.is_open() {
            assert!(Instant::now() < until, "the arrears are not delivered");
            outlet.tend();
            std::thread::sleep(Duration::from_millis(5));
        }
        for _ in 0..20 {
            sent += 1;
            accept(&mut outlet, sent);
        }
        // Some of them are on their way now, acknowledged or not.
        outlet.tend();
        std::thread::sleep(Duration::from_millis(fastrand::u64(0..10)));
        broker.kill();
        listener.iter().for_each(|(topic, payload)| arrived.note(&topic, &payload));
        let until = Instant::now() + PATIENCE;
        while outlet.is_open() {
            assert!(Instant::now() < until, "the end of the session is not noticed");
            outlet.tend();
            std::thread::sleep(Duration::from_millis(5));
        }
        if is_long() {
            // An attempt finds nobody: connections to one broker are bounded.
            std::thread::sleep(Duration::from_millis(1500));
        }
    }
    let _broker = mosquitto.start(port);
    let mut subscriber = Subscriber::connect(port, "verge/#").expect("a subscription");
    let until = Instant::now() + PATIENCE;
    while outlet.counts().waiting > 0 {
        assert!(Instant::now() < until, "the arrears are not delivered");
        outlet.tend();
        std::thread::sleep(Duration::from_millis(5));
    }
    outlet.stop();
    while let Some((topic, payload)) = subscriber.next(Duration::from_millis(500)) {
        arrived.note(&topic, &payload);
    }
    arrived.assert_complete(u64::try_from(sent).expect("positive"));
    println!("{kills} kills of the broker: {sent} windows, all arrived");
}

#[test]
fn a_day_without_a_broker_drains_and_live_windows_go_first() {
    let Some(mosquitto) = Mosquitto::installed() else { return };
    let port = free_port();
    let folder = common::folder();
    let day = repetitions(100, 1440) as u64;
    let mut outlet = outlet(port, folder.path(), if day < 1440 { 50.0 } else { 10.0 });
    (1..=day).for_each(|n| accept(&mut outlet, n as i64));
    let _broker = mosquitto.start(port);
    let mut subscriber = Subscriber::connect(port, "verge/#").expect("a subscription");
    let started = Instant::now();
    let mut arrived = Arrived::default();
    let mut live = None;
    while outlet.counts().waiting > 0 {
        assert!(started.elapsed() < Duration::from_mins(10), "a day drains within 10 minutes");
        outlet.tend();
        if live.is_none() && outlet.counts().waiting < day / 2 {
            accept(&mut outlet, day as i64 + 1);
            live = Some(arrived.times.len());
        }
        while let Some((topic, payload)) = subscriber.next(Duration::from_millis(5)) {
            arrived.note(&topic, &payload);
            if topic.ends_with("/density/60s") && !topic.contains("replay") {
                let overtaken = arrived.times.len() - live.expect("only then is it sent");
                assert!(overtaken <= 34, "{overtaken} arrears went before a live window");
            }
        }
    }
    let seconds = started.elapsed().as_secs_f64();
    outlet.stop();
    while let Some((topic, payload)) = subscriber.next(Duration::from_millis(500)) {
        arrived.note(&topic, &payload);
    }
    arrived.assert_complete(day + 1);
    assert_eq!(arrived.done, 1);
    println!("{day} windows of an outage were delivered in {seconds:.0} s");
}
