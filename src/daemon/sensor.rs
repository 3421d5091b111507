//! The running sensor: what a turn of the line does, and what follows from it.
//!
//! Owns the order of a turn, and what is counted and said of it. `change` puts a new
//! configuration in force, `report` writes the health message. Reads the clock and knows no
//! signal and no service manager.

mod change;
mod report;

use super::board::Driven;
use super::clock::{self, Step, Watch};
use super::config::Config;
use super::exit::Failure;
use super::line::Measured;
use super::metrics::Metrics;
use super::outlet::Outlet;
use super::publish::home_assistant::Announcement;
use super::publish::payload::{self, Frames, status_name};
use super::reload::Pending;
use super::station::Station;
use crate::alarm::Alarm;
use crate::density::{Closed, SampleZoneStatus};
use crate::derate::Pace;
use crate::fault::Allowance;
use crate::hal::{Switch, Thermometer, Watchdog};
use crate::health::{Actions, Event, Health};
use crate::units::UtcMs;
use change::announcements;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

/// Time between two health messages while nothing changes.
const HEALTH_INTERVAL: Duration = Duration::from_secs(60);

/// Makes a panic of a stage a fault like its others.
fn survive<T>(stage: impl FnOnce() -> Result<T, Failure>) -> Result<T, Failure> {
    catch_unwind(AssertUnwindSafe(stage)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
        Err(Failure::Stage(text.unwrap_or("no message").to_owned()))
    })
}

/// The running line with what is known about its health.
pub struct Sensor {
    config: Config,
    station: Station,
    outlet: Outlet,
    started: Instant,
    watch: Watch,
    /// When the clock was last seen not to be synchronised.
    unsynchronised: Option<UtcMs>,
    health: Health,
    actions: Option<Actions>,
    frames: Frames,
    last_fault: Option<String>,
    health_sent: Option<Instant>,
    metrics: Option<Metrics>,
    announcements: Vec<Announcement>,
    announced: Option<u64>,
    pace: Pace,
    stage_faults: Allowance,
    board_broken: bool,
    pending: Option<Pending>,
    /// Why the latest new configuration was refused.
    refused: Option<String>,
}

impl Sensor {
    /// A sensor that begins with the next turn.
    pub fn new(config: Config, station: Station, outlet: Outlet) -> Self {
        Self {
            announcements: announcements(&config, station.line()),
            health: Health::new(config.interval(), Duration::ZERO),
            metrics: config.metrics.file.as_deref().map(Metrics::new),
            config,
            station,
            outlet,
            started: Instant::now(),
            watch: Watch::start(),
            unsynchronised: None,
            actions: None,
            frames: Frames::default(),
            last_fault: None,
            health_sent: None,
            announced: None,
            pace: Pace::Full,
            stage_faults: Allowance::default(),
            board_broken: false,
            pending: None,
            refused: None,
        }
    }

    /// The configuration that is in force.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The configuration that takes over next.
    #[cfg(test)]
    pub fn pending(&self) -> Option<&Pending> {
        self.pending.as_ref()
    }

    /// The end of the line.
    #[cfg(test)]
    pub fn outlet(&self) -> &Outlet {
        &self.outlet
    }

    /// Time since start.
    pub fn since_start(&self) -> Duration {
        self.started.elapsed()
    }

    /// Says goodbye; what has not arrived waits on the disk.
    pub fn stop(self) {
        self.outlet.stop();
    }

    /// Hears what the clock says before anything is measured at `time`: whether it was set,
    /// and whether a new configuration takes over.
    fn hear_clock(&mut self, time: UtcMs) {
        if let Some(Step { from, to }) = self.watch.step() {
            let by_s = (to.0 - from.0) as f64 / 1000.0;
            log::warn!("the clock was set by {by_s:+.1} s, to {}", clock::rfc3339(to));
            if let Some(last) = self.unsynchronised.as_mut() {
                *last = to;
            }
            let closed = self.station.line_mut().advance(from);
            self.publish(&closed);
            let closed = self.station.line_mut().set_clock(from, to);
            self.publish(&closed);
        }
        if !clock::is_synchronised() {
            self.unsynchronised = Some(clock::now());
        }
        if let Some(pending) = self.pending.take_if(|pending| pending.is_due(time)) {
            self.take_over(pending);
        }
    }

