//! A sensor on a test bench: recorded frames, clocks set by hand, a broker inside the program,
//! and a subscriber that reads every window.

use super::Sensor;
use crate::daemon::assemble::Assembly;
use crate::daemon::board::Driven;
use crate::daemon::clock::hand;
use crate::daemon::config::Config;
use crate::daemon::publish::loopback::Subscriber;
use crate::daemon::reload::{Outcome, Reload};
use crate::hal::Board;
use crate::units::UtcMs;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

const PATIENCE: Duration = Duration::from_secs(60);
pub const TABLE: &str = "tests/data/curve.lut";
/// Between two pictures: four in the shorter window, twelve in the longer.
const INTERVAL_S: u64 = 5;
pub const LENGTHS_S: [u64; 2] = [20, 60];
/// 08:00:02.3 of a day: in the middle of every window.
pub const BEGIN: UtcMs = UtcMs(1_767_600_002_300);

/// A configuration in a folder of its own, and the sensor that runs it.
pub struct Bench {
    pub folder: tempfile::TempDir,
    pub sensor: Sensor,
    board: Driven<(), (), (), ()>,
    pub reload: Reload,
    pub asked: Arc<AtomicBool>,
    seconds: u64,
}

impl Bench {
    pub fn start(port: u16) -> Self {
        hand::stop(BEGIN);
        let folder = tempfile::tempdir().expect("a temporary folder");
        write_config(folder.path(), port, "");
        let path = folder.path().join("verge.toml");
        let config = Config::read(&path).expect("a right configuration");
        let assembly = Assembly::of(&config).expect("what it names is there");
        let (station, outlet) = assembly.open(&config).expect("nobody has the spool");
        let asked = Arc::new(AtomicBool::new(false));
        let reload = Reload::new(&path, Arc::clone(&asked));
        let sensor = Sensor::new(config, station, outlet);
        let board = Driven::new(Board::default());
        let mut bench = Self { folder, sensor, board, reload, asked, seconds: 0 };
        bench.tend(|sensor| sensor.outlet().is_open());
        bench
    }

    /// Lets that time pass, with a picture each [`INTERVAL_S`].
    pub fn pass(&mut self, seconds: u64) {
        for _ in 0..seconds {
            let event = if self.seconds.is_multiple_of(INTERVAL_S) {
                self.sensor.turn().expect("a line that does not give up")
            } else {
                None
            };
            self.sensor.settle(event, &self.board);
            self.seconds += 1;
            hand::pass(Duration::from_secs(1));
        }
    }

