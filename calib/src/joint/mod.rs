//! The joint method: one camera over one road plane, all vehicles at once.
//!
//! Not in the paper. Each vehicle has a position and a yaw on the road and a continuous
//! shape with a prior; focal length, tilt, roll and height are shared; robust least squares
//! over all key points, from several focal lengths; lines side by side and known lengths
//! are further observations. The curvature at the optimum gives the error of any length.
//!
//! Owns settings, result and the average over fleets. Does not own the fits (see `fit`).

pub mod cues;
mod fit;
mod like_models;
pub mod residuals;
pub mod scene;
pub mod shape;
pub mod solver;
pub mod start;
pub mod uncertainty;
pub mod untold;

use crate::camera::Camera;
use crate::error::Result;
use crate::files::stated::Uncertainty;
use crate::length_error::{self, UncertainCamera};
use crate::problem::Problem;
use crate::road::fit::Labelled;
use cues::RoadCues;
use fit::Fit;
pub use fit::{FLEETS, Fleet};
use rayon::prelude::*;
use scene::{CameraState, CameraStep, FLEET_AT};
use solver::{CameraInformation, CameraPrior, Estimate};
use uncertainty::CameraCovariance;

/// Options of the joint method.
#[derive(Clone, Debug)]
pub struct Settings {
    /// A further focal length to start from, px.
    pub f0: Option<f64>,
    /// Estimate radial distortion too.
    pub distortion: bool,
    /// Standard deviation of the camera's sway between pictures, px.
    pub sway_px: f64,
    /// How far a fleet as a whole may differ from the models given, in standard deviations
    /// of a single car (see [`shape::UNKNOWN_CARS`]). No key point shows it: it is the
    /// floor of the stated error.
    pub fleet: f64,
    /// Lines and marks on the road.
    pub cues: RoadCues,
}

/// A city's cars against five models of another market: 3 % in size, 2 % along each axis.
pub const FLEET_DIFFERENCE: f64 = 0.7;

impl Default for Settings {
    fn default() -> Self {
        Settings {
            f0: None,
            distortion: false,
            sway_px: 0.0,
            fleet: FLEET_DIFFERENCE,
            cues: RoadCues::default(),
        }
    }
}

/// What the joint method found.
#[derive(Clone, Debug)]
pub struct Joint {
    /// The unknowns at the optimum.
    pub estimate: Estimate,
    /// Covariance of the camera's unknowns.
    pub covariance: CameraCovariance,
    /// Probability of each fleet that could be fitted.
    pub fleets: Vec<(Fleet, f64)>,
    /// Standard deviation of a label's coordinate, estimated from the fit, px.
    pub label_sd_px: f64,
    /// Root mean square misfit of each vehicle's key points, px.
    pub misfit_px: Vec<f64>,
    /// Linearisations over all starts.
    pub evaluations: usize,
    image_size: [u32; 2],
}

impl Joint {
    /// The calibrated camera.
    pub fn camera(&self) -> Camera {
        self.estimate.camera.camera(self.image_size)
    }

    /// How strange the camera is among cameras over roads: squared standard deviations of
    /// focal length and height from their priors, together (chi squared of two).
    pub fn strangeness(&self) -> f64 {
        let prior = prior(f64::from(self.image_size[0]), &Settings::default());
        let off = (self.estimate.camera.vector() - prior.mean).component_div(&prior.sd);
        off[0] * off[0] + off[3] * off[3]
    }

    /// The camera with the covariance of its unknowns; joint takes the road to be level.
    pub fn known(&self) -> UncertainCamera {
        let mut covariance = length_error::CameraCovariance::zeros();
        let own = self.covariance.0.fixed_view::<5, 5>(0, 0);
        covariance.fixed_view_mut::<5, 5>(0, 0).copy_from(&own);
        UncertainCamera { camera: self.camera(), covariance }
    }

    /// Standard errors and covariance in the calibration file's terms.
    pub fn uncertainty(&self) -> Uncertainty {
        Uncertainty::of(&self.known(), Some(self.label_sd_px))
    }

