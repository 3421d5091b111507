//! CMA-ES over the seven parameters of a camera (rotation vector, translation, focal
//! length): parameters, state, and the reason it stopped.
//!
//! Owns the optimiser: Hansen and Ostermeier 1996, with the default constants of Hansen,
//! "The CMA Evolution Strategy: A Tutorial" (arXiv 1604.00772, 2023 version, Table 1) and
//! positive recombination weights. Does not own any loss. The dimension is fixed so that
//! all state lives on the stack: an evaluation costs well under a microsecond here. It is our
//! own because the crate `cmaes` sizes its state at run time, on the heap, which half a million
//! evaluations a calibration would feel, and because each constant here can be held against the
//! tutorial.

use nalgebra::{SMatrix, SVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Parameters of a camera: Proposition 1 of the paper reduces 13 to 7.
pub const DIMENSION: usize = 7;
/// A point of the search space.
pub type Point = SVector<f64, DIMENSION>;
type Square = SMatrix<f64, DIMENSION, DIMENSION>;

/// Candidates a generation, 4 + floor(3 ln 7) (tutorial, Eq. 48).
pub const POPULATION: usize = 9;
const PARENTS: usize = POPULATION / 2;

/// Where and how to search.
#[derive(Clone, Copy, Debug)]
pub struct Parameters {
    /// First mean.
    pub start: Point,
    /// First standard deviation of each coordinate.
    pub step: Point,
    /// Lower bounds, absolute.
    pub lower: Point,
    /// Upper bounds, absolute.
    pub upper: Point,
    /// Most evaluations of the loss.
    pub budget: usize,
    /// Stop before the budget once converged. Off only to time whole budgets.
    pub stop_early: bool,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Independent stream under the same seed, one for each parallel search.
    pub stream: u64,
}

/// Why a search stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Termination {
    /// The budget of evaluations is spent.
    Budget,
    /// The best losses of the last generations agree to [`LOSS_TOLERANCE`].
    LossTolerance,
    /// The search distribution is narrower than [`STEP_TOLERANCE`] of the first one.
    StepTolerance,
    /// The covariance is too elongated to go on (condition above [`MAX_CONDITION`]).
    Condition,
    /// No candidate of a generation had a finite loss.
    Infeasible,
}

/// Spread of the last best losses that counts as converged, relative to the loss.
pub const LOSS_TOLERANCE: f64 = 1e-12;
/// Width of the search distribution, relative to the first, that counts as converged.
pub const STEP_TOLERANCE: f64 = 1e-9;
/// Largest condition number of the covariance.
pub const MAX_CONDITION: f64 = 1e14;
/// Generations whose best losses are compared: 10 + 30 n / lambda (tutorial, B.3).
const HISTORY: usize = 10 + 30 * DIMENSION / POPULATION;

/// The result of a search.
#[derive(Clone, Copy, Debug)]
pub struct Outcome {
    /// The best point seen, inside the bounds.
    pub best: Point,
    /// Its loss.
    pub loss: f64,
    /// How often the loss was evaluated.
    pub evaluations: usize,
    /// Why the search stopped.
    pub termination: Termination,
}

/// Strategy constants (tutorial, Table 1).
struct Constants {
    weights: [f64; PARENTS],
    mu_eff: f64,
    c_sigma: f64,
    d_sigma: f64,
    c_c: f64,
    c_1: f64,
    c_mu: f64,
    chi_n: f64,
}

impl Constants {
    fn new() -> Self {
        let n = DIMENSION as f64;
        let raw: [f64; PARENTS] =
            std::array::from_fn(|i| ((POPULATION as f64 + 1.0) / 2.0).ln() - ((i + 1) as f64).ln());
        let sum: f64 = raw.iter().sum();
        let weights = raw.map(|w| w / sum);
        let mu_eff = 1.0 / weights.iter().map(|w| w * w).sum::<f64>();
        let c_sigma = (mu_eff + 2.0) / (n + mu_eff + 5.0);
        let c_1 = 2.0 / ((n + 1.3).powi(2) + mu_eff);
        Constants {
            weights,
            mu_eff,
            c_sigma,
            d_sigma: 1.0 + c_sigma + 2.0 * (((mu_eff - 1.0) / (n + 1.0)).sqrt() - 1.0).max(0.0),
            c_c: (4.0 + mu_eff / n) / (n + 4.0 + 2.0 * mu_eff / n),
            c_1,
            c_mu: (1.0 - c_1)
                .min(2.0 * (mu_eff - 2.0 + 1.0 / mu_eff) / ((n + 2.0).powi(2) + mu_eff)),
            chi_n: n.sqrt() * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n)),
        }
    }
}

