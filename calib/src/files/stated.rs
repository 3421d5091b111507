//! What a calibration file states of its own error.
//!
//! Owns the fields `uncertainty` and `errors`. Does not own the file (see `calibration`) nor how
//! errors follow from a covariance (see `length_error`).

use crate::length_error::UncertainCamera;
use serde::{Deserialize, Serialize};

/// Uncertainty of a camera, from the curvature of its posterior.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Uncertainty {
    /// Standard error of the focal length, px.
    pub f_px: f64,
    /// Standard error of the height of the camera, m.
    pub height_m: f64,
    /// Standard error of the tilt, rad.
    pub tilt_rad: f64,
    /// Standard error of the roll, rad.
    pub roll_rad: f64,
    /// Standard deviation of a label's coordinate as the fit shows it, px (joint).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label_sd_px: Option<f64>,
    /// Covariance of (log f, tilt, roll, log height, k1, crest in 1/m), row by row. Road
    /// lengths depend on these and on nothing else. Files of a level road may leave out the
    /// crest.
    #[serde(deserialize_with = "with_or_without_crest")]
    pub covariance: [[f64; 6]; 6],
}

impl Uncertainty {
    /// Of a camera whose covariance is known.
    pub fn of(known: &UncertainCamera, label_sd_px: Option<f64>) -> Self {
        let covariance = &known.covariance;
        let sd = |k: usize| covariance[(k, k)].max(0.0).sqrt();
        Uncertainty {
            f_px: known.camera.lens.f * sd(0),
            tilt_rad: sd(1),
            roll_rad: sd(2),
            height_m: known.camera.height_m() * sd(3),
            label_sd_px,
            covariance: std::array::from_fn(|a| std::array::from_fn(|b| covariance[(a, b)])),
        }
    }
}

fn with_or_without_crest<'de, D: serde::Deserializer<'de>>(
    d: D,
) -> std::result::Result<[[f64; 6]; 6], D::Error> {
    let rows = Vec::<Vec<f64>>::deserialize(d)?;
    let n = rows.len();
    if !(n == 5 || n == 6) || rows.iter().any(|r| r.len() != n || !r.iter().all(|x| x.is_finite()))
    {
        return Err(serde::de::Error::custom("the covariance has 5 or 6 rows of as many numbers"));
    }
    let at = |a: usize, b: usize| rows.get(a).and_then(|r| r.get(b)).copied().unwrap_or(0.0);
    Ok(std::array::from_fn(|a| std::array::from_fn(|b| at(a, b))))
}

/// Error of lengths at three distances, as the road fit states it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StatedErrors {
    /// Length of the stretches near, in the middle and far, m.
    pub stretch_m: f64,
    /// At the near end.
    pub near: StatedError,
    /// In the middle.
    pub middle: StatedError,
    /// At the far end.
    pub far: StatedError,
    /// Of the width of each lane that was drawn.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lanes: Vec<StatedLane>,
}

/// Error of the width of a lane.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StatedLane {
    /// What it is called.
    pub name: String,
    /// At its near end.
    pub near: StatedWidth,
    /// In its middle.
    pub middle: StatedWidth,
    /// At its far end.
    pub far: StatedWidth,
}

/// Error of a width at one place.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StatedWidth {
    /// Where, px.
    pub at: [f64; 2],
    /// The width there, m.
    pub width_m: f64,
    /// Its standard error, as a part of it.
    pub rel_err: f64,
}

impl StatedErrors {
    /// The worst standard errors across the road near, in the middle and far, as parts: of the
    /// lanes' widths, or without lanes of a stretch.
    pub fn across(&self) -> [f64; 3] {
        if self.lanes.is_empty() {
            return [self.near.across, self.middle.across, self.far.across];
        }
        let worst = |of: fn(&StatedLane) -> StatedWidth| {
            self.lanes.iter().map(|l| of(l).rel_err).fold(0.0, f64::max)
        };
        [worst(|l| l.near), worst(|l| l.middle), worst(|l| l.far)]
    }
}

/// Standard errors of a stretch at one place, as parts of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StatedError {
    /// Where, px.
    pub at: [f64; 2],
    /// Of a stretch along the road.
    pub along: f64,
    /// Of a stretch across it.
    pub across: f64,
}