    /// What it says of the camera, for the road fit.
    pub fn labelled(&self) -> Labelled {
        let state = &self.estimate.camera;
        let mean = [state.log_f, state.tilt, state.roll, state.log_height, state.k1];
        Labelled::on_level_road(mean, self.image_size, &self.known().covariance)
    }

    /// Standard error of a length on the road, as a part of it, where the vehicles stand.
    pub fn rel_err(&self) -> Option<f64> {
        let Estimate { camera, vehicles, .. } = &self.estimate;
        self.covariance.relative_sd_at(camera, self.image_size, vehicles)
    }
}

/// A road of 100 m radius turns by 0.01 rad per m; most turn less.
const CURVATURE_SD: f64 = 0.005;

/// The prior of a camera over a road: focal length a few to one (the median lens is 1.1
/// widths), height 12 m within a factor of 1.8, roll 3 degrees, tilt open.
pub fn prior(width_px: f64, settings: &Settings) -> CameraPrior {
    let k1_sd = if settings.distortion { 0.1 } else { 1e-9 };
    let mean = [(1.1 * width_px).ln(), 0.35, 0.0, 12f64.ln(), 0.0, 0.0, 0.0];
    let sd = [0.6, 0.5, 3f64.to_radians(), 0.6, k1_sd, 10.0, CURVATURE_SD];
    let of = |own: [f64; FLEET_AT], fleet: f64| {
        CameraStep::from_fn(|k, _| own.get(k).copied().unwrap_or(fleet))
    };
    CameraPrior { mean: of(mean, 0.0), sd: of(sd, settings.fleet.max(1e-6)) }
}

/// Calibrates. The starts run in parallel; the result does not depend on threads.
///
/// # Errors
/// When no vehicle can be posed at any of the starting focal lengths.
pub fn calibrate(problem: &Problem, settings: &Settings) -> Result<Joint> {
    let (start, mut evaluations) = fit::best_start(problem, settings)?;
    let fits: Vec<Option<Fit>> = FLEETS
        .par_iter()
        .map(|fleet| match (fleet, fit::fit(problem, settings, *fleet, &start)) {
            // Cars that are like no model, or models that lack a point, leave the others.
            (Fleet::LikeModels(_), Err(_)) => Ok(None),
            (_, found) => found.map(Some),
        })
        .collect::<Result<_>>()?;
    let fits: Vec<Fit> = fits.into_iter().flatten().collect();
    evaluations += fits.iter().map(|f| f.evaluations).sum::<usize>();
    Ok(average(fits, evaluations, problem.image_size))
}

/// Averages the fits by their evidence: mean and covariance of the mixture; the vehicles
/// are those of the likeliest fit.
fn average(fits: Vec<Fit>, evaluations: usize, image_size: [u32; 2]) -> Joint {
    let top = fits.iter().map(|f| f.log_evidence).fold(f64::NEG_INFINITY, f64::max);
    let raw: Vec<f64> = fits.iter().map(|f| (f.log_evidence - top).exp()).collect();
    let total: f64 = raw.iter().sum();
    let weighted = || fits.iter().zip(raw.iter().map(|w| w / total));
    let mean: CameraStep = weighted().map(|(f, w)| f.estimate.camera.vector() * w).sum();
    let covariance: CameraInformation = weighted()
        .map(|(f, w)| {
            let off = f.estimate.camera.vector() - mean;
            (f.covariance + off * off.transpose()) * w
        })
        .sum();
    let best = (0..fits.len()).max_by(|&a, &b| raw[a].total_cmp(&raw[b])).unwrap_or(0);
    let fleets = fits.iter().map(|f| f.fleet).zip(raw.iter().map(|w| w / total)).collect();
    let Fit { mut estimate, label_sd_px, misfit_px, .. } =
        fits.into_iter().nth(best).expect("fits about the mean are never left out");
    estimate.camera = CameraState::of_vector(&mean);
    Joint {
        estimate,
        covariance: CameraCovariance(covariance),
        fleets,
        label_sd_px,
        misfit_px,
        evaluations,
        image_size,
    }
}
