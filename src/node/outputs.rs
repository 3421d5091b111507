//! The decision which outputs are closed, by density and by time.
//!
//! Owns hysteresis, the least time on, and the way into the fail-safe state and out of it.
//! Time is counted by the board, from its start; the box's clock decides nothing.

use super::settings::{MAX_OUTPUTS, Output, Settings};
use crate::density::SampleZoneStatus;
use crate::units::{UtcMs, millis};
use crate::wire::DensityMessage;
use core::time::Duration;

/// Effect of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heard {
    /// At least one output has a fresh reading.
    Used,
    /// Right site and window, but no output's lane has a density with status `oK`.
    Unusable,
    /// The same message as the one before: a sender that hangs keeps nothing fresh.
    Repeated,
    /// Another site's.
    OtherSite,
    /// Of a window length that the settings do not ask for.
    OtherWindow,
}

/// One output's past.
#[derive(Clone, Copy, Debug, Default)]
struct Past {
    closed: bool,
    /// When a density closed it; `None` while it is open, or closed to be fail-safe.
    closed_since: Option<Duration>,
    /// When the latest usable reading came.
    read_at: Option<Duration>,
    density_veh_km: f32,
}

/// All outputs.
#[derive(Clone, Debug)]
pub struct Outputs {
    settings: Settings,
    pasts: [Past; MAX_OUTPUTS],
    latest: Option<(u64, UtcMs)>,
    /// The settings were lost: every output stays closed.
    lost: bool,
}

impl Outputs {
    /// Outputs that have heard nothing yet.
    pub fn new(settings: Settings) -> Self {
        Self { settings, pasts: [Past::default(); MAX_OUTPUTS], latest: None, lost: false }
    }

    /// Outputs whose settings cannot be read any more.
    pub fn lost() -> Self {
        Self { lost: true, ..Self::new(Settings::default()) }
    }

    /// Their settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Takes over other settings. An output whose settings are the same keeps its past.
    pub fn replace(&mut self, now: Duration, settings: Settings) {
        // Brought up to now first, so that a reading that has run out does not come back to
        // life under a longer hold time.
        self.pins(now);
        let same_source =
            self.settings.site == settings.site && self.settings.window_s == settings.window_s;
        for ((past, old), new) in
            self.pasts.iter_mut().zip(&self.settings.outputs).zip(&settings.outputs)
        {
            if !same_source || old != new {
                *past = Past::default();
            }
        }
        self.settings = settings;
        self.lost = false;
    }

    /// Takes a message that arrived at `now`.
    pub fn hear(&mut self, now: Duration, message: &DensityMessage) -> Heard {
        if !self.settings.site.is_empty() && self.settings.site != message.site {
            return Heard::OtherSite;
        }
        let report = &message.report;
        let window = report.to.saturating_since(report.from);
        if self.settings.window_s != 0
            && window != Duration::from_secs(u64::from(self.settings.window_s))
        {
            return Heard::OtherWindow;
        }
        if self.latest.replace((message.seq, report.to)) == Some((message.seq, report.to)) {
            return Heard::Repeated;
        }
        let mut heard = Heard::Unusable;
        for (past, set) in self.pasts.iter_mut().zip(&self.settings.outputs) {
            let Some(set) = set else { continue };
            let Some(lane) = report.lanes.iter().find(|lane| lane.lane == set.lane) else {
                continue;
            };
            match lane.density_veh_km {
                Some(density) if lane.status == SampleZoneStatus::Ok && plausible(density) => {
                    past.read_at = Some(now);
                    past.density_veh_km = density;
                    heard = Heard::Used;
                }
                _ => {}
            }
        }
        heard
    }

    /// The pins' states at `now`: bit 0 is output 1.
    pub fn pins(&mut self, now: Duration) -> u8 {
        if self.lost {
            return u8::MAX;
        }
        let mut pins = 0;
        for (bit, (past, set)) in self.pasts.iter_mut().zip(&self.settings.outputs).enumerate() {
            let Some(set) = set else { continue };
            if past.turn(now, self.settings.hold_s, set) {
                pins |= 1 << bit;
            }
        }
        pins
    }
}

/// A density that a road can have. A message's checksum was right, so anything else is a fault
/// of its sender.
fn plausible(density_veh_km: f32) -> bool {
    density_veh_km.is_finite() && density_veh_km >= 0.0
}

impl Past {
    fn turn(&mut self, now: Duration, hold_s: u16, set: &Output) -> bool {
        let past =
            |at, for_s: u16| millis(now).saturating_sub(millis(at)) >= i64::from(for_s) * 1000;
        let fresh = self.read_at.is_some_and(|at| !past(at, hold_s));
        if !fresh {
            // The reading is forgotten. The fail-safe state is not a detection: it starts no least
            // time on.
            *self = Self { closed: set.fail_safe, ..Self::default() };
            return self.closed;
        }
        let may_open = self.closed_since.is_none_or(|at| past(at, set.least_on_s));
        if self.density_veh_km >= set.on_veh_km {
            self.closed = true;
            self.closed_since = self.closed_since.or(Some(now));
        } else if self.density_veh_km <= set.off_veh_km && may_open {
            self.closed = false;
            self.closed_since = None;
        }
        self.closed
    }
}
