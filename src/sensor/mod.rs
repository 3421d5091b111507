//! The sensor: what follows from what happens at the camera, the clock and the board.
//!
//! Owns windows, alarms, the pace, and when health is published. A state machine: time and
//! outcomes come in, [`Action`]s go out through a callback, in the order in which they are to
//! be performed. Knows no clock, no picture, no model and no broker, and never allocates.
//!
//! A turn of the line is [`Sensor::turn`]; between turns, a few times a second, comes
//! [`Sensor::tick`]. [`Sensor::clock_set`] and [`Sensor::replace`] come before the turn or
//! tick at which they are noticed.

mod action;
mod takeover;
mod windows;

pub use action::{Action, Frames, GivenUp, Now, Outcome};
pub use windows::{ClosedWindow, Preset, Windows};

use crate::alarm::Alarm;
use crate::density::{MAX_WINDOWS, SampleZoneStatus};
use crate::derate::Pace;
use crate::fault::Allowance;
use crate::health::{Actions, Health};
use crate::units::UtcMs;
use core::time::Duration;
use takeover::TakeOver;

/// Time between two health messages while nothing changes.
pub const HEALTH_INTERVAL: Duration = Duration::from_secs(60);

/// The state of the sensor. `P` holds its presets ([`Windows`]).
#[derive(Clone, Debug)]
pub struct Sensor<P, const W: usize = MAX_WINDOWS> {
    windows: Windows<P, W>,
    /// Time between two pictures at full pace.
    interval: Duration,
    pace: Pace,
    health: Health,
    frames: Frames,
    stage_faults: Allowance,
    /// When the clock was last seen not to be synchronised.
    unsynchronised: Option<UtcMs>,
    /// Consequences of the latest tick for the pictures.
    latest: Option<Actions>,
    board_broken: bool,
    /// When health was last published; `None` where it is due.
    health_sent: Option<Duration>,
    takeover: Option<TakeOver>,
}

impl<const W: usize, P: AsRef<[Preset<W>]> + AsMut<[Preset<W>]>> Sensor<P, W> {
    /// A sensor whose camera gives a picture each `interval`.
    pub fn new(presets: P, interval: Duration) -> Self {
        Self {
            windows: Windows::new(presets),
            interval,
            pace: Pace::Full,
            health: Health::new(interval, Duration::ZERO),
            frames: Frames::default(),
            stage_faults: Allowance::default(),
            unsynchronised: None,
            latest: None,
            board_broken: false,
            health_sent: None,
            takeover: None,
        }
    }

