//! One fit of the joint method: everything at once under one assumption about the fleet.
//!
//! Owns the fleets, the starts and the noise model. Does not own the terms (see `residuals`,
//! `cues`) nor which model a vehicle is like (see `like_models`).

use super::cues::{CueNoise, RoadCues};
use super::like_models::Lineup;
use super::residuals::Observed;
use super::scene::CameraState;
use super::shape::{ShapePrior, UNKNOWN_CARS};
use super::solver::{CameraInformation, Estimate, Objective};
use super::{Settings, prior, start};
use crate::error::{Error, Result};
use crate::problem::Problem;
use rayon::prelude::*;

/// What the cars of a scene may be. The number is how diverse they are, as a part of
/// [`UNKNOWN_CARS`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fleet {
    /// Cars about the mean of the known models, also in what the models differ in.
    AboutMean(f64),
    /// Each car is like one of the known models, or exactly that model at 0.
    LikeModels(f64),
}

/// The fleets that the data choose from, all as probable before.
pub const FLEETS: [Fleet; 5] = [
    Fleet::LikeModels(0.0),
    Fleet::LikeModels(0.5),
    Fleet::AboutMean(0.5),
    Fleet::AboutMean(1.0),
    Fleet::AboutMean(2.0),
];

impl Fleet {
    fn diversity(self) -> f64 {
        match self {
            Fleet::AboutMean(diversity) | Fleet::LikeModels(diversity) => diversity,
        }
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

/// The objective before the noise is known.
fn objective(problem: &Problem, settings: &Settings, shape: &ShapePrior) -> Objective {
    let width = problem.width_px();
    let sd_px = FIRST_LABEL_SD_WIDTHS * width;
    Objective {
        image_size: problem.image_size,
        observed: problem
            .vehicles
            .iter()
            .map(|v| Observed::of(v, ShapePrior::of_vehicle(v, shape), sd_px))
            .collect(),
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
pub fn best_start(problem: &Problem, settings: &Settings) -> Result<(Estimate, usize)> {
    let shape = ShapePrior::of_models(&problem.models, UNKNOWN_CARS);
    let shapes: Vec<ShapePrior> =
        problem.vehicles.iter().map(|v| ShapePrior::of_vehicle(v, &shape)).collect();
    let objective = objective(problem, settings, &shape);
    let width = problem.width_px();
    let focal_lengths: Vec<f64> =
        START_WIDTHS.iter().map(|w| w * width).chain(settings.f0).collect();
    let starts: Vec<Estimate> = focal_lengths
        .par_iter()
        .filter_map(|&f| {
            let size = problem.image_size;
            let (camera, vehicles) = start::at_focal_length(f, size, &problem.vehicles, &shapes)?;
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

pub fn lost(detail: &str) -> Error {
    Error::Solver { method: "joint", detail: detail.to_owned() }
}

/// The fit under one assumption about the fleet.
pub struct Fit {
    /// What was assumed.
    pub fleet: Fleet,
    /// The unknowns at the optimum; of the camera, their mean.
    pub estimate: Estimate,
    /// Covariance of the camera's unknowns.
    pub covariance: CameraInformation,
    /// Logarithm of the probability of the data, but for a constant that all fleets share.
    pub log_evidence: f64,
    /// Standard deviation of a label's coordinate, px.
    pub label_sd_px: f64,
    /// Root mean square misfit of each vehicle's key points, px.
    pub misfit_px: Vec<f64>,
    /// Linearisations.
    pub evaluations: usize,
}

/// Fits everything under one assumption about the fleet: rounds of noise and least squares.
pub fn fit(problem: &Problem, settings: &Settings, fleet: Fleet, start: &Estimate) -> Result<Fit> {
    let spread = UNKNOWN_CARS.times(fleet.diversity());
    let mean = ShapePrior::of_models(&problem.models, spread);
    let mut objective = objective(problem, settings, &mean);
    objective.cues = settings.cues.clone();
    let mut label_sd_px = FIRST_LABEL_SD_WIDTHS * problem.width_px();
    let mut lineup = match fleet {
        Fleet::AboutMean(_) => None,
        Fleet::LikeModels(_) => Some(
            Lineup::of(problem, spread)
                .ok_or_else(|| lost("some models lack key points that the vehicles show"))?,
        ),
    };
    let mut best = start.clone();
    let mut evaluations = 0;
    let left = || lost("the fit left the picture");
    for _ in 0..ROUNDS {
        objective.cue_noise = objective
            .cues
            .noise(&best.camera, problem.image_size)
            .ok_or_else(|| lost("a lane line or mark lies above the horizon of the vehicles"))?;
        if let Some(lineup) = &mut lineup {
            lineup.choose(&mut objective, &mut best, label_sd_px).ok_or_else(left)?;
        }
        label_sd_px = update_noise(&mut objective, &best, label_sd_px);
        let Estimate { camera, vehicles, .. } = best;
        best = objective.minimise(camera, vehicles, ROUND_STEPS).ok_or_else(left)?;
        evaluations += best.steps;
    }
    let undetermined = || lost("the data do not determine a camera; label more vehicles");
    let information = objective.information(&best).ok_or_else(undetermined)?;
    let mut covariance = information.camera.try_inverse().ok_or_else(undetermined)?;
    let mut log_evidence = information.log_evidence;
    let misfit_px = misfits(&objective, &best);
    if let Some(lineup) = &lineup {
        let mixture = lineup.mixture(&objective, &best, label_sd_px).ok_or_else(undetermined)?;
        best.camera = CameraState::of_vector(&(best.camera.vector() + mixture.mean));
        covariance = mixture.covariance;
        log_evidence += mixture.log_evidence;
    }
    Ok(Fit { fleet, estimate: best, covariance, log_evidence, label_sd_px, misfit_px, evaluations })
}

/// Root mean square misfit of each vehicle's key points, px.
fn misfits(objective: &Objective, at: &Estimate) -> Vec<f64> {
    objective
        .observed
        .iter()
        .zip(&at.vehicles)
        .map(|(o, v)| {
            let misfits = o.misfits(&at.camera, objective.image_size, v);
            (misfits.iter().map(|(r2, _)| r2).sum::<f64>() / misfits.len() as f64).sqrt()
        })
        .collect()
}

/// Estimates the label noise from the misfits and gives every point its own: label noise
/// plus the scatter of a key point on a real car, which near cars show larger. Returns the
/// label noise, px.
///
/// The noise solves sum r^2 / (sd^2 + own^2) = observations - determined
/// parameters.
fn update_noise(objective: &mut Objective, at: &Estimate, now_px: f64) -> f64 {
    let size = objective.image_size;
    let misfits: Vec<Vec<(f64, f64)>> = objective
        .observed
        .iter()
        .zip(&at.vehicles)
        .map(|(o, v)| o.misfits(&at.camera, size, v))
        .collect();
    let count = 2 * misfits.iter().map(Vec::len).sum::<usize>();
    let determined = objective.information(at).map_or(0.5 * count as f64, |i| i.determined);
    let freedom = (count as f64 - determined).max(MIN_FREEDOM * count as f64);
    let excess = |sd: f64| {
        let terms = misfits.iter().flatten();
        terms.map(|(r2, own)| r2 / (sd * sd + own)).sum::<f64>() - freedom
    };
    let (mut low, mut high) = (MIN_LABEL_SD_PX, 20.0 * now_px.max(1.0));
    for _ in 0..BISECTIONS {
        let middle = (low * high).sqrt();
        if excess(middle) > 0.0 { low = middle } else { high = middle }
    }
    let sd = (low * high).sqrt();
    for (observed, misfits) in objective.observed.iter_mut().zip(&misfits) {
        observed.set_noise(sd, misfits);
    }
    sd
}

/// Part of the observations that always counts as left over for the noise.
const MIN_FREEDOM: f64 = 0.25;
/// Halvings of the noise's bracket (log scale): 1e-9 of it remains.
const BISECTIONS: usize = 30;
