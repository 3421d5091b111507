//! Vehicles that are each like one of the known models, or exactly one.
//!
//! Which model each vehicle is like is unknown: for every vehicle and model the key points give
//! a quadratic form on the camera, so the evidence of an assignment of models to vehicles
//! is a sum of such forms and one Cholesky factor. A best-first search gathers the likely
//! assignments; camera and covariance are those of their mixture.
//!
//! Owns the search and the mixture. Does not own the noise nor the fit (see `fit`).

use super::residuals::Observed;
use super::scene::{CAMERA, CameraState, CameraStep, VehicleState};
use super::shape::{Coefficients, ShapePrior, Spread};
use super::solver::{CameraInformation, Estimate, Objective};
use crate::bodies::Body;
use crate::problem::Problem;
use crate::vehicle::Vehicle;
use nalgebra::{Cholesky, Const};
use std::collections::BTreeMap;

/// Assignments whose neighbours are looked at, at most.
const EXPANSIONS: usize = 40;
/// Assignments this much less likely than the best (log) are not looked around from.
const UNLIKELY: f64 = 5.0;
/// Assignments this much less likely than the best (log) are left out of the mixture.
const NEGLIGIBLE: f64 = 12.0;
/// Steps of one vehicle under a held camera.
const SETTLE_STEPS: usize = 20;

/// Which model each vehicle is.
type Assignment = Vec<u8>;

/// Every vehicle under every model, in the problem's order.
pub struct Lineup {
    alternatives: Vec<Vec<Observed>>,
    /// The assignment of the fit.
    chosen: Assignment,
}

/// One vehicle as one model, as the camera's unknowns see it.
struct Form {
    state: VehicleState,
    information: CameraInformation,
    gradient: CameraStep,
    /// Logarithm of the evidence at the camera of the expansion, but for a shared constant.
    level: f64,
}

/// The likely assignments about one camera.
pub struct Mixture {
    /// Mean change of the camera.
    pub mean: CameraStep,
    /// Covariance of the camera.
    pub covariance: CameraInformation,
    /// Logarithm of the evidence of all assignments, each with the same prior probability,
    /// against that of the one chosen.
    pub log_evidence: f64,
}

impl Lineup {
    /// `None` where a model lacks a key point that a vehicle shows: evidence on different
    /// points does not compare.
    pub fn of(problem: &Problem, spread: Spread) -> Option<Self> {
        let shapes: Vec<ShapePrior> =
            problem.models.chunks(1).map(|m| ShapePrior::of_models(m, spread)).collect();
        let under = |v: &Vehicle| -> Option<Vec<Observed>> {
            // A van is a van, whichever model the cars are.
            let shapes = if v.body == Body::Car { &shapes[..] } else { &shapes[..1] };
            let as_one = |s| Observed::of(v, ShapePrior::of_vehicle(v, s), 1.0);
            let all: Vec<_> = shapes.iter().map(as_one).collect();
            all.iter().all(|o| o.points.len() == v.points.len()).then_some(all)
        };
        let alternatives = problem.vehicles.iter().map(under).collect::<Option<_>>()?;
        Some(Lineup { alternatives, chosen: Assignment::new() })
    }

    /// Chooses the likeliest assignment about an estimate, for the objective and the
    /// estimate; `None` when some vehicle fits no model.
    pub fn choose(
        &mut self,
        objective: &mut Objective,
        at: &mut Estimate,
        label_sd_px: f64,
    ) -> Option<()> {
        let forms = self.forms(objective, at, label_sd_px);
        let search = Search { base: objective.camera_terms(&at.camera), forms: &forms };
        let found = search.run()?;
        self.chosen = likeliest(found.iter())?.0.clone();
        let all = self.chosen.iter().zip(&self.alternatives).zip(&forms).zip(&mut at.vehicles);
        objective.observed.clear();
        for (((model, alternatives), forms), vehicle) in all {
            let model = usize::from(*model);
            objective.observed.push(alternatives[model].clone());
            *vehicle = forms[model].as_ref()?.state;
        }
        Some(())
    }

