//! The sensor's behaviour as arrays of events: no clock, no model and no broker.

mod time;

use super::*;
use crate::density::Start;
use crate::lane::{Description, Lane, Name};
use crate::units::{Direction, ImageSize, LaneId, VehicleClass};
use std::format;
use std::string::{String, ToString};
use std::vec::Vec;

/// Between two pictures, s: four in the shorter window, twelve in the longer.
const INTERVAL_S: u64 = 5;
const LENGTHS_S: [u64; 2] = [20, 60];
/// 08:00:02.3 of a day: in the middle of every window.
const BEGIN: UtcMs = UtcMs(1_767_600_002_300);

/// One event of a test.
enum Step {
    /// So many seconds pass; each fifth brings this.
    Pass(u64, Camera),
    /// The wall clock is set by so many ms, and held to be right from then on, or not.
    SetClock(i64, bool),
    /// A new configuration is ready, with a calibration of that name.
    Prepare(&'static str),
    /// The temperature allows this pace.
    Heat(Pace),
    /// A part of the board fails, or none does.
    Board(bool),
}

use Step::{Board, Heat, Pass, Prepare, SetClock};

/// Behaviour of the camera.
#[derive(Clone, Copy)]
enum Camera {
    /// A picture that shows that preset, with that many vehicles.
    Shows(usize, usize),
    /// None that is measured.
    Gives(Outcome<'static>),
}

use Camera::{Gives, Shows};

const ROAD: Camera = Shows(0, 3);

/// A window that was handed out.
#[derive(Clone, Debug, PartialEq)]
struct Window {
    from: UtcMs,
    to: UtcMs,
    calibration: String,
    clock_synced: bool,
    /// Frames, of lane 1.
    used: u32,
    expected: u32,
    density: Option<f32>,
    status: SampleZoneStatus,
}

impl Window {
    fn length_s(&self) -> i64 {
        (self.to.0 - self.from.0) / 1000
    }
}

fn table(calibration: &str) -> Description {
    let lane = |number, length_m| {
        let id = LaneId::new(number).expect("in range");
        Lane { id, direction: Direction::Toward, length_m }
    };
    Description {
        camera_id: Name::try_from("camera").expect("short"),
        image_size: ImageSize { width: 320, height: 240 },
        lanes: [lane(1, 50.0), lane(2, 100.0)].into_iter().collect(),
        length_rel_err: Some(0.02),
        calibration_id: Name::try_from(calibration).expect("short"),
        calibration_sha256: [7; 32],
        cell_length_m: 10.0,
    }
}

fn presets(names: &[&str]) -> Vec<Preset> {
    let lengths = LENGTHS_S.map(Duration::from_secs);
    let preset = |name: &&str| {
        let interval = Duration::from_secs(INTERVAL_S);
        Preset::new(&table(name), &lengths, interval, 0.5, Start::AtNextWindow)
    };
    names.iter().map(preset).collect::<Result<_, _>>().expect("right settings")
}

/// The daemon's part: it reads the clocks, performs what is asked, and does no more.
struct Bench {
    sensor: Sensor<Vec<Preset>>,
    now: Now,
    board_broken: bool,
    prepared: Option<&'static str>,
    windows: Vec<Window>,
    /// Alarms, paces, power and health, with the second.
    said: Vec<(u64, String)>,
    power: bool,
    gave_up: bool,
}

impl Bench {
    fn new(names: &[&str]) -> Self {
        Self {
            sensor: Sensor::new(presets(names), Duration::from_secs(INTERVAL_S)),
            now: Now { time: BEGIN, since_start: Duration::ZERO, synchronised: true },
            board_broken: false,
            prepared: None,
            windows: Vec::new(),
            said: Vec::new(),
            power: true,
            gave_up: false,
        }
    }

    /// Runs a script and returns what came of it.
    fn run(steps: &[Step]) -> Self {
        let mut bench = Self::new(&["first", "other"]);
        steps.iter().for_each(|step| bench.step(step));
        bench
    }

