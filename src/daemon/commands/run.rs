//! `verge run`: measures and publishes until it is told to stop.

use crate::daemon::board::Driven;
use crate::daemon::clock;
use crate::daemon::config::Config;
use crate::daemon::exit::Failure;
use crate::daemon::metrics::Metrics;
use crate::daemon::notify::Notify;
use crate::daemon::publish::home_assistant::{self, Announcement};
use crate::daemon::publish::payload::{self, Frames, Messages, Stream, status_name};
use crate::daemon::{Line, Measured, Outlet, Scene, Station, open_outlet};
use crate::density::{Closed, SampleZoneStatus};
use crate::derate::Pace;
use crate::fault::Allowance;
use crate::hal::{Board, Switch, Thermometer, Watchdog};
use crate::health::{Actions, Alarm, Event, Health};
use crate::units::UtcMs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Time between two health messages while nothing changes.
const HEALTH_INTERVAL: Duration = Duration::from_secs(60);
/// Longest sleep of the loop: windows close, lamps blink and stops are heard this late.
const TICK: Duration = Duration::from_millis(250);

pub fn run<L, R, W, T>(config: &Path, board: Board<L, R, W, T>) -> Result<(), Failure>
where
    L: Switch,
    R: Switch,
    W: Watchdog,
    T: Thermometer,
{
    let config = Config::read(config)?;
    let stop = stop_flag()?;
    let mut notify = Notify::from_environment();
    let mut board = Driven::new(board);
    let station = Station::open(&config)?;
    let outlet = open_outlet(&config, &station.line)?;
    log::info!("site {}: measuring every {:?}", config.site, config.interval());
    let mut sensor = Sensor::new(&config, station, outlet);
    let (mut next, mut ready) = (Instant::now(), false);
    let mut outcome = Ok(());
    while outcome.is_ok() && !stop.load(Ordering::Relaxed) {
        sensor.set_pace(board.pace(sensor.started.elapsed()));
        let mut event = None;
        if Instant::now() >= next {
            match sensor.turn() {
                Ok(turned) => event = turned,
                Err(failure) => outcome = Err(failure),
            }
            next = (next + sensor.interval()).max(Instant::now());
        }
        let actions = sensor.settle(event, &board);
        let now = sensor.started.elapsed();
        board.drive(actions, now);
        notify.status(&sensor.describe(actions));
        if !ready {
            notify.ready();
            ready = true;
        }
        // The end of the line: a stage that hangs is never followed by these.
        notify.alive();
        board.feed(now);
        std::thread::sleep(next.saturating_duration_since(Instant::now()).min(TICK));
    }
    log::info!("stopping");
    notify.stopping();
    sensor.outlet.stop();
    if outcome.is_ok() {
        board.stop();
    }
    outcome
}

/// Set by SIGTERM and SIGINT.
fn stop_flag() -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        signal_hook::flag::register(signal, Arc::clone(&stop))
            .map_err(|error| Failure::Internal(format!("signals cannot be heard: {error}")))?;
    }
    Ok(stop)
}

/// Makes a panic of a stage a fault like its others.
fn survive<T>(stage: impl FnOnce() -> Result<T, Failure>) -> Result<T, Failure> {
    catch_unwind(AssertUnwindSafe(stage)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
        Err(Failure::Stage(text.unwrap_or("no message").to_owned()))
    })
}

/// The running line with what is known about its health.
struct Sensor {
    site: String,
    station: Station,
    outlet: Outlet,
    started: Instant,
    health: Health,
    actions: Option<Actions>,
    frames: Frames,
    last_fault: Option<String>,
    health_sent: Option<Instant>,
    metrics: Option<Metrics>,
    announcements: Vec<Announcement>,
    announced: Option<u64>,
    interval: Duration,
    pace: Pace,
    stage_faults: Allowance,
    board_broken: bool,
}

impl Sensor {
    fn new(config: &Config, mut station: Station, outlet: Outlet) -> Self {
        let announcements = announcements(config, &mut station);
        Self {
            site: config.site.clone(),
            station,
            outlet,
            started: Instant::now(),
            health: Health::new(config.interval(), Duration::ZERO),
            actions: None,
            frames: Frames::default(),
            last_fault: None,
            health_sent: None,
            metrics: config.metrics.file.as_deref().map(Metrics::new),
            announcements,
            announced: None,
            interval: config.interval(),
            pace: Pace::Full,
            stage_faults: Allowance::default(),
            board_broken: false,
        }
    }

    /// Time between two pictures at the pace of now.
    fn interval(&self) -> Duration {
        if self.pace == Pace::Half { self.interval * 2 } else { self.interval }
    }

    /// Takes over the pace that the enclosure's temperature allows.
    fn set_pace(&mut self, pace: Pace) {
        let before = std::mem::replace(&mut self.pace, pace);
        if before == pace {
            return;
        }
        log::warn!("the enclosure's temperature sets the pace: {}", pace_name(pace));
        let interval = self.interval();
        self.station.line.set_interval(interval);
        if (before == Pace::Full) != (pace == Pace::Full) {
            self.tell_alarm("overheated", pace != Pace::Full);
        }
        self.health_sent = None;
    }