    /// The likely assignments about an estimate that was made under the one chosen.
    pub fn mixture(
        &self,
        objective: &Objective,
        at: &Estimate,
        label_sd_px: f64,
    ) -> Option<Mixture> {
        let forms = self.forms(objective, at, label_sd_px);
        let search = Search { base: objective.camera_terms(&at.camera), forms: &forms };
        let found = search.run()?;
        let top = likeliest(found.iter())?.1.log_evidence;
        let likely = found.values().filter(|s| s.log_evidence > top - NEGLIGIBLE);
        let weigh = |s: &Scored| (s.log_evidence - top).exp();
        let total: f64 = likely.clone().map(weigh).sum();
        let mean: CameraStep = likely.clone().map(|s| s.step * (weigh(s) / total)).sum();
        let covariance: CameraInformation = likely
            .map(|s| {
                let off = s.step - mean;
                (s.factor.inverse() + off * off.transpose()) * (weigh(s) / total)
            })
            .sum();
        let chosen = search.score(&self.chosen)?.log_evidence;
        let choices: f64 = forms.iter().map(|f| (f.len() as f64).ln()).sum();
        Some(Mixture { mean, covariance, log_evidence: top + total.ln() - chosen - choices })
    }

    fn forms(&self, objective: &Objective, at: &Estimate, sd_px: f64) -> Vec<Vec<Option<Form>>> {
        let each = self.alternatives.iter().zip(&at.vehicles);
        each.map(|(all, state)| {
            all.iter().map(|o| form(objective, o, &at.camera, state, sd_px)).collect()
        })
        .collect()
    }
}

fn form(
    objective: &Objective,
    observed: &Observed,
    camera: &CameraState,
    state: &VehicleState,
    sd_px: f64,
) -> Option<Form> {
    let (size, shift) = (objective.image_size, objective.shift_sd_px);
    let mut observed = observed.clone();
    let start = VehicleState { shape: Coefficients::zeros(), ..*state };
    let misfits = observed.misfits(camera, size, &start);
    observed.set_noise(sd_px, &misfits);
    let (state, cost) = observed.settle(camera, size, start, shift, SETTLE_STEPS)?;
    let block = observed.linearise(camera, size, &state, shift);
    let part = block.eliminate(0.0)?;
    Some(Form {
        state,
        information: block.cc - block.cv * part.gain,
        gradient: block.gc - block.cv * part.own,
        level: -cost - 0.5 * part.log_determinant - observed.log_noise(),
    })
}

/// An assignment with what it says of the camera.
struct Scored {
    log_evidence: f64,
    step: CameraStep,
    factor: Cholesky<f64, Const<CAMERA>>,
    expanded: bool,
}

fn likeliest<'a>(
    all: impl Iterator<Item = (&'a Assignment, &'a Scored)>,
) -> Option<(&'a Assignment, &'a Scored)> {
    all.max_by(|a, b| a.1.log_evidence.total_cmp(&b.1.log_evidence))
}

struct Search<'a> {
    base: (CameraInformation, CameraStep),
    forms: &'a [Vec<Option<Form>>],
}

impl Search<'_> {
    /// Best first: from each vehicle's best model at the held camera, always the
    /// likeliest assignment not yet looked around from, changing one vehicle at a time.
    fn run(&self) -> Option<BTreeMap<Assignment, Scored>> {
        let level = |f: &Option<Form>| f.as_ref().map_or(f64::NEG_INFINITY, |f| f.level);
        let first: Assignment = self
            .forms
            .iter()
            .map(|all| {
                let best =
                    (0..all.len()).max_by(|&a, &b| level(&all[a]).total_cmp(&level(&all[b])));
                best.unwrap_or(0) as u8
            })
            .collect();
        let mut found = BTreeMap::from([(first.clone(), self.score(&first)?)]);
        for _ in 0..EXPANSIONS {
            let top = likeliest(found.iter())?.1.log_evidence;
            let Some((from, next)) = likeliest(found.iter().filter(|(_, s)| !s.expanded)) else {
                break;
            };
            if next.log_evidence < top - UNLIKELY {
                break;
            }
            let from = from.clone();
            found.entry(from.clone()).and_modify(|s| s.expanded = true);
            for vehicle in 0..from.len() {
                for model in 0..self.forms[vehicle].len() as u8 {
                    let mut other = from.clone();
                    other[vehicle] = model;
                    if found.contains_key(&other) {
                        continue;
                    }
                    if let Some(scored) = self.score(&other) {
                        found.insert(other, scored);
                    }
                }
            }
        }
        Some(found)
    }

    fn score(&self, assignment: &[u8]) -> Option<Scored> {
        let (mut information, mut gradient) = self.base;
        let mut log_evidence = 0.0;
        for (model, all) in assignment.iter().zip(self.forms) {
            let form = all[usize::from(*model)].as_ref()?;
            information += form.information;
            gradient += form.gradient;
            log_evidence += form.level;
        }
        let factor = information.cholesky()?;
        let step = -factor.solve(&gradient);
        let log_determinant = 2.0 * factor.l().diagonal().map(f64::ln).sum();
        log_evidence -= 0.5 * (gradient.dot(&step) + log_determinant);
        Some(Scored { log_evidence, step, factor, expanded: false })
    }
}