/// The search distribution, in units of the first standard deviations around the start.
struct State {
    mean: Point,
    sigma: f64,
    covariance: Square,
    path_sigma: Point,
    path_c: Point,
    /// Square roots of the eigenvalues of the covariance, and its eigenvectors.
    axis_lengths: Point,
    axes: Square,
    generation: usize,
}

impl State {
    fn new() -> Self {
        State {
            mean: Point::zeros(),
            sigma: 1.0,
            covariance: Square::identity(),
            path_sigma: Point::zeros(),
            path_c: Point::zeros(),
            axis_lengths: Point::repeat(1.0),
            axes: Square::identity(),
            generation: 0,
        }
    }

    /// Moves the distribution towards the best steps y, best first (tutorial, Fig. 6).
    fn update(&mut self, k: &Constants, best_steps: &[Point; PARENTS]) {
        let shift: Point = best_steps.iter().zip(k.weights).map(|(y, w)| y * w).sum();
        self.mean += shift * self.sigma;
        self.generation += 1;

        let whitened = self.axes * self.axes.tr_mul(&shift).component_div(&self.axis_lengths);
        self.path_sigma = self.path_sigma * (1.0 - k.c_sigma)
            + whitened * (k.c_sigma * (2.0 - k.c_sigma) * k.mu_eff).sqrt();
        let length = self.path_sigma.norm();
        let settled = 1.0 - (1.0 - k.c_sigma).powf(2.0 * self.generation as f64);
        let stalled = length / settled.sqrt() >= (1.4 + 2.0 / (DIMENSION as f64 + 1.0)) * k.chi_n;
        let h = if stalled { 0.0 } else { 1.0 };
        self.path_c =
            self.path_c * (1.0 - k.c_c) + shift * (h * (k.c_c * (2.0 - k.c_c) * k.mu_eff).sqrt());

        let lost = (1.0 - h) * k.c_c * (2.0 - k.c_c);
        self.covariance *= 1.0 - k.c_1 - k.c_mu + k.c_1 * lost;
        self.covariance.ger(k.c_1, &self.path_c, &self.path_c, 1.0);
        for (y, w) in best_steps.iter().zip(k.weights) {
            self.covariance.ger(k.c_mu * w, y, y, 1.0);
        }
        self.sigma *= ((k.c_sigma / k.d_sigma) * (length / k.chi_n - 1.0)).exp();
    }

    /// Recomputes the axes. Returns the condition number of the covariance.
    fn decompose(&mut self) -> f64 {
        self.covariance = (self.covariance + self.covariance.transpose()) * 0.5;
        let eigen = self.covariance.symmetric_eigen();
        let largest = eigen.eigenvalues.max();
        self.axis_lengths =
            eigen.eigenvalues.map(|v| v.max(largest * (1.0 / (10.0 * MAX_CONDITION))).sqrt());
        self.axes = eigen.eigenvectors;
        largest / eigen.eigenvalues.min().max(f64::MIN_POSITIVE)
    }
}

/// Generations between decompositions: one in two costs no convergence here and saves
/// half of the eigenvalue problems.
const DECOMPOSE_EVERY: usize = 2;

/// Minimises a loss of the seven parameters. A loss that is not finite marks a point as
/// infeasible. The same parameters give the same outcome on every machine and with any
/// number of threads.
pub fn minimise(parameters: &Parameters, mut loss: impl FnMut(&Point) -> f64) -> Outcome {
    let constants = Constants::new();
    let mut rng = ChaCha8Rng::seed_from_u64(parameters.seed);
    rng.set_stream(parameters.stream);
    let mut state = State::new();
    let start = parameters.inside(&Point::zeros());
    let mut outcome = Outcome {
        best: start,
        loss: finite_or_infinite(loss(&start)),
        evaluations: 1,
        termination: Termination::Budget,
    };
    let mut history = [f64::INFINITY; HISTORY];

    while outcome.evaluations + POPULATION <= parameters.budget {
        let mut ranked: [(f64, Point); POPULATION] = std::array::from_fn(|_| {
            let z = Point::from_fn(|_, _| StandardNormal.sample(&mut rng));
            let y = state.axes * z.component_mul(&state.axis_lengths);
            let x = parameters.inside(&(state.mean + y * state.sigma));
            let value = finite_or_infinite(loss(&x));
            if value < outcome.loss {
                (outcome.loss, outcome.best) = (value, x);
            }
            (value, y)
        });
        outcome.evaluations += POPULATION;
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
        if ranked[0].0.is_infinite() {
            outcome.termination = Termination::Infeasible;
            return outcome;
        }
        state.update(&constants, &std::array::from_fn(|i| ranked[i].1));
        let condition =
            if state.generation.is_multiple_of(DECOMPOSE_EVERY) { state.decompose() } else { 1.0 };

        history[state.generation % HISTORY] = ranked[0].0;
        let reason = if !parameters.stop_early {
            None
        } else if condition > MAX_CONDITION {
            Some(Termination::Condition)
        } else if state.sigma * state.axis_lengths.max() < STEP_TOLERANCE {
            Some(Termination::StepTolerance)
        } else if spread(&history) <= LOSS_TOLERANCE * ranked[0].0.abs() {
            Some(Termination::LossTolerance)
        } else {
            None
        };
        if let Some(reason) = reason {
            outcome.termination = reason;
            return outcome;
        }
    }
    outcome
}

