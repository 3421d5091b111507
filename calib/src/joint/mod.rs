//! The joint method: one camera over one road plane, all vehicles at once.
//!
//! Not in the paper. Each vehicle has a position and a yaw on the road and a continuous
//! shape with a prior; focal length, tilt, roll and height are shared; robust least squares
//! over all key points, from several focal lengths; lines side by side and known lengths
//! are further observations. The curvature at the optimum gives the error of any length.
//!
//! Owns the order of these steps and the noise model. Does not own the terms.

pub mod cues;
pub mod residuals;
pub mod scene;
pub mod shape;
pub mod solver;
pub mod start;
pub mod uncertainty;

use crate::calibration::Uncertainty;
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::problem::Problem;
use cues::{CueNoise, RoadCues};
use rayon::prelude::*;
use residuals::Observed;
use scene::{CameraState, CameraStep, FLEET_AT};
use shape::ShapePrior;
use solver::{CameraInformation, CameraPrior, Estimate, Objective};
use uncertainty::CameraCovariance;

/// What the joint method can be told.
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
    /// Probability of each of [`DIVERSITIES`].
    pub diversity: [f64; DIVERSITIES.len()],
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

    /// Standard errors and covariance in the calibration file's terms.
    pub fn uncertainty(&self) -> Uncertainty {
        let CameraState { log_f, log_height, .. } = self.estimate.camera;
        let c = &self.covariance;
        Uncertainty {
            f_px: log_f.exp() * c.sd(0),
            tilt_rad: c.sd(1),
            roll_rad: c.sd(2),
            height_m: log_height.exp() * c.sd(3),
            label_sd_px: self.label_sd_px,
            covariance: std::array::from_fn(|a| std::array::from_fn(|b| c.0[(a, b)])),
        }
    }

    /// Standard error of a length on the road, as a part of it, where the vehicles stand.
    pub fn rel_err(&self) -> Option<f64> {
        let Estimate { camera, vehicles, .. } = &self.estimate;
        self.covariance.relative_sd_at(camera, self.image_size, vehicles)
    }
}

/// Focal lengths to start from, as parts of the picture's width: 80 to 23 degrees.
const START_WIDTHS: [f64; 4] = [0.6, 1.0, 1.6, 2.5];
/// Label noise before it is estimated, as a part of the picture's width: 1 px of 320.
const FIRST_LABEL_SD_WIDTHS: f64 = 1.0 / 320.0;
/// Label noise is never taken to be smaller than this, px.
const MIN_LABEL_SD_PX: f64 = 0.1;
/// Rounds of noise estimate and fit.
const ROUNDS: usize = 4;
/// Steps of each start, then of the best one in each round.
const START_STEPS: usize = 40;
const ROUND_STEPS: usize = 40;

/// A road of 100 m radius turns by 0.01 rad per m; most turn less.
const CURVATURE_SD: f64 = 0.005;

/// The prior of a camera over a road: focal length a few to one (the median lens is 1.1
/// widths), height 12 m within a factor of 1.8, roll 3 degrees, tilt open.
fn prior(width_px: f64, settings: &Settings) -> CameraPrior {
    let k1_sd = if settings.distortion { 0.1 } else { 1e-9 };
    let mean = [(1.1 * width_px).ln(), 0.35, 0.0, 12f64.ln(), 0.0, 0.0, 0.0];
    let sd = [0.6, 0.5, 3f64.to_radians(), 0.6, k1_sd, 10.0, CURVATURE_SD];
    let of = |own: [f64; FLEET_AT], fleet: f64| {
        CameraStep::from_fn(|k, _| own.get(k).copied().unwrap_or(fleet))
    };
    CameraPrior { mean: of(mean, 0.0), sd: of(sd, settings.fleet.max(1e-6)) }
}

/// How diverse the fleet may be, as parts of [`shape::UNKNOWN_CARS`]: (nearly) the known
/// models themselves, something between, none of them, or twice as diverse. The data choose.
pub const DIVERSITIES: [f64; 4] = [0.1, 0.5, 1.0, 2.0];

/// The fit under one assumption about the fleet.
struct Fit {
    estimate: Estimate,
    covariance: CameraInformation,
    log_evidence: f64,
    label_sd_px: f64,
    misfit_px: Vec<f64>,
    evaluations: usize,
}

/// Calibrates. The starts run in parallel; the result does not depend on threads.
///
/// # Errors
/// When no vehicle can be posed at any of the starting focal lengths.
pub fn calibrate(problem: &Problem, settings: &Settings) -> Result<Joint> {
    let (start, mut evaluations) = best_start(problem, settings)?;
    let fits: Vec<Fit> = DIVERSITIES
        .par_iter()
        .map(|d| fit(problem, settings, shape::UNKNOWN_CARS.times(*d), &start))
        .collect::<Result<_>>()?;
    evaluations += fits.iter().map(|f| f.evaluations).sum::<usize>();
    Ok(average(fits, evaluations, problem.image_size))
}

fn objective(problem: &Problem, settings: &Settings, spread: shape::Spread) -> Objective {
    let shape = ShapePrior::of_models(&problem.models, spread);
    let width = problem.width_px();
    let sd_px = FIRST_LABEL_SD_WIDTHS * width;
    Objective {
        image_size: problem.image_size,
        observed: problem.vehicles.iter().map(|v| Observed::of(v, &shape, sd_px)).collect(),
        shape,
        prior: prior(width, settings),
        shift_sd_px: settings.sway_px.max(MIN_SWAY_PX),
        // The cues join later: their noise needs a camera that sees them.
        cues: RoadCues::default(),
        cue_noise: CueNoise::default(),
    }
}

