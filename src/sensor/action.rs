//! Events that the sensor takes, and actions that it returns.
//!
//! Plain values: `sensor` decides what they mean to windows and alarms, and the daemon performs
//! them.

use super::windows::ClosedWindow;
use crate::alarm::Alarm;
use crate::density::FrameCounts;
use crate::derate::Pace;
use crate::health::{Actions, Event};
use crate::track::LaneMoves;
use crate::units::UtcMs;
use core::time::Duration;

/// The time, by both clocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Now {
    /// The wall clock.
    pub time: UtcMs,
    /// Time since start, which nobody sets.
    pub since_start: Duration,
    /// Whether a time source has set the wall clock.
    pub synchronised: bool,
}

/// Outcome of a turn of the line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome<'a> {
    /// A picture of that preset was measured.
    Measured {
        /// Number of the preset.
        preset: usize,
        /// The vehicles in it.
        counts: &'a FrameCounts,
        /// Motion of the vehicles since the picture before, where they are followed.
        moves: Option<&'a LaneMoves>,
    },
    /// The camera gave the picture that it gave before.
    Unchanged,
    /// A picture came that cannot be read or measured.
    Damaged,
    /// No picture came.
    Missing,
    /// A new picture came that was not measured, for the reason of this alarm.
    Withheld(Alarm),
    /// A new picture came that was not measured, and nothing is wrong yet.
    PassedOver,
    /// A stage of the line broke: a fault of the program.
    StageFault,
    /// No picture was asked for.
    NotAsked,
}

impl Outcome<'_> {
    /// The event for the camera's health; `None` where no camera was asked.
    pub const fn event(&self) -> Option<Event> {
        Some(match self {
            Self::Measured { .. } => Event::Measured,
            Self::Unchanged => Event::Unchanged,
            Self::Damaged | Self::StageFault => Event::Damaged,
            Self::Missing => Event::Missing,
            Self::Withheld(alarm) => Event::Withheld(*alarm),
            Self::PassedOver => Event::PassedOver,
            Self::NotAsked => return None,
        })
    }
}

/// Counts of the pictures since start, by outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Frames {
    /// Measured.
    pub measured: u64,
    /// The same picture as before.
    pub unchanged: u64,
    /// Came, but could not be read or measured.
    pub damaged: u64,
    /// Did not come.
    pub missing: u64,
    /// Came, but were not fit to be measured: blank, blinded, blurred, displaced.
    pub withheld: u64,
}

impl Frames {
    pub(super) const fn note(&mut self, event: Event) {
        let count = match event {
            Event::Measured => &mut self.measured,
            Event::Unchanged => &mut self.unchanged,
            Event::Damaged => &mut self.damaged,
            Event::Missing => &mut self.missing,
            Event::Withheld(_) | Event::PassedOver => &mut self.withheld,
        };
        *count = count.saturating_add(1);
    }
}

/// A request of the sensor to its daemon.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action<'a> {
    /// A window has closed: deliver it.
    Window {
        /// It, with the table it was measured with.
        window: ClosedWindow<'a>,
        /// Whether the clock was right all the while.
        clock_synced: bool,
    },
    /// An alarm is raised or cleared: publish it.
    Alarm {
        /// The alarm.
        alarm: Alarm,
        /// Raised, or cleared.
        active: bool,
    },
    /// Publish how the sensor is.
    Health(Actions),
    /// From now on ask for pictures at this pace.
    Pace(Pace),
}

/// Stages break too often: the program is to end, so that its supervisor starts it again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GivenUp;