    /// Time between two pictures at the pace of now.
    pub fn interval(&self) -> Duration {
        self.config.interval() * if self.pace == Pace::Half { 2 } else { 1 }
    }

    /// Takes over the pace that the enclosure's temperature allows.
    pub fn set_pace(&mut self, pace: Pace) {
        let before = std::mem::replace(&mut self.pace, pace);
        if before == pace {
            return;
        }
        log::warn!("the enclosure's temperature sets the pace: {}", report::pace(pace).name());
        let interval = self.interval();
        self.station.line_mut().set_interval(interval);
        if (before == Pace::Full) != (pace == Pace::Full) {
            self.tell_alarm(Alarm::Overheated, pace != Pace::Full);
        }
        self.health_sent = None;
    }

    /// One turn of the line: a picture, or the reason why there is none; `None` where none
    /// was asked for.
    ///
    /// # Errors
    /// [`Failure::Stage`] when stages have panicked too often.
    pub fn turn(&mut self) -> Result<Option<Event>, Failure> {
        if self.pace == Pace::Stopped {
            self.hear_clock(clock::now());
            let suspended = SampleZoneStatus::DetectionAutoSuspended;
            let closed = self.station.line_mut().miss(clock::now(), suspended);
            self.publish(&closed);
            return Ok(None);
        }
        let begun = Instant::now();
        let captured = survive(|| self.station.capture());
        let is_new = matches!(captured, Ok(true));
        self.hear_clock(if is_new { self.station.frame().time } else { clock::now() });
        let outcome = match captured {
            Ok(true) => survive(|| self.station.measure()).map(Some),
            Ok(false) => Ok(None),
            Err(failure) => Err(failure),
        };
        if let (Some(metrics), Ok(Some(_))) = (&mut self.metrics, &outcome) {
            metrics.note_turn(begun.elapsed());
        }
        if let Err(fault @ Failure::Stage(_)) = &outcome {
            log::error!("{fault}");
            if !self.stage_faults.note(self.started.elapsed()) {
                return outcome.map(|_| None);
            }
        }
        Ok(Some(self.judge(outcome)))
    }

    /// Counts what came of a turn, and publishes the windows that it closed.
    fn judge(&mut self, outcome: Result<Option<Measured>, Failure>) -> Event {
        let (event, status) = match outcome {
            Ok(Some(measured)) => {
                self.last_fault = None;
                match measured.event {
                    Event::Measured => self.frames.measured += 1,
                    Event::Unchanged => self.frames.unchanged += 1,
                    _ => self.frames.withheld += 1,
                }
                self.publish(&measured.closed);
                return measured.event;
            }
            Ok(None) => {
                self.frames.unchanged += 1;
                (Event::Unchanged, SampleZoneStatus::InputDataIntegrity)
            }
            Err(fault) => {
                self.note(&fault);
                if fault.is_missing_picture() {
                    self.frames.missing += 1;
                    (Event::Missing, SampleZoneStatus::SensorFailure)
                } else {
                    self.frames.damaged += 1;
                    (Event::Damaged, SampleZoneStatus::InputDataIntegrity)
                }
            }
        };
        let closed = self.station.line_mut().miss(clock::now(), status);
        self.publish(&closed);
        event
    }

    /// Says a fault when it is another than the last: once, not with every frame.
    fn note(&mut self, fault: &Failure) {
        let text = fault.to_string();
        if self.last_fault.as_ref() != Some(&text) {
            log::warn!("no measurement: {text}");
            self.last_fault = Some(text);
        }
    }

