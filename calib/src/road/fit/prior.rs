//! What a camera over a road may be before any cue.
//!
//! Owns the prior's numbers, and what stands in its place where vehicles were labelled.

use super::cues::{CREST_SD, Cues, DISTORTION_SD};
use super::view::{CAMERA, DISTORTION, LOG_F, LOG_HEIGHT, TILT, Unknowns};
use nalgebra::SMatrix;

/// Focal length before any cue: 1.1 widths within a factor 1.8.
const FOCAL_WIDTHS: f64 = 1.1;
/// Standard deviation of the logarithms of focal length and height.
const FACTOR_SD: f64 = 0.6;
/// Height of the camera before any cue, m.
const HEIGHT_M: f64 = 12.0;
/// Standard deviation of a stated height, as a part of it: a mast on a bank, a sagging arm.
const STATED_HEIGHT_SD: f64 = 0.03;
/// Tilt before any cue, rad, and its standard deviation.
const TILT_PRIOR: [f64; 2] = [0.35, 0.5];
/// Standard deviation of the roll, rad.
const ROLL_SD: f64 = 3.0 * std::f64::consts::PI / 180.0;
/// Distortion before any cue: lenses of traffic cameras are a little barrel-shaped.
const DISTORTION_MEAN: f64 = -0.02;

/// Normal prior on the camera's unknowns.
#[derive(Clone, Debug)]
pub struct Prior {
    /// Its middle.
    pub mean: Unknowns,
    /// Upper factor of the information: residuals are `root * (unknowns - mean)`.
    pub root: SMatrix<f64, CAMERA, CAMERA>,
}

impl Prior {
    /// What a camera over a road may be, and what the cues state of it.
    pub fn of(cues: &Cues, image_size: [u32; 2]) -> Option<Self> {
        let width = f64::from(image_size[0]);
        let height = cues.height_m.unwrap_or(HEIGHT_M);
        let mut mean = Unknowns::zeros();
        mean[LOG_F] = (FOCAL_WIDTHS * width).ln();
        mean[TILT] = TILT_PRIOR[0];
        mean[LOG_HEIGHT] = height.ln();
        mean[DISTORTION] = DISTORTION_MEAN;
        let height_sd = if cues.height_m.is_some() { STATED_HEIGHT_SD } else { FACTOR_SD };
        let sd = [FACTOR_SD, TILT_PRIOR[1], ROLL_SD, height_sd, DISTORTION_SD, CREST_SD];
        let own = SMatrix::from_diagonal(&Unknowns::from(sd).map(|s| 1.0 / s));
        let Some(labelled) = &cues.labelled else {
            return Some(Prior { mean, root: own });
        };
        // What labelled vehicles say takes the prior's place, but for a stated height.
        let mut information = labelled.covariance.try_inverse()?;
        let mut weighted = information * labelled.mean;
        if cues.height_m.is_some() {
            let stated = STATED_HEIGHT_SD.powi(-2);
            information[(LOG_HEIGHT, LOG_HEIGHT)] += stated;
            weighted[LOG_HEIGHT] += stated * height.ln();
        }
        let factor = information.cholesky()?;
        Some(Prior { mean: factor.solve(&weighted), root: factor.l().transpose() })
    }
}
