//! Settings of each output: its lane, its thresholds, its least time on, its fail-safe state.
//!
//! Owns the settings and what makes them acceptable. [`super::protocol`] carries them,
//! [`super::store`] keeps them.

use crate::lane::Name;
use crate::units::LaneId;
use core::fmt;
use serde::{Deserialize, Serialize};

/// Outputs of one node: what a detector rack's card has at the most.
pub const MAX_OUTPUTS: usize = 8;
/// Highest threshold, veh/km/lane: cars bumper to bumper are about 200.
pub const MAX_THRESHOLD_VEH_KM: f32 = 500.0;
/// Longest hold time, s: four windows of 15 min.
pub const MAX_HOLD_S: u16 = 3600;
/// Longest least time on, s.
pub const MAX_LEAST_ON_S: u16 = 3600;

/// One output.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Output {
    /// The lane whose density it follows.
    pub lane: LaneId,
    /// It closes at this density and above, veh/km.
    pub on_veh_km: f32,
    /// It opens at this density and below, veh/km; between the two it stays as it is.
    pub off_veh_km: f32,
    /// Once closed it stays closed for so long, s.
    pub least_on_s: u16,
    /// Its state when nothing usable has come for the hold time: `true` is closed, a call.
    pub fail_safe: bool,
}

/// The settings of a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// The site whose messages count; empty: every site's.
    pub site: Name,
    /// Length of the windows that count, s; 0: every one.
    pub window_s: u16,
    /// Time without a usable reading after which an output goes to its fail-safe state, s.
    pub hold_s: u16,
    /// The outputs, in the order of the pins; `None` stays open.
    pub outputs: [Option<Output>; MAX_OUTPUTS],
}

impl Default for Settings {
    fn default() -> Self {
        Self { site: Name::new(), window_s: 0, hold_s: 180, outputs: [None; MAX_OUTPUTS] }
    }
}

/// Why settings are refused. Outputs count from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SettingsError {
    /// A threshold that is not a number from 0 to [`MAX_THRESHOLD_VEH_KM`].
    Threshold {
        /// The output.
        output: u8,
    },
    /// The threshold for off is not below the one for on.
    NoHysteresis {
        /// The output.
        output: u8,
    },
    /// A least time on of more than [`MAX_LEAST_ON_S`].
    LeastOn {
        /// The output.
        output: u8,
    },
    /// A hold time outside 1 to [`MAX_HOLD_S`], or shorter than the window: each message would
    /// find the outputs in their fail-safe state.
    Hold,
}

impl fmt::Display for SettingsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Threshold { output } => {
                write!(f, "output {output}: thresholds are from 0 to {MAX_THRESHOLD_VEH_KM} veh/km")
            }
            Self::NoHysteresis { output } => {
                write!(f, "output {output}: off_veh_km must be below on_veh_km")
            }
            Self::LeastOn { output } => {
                write!(f, "output {output}: least_on_s is at most {MAX_LEAST_ON_S} s")
            }
            Self::Hold => write!(
                f,
                "hold_s must be from 1 to {MAX_HOLD_S} s and longer than window_s, or the outputs \
                 fall to their fail-safe state between two messages"
            ),
        }
    }
}

impl core::error::Error for SettingsError {}

impl Settings {
    /// Whether a node can work by these settings.
    ///
    /// # Errors
    /// The first [`SettingsError`] found.
    pub fn check(&self) -> Result<(), SettingsError> {
        if !(1..=MAX_HOLD_S).contains(&self.hold_s) || self.hold_s <= self.window_s {
            return Err(SettingsError::Hold);
        }
        for (output, number) in self.outputs.iter().zip(1..) {
            let Some(set) = output else { continue };
            let possible = 0.0..=MAX_THRESHOLD_VEH_KM;
            if !possible.contains(&set.on_veh_km) || !possible.contains(&set.off_veh_km) {
                return Err(SettingsError::Threshold { output: number });
            }
            if set.off_veh_km >= set.on_veh_km {
                return Err(SettingsError::NoHysteresis { output: number });
            }
            if set.least_on_s > MAX_LEAST_ON_S {
                return Err(SettingsError::LeastOn { output: number });
            }
        }
        Ok(())
    }
}