    fn step(&mut self, step: &Step) {
        match *step {
            Pass(seconds, camera) => (0..seconds).for_each(|_| self.second(camera)),
            SetClock(by_ms, synchronised) => {
                let from = self.now.time;
                self.now.time = UtcMs(from.0 + by_ms);
                self.now.synchronised = synchronised;
                if by_ms != 0 {
                    let to = self.now.time;
                    self.tell(|sensor, act| sensor.clock_set(from, to, act));
                }
            }
            Prepare(name) => {
                self.prepared = Some(name);
                self.sensor.prepare(self.now.time);
            }
            Heat(pace) => self.tell(|sensor, act| sensor.set_pace(pace, act)),
            Board(broken) => self.board_broken = broken,
        }
    }

    fn second(&mut self, camera: Camera) {
        self.take_over();
        let (now, seconds) = (self.now, self.now.since_start.as_secs());
        if seconds.is_multiple_of(self.sensor.interval().as_secs()) {
            let mut counts = presets(&["any"])[0].counts();
            let outcome = match camera {
                _ if self.sensor.pace() == Pace::Stopped => Outcome::NotAsked,
                Shows(preset, vehicles) => {
                    let lane = LaneId::new(1).expect("in range");
                    (0..vehicles).for_each(|_| counts.add(lane, 1.0, VehicleClass::Car));
                    Outcome::Measured { preset, counts: &counts, moves: None }
                }
                Gives(outcome) => outcome,
            };
            self.gave_up |= self.tell(|s, act| s.turn(now, now.time, &outcome, act)).is_err();
        }
        let broken = self.board_broken;
        let power = self.tell(|sensor, act| sensor.tick(now, broken, act)).camera_power_on;
        if core::mem::replace(&mut self.power, power) != power {
            let text = format!("power {}", if power { "on" } else { "off" });
            self.said.push((now.since_start.as_secs(), text));
        }
        self.now.since_start += Duration::from_secs(1);
        self.now.time = UtcMs(self.now.time.0 + 1000);
    }

    fn take_over(&mut self) {
        let time = self.now.time;
        let due = self.tell(|sensor, act| sensor.takeover_due(time, act));
        if let Some((at, name)) = due.zip(self.prepared) {
            let interval = Duration::from_secs(INTERVAL_S);
            self.tell(|sensor, act| sensor.replace(at, presets(&[name]), interval, None, act));
        }
    }