    /// Closes windows, judges health and publishes what has changed.
    pub fn settle<L, R, W, T>(
        &mut self,
        event: Option<Event>,
        board: &Driven<L, R, W, T>,
    ) -> Actions
    where
        L: Switch,
        R: Switch,
        W: Watchdog,
        T: Thermometer,
    {
        let time = clock::now();
        self.hear_clock(time);
        let closed = self.station.line_mut().advance(time);
        self.publish(&closed);
        self.outlet.tend();
        let since_start = self.since_start();
        let actions = match event {
            _ if self.pace == Pace::Stopped => Actions {
                status: SampleZoneStatus::DetectionAutoSuspended,
                ..self.health.hold(since_start)
            },
            Some(event) => self.health.on(event, since_start),
            None => self.health.idle(since_start),
        };
        if self.board_broken != board.is_broken() {
            self.board_broken = board.is_broken();
            self.tell_alarm(Alarm::BoardFault, self.board_broken);
            self.health_sent = None;
        }
        let alarm_before = self.actions.and_then(|before| before.alarm);
        if alarm_before != actions.alarm {
            self.change_alarm(alarm_before, false);
            self.change_alarm(actions.alarm, true);
        }
        let changed = self.actions.map(|before| before.status) != Some(actions.status);
        self.actions = Some(actions);
        self.announce();
        if changed || self.health_sent.is_none_or(|sent| sent.elapsed() >= HEALTH_INTERVAL) {
            self.health_sent = Some(Instant::now());
            self.publish_health(actions, board);
        }
        actions
    }

    fn publish(&mut self, closed: &Closed) {
        self.outlet.measured_with(self.station.line().reported());
        for report in closed {
            let is_true = self.unsynchronised.is_none_or(|last| report.from > last);
            self.outlet.density(report, is_true);
            if let Some(metrics) = &mut self.metrics {
                metrics.note(report);
            }
        }
    }

    /// Says to Home Assistant what there is, after each connection: the broker may have
    /// lost what it kept.
    fn announce(&mut self) {
        let publisher = self.outlet.publisher();
        let session = publisher.session();
        if session.is_some() && session != std::mem::replace(&mut self.announced, session) {
            for announcement in &self.announcements {
                publisher.announce(announcement.clone());
            }
        }
    }

    fn change_alarm(&self, alarm: Option<Alarm>, active: bool) {
        let Some(alarm) = alarm else { return };
        if active {
            log::error!("alarm {}: no density until it is over", alarm.name());
        } else {
            log::info!("alarm {} is over", alarm.name());
        }
        self.tell_alarm(alarm, active);
    }

    /// The alarms that are on.
    fn alarms(&self) -> Vec<Alarm> {
        let of_pictures = self.actions.and_then(|actions| actions.alarm);
        let heat = (self.pace != Pace::Full).then_some(Alarm::Overheated);
        let board = self.board_broken.then_some(Alarm::BoardFault);
        [of_pictures, heat, board].into_iter().flatten().collect()
    }

    fn tell_alarm(&self, alarm: Alarm, active: bool) {
        self.outlet.publisher().alarm(&payload::AlarmMessage {
            schema: payload::Schema::default(),
            site: self.config.site.clone(),
            time: clock::now().into(),
            name: alarm.into(),
            active,
        });
    }

    /// What is wrong: with the pictures first, else with a new configuration.
    fn fault(&self) -> Option<&str> {
        self.last_fault.as_deref().or(self.refused.as_deref())
    }

    /// The state in one line, for the service manager.
    pub fn describe(&self) -> String {
        let status = self.actions.map_or("starting", |actions| status_name(actions.status));
        let fault = self.fault().map_or(String::new(), |fault| format!(": {fault}"));
        let next = self.pending.as_ref().map_or(String::new(), |pending| {
            format!("; new configuration from {}", clock::rfc3339(pending.at()))
        });
        format!("{status}{fault}{next}")
    }
}

#[cfg(all(test, feature = "demo"))]
pub mod rig;

#[cfg(all(test, feature = "demo"))]
mod clock_tests;

#[cfg(test)]
mod tests {
    use super::*;

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
