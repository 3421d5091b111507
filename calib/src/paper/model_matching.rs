//! Stage 2 of MVCalib, vehicle model matching: CMA-ES on the projection loss for each
//! vehicle and model, then the best model of each vehicle (Eq. 2d_loss and proj).
//!
//! Owns the searches and the choice. Does not own the loss or the optimiser.

use crate::camera::Pose;
use crate::paper::candidates::Candidate;
use crate::paper::cmaes::{self, Outcome, Parameters, Point, Termination};
use crate::paper::loss::{Form, pack, projection_loss, unpack};
use crate::problem::Problem;
use rayon::prelude::*;

/// A candidate after its own search over focal length and pose.
#[derive(Clone, Copy, Debug)]
pub struct Matched {
    /// Index of the vehicle.
    pub vehicle: usize,
    /// Index of the model.
    pub model: usize,
    /// Focal length, px.
    pub f: f64,
    /// The pose over that vehicle's own patch of road.
    pub pose: Pose,
    /// The projection loss in the chosen form, px.
    pub loss: f64,
    /// Evaluations spent.
    pub evaluations: usize,
    /// Why the search stopped.
    pub termination: Termination,
}

/// How the two CMA-ES stages search.
#[derive(Clone, Copy, Debug)]
pub struct Search {
    /// What limits the parameters.
    pub bounds: Bounds,
    /// Bounds of the focal length, px, where `bounds` is absolute.
    pub focal: [f64; 2],
    /// Most evaluations of each search.
    pub budget: usize,
    /// Stop before the budget once converged.
    pub stop_early: bool,
    /// Seed of all searches.
    pub seed: u64,
}

/// What limits the parameters of a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bounds {
    /// Fixed limits, the same from every start.
    Absolute,
    /// The authors' program: 30 % to either side of each component of the start. A
    /// component that starts near 0 is frozen there. Kept because the published numbers
    /// depend on it.
    Authors,
}

/// First standard deviation of the rotation vector, rad.
const ROTATION_STEP: f64 = 0.1;
/// First standard deviation of the translation as a part of the distance to the vehicle.
const TRANSLATION_STEP: f64 = 0.1;
/// First standard deviation of the focal length as a part of the start.
const FOCAL_STEP: f64 = 0.1;
/// The rotation vector stays within one turn, rad.
const ROTATION_BOUND: f64 = 2.0 * std::f64::consts::PI;
/// No camera looks at a car further away than this, m.
const TRANSLATION_BOUND_M: f64 = 500.0;
/// The authors' bounds as a part of each component of the start.
const AUTHORS_BOUND: f64 = 0.3;
/// The authors' first standard deviation as a part of half the range between the bounds
/// (nevergrad's default for a bounded scalar is a sixth of the range).
const AUTHORS_STEP: f64 = 1.0 / 3.0;

impl Search {
    /// The search from one start, in its own stream of random numbers.
    pub fn parameters(&self, start: Point, stream: u64) -> Parameters {
        let Search { budget, stop_early, seed, .. } = *self;
        if self.bounds == Bounds::Authors {
            let half = start.abs() * AUTHORS_BOUND;
            let (lower, upper) = (start - half, start + half);
            let step = half * AUTHORS_STEP;
            return Parameters { start, step, lower, upper, budget, stop_early, seed, stream };
        }
        let distance = start.fixed_rows::<3>(3).norm();
        let (r, t) = (ROTATION_STEP, TRANSLATION_STEP * distance);
        let (rb, tb) = (ROTATION_BOUND, TRANSLATION_BOUND_M);
        let mut start = start;
        start[6] = start[6].clamp(self.focal[0], self.focal[1]);
        Parameters {
            start,
            step: Point::from([r, r, r, t, t, t, FOCAL_STEP * start[6]]),
            lower: Point::from([-rb, -rb, -rb, -tb, -tb, 0.0, self.focal[0]]),
            upper: Point::from([rb, rb, rb, tb, tb, tb, self.focal[1]]),
            budget,
            stop_early,
            seed,
            stream,
        }
    }
}

/// Refines every candidate on its projection loss, in parallel, in the given order.
pub fn refine(
    problem: &Problem,
    candidates: &[Candidate],
    form: Form,
    search: &Search,
    done: &(dyn Fn() + Sync),
) -> Vec<Matched> {
    let centre = problem.lens(1.0).centre;
    candidates
        .par_iter()
        .enumerate()
        .map(|(stream, c)| {
            let pairs = problem.pairs(c.vehicle, c.model);
            let start = pack(&c.pose, c.f);
            let loss = |x: &Point| projection_loss(&pairs, centre, form, x);
            let out = cmaes::minimise(&search.parameters(start, stream as u64), loss);
            done();
            matched(c.vehicle, c.model, &out)
        })
        .collect()
}

pub(crate) fn matched(vehicle: usize, model: usize, out: &Outcome) -> Matched {
    let (pose, f) = unpack(&out.best);
    let Outcome { loss, evaluations, termination, .. } = *out;
    Matched { vehicle, model, f, pose, loss, evaluations, termination }
}

/// The best model of each vehicle, by vehicle (Eq. proj). Vehicles without a candidate are
/// absent.
pub fn best_of_each(all: &[Matched]) -> Vec<Matched> {
    let count = all.iter().map(|m| m.vehicle + 1).max().unwrap_or(0);
    (0..count)
        .filter_map(|v| {
            all.iter().filter(|m| m.vehicle == v).min_by(|a, b| a.loss.total_cmp(&b.loss)).copied()
        })
        .collect()
}