    /// Tends the sensor until `done`, while its clocks stand.
    pub fn tend(&mut self, done: impl Fn(&Sensor) -> bool) {
        let until = Instant::now() + PATIENCE;
        while !done(&self.sensor) {
            assert!(Instant::now() < until, "the broker has not taken what waits");
            self.sensor.settle(None, &self.board);
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Waits for what becomes of a request, told as the daemon's loop tells it. Returns how
    /// often loading has begun.
    pub fn await_outcome(&mut self) -> (usize, Result<(), String>) {
        let until = Instant::now() + PATIENCE;
        let mut begun = 0;
        while Instant::now() < until {
            match self.reload.outcome(self.sensor.config()) {
                Some(Outcome::Begun) => begun += 1,
                Some(Outcome::Loaded(candidate)) => {
                    self.sensor.prepare(candidate);
                    return (begun, Ok(()));
                }
                Some(Outcome::Refused(failure)) => {
                    self.sensor.refuse(&failure);
                    return (begun, Err(failure.to_string()));
                }
                None => std::thread::sleep(Duration::from_millis(5)),
            }
        }
        panic!("nothing was loaded");
    }

    pub fn reload(&mut self) -> Result<(), String> {
        self.asked.store(true, Ordering::Relaxed);
        self.await_outcome().1
    }

    /// Delivers what waits and ends.
    pub fn stop(mut self) {
        self.tend(|sensor| sensor.outlet().counts().waiting == 0);
        self.sensor.stop();
    }
}

/// Writes the configuration; `more` holds keys of the broker and further sections.
pub fn write_config(folder: &Path, port: u16, more: &str) {
    let here = std::env::current_dir().expect("a working directory");
    let here = here.display();
    let table = folder.join("table.lut");
    if !table.exists() {
        fs::copy(TABLE, &table).expect("it ships");
    }
    let text = format!(
        "site = \"bench\"\n[camera]\nid = \"curve\"\ninterval_s = {INTERVAL_S}\n\
         source = \"{here}/tests/data/curve/frames\"\n\
         [model]\nfile = \"{here}/models/verge_nanodet_640x480.toml\"\n\
         [lane_table]\nfile = \"table.lut\"\n[windows]\nlengths_s = {LENGTHS_S:?}\n\
         [mqtt]\nport = {port}\n{more}"
    );
    fs::write(folder.join("verge.toml"), text).expect("writing it");
}

/// What is of interest in a window that arrived.
#[derive(Clone, Debug)]
pub struct Window {
    pub from: UtcMs,
    pub to: UtcMs,
    pub calibration: String,
    pub clock_synced: bool,
    /// Frames, of lane 1.
    pub used: u64,
    pub expected: u64,
}

/// Windows as they arrived, by length, in the order of their `seq`.
#[derive(Default)]
pub struct Arrived {
    pub windows: BTreeMap<String, BTreeMap<u64, Window>>,
    pub health: Vec<Value>,
}

impl Arrived {
    /// Reads until the sensor says goodbye.
    pub fn read(&mut self, subscriber: &mut Subscriber) {
        loop {
            let (topic, bytes) = subscriber.next(PATIENCE).expect("it says goodbye");
            let topic = topic.strip_prefix("verge/bench/").expect("the site's root");
            if topic == "presence" && bytes == b"shutdown" {
                return;
            }
            if topic == "health" {
                self.health.push(serde_json::from_slice(&bytes).expect("JSON"));
            }
            let Some((_, length)) = topic.split_once("density/") else { continue };
            let message: Value = serde_json::from_slice(&bytes).expect("JSON");
            let time = |key: &str| {
                let time = message[key].as_str().and_then(|text| text.parse().ok());
                UtcMs(time.map(jiff::Timestamp::as_millisecond).expect("a time"))
            };
            let lane = &message["lanes"][0];
            let [used, expected] =
                ["frames_used", "frames_expected"].map(|key| lane[key].as_u64().expect("a number"));
            assert_eq!(lane["status"], "oK", "{message:#}");
            let window = Window {
                from: time("from"),
                to: time("to"),
                calibration: message["calibration"]["id"].as_str().expect("a name").to_owned(),
                clock_synced: message["clock_synced"].as_bool().expect("true or false"),
                used,
                expected,
            };
            let seq = message["seq"].as_u64().expect("a number");
            let of_length = self.windows.entry(length.to_owned()).or_default();
            let twice = of_length.insert(seq, window);
            assert!(twice.is_none(), "{length} {seq} came twice");
        }
    }

    /// Every window from the first whole one to `end` is there once, in order; returns the
    /// beginning of the first that is not of the calibration with which it began.
    pub fn check(&self, end: UtcMs) -> Option<UtcMs> {
        let mut changes = Vec::new();
        for (&length_s, name) in LENGTHS_S.iter().zip(["20s", "60s"]) {
            let length = Duration::from_secs(length_s);
            let windows = &self.windows[name];
            let numbers: Vec<_> = windows.keys().copied().collect();
            assert_eq!(numbers, (1..=windows.len() as u64).collect::<Vec<_>>(), "{name}");
            let mut expected = BEGIN.floor_to(length);
            for window in windows.values() {
                expected = expected.saturating_add(length);
                assert_eq!(window.from, expected, "{name}: one after the other");
                assert_eq!(window.used, window.expected, "{name}: {window:?} is whole");
            }
            assert_eq!(expected.saturating_add(length), end.floor_to(length), "{name}");
            let first = &windows[&1].calibration;
            let other = windows.values().find(|window| window.calibration != *first);
            changes.push(other.map(|window| window.from));
        }
        assert_eq!(changes[0], changes[1], "both lengths change at once");
        changes[0]
    }
}

pub fn subscribe(port: u16) -> Subscriber {
    Subscriber::connect(port, "verge/#").expect("a subscription")
}
