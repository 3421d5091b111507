//! The running sensor: reads the clocks, turns the line, and does what the core decides.
//!
//! Owns no decision: those are made by [`crate::sensor`]. `hands` performs its actions, `report`
//! writes the health message, `takeover` puts a new configuration in force, `road` keeps the empty
//! road over restarts. Knows no signal and no service manager.

mod hands;
mod log_lines;
mod report;
mod road;
mod takeover;

use super::board::Driven;
use super::clock::{self, Step, Watch};
use super::config::Config;
use super::exit::Failure;
use super::outlet::Outlet;
use super::publish::payload::status_name;
use super::reload::Candidate;
use super::station::{ANSWERS, Station, advice};
use crate::derate::Pace;
use crate::hal::{Switch, Thermometer, Watchdog};
use crate::health::Actions;
use crate::sensor::{Action, GivenUp, Now, Outcome, Preset, Sensor};
use crate::units::UtcMs;
use hands::Hands;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

/// Makes a panic of a stage a fault like its others.
fn survive<T>(stage: impl FnOnce() -> Result<T, Failure>) -> Result<T, Failure> {
    catch_unwind(AssertUnwindSafe(stage)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
        Err(Failure::Stage(text.unwrap_or("no message").to_owned()))
    })
}

/// The sensor's outcome for a fault.
fn outcome_of(fault: &Failure) -> Outcome<'static> {
    match fault {
        Failure::Stage(_) => Outcome::StageFault,
        fault if fault.is_missing_picture() => Outcome::Missing,
        _ => Outcome::Damaged,
    }
}

/// How the publishing thread is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Publishing {
    /// It turns.
    Turning,
    /// It has not turned for so long that the watchdog gets no food.
    Stalled,
    /// It has ended, or will not turn again: the process ends, and is restarted.
    Lost,
}

impl Publishing {
    /// It may take 10 s each to find a name, to connect, and to write.
    const STALLED: Duration = Duration::from_secs(60);
    const LOST: Duration = Duration::from_secs(180);

    fn of(stalled: Option<Duration>) -> Self {
        match stalled {
            None => Self::Lost,
            Some(time) if time > Self::LOST => Self::Lost,
            Some(time) if time > Self::STALLED => Self::Stalled,
            Some(_) => Self::Turning,
        }
    }
}

/// The line at work, with what decides and what performs.
pub struct Running {
    config: Config,
    sensor: Sensor<Vec<Preset>>,
    station: Station,
    hands: Hands,
    /// The clock that nobody sets, at the start.
    started: Duration,
    watch: Watch,
    pending: Option<Box<Candidate>>,
    road: road::Keeper,
}

impl Running {
    /// Begins with the next turn.
    pub fn new(
        config: Config,
        (station, sensor, outlet): (Station, Sensor<Vec<Preset>>, Outlet),
    ) -> Self {
        let (model, table) = station.line().describe();
        log::info!("{model}; {table}");
        log::info!("{}", log_lines::first_numbers(&config.window_lengths(), clock::now()));
        Self {
            hands: Hands::new(&config, station.line(), outlet),
            road: road::Keeper::new(config.road_file()),
            config,
            sensor,
            station,
            started: clock::monotonic(),
            watch: Watch::new(clock::now(), clock::monotonic()),
            pending: None,
        }
    }

    /// The configuration that is in force.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Time since start.
    pub fn since_start(&self) -> Duration {
        clock::monotonic().saturating_sub(self.started)
    }

    /// Time between two pictures at the pace of now.
    pub fn interval(&self) -> Duration {
        self.sensor.interval()
    }

    /// Whether the publishing thread turns.
    pub fn publishing(&self) -> Publishing {
        Publishing::of(self.hands.outlet.publisher().stalled())
    }

    /// Says goodbye; what has not arrived waits on the disk.
    pub fn stop(mut self) {
        self.road.finish(self.station.line());
        self.hands.stop();
    }

    fn now(&self) -> Now {
        Now {
            time: clock::now(),
            since_start: self.since_start(),
            synchronised: clock::is_synchronised(),
        }
    }