    fn tell<T>(
        &mut self,
        what: impl FnOnce(&mut Sensor<Vec<Preset>>, &mut dyn FnMut(Action<'_>)) -> T,
    ) -> T {
        let Self { sensor, now, windows, said, .. } = self;
        let mut say = |text: String| said.push((now.since_start.as_secs(), text));
        what(sensor, &mut |action| match action {
            Action::Window { window: ClosedWindow { report, calibration }, clock_synced } => {
                let lane = &report.lanes[0];
                windows.push(Window {
                    from: report.from,
                    to: report.to,
                    calibration: calibration.id.as_str().into(),
                    clock_synced,
                    used: lane.frames_used,
                    expected: lane.frames_expected,
                    density: lane.density_veh_km,
                    status: lane.status,
                });
            }
            Action::Alarm { alarm, active } => {
                say(format!("{}{}", if active { "+" } else { "-" }, alarm.name()));
            }
            Action::Health(Actions { status, .. }) => say(format!("{status:?}")),
            Action::Pace(pace) => say(format!("{pace:?}")),
        })
    }

    /// The windows of that length, which are aligned to the clock.
    fn of(&self, length_s: u64) -> Vec<Window> {
        let of_length = |window: &&Window| window.length_s() == length_s as i64;
        let windows: Vec<_> = self.windows.iter().filter(of_length).cloned().collect();
        assert!(windows.iter().all(|w| w.from.0 % (length_s as i64 * 1000) == 0), "{windows:#?}");
        windows
    }

    /// Everything published besides health, with the second.
    fn alarms(&self) -> Vec<(u64, &str)> {
        let is_alarm = |text: &str| text.starts_with(['+', '-']);
        self.said.iter().map(|(at, text)| (*at, text.as_str())).filter(|s| is_alarm(s.1)).collect()
    }
}

/// Whether each window ends where the next begins.
fn are_seamless(windows: &[Window]) -> bool {
    windows.windows(2).all(|pair| pair[0].to == pair[1].from)
}

#[test]
fn every_alarm_is_raised_told_and_cleared() {
    let moved = Gives(Outcome::Withheld(Alarm::CameraMoved));
    let blind = |alarm| [Pass(60, Gives(Outcome::Withheld(alarm))), Pass(30, ROAD)];
    // Alarm, what raises and clears it, when it is published.
    let rows: [(Alarm, [Step; 2], [u64; 2]); 6] = [
        (Alarm::NoPicture, [Pass(60, Gives(Outcome::Missing)), Pass(30, ROAD)], [16, 60]),
        (Alarm::FrozenPicture, [Pass(60, Gives(Outcome::Unchanged)), Pass(30, ROAD)], [21, 60]),
        (Alarm::BlankPicture, blind(Alarm::BlankPicture), [21, 60]),
        (Alarm::BlindedPicture, blind(Alarm::BlindedPicture), [21, 60]),
        (Alarm::BlurredPicture, blind(Alarm::BlurredPicture), [21, 60]),
        (Alarm::CameraMoved, [Pass(60, moved), Pass(30, ROAD)], [0, 60]),
    ];
    for (alarm, steps, [raised, cleared]) in rows {
        let bench = Bench::run(&steps);
        let name = alarm.name();
        let expected = [(raised, format!("+{name}")), (cleared, format!("-{name}"))];
        let expected: Vec<_> = expected.iter().map(|(at, text)| (*at, text.as_str())).collect();
        assert_eq!(bench.alarms(), expected);
        let during = bench.of(20).into_iter().find(|w| w.to.0 == BEGIN.0 + 57_700);
        let during = during.expect("a window under the alarm");
        assert_eq!((during.density, during.status), (None, alarm.status()), "{name}");
        let said = |status: SampleZoneStatus| (raised, format!("{status:?}"));
        assert!(bench.said.contains(&said(alarm.status())), "health follows at once: {name}");
    }
    let heat = [Pass(10, ROAD), Heat(Pace::Half), Pass(10, ROAD), Heat(Pace::Full)];
    assert_eq!(Bench::run(&heat).alarms(), [(10, "+overheated"), (20, "-overheated")]);
    let board = [Pass(10, ROAD), Board(true), Pass(10, ROAD), Board(false), Pass(1, ROAD)];
    assert_eq!(Bench::run(&board).alarms(), [(10, "+board_fault"), (20, "-board_fault")]);
}

#[test]
fn heat_slows_the_line_and_stops_it_and_windows_say_so() {
    let script =
        [Pass(60, ROAD), Heat(Pace::Half), Pass(60, ROAD), Heat(Pace::Stopped), Pass(60, ROAD)];
    let bench = Bench::run(&script);
    let windows = bench.of(20);
    let at = |second: i64| {
        let time = UtcMs(BEGIN.0 + second * 1000);
        let holds = |window: &&Window| (window.from..window.to).contains(&time);
        windows.iter().find(holds).expect("a window")
    };
    assert_eq!((at(40).used, at(40).expected), (4, 4));
    assert_eq!((at(90).used, at(90).expected, at(90).density), (2, 2, Some(60.0)));
    assert_eq!((at(150).used, at(150).density), (0, None));
    assert_eq!(at(150).status, SampleZoneStatus::DetectionAutoSuspended);
    let paces: Vec<_> = bench.said.iter().map(|(at, text)| (*at, text.as_str())).collect();
    for expected in [
        (60, "Half"),
        (60, "+overheated"),
        (60, "Ok"),
        (120, "Stopped"),
        (120, "DetectionAutoSuspended"),
    ] {
        assert!(paces.contains(&expected), "{expected:?} in {paces:?}");
    }
    // It cools: no alarm of a camera that was not asked.
    let mut bench = bench;
    [Heat(Pace::Full), Pass(60, ROAD)].iter().for_each(|step| bench.step(step));
    assert_eq!(bench.alarms(), [(60, "+overheated"), (180, "-overheated")]);
}

#[test]
fn an_outage_of_the_camera_is_counted_and_its_power_is_cycled() {
    let bench = Bench::run(&[Pass(60, ROAD), Pass(600, Gives(Outcome::Missing)), Pass(60, ROAD)]);
    assert_eq!(bench.sensor.frames(), Frames { measured: 24, missing: 120, ..Frames::default() });
    let power: Vec<_> = bench.said.iter().filter(|(_, text)| text.starts_with("power")).collect();
    // The last picture came at 55 s; 20 s to notice, 120 s of patience, then twice as long.
    let (first, second) = (55 + 20 + 120, 55 + 20 + 120 + 240);
    let expected = [(first, "off"), (first + 10, "on"), (second, "off"), (second + 10, "on")];
    let expected = expected.map(|(at, is)| (at, format!("power {is}")));
    assert_eq!(power, expected.iter().collect::<Vec<_>>());
}

#[test]
fn a_window_carries_the_table_of_the_preset_at_which_the_camera_looks() {
    let elsewhere = Shows(1, 5);
    let script = [Pass(58, ROAD), Pass(60, elsewhere), Pass(62, ROAD)];
    let bench = Bench::run(&script);
    let windows = bench.of(60);
    let told: Vec<_> = windows.iter().map(|w| (w.calibration.as_str(), w.used)).collect();
    assert_eq!(told, [("other", 12), ("first", 12)], "pictures of one preset alone");
    assert_eq!(windows.iter().map(|w| w.density).collect::<Vec<_>>(), [Some(100.0), Some(60.0)]);
    assert!(are_seamless(&bench.of(20)));
}

#[test]
fn a_line_whose_stages_break_too_often_is_given_up() {
    let broken = Gives(Outcome::StageFault);
    let mut bench = Bench::run(&[Pass(25, broken)]);
    assert_eq!((bench.gave_up, bench.sensor.frames().damaged), (false, 5));
    bench.step(&Pass(5, broken));
    assert!(bench.gave_up);
    assert_eq!(bench.sensor.stage_faults(), 6);
    let slow = [broken, ROAD, ROAD].map(|camera| Pass(5, camera));
    let mut bench = Bench::new(&["first"]);
    (0..100).for_each(|_| slow.iter().for_each(|step| bench.step(step)));
    assert!(!bench.gave_up, "one in 15 s, indefinitely");
}

#[test]
fn health_is_published_each_minute_when_it_changes_and_when_asked() {
    let mut bench = Bench::run(&[Pass(150, ROAD)]);
    let health = |bench: &Bench| bench.said.iter().map(|(at, _)| *at).collect::<Vec<_>>();
    assert_eq!(health(&bench), [0, 60, 120]);
    bench.sensor.publish_health();
    bench.step(&Pass(70, ROAD));
    assert_eq!(health(&bench), [0, 60, 120, 150, 210]);
}

#[test]
fn a_new_listener_hears_of_the_alarms_that_are_on() {
    let script = [Heat(Pace::Half), Board(true), Pass(30, Gives(Outcome::Missing)), Prepare("b")];
    let mut bench = Bench::run(&script);
    bench.said.clear();
    bench.step(&Pass(60, Gives(Outcome::Missing)));
    let alarms: Vec<_> = bench.alarms().into_iter().map(|(_, text)| text.to_string()).collect();
    assert_eq!(alarms, ["+no_picture", "+overheated", "+board_fault"]);
}
