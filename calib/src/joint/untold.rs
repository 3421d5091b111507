//! Vehicles whose body nobody told: cars that a van, a minibus or a taxi would be likelier.
//!
//! Not in the paper. A van taken for a car makes every length too short, and no residual shows
//! it: the camera bends until the van is a car. What shows it is the probability of all labels
//! together, once with the vehicle as a car and once as another body. Owns that comparison, one
//! vehicle after the other. Does not own the fits (see `fit`) nor the verdict (see `trust`).

use super::Settings;
use super::fit::{self, Fleet};
use super::solver::Estimate;
use crate::bodies::Body;
use crate::problem::Problem;
use rayon::prelude::*;

/// How much rarer than cars other bodies are among vehicles that somebody labels.
const SHARE: f64 = 0.1;
/// Least logarithm of the odds at which a vehicle is named.
pub const NAMED: f64 = 3.0;
/// Fewest vehicles among which one may be told from the others.
pub const MIN_VEHICLES: usize = 3;

/// A vehicle that is likelier another body than the car that it is taken for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Untold {
    /// Its place in the problem.
    pub vehicle: usize,
    /// What it is likelier.
    pub body: Body,
    /// Logarithm of the odds, those named before being what they are named.
    pub log_odds: f64,
}

/// The vehicles that are likelier another body, the likeliest first. `at` is the fit with each
/// as it is labelled.
pub fn untold(problem: &Problem, settings: &Settings, at: &Estimate) -> Vec<Untold> {
    untold_above(NAMED, problem, settings, at)
}

/// The same with another limit of the logarithm of the odds.
pub fn untold_above(
    least: f64,
    problem: &Problem,
    settings: &Settings,
    at: &Estimate,
) -> Vec<Untold> {
    let mut named: Vec<Untold> = Vec::new();
    if problem.vehicles.len() < MIN_VEHICLES {
        return named;
    }
    let fitted = |problem: &Problem, at: &Estimate| {
        fit::fit(problem, settings, Fleet::AboutMean(1.0), at).ok()
    };
    let mut problem = problem.clone();
    let Some(mut now) = fitted(&problem, at) else { return named };
    // More than half of other bodies is a fleet that nothing here knows.
    while named.len() < problem.vehicles.len() / 2 {
        let best = |others: Vec<Others>| {
            others
                .into_par_iter()
                .filter_map(|others| {
                    let mut other = problem.clone();
                    for &k in &others.vehicles {
                        other.vehicles[k].body = others.body;
                    }
                    let fit = fitted(&other, &now.estimate)?;
                    let prior = others.vehicles.len() as f64 * SHARE.ln();
                    let log_odds = fit.log_evidence - now.log_evidence + prior;
                    (log_odds >= least).then_some((log_odds, others, fit))
                })
                .max_by(|a, b| a.0.total_cmp(&b.0))
        };
        // Two of a kind hide each other: with one of them told, the other pulls as before.
        let found = best(singles(&problem)).or_else(|| best(pairs(&problem)));
        let Some((log_odds, Others { vehicles, body }, fit)) = found else { break };
        for vehicle in vehicles {
            problem.vehicles[vehicle].body = body;
            named.push(Untold { vehicle, body, log_odds });
        }
        now = fit;
    }
    named
}

/// Cars that might all be of one other body.
struct Others {
    vehicles: Vec<usize>,
    body: Body,
}

fn cars(problem: &Problem) -> impl Iterator<Item = usize> + '_ {
    (0..problem.vehicles.len()).filter(|&k| problem.vehicles[k].body == Body::Car)
}

fn singles(problem: &Problem) -> Vec<Others> {
    let others = Body::ALL.into_iter().filter(|b| *b != Body::Car);
    others.flat_map(|body| cars(problem).map(move |k| Others { vehicles: vec![k], body })).collect()
}

/// A taxi is nearly a car: two of them change nothing.
fn pairs(problem: &Problem) -> Vec<Others> {
    let mut all = Vec::new();
    for body in [Body::Van, Body::Minibus] {
        for a in cars(problem) {
            let later = cars(problem).filter(|b| *b > a);
            all.extend(later.map(|b| Others { vehicles: vec![a, b], body }));
        }
    }
    all
}
