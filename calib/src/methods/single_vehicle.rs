//! Cameras from single vehicles: a solver on every vehicle and model, and the choice of one.
//!
//! Owns how the baselines become a calibration: the best model of each vehicle by its
//! reprojection error, then the vehicle whose camera fits all the others best by the
//! fine-tuning loss, which is how the paper scores the stages too. Does not own a solver.

use crate::baselines::upnp::Solution;
use crate::camera::Lens;
use crate::error::{Error, Result};
use crate::paper::cmaes::Termination;
use crate::paper::fine_tuning;
use crate::paper::loss::{Weights, pack};
use crate::paper::model_matching::{Matched, best_of_each};
use crate::problem::Problem;
use crate::vehicle::Pair;
use rayon::prelude::*;

/// A solver of pose and focal length for one vehicle's pairs.
pub type Solver = fn(&[Pair], &Lens, bool) -> Option<Solution>;

/// The best model of each vehicle, and the index of the vehicle whose camera wins.
///
/// # Errors
/// When no vehicle gives a camera above the road.
pub fn solve(
    problem: &Problem,
    method: &'static str,
    solver: Solver,
    gauss_newton: bool,
    weights: Weights,
) -> Result<(Vec<Matched>, usize)> {
    let unit = problem.lens(problem.width_px());
    let jobs: Vec<(usize, usize)> = (0..problem.vehicles.len())
        .flat_map(|v| (0..problem.models.len()).map(move |m| (v, m)))
        .collect();
    let all: Vec<Matched> = jobs
        .par_iter()
        .filter_map(|&(vehicle, model)| {
            let found = solver(&problem.pairs(vehicle, model), &unit, gauss_newton)?;
            (found.pose.camera_centre().z > 0.0).then_some(Matched {
                vehicle,
                model,
                f: found.lens.f,
                pose: found.pose,
                loss: found.error_px,
                evaluations: 1,
                termination: Termination::Budget,
            })
        })
        .collect();
    let matched = best_of_each(&all);
    let loss = fine_tuning::loss_of(problem, &matched, weights);
    let score = |k: usize| loss.evaluate(k, &pack(&matched[k].pose, matched[k].f));
    let best = (0..matched.len()).min_by(|&a, &b| score(a).total_cmp(&score(b)));
    let best = best.ok_or_else(|| Error::Solver {
        method,
        detail: "no vehicle gives a camera above the road; it needs more or better points".into(),
    })?;
    Ok((matched, best))
}