    /// One turn of the line: a picture, or the reason why there is none; `None` where none
    /// was asked for.
    ///
    /// # Errors
    /// [`Failure::Stage`] when stages have panicked too often.
    fn turn(&mut self) -> Result<Option<Event>, Failure> {
        if self.pace == Pace::Stopped {
            let suspended = SampleZoneStatus::DetectionAutoSuspended;
            let closed = self.station.line.miss(clock::now(), suspended);
            self.publish(&closed);
            return Ok(None);
        }
        let begun = Instant::now();
        let outcome = survive(|| self.station.turn());
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
        let closed = self.station.line.miss(clock::now(), status);
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
    fn settle<L, R, W, T>(&mut self, event: Option<Event>, board: &Driven<L, R, W, T>) -> Actions
    where
        L: Switch,
        R: Switch,
        W: Watchdog,
        T: Thermometer,
    {
        let closed = self.station.line.advance(clock::now());
        self.publish(&closed);
        self.outlet.tend();
        let since_start = self.started.elapsed();
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
            self.tell_alarm("board_fault", self.board_broken);
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
        self.outlet.measured_with(self.station.line.reported());
        for report in closed {
            self.outlet.density(report, clock::is_synchronised());
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
        let Some(name) = alarm.map(Alarm::name) else { return };
        if active {
            log::error!("alarm {name}: no density until it is over");
        } else {
            log::info!("alarm {name} is over");
        }
        self.tell_alarm(name, active);
    }

    fn tell_alarm(&self, name: &str, active: bool) {
        let time = clock::rfc3339(clock::now());
        self.outlet
            .publisher()
            .alarm(name, &payload::Alarm { site: &self.site, time, name, active });
    }

    /// The state in one line, for the service manager.
    fn describe(&self, actions: Actions) -> String {
        let status = status_name(actions.status);
        match &self.last_fault {
            Some(fault) => format!("{status}: {fault}"),
            None => status.to_owned(),
        }
    }

    fn publish_health<L, R, W, T>(&mut self, actions: Actions, board: &Driven<L, R, W, T>)
    where
        L: Switch,
        R: Switch,
        W: Watchdog,
        T: Thermometer,
    {
        let now: UtcMs = clock::now();
        let (delivered, refused) = self.outlet.publisher().counts();
        let spool = self.outlet.counts();
        let stream = self.station.source.counts();
        let faults = board.faults();
        let line = &self.station.line;
        let health = payload::Health {
            site: &self.site,
            time: clock::rfc3339(now),
            version: env!("CARGO_PKG_VERSION"),
            status: status_name(actions.status),
            alarm: actions.alarm.map(Alarm::name),
            uptime_s: self.started.elapsed().as_secs(),
            clock_synced: clock::is_synchronised(),
            camera: line.scene().map(|scene| Self::camera(line, scene)),
            frames: self.frames,
            stream: Stream {
                flagged: stream.flagged,
                lost: stream.lost,
                reopened: stream.reopened,
            },
            messages: Messages {
                delivered,
                refused,
                waiting: spool.waiting,
                in_memory: spool.in_memory,
                dropped: spool.dropped,
                damaged: spool.damaged,
            },
            board: payload::Board {
                enclosure_c: board.enclosure_c(),
                pace: pace_name(self.pace),
                faults: payload::BoardFaults {
                    status_led: faults.status_led,
                    camera_power: faults.camera_power,
                    watchdog: faults.watchdog,
                    thermometer: faults.thermometer,
                },
                last_fault: board.last_fault(),
            },
            stage_faults: self.stage_faults.faults(),
            last_fault: self.last_fault.as_deref(),
        };
        self.outlet.publisher().health(&health);
        if let Some(metrics) = &mut self.metrics {
            metrics.write(&health, self.outlet.is_open());
        }
    }

    fn camera<'l>(line: &'l Line, scene: &Scene) -> payload::Camera<'l> {
        let tenths = |px: f32| (px * 10.0).round() / 10.0;
        payload::Camera {
            aim: scene.aiming().name(),
            preset: &line.counting().table().calibration_id,
            shift_px: scene.shift().map(|shift| [tenths(shift.u), tenths(shift.v)]),
            light: scene.latest().map(|look| if look.is_night() { "night" } else { "day" }),
        }
    }
}

/// The discovery messages that the configuration asks for.
fn announcements(config: &Config, station: &mut Station) -> Vec<Announcement> {
    let settings = &config.home_assistant;
    if !settings.discovery {
        return Vec::new();
    }
    let lengths: Vec<_> =
        config.windows.lengths_s.iter().copied().map(Duration::from_secs).collect();
    let lanes = &station.line.counting().table().lanes;
    home_assistant::announcements(
        &settings.prefix,
        &config.site,
        &config.root_topic(),
        lanes,
        &lengths,
    )
}

const fn pace_name(pace: Pace) -> &'static str {
    match pace {
        Pace::Full => "full",
        Pace::Half => "half",
        Pace::Stopped => "stopped",
    }
}

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
