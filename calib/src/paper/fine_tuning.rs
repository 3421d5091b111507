//! Stage 3 of MVCalib, parameter fine tuning: CMA-ES on the weighted back-projection loss
//! of all vehicles, from every anchor; the best anchor wins (Eq. obj_func and final).
//!
//! Owns the searches and the choice. Does not own the loss or the optimiser.

use crate::paper::cmaes::{self, Point};
use crate::paper::loss::{FineTuningLoss, Weights, pack};
use crate::paper::model_matching::{Matched, Search, matched};
use crate::problem::Problem;
use rayon::prelude::*;

/// The back-projection loss of the vehicles with their matched models.
pub fn loss_of(problem: &Problem, matches: &[Matched], weights: Weights) -> FineTuningLoss {
    let pairs: Vec<_> = matches.iter().map(|m| problem.pairs(m.vehicle, m.model)).collect();
    FineTuningLoss::new(&pairs, problem.lens(1.0).centre, weights)
}

/// Fine-tunes from every anchor, in parallel; the results stand in the anchors' order, with
/// the back-projection loss as their loss.
pub fn tune(
    problem: &Problem,
    anchors: &[Matched],
    weights: Weights,
    search: &Search,
    done: &(dyn Fn() + Sync),
) -> Vec<Matched> {
    let loss = loss_of(problem, anchors, weights);
    anchors
        .par_iter()
        .enumerate()
        .map(|(index, anchor)| {
            let parameters = search.parameters(pack(&anchor.pose, anchor.f), index as u64);
            let out = cmaes::minimise(&parameters, |x: &Point| loss.evaluate(index, x));
            done();
            matched(anchor.vehicle, anchor.model, &out)
        })
        .collect()
}

/// Index of the anchor with the smallest loss (Eq. final); `None` when none is finite.
pub fn best(tuned: &[Matched]) -> Option<usize> {
    (0..tuned.len())
        .filter(|&i| tuned[i].loss.is_finite())
        .min_by(|&a, &b| tuned[a].loss.total_cmp(&tuned[b].loss))
}