fn finite_or_infinite(loss: f64) -> f64 {
    if loss.is_finite() { loss } else { f64::INFINITY }
}

fn spread(history: &[f64]) -> f64 {
    let (low, high) =
        history.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &x| (l.min(x), h.max(x)));
    if high.is_finite() { high - low } else { f64::INFINITY }
}

impl Parameters {
    /// A point of the search distribution in the caller's units, folded back at the
    /// bounds so that the loss stays continuous there.
    fn inside(&self, scaled: &Point) -> Point {
        Point::from_fn(|i, _| {
            let x = self.start[i] + scaled[i] * self.step[i];
            fold(x, self.lower[i], self.upper[i])
        })
    }
}

/// Reflects `x` at the ends of [low, high] until it lies inside.
fn fold(x: f64, low: f64, high: f64) -> f64 {
    if (low..=high).contains(&x) {
        return x;
    }
    let width = high - low;
    let phase = (x - low).rem_euclid(2.0 * width);
    low + if phase > width { 2.0 * width - phase } else { phase }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parameters(budget: usize, seed: u64) -> Parameters {
        Parameters {
            start: Point::repeat(2.0),
            step: Point::repeat(0.5),
            lower: Point::repeat(-10.0),
            upper: Point::repeat(10.0),
            budget,
            stop_early: true,
            seed,
            stream: 0,
        }
    }

    fn rosenbrock(x: &Point) -> f64 {
        (0..DIMENSION - 1)
            .map(|i| 100.0 * (x[i + 1] - x[i] * x[i]).powi(2) + (1.0 - x[i]).powi(2))
            .sum()
    }

    #[test]
    fn an_elongated_ellipsoid_is_solved_from_every_seed() {
        for seed in 0..10 {
            let ellipsoid =
                |x: &Point| (0..DIMENSION).map(|i| 10f64.powi(i as i32) * x[i] * x[i]).sum();
            let out = minimise(&parameters(20_000, seed), ellipsoid);
            assert!(out.loss < 1e-12, "seed {seed}: {out:?}");
            assert_ne!(out.termination, Termination::Budget);
        }
    }

    #[test]
    fn rosenbrock_is_solved_from_most_seeds() {
        // It has a second minimum for n > 3 that a local search may end in.
        let solved = (0..10)
            .filter(|&seed| minimise(&parameters(30_000, seed), rosenbrock).loss < 1e-8)
            .count();
        assert!(solved >= 8, "{solved} of 10");
    }

    #[test]
    fn the_best_point_stays_inside_the_bounds() {
        let mut p = parameters(5_000, 1);
        p.upper = Point::repeat(3.0);
        let out = minimise(&p, |x| (x - Point::repeat(5.0)).norm_squared());
        assert!(out.best.iter().all(|c| (-10.0..=3.0).contains(c)));
        assert!((out.best - Point::repeat(3.0)).norm() < 1e-3, "{}", out.best);
    }

    #[test]
    fn the_same_seed_gives_the_same_bits_and_streams_differ() {
        let a = minimise(&parameters(500, 7), rosenbrock);
        let b = minimise(&parameters(500, 7), rosenbrock);
        let c = minimise(&Parameters { stream: 1, ..parameters(500, 7) }, rosenbrock);
        assert_eq!((a.best, a.loss, a.evaluations), (b.best, b.loss, b.evaluations));
        assert_ne!(a.best, c.best);
        assert!(a.evaluations <= 500 && a.termination == Termination::Budget);
    }

    #[test]
    fn nothing_feasible_is_said() {
        let out = minimise(&parameters(500, 7), |_| f64::NAN);
        assert_eq!(out.termination, Termination::Infeasible);
        assert!(out.loss.is_infinite());
    }
}