    /// Takes what came of a turn of the line. `taken` is when the picture was taken; without
    /// one, now.
    ///
    /// # Errors
    /// [`GivenUp`] with one fault of a stage too many.
    pub fn turn(
        &mut self,
        now: Now,
        taken: UtcMs,
        outcome: &Outcome<'_>,
        act: &mut dyn FnMut(Action<'_>),
    ) -> Result<(), GivenUp> {
        self.note_clock(now);
        if *outcome == Outcome::StageFault && !self.stage_faults.note(now.since_start) {
            return Err(GivenUp);
        }
        let unsynchronised = self.unsynchronised;
        self.windows.take(taken, outcome, &mut |window| act(closed(window, unsynchronised)));
        if let Some(event) = outcome.event() {
            self.frames.note(event);
            self.health.on(event, now.since_start);
        }
        Ok(())
    }

    /// Closes the windows that have ended, and says what has changed. To be called a few times
    /// a second. Returns how the sensor is, and what lamp and relay are to show.
    pub fn tick(
        &mut self,
        now: Now,
        board_broken: bool,
        act: &mut dyn FnMut(Action<'_>),
    ) -> Actions {
        self.note_clock(now);
        self.advance(now.time, act);
        if self.board_broken != board_broken {
            self.board_broken = board_broken;
            act(Action::Alarm { alarm: Alarm::BoardFault, active: board_broken });
            self.publish_health();
        }
        let latest = if self.pace == Pace::Stopped {
            let status = SampleZoneStatus::DetectionAutoSuspended;
            Actions { status, ..self.health.hold(now.since_start) }
        } else {
            self.health.idle(now.since_start)
        };
        let before = self.latest.replace(latest);
        let alarm_before = before.and_then(|before| before.alarm);
        if alarm_before != latest.alarm {
            for (alarm, active) in [(alarm_before, false), (latest.alarm, true)] {
                if let Some(alarm) = alarm {
                    act(Action::Alarm { alarm, active });
                }
            }
        }
        let changed = before.map(|before| before.status) != Some(latest.status);
        let is_due = |sent| now.since_start.saturating_sub(sent) >= HEALTH_INTERVAL;
        if changed || self.health_sent.is_none_or(is_due) {
            self.health_sent = Some(now.since_start);
            act(Action::Health(latest));
        }
        latest
    }

    /// The clock, which would show `from`, was set and shows `to`.
    pub fn clock_set(&mut self, from: UtcMs, to: UtcMs, act: &mut dyn FnMut(Action<'_>)) {
        if let Some(last) = self.unsynchronised.as_mut() {
            *last = to;
        }
        self.advance(from, act);
        let unsynchronised = self.unsynchronised;
        self.windows.set_clock(from, to, &mut |window| act(closed(window, unsynchronised)));
    }

    /// The enclosure's temperature allows this pace.
    pub fn set_pace(&mut self, pace: Pace, act: &mut dyn FnMut(Action<'_>)) {
        let before = core::mem::replace(&mut self.pace, pace);
        if before == pace {
            return;
        }
        act(Action::Pace(pace));
        self.windows.set_interval(self.interval());
        if (before == Pace::Full) != (pace == Pace::Full) {
            act(Action::Alarm { alarm: Alarm::Overheated, active: pace != Pace::Full });
        }
        self.publish_health();
    }

    /// Another configuration is ready. Returns when it takes over: at the next instant at which
    /// all running windows end. One that was waiting is forgotten.
    pub fn prepare(&mut self, now: UtcMs) -> UtcMs {
        let takeover = TakeOver::after(now, self.windows.period());
        self.takeover = Some(takeover);
        self.publish_health();
        takeover.at()
    }

    /// When the configuration that waits takes over.
    pub fn takes_over_at(&self) -> Option<UtcMs> {
        self.takeover.as_ref().map(TakeOver::at)
    }

    /// Whether the configuration that waits takes over by `time`: ends the running windows, and
    /// returns the instant from which on the new ones run. [`Self::replace`] is to follow.
    pub fn takeover_due(&mut self, time: UtcMs, act: &mut dyn FnMut(Action<'_>)) -> Option<UtcMs> {
        let at = self.takeover.as_mut()?.due(time)?;
        self.takeover = None;
        self.advance(at, act);
        Some(at)
    }

    /// From `at` on these presets are measured. With another camera its health starts over;
    /// active alarms are published again, because the subscriber may be new.
    pub fn replace(
        &mut self,
        at: UtcMs,
        presets: P,
        interval: Duration,
        camera_since: Option<Duration>,
        act: &mut dyn FnMut(Action<'_>),
    ) {
        self.windows = Windows::new(presets);
        // New windows begin here, and none ends.
        self.windows.advance(at, &mut |_| ());
        self.interval = interval;
        self.windows.set_interval(self.interval());
        if let Some(now) = camera_since {
            self.health = Health::new(interval, now);
        }
        for alarm in self.alarms() {
            act(Action::Alarm { alarm, active: true });
        }
        self.publish_health();
    }

    /// The next tick publishes health, whatever it is.
    pub fn publish_health(&mut self) {
        self.health_sent = None;
    }

    /// Time between two pictures at the pace of now.
    pub fn interval(&self) -> Duration {
        self.interval.saturating_mul(if self.pace == Pace::Half { 2 } else { 1 })
    }

    /// The pace that the enclosure's temperature allows.
    pub const fn pace(&self) -> Pace {
        self.pace
    }

    /// How far a measurement can be used, by the latest tick; `None` before the first.
    pub fn status(&self) -> Option<SampleZoneStatus> {
        self.latest.map(|latest| latest.status)
    }

    /// Time between two new pictures, where the camera has them less often than it is asked: windows
    /// then have too few of them.
    pub fn camera_period(&self) -> Option<Duration> {
        self.health.period()
    }

    /// The alarms that are on.
    pub fn alarms(&self) -> impl Iterator<Item = Alarm> + use<P, W> {
        let of_pictures = self.latest.and_then(|latest| latest.alarm);
        let heat = (self.pace != Pace::Full).then_some(Alarm::Overheated);
        let board = self.board_broken.then_some(Alarm::BoardFault);
        [of_pictures, heat, board].into_iter().flatten()
    }

    /// Counts of the pictures, by outcome.
    pub const fn frames(&self) -> Frames {
        self.frames
    }

    /// Faults of stages since start.
    pub fn stage_faults(&self) -> u64 {
        self.stage_faults.faults()
    }

    /// The running windows.
    pub const fn windows(&self) -> &Windows<P, W> {
        &self.windows
    }

    fn note_clock(&mut self, now: Now) {
        if !now.synchronised {
            self.unsynchronised = Some(now.time);
        }
    }

    fn advance(&mut self, time: UtcMs, act: &mut dyn FnMut(Action<'_>)) {
        let unsynchronised = self.unsynchronised;
        self.windows.advance(time, &mut |window| act(closed(window, unsynchronised)));
    }
}

/// A window is right where the clock was right since before it began.
fn closed(window: ClosedWindow<'_>, unsynchronised: Option<UtcMs>) -> Action<'_> {
    let clock_synced = unsynchronised.is_none_or(|last| window.report.from > last);
    Action::Window { window, clock_synced }
}

#[cfg(test)]
mod tests;