/// A camera that does not sway: shifts of a picture are pinned to this, px.
const MIN_SWAY_PX: f64 = 1e-3;

/// The best of the starts, fitted to the key points alone, and the steps it took.
fn best_start(problem: &Problem, settings: &Settings) -> Result<(Estimate, usize)> {
    let objective = objective(problem, settings, shape::UNKNOWN_CARS);
    let width = problem.width_px();
    let focal_lengths: Vec<f64> =
        START_WIDTHS.iter().map(|w| w * width).chain(settings.f0).collect();
    let starts: Vec<Estimate> = focal_lengths
        .par_iter()
        .filter_map(|&f| {
            let (size, shape) = (problem.image_size, &objective.shape);
            let (camera, vehicles) = start::at_focal_length(f, size, &problem.vehicles, shape)?;
            objective.minimise(camera, vehicles, START_STEPS)
        })
        .collect();
    let steps = starts.iter().map(|e| e.steps).sum();
    let best = starts.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost));
    let best = best.ok_or_else(|| {
        lost("no start puts the vehicles on a road below the camera; check the labels")
    })?;
    Ok((best, steps))
}

fn lost(detail: &str) -> Error {
    Error::Solver { method: "joint", detail: detail.to_owned() }
}

/// Fits everything under one assumption about the fleet: rounds of noise and least squares.
fn fit(
    problem: &Problem,
    settings: &Settings,
    spread: shape::Spread,
    start: &Estimate,
) -> Result<Fit> {
    let mut objective = objective(problem, settings, spread);
    objective.cues = settings.cues.clone();
    let size = problem.image_size;
    let mut best = start.clone();
    let mut label_sd_px = FIRST_LABEL_SD_WIDTHS * problem.width_px();
    let mut evaluations = 0;
    for _ in 0..ROUNDS {
        objective.cue_noise = objective
            .cues
            .noise(&best.camera, size)
            .ok_or_else(|| lost("a lane line or mark lies above the horizon of the vehicles"))?;
        label_sd_px = update_noise(&mut objective, &best, label_sd_px);
        let Estimate { camera, vehicles, .. } = best;
        best = objective
            .minimise(camera, vehicles, ROUND_STEPS)
            .ok_or_else(|| lost("the fit left the picture"))?;
        evaluations += best.steps;
    }
    let undetermined = || lost("the data do not determine a camera; label more vehicles");
    let information = objective.information(&best).ok_or_else(undetermined)?;
    let covariance = information.camera.try_inverse().ok_or_else(undetermined)?;
    let misfit_px = objective
        .observed
        .iter()
        .zip(&best.vehicles)
        .map(|(o, v)| {
            let misfits = o.misfits(&best.camera, size, v, &objective.shape);
            (misfits.iter().map(|(r2, _)| r2).sum::<f64>() / misfits.len() as f64).sqrt()
        })
        .collect();
    let log_evidence = information.log_evidence;
    Ok(Fit { estimate: best, covariance, log_evidence, label_sd_px, misfit_px, evaluations })
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
    let mut diversity = [0.0; DIVERSITIES.len()];
    diversity.iter_mut().zip(&raw).for_each(|(d, w)| *d = w / total);
    let Fit { mut estimate, label_sd_px, misfit_px, .. } =
        fits.into_iter().nth(best).expect("there is a fit for every diversity");
    estimate.camera = CameraState::of_vector(&mean);
    Joint {
        estimate,
        covariance: CameraCovariance(covariance),
        diversity,
        label_sd_px,
        misfit_px,
        evaluations,
        image_size,
    }
}

/// Estimates the label noise from the misfits and gives every point its own: label noise
/// plus the scatter of a key point on a real car, which near cars show larger. Returns the
/// label noise, px.
///
/// The noise solves sum r^2 / (sd^2 + (f/z point_sd)^2) = observations - determined
/// parameters.
fn update_noise(objective: &mut Objective, at: &Estimate, now_px: f64) -> f64 {
    let size = objective.image_size;
    let point_sd = objective.shape.point_sd_m;
    let misfits: Vec<Vec<(f64, f64)>> = objective
        .observed
        .iter()
        .zip(&at.vehicles)
        .map(|(o, v)| o.misfits(&at.camera, size, v, &objective.shape))
        .collect();
    let count = 2 * misfits.iter().map(Vec::len).sum::<usize>();
    let determined = objective.information(at).map_or(0.5 * count as f64, |i| i.determined);
    let freedom = (count as f64 - determined).max(MIN_FREEDOM * count as f64);
    let excess = |sd: f64| {
        let terms = misfits.iter().flatten();
        terms.map(|(r2, scale)| r2 / (sd * sd + (scale * point_sd).powi(2))).sum::<f64>() - freedom
    };
    let (mut low, mut high) = (MIN_LABEL_SD_PX, 20.0 * now_px.max(1.0));
    for _ in 0..BISECTIONS {
        let middle = (low * high).sqrt();
        if excess(middle) > 0.0 { low = middle } else { high = middle }
    }
    let sd = (low * high).sqrt();
    for (observed, misfits) in objective.observed.iter_mut().zip(&misfits) {
        for (slot, (_, scale)) in observed.sd_px.iter_mut().zip(misfits) {
            *slot = (sd * sd + (scale * point_sd).powi(2)).sqrt();
        }
    }
    sd
}

/// Part of the observations that always counts as left over for the noise.
const MIN_FREEDOM: f64 = 0.25;
/// Halvings of the noise's bracket (log scale): 1e-9 of it remains.
const BISECTIONS: usize = 30;