    /// Tells the core something, and does what it asks for.
    fn tell<T>(
        &mut self,
        what: impl FnOnce(&mut Sensor<Vec<Preset>>, &mut dyn FnMut(Action<'_>)) -> T,
    ) -> T {
        let Self { sensor, hands, .. } = self;
        what(sensor, &mut |action| hands.perform(action))
    }

    /// Before anything is measured at `time`: whether the clock was set, and whether a new
    /// configuration takes over.
    fn hear_clock(&mut self, time: UtcMs) {
        if let Some(Step { from, to }) = self.watch.step(clock::now(), clock::monotonic()) {
            let by_s = (to.0 - from.0) as f64 / 1000.0;
            log::warn!("the clock was set by {by_s:+.1} s, to {}", clock::rfc3339(to));
            self.tell(|sensor, act| sensor.clock_set(from, to, act));
        }
        if let Some(at) = self.tell(|sensor, act| sensor.takeover_due(time, act)) {
            self.take_over(at);
        }
    }

    /// Takes over the pace that the enclosure's temperature allows.
    pub fn set_pace(&mut self, pace: Pace) {
        self.tell(|sensor, act| sensor.set_pace(pace, act));
    }

    /// One turn of the line: a picture, or the reason why there is none.
    ///
    /// # Errors
    /// [`Failure::Stage`] when stages have panicked too often.
    pub fn turn(&mut self) -> Result<(), Failure> {
        if self.sensor.pace() == Pace::Stopped {
            let now = self.now();
            self.hear_clock(now.time);
            // Where no stage ran, none broke.
            let _ = self.tell(|sensor, act| sensor.turn(now, now.time, &Outcome::NotAsked, act));
            return Ok(());
        }
        let begun = clock::monotonic();
        let captured = survive(|| self.station.capture());
        let is_new = matches!(captured, Ok(true));
        let time = if is_new { self.station.frame().time } else { clock::now() };
        self.hear_clock(time);
        let started = self.started;
        let Self { station, sensor, hands, .. } = self;
        let outcome = match captured {
            Ok(true) => survive(|| station.measure(&mut |_| ())),
            Ok(false) => Ok(Outcome::Unchanged),
            Err(fault) => Err(fault),
        };
        let now = Now {
            time: clock::now(),
            since_start: clock::monotonic().saturating_sub(started),
            synchronised: clock::is_synchronised(),
        };
        let mut act = |action: Action<'_>| hands.perform(action);
        let turned = match outcome {
            Ok(outcome) => {
                let taken = if is_new { time } else { now.time };
                // A stage that gave an outcome did not break.
                let _ = sensor.turn(now, taken, &outcome, &mut act);
                if is_new {
                    hands.note_measured(clock::monotonic().saturating_sub(begun));
                }
                Ok(())
            }
            Err(fault) => {
                let given_up = sensor.turn(now, now.time, &outcome_of(&fault), &mut act);
                hands.note_fault(&fault);
                given_up.map_err(|GivenUp| fault)
            }
        };
        let slow = sensor.camera_period().map(|period| advice(period, sensor.interval()));
        hands.note_slow(
            slow.or_else(|| station.slow_keys()).or_else(|| station.slow_answers(ANSWERS)),
        );
        turned
    }

    /// Closes windows, judges health and publishes what has changed. Returns what lamp and relay
    /// are to show.
    pub fn settle<L, R, W, T>(&mut self, board: &Driven<L, R, W, T>) -> Actions
    where
        L: Switch,
        R: Switch,
        W: Watchdog,
        T: Thermometer,
    {
        let now = self.now();
        self.hear_clock(now.time);
        self.hands.tend();
        self.road.tend(self.station.line(), now.since_start);
        let actions = self.tell(|sensor, act| sensor.tick(now, board.is_broken(), act));
        if self.hands.is_health_due() {
            self.publish_health(actions, board);
        }
        actions
    }

    /// The state in one line, for the service manager.
    pub fn describe(&self) -> String {
        let status = self.sensor.status().map_or("starting", status_name);
        let fault = self.hands.fault().map_or(String::new(), |fault| format!(": {fault}"));
        let next = self
            .sensor
            .takes_over_at()
            .map_or(String::new(), |at| format!("; new configuration from {}", clock::rfc3339(at)));
        format!("{status}{fault}{next}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_does_not_turn_gets_no_watchdog_fed_and_ends_the_process() {
        let after = |seconds| Publishing::of(Some(Duration::from_secs(seconds)));
        assert_eq!([0, 45, 61, 200].map(after), {
            use Publishing::{Lost, Stalled, Turning};
            [Turning, Turning, Stalled, Lost]
        });
        assert_eq!(Publishing::of(None), Publishing::Lost);
    }

    #[test]
    fn a_panic_of_a_stage_is_a_fault_with_its_message() {
        assert_eq!(survive(|| Ok(7)).expect("no fault"), 7);
        let number = 9;
        let fault = survive(|| -> Result<(), _> { panic!("index {number} of 8") });
        let text = fault.expect_err("it panicked").to_string();
        assert!(text.contains("index 9 of 8"), "{text}");
        let fault = survive(|| -> Result<(), _> { Err(Failure::Internal("known".into())) });
        assert!(matches!(fault, Err(Failure::Internal(_))));
    }
}
