//! `verge run`: measures and publishes until it is told to stop.

use crate::daemon::clock;
use crate::daemon::config::Config;
use crate::daemon::exit::Failure;
use crate::daemon::publish::payload::{self, Frames, Messages, status_name};
use crate::daemon::{Outlet, Station, open_outlet};
use crate::density::{Closed, SampleZoneStatus};
use crate::hal::{Board, Switch, Thermometer, Watchdog};
use crate::health::{Actions, Alarm, Event, Health};
use crate::units::UtcMs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Time between two health messages while nothing changes.
const HEALTH_INTERVAL: Duration = Duration::from_secs(60);
/// Longest sleep of the loop: windows close, lamps blink and stops are heard this late.
const TICK: Duration = Duration::from_millis(250);

pub fn run<L, R, W, T>(config: &Path, mut board: Board<L, R, W, T>) -> Result<(), Failure>
where
    L: Switch,
    R: Switch,
    W: Watchdog,
    T: Thermometer,
{
    let config = Config::read(config)?;
    let stop = stop_flag()?;
    let station = Station::open(&config)?;
    let outlet = open_outlet(&config, &station.line)?;
    log::info!("site {}: measuring every {:?}", config.site, config.interval());
    let mut sensor = Sensor::new(&config, station, outlet);
    let mut next = Instant::now();
    while !stop.load(Ordering::Relaxed) {
        let mut event = None;
        if Instant::now() >= next {
            event = Some(sensor.turn());
            next = (next + config.interval()).max(Instant::now());
        }
        let actions = sensor.settle(event);
        drive(&mut board, actions);
        std::thread::sleep(next.saturating_duration_since(Instant::now()).min(TICK));
    }
    log::info!("stopping");
    sensor.outlet.stop();
    Ok(())
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

/// Drives the board's parts. A part that fails is said once in a while and never stops the
/// measurement.
fn drive<L, R, W, T>(board: &mut Board<L, R, W, T>, actions: Actions)
where
    L: Switch,
    R: Switch,
    W: Watchdog,
    T: Thermometer,
{
    if let Err(error) = board.status_led.set(actions.led_on) {
        log::debug!("status lamp: {error:?}");
    }
    if let Err(error) = board.camera_power.set(actions.camera_power_on) {
        log::warn!("camera power: {error:?}");
    }
    if let Err(error) = board.watchdog.feed() {
        log::error!("watchdog: {error:?}");
    }
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
}

impl Sensor {
    fn new(config: &Config, station: Station, outlet: Outlet) -> Self {
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
        }
    }

    /// One turn of the line: a picture, or the reason why there is none.
    fn turn(&mut self) -> Event {
        let outcome = self.station.turn();
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
    fn settle(&mut self, event: Option<Event>) -> Actions {
        let closed = self.station.line.advance(clock::now());
        self.publish(&closed);
        self.outlet.tend();
        let since_start = self.started.elapsed();
        let actions = match event {
            Some(event) => self.health.on(event, since_start),
            None => self.health.idle(since_start),
        };
        let alarm_before = self.actions.and_then(|before| before.alarm);
        if alarm_before != actions.alarm {
            self.change_alarm(alarm_before, false);
            self.change_alarm(actions.alarm, true);
        }
        let changed = self.actions.map(|before| before.status) != Some(actions.status);
        self.actions = Some(actions);
        if changed || self.health_sent.is_none_or(|sent| sent.elapsed() >= HEALTH_INTERVAL) {
            self.health_sent = Some(Instant::now());
            self.publish_health(actions);
        }
        actions
    }

    fn publish(&mut self, closed: &Closed) {
        self.outlet.measured_with(self.station.line.reported());
        for report in closed {
            self.outlet.density(report, clock::is_synchronised());
        }
    }

    fn change_alarm(&self, alarm: Option<Alarm>, active: bool) {
        let Some(name) = alarm.map(Alarm::name) else { return };
        if active {
            log::error!("alarm {name}: no density until it is over");
        } else {
            log::info!("alarm {name} is over");
        }
        let time = clock::rfc3339(clock::now());
        self.outlet
            .publisher()
            .alarm(name, &payload::Alarm { site: &self.site, time, name, active });
    }

    fn publish_health(&self, actions: Actions) {
        let now: UtcMs = clock::now();
        let (delivered, refused) = self.outlet.publisher().counts();
        let spool = self.outlet.counts();
        self.outlet.publisher().health(&payload::Health {
            site: &self.site,
            time: clock::rfc3339(now),
            version: env!("CARGO_PKG_VERSION"),
            status: status_name(actions.status),
            alarm: actions.alarm.map(Alarm::name),
            uptime_s: self.started.elapsed().as_secs(),
            clock_synced: clock::is_synchronised(),
            camera: self.station.line.scene().map(|scene| self.camera(scene)),
            frames: self.frames,
            messages: Messages {
                delivered,
                refused,
                waiting: spool.waiting,
                in_memory: spool.in_memory,
                dropped: spool.dropped,
                damaged: spool.damaged,
            },
            last_fault: self.last_fault.as_deref(),
        });
    }

    fn camera(&self, scene: &crate::daemon::Scene) -> payload::Camera<'_> {
        let tenths = |px: f32| (px * 10.0).round() / 10.0;
        payload::Camera {
            aim: scene.aiming().name(),
            preset: &self.station.line.counting().table().calibration_id,
            shift_px: scene.shift().map(|shift| [tenths(shift.u), tenths(shift.v)]),
            light: scene.latest().map(|look| if look.is_night() { "night" } else { "day" }),
        }
    }
}
