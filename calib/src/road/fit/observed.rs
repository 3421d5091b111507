//! What boxes tell less because nobody knows which body each shows.
//!
//! Owns the missing information: the curvature that `solve` steps by takes each box for its bodies
//! with fixed probabilities, and the bodies' shares and the boxes' scatter as given. A camera that
//! moves also moves these, and what they take is lost (Louis 1982, "Finding the observed information
//! matrix when using the EM algorithm", section 3). Does not own the mixture (see `mixture`).

use super::bodies::{ALL as ALL_BODIES, BODIES};
use super::mixture::{Mixture, Possible, SCATTER_WORTH, SHARE_WORTH};
use super::problem::{ALL, Information, Problem, Theta};
use super::traffic::SHARED;
use super::view::{CAMERA, STEP};
use nalgebra::{SMatrix, SVector};

/// The shares of the bodies, and the logarithm of the scatter.
const LATENT: usize = BODIES + 1;
/// Place of the scatter.
const SCATTER: usize = ALL + BODIES;
const WHOLE: usize = ALL + LATENT;
type Score = SVector<f64, WHOLE>;
type Wide = SMatrix<f64, WHOLE, WHOLE>;

/// Sums over all boxes.
struct Sums {
    /// Variance of each box's score over its bodies, summed.
    missing: Wide,
    /// Boxes that show a vehicle.
    boxes: f64,
    /// The same, each by how well its body's fleet is known.
    trusted: f64,
}

impl Sums {
    /// Adds a box, given the score and the probability of each body that it may be.
    fn add(&mut self, bodies: &[(Score, Possible)]) {
        let known: f64 = bodies.iter().map(|(_, of)| of.p).sum();
        let mean: Score = bodies.iter().map(|(score, of)| score * of.p).sum();
        for (score, of) in bodies {
            let off = score - mean;
            let trusted = of.p * ALL_BODIES[of.body].trust;
            self.missing += off * off.transpose() * trusted;
            self.trusted += trusted;
        }
        // Otherwise it is no whole vehicle, whose score is 0.
        self.missing += mean * mean.transpose() * (1.0 - known).max(0.0);
        self.boxes += known;
    }
}

impl Problem<'_> {
    /// The information on the unknowns with bodies, shares and scatter integrated out; `complete`
    /// takes them as known.
    pub(super) fn observed(
        &mut self,
        theta: &Theta,
        mixture: &Mixture,
        complete: &Information,
    ) -> Option<Information> {
        let shares = mixture.shares();
        let scores = self.scores(theta, mixture)?;
        let mut sums = Sums { missing: Wide::zeros(), boxes: 0.0, trusted: 0.0 };
        scores.chunk_by(|a, b| a.1.seen == b.1.seen).for_each(|of_box| sums.add(of_box));
        let weight = mixture.weight();
        let mut r = Vec::new();
        self.residuals(theta, None, &mut r)?;
        let (other, _) = self.normal(theta, None, &r, &[true; CAMERA])?;
        // What the boxes tell, and what is known without them.
        let (mut told, mut known) = (Wide::zeros(), Wide::zeros());
        told.fixed_view_mut::<ALL, ALL>(0, 0).copy_from(&(complete - other));
        known.fixed_view_mut::<ALL, ALL>(0, 0).copy_from(&other);
        for (a, of_a) in shares.iter().enumerate() {
            for (b, of_b) in shares.iter().enumerate() {
                let own = if a == b { *of_a } else { 0.0 };
                let of_one_box = weight * (own - of_a * of_b);
                told[(ALL + a, ALL + b)] = sums.boxes * of_one_box;
                known[(ALL + a, ALL + b)] = SHARE_WORTH * of_one_box;
            }
            // Only the ratios of shares mean something.
            known[(ALL + a, ALL + a)] += 1e-3;
        }
        told[(SCATTER, SCATTER)] = weight * sums.trusted;
        known[(SCATTER, SCATTER)] = weight * 0.5 * SCATTER_WORTH;
        told -= sums.missing * weight;
        // Bodies that count less than they are likely can seem to tell less than nothing.
        let mut spectrum = told.symmetric_eigen();
        spectrum.eigenvalues.apply(|l| *l = l.max(0.0));
        let whole = spectrum.recompose() + known;
        let own = whole.fixed_view::<ALL, ALL>(0, 0).into_owned();
        let cross = whole.fixed_view::<ALL, LATENT>(0, ALL).into_owned();
        let latent = whole.fixed_view::<LATENT, LATENT>(ALL, ALL).into_owned().cholesky()?;
        Some(own - cross * latent.solve(&cross.transpose()))
    }

    /// How the logarithm of the likelihood of each box, as each body that it may be, changes with
    /// the unknowns, the shares and the scatter.
    fn scores(&mut self, theta: &Theta, mixture: &Mixture) -> Option<Vec<(Score, Possible)>> {
        let (all, of) = mixture.possible();
        let (mut r, mut moved) = (Vec::new(), Vec::new());
        self.residuals(theta, Some(&all), &mut r)?;
        let first = r.len() - 2 * of.len();
        let mut slopes = Vec::with_capacity(CAMERA);
        self.bounding.is_held = true;
        for (k, step) in STEP.into_iter().enumerate() {
            let mut at = *theta;
            at[k] += step;
            let is_on_road = self.residuals(&at, Some(&all), &mut moved).is_some();
            let slope = moved.iter().zip(&r).map(|(a, b)| (a - b) / step);
            slopes.push(if is_on_road { slope.collect::<Vec<_>>() } else { vec![0.0; r.len()] });
        }
        self.bounding.is_held = false;
        let shares = mixture.shares();
        let score = |(pair, (rows, of)): (usize, ([[f64; SHARED]; 2], &Possible))| {
            let mut score = Score::zeros();
            let mut misfit = 0.0;
            for (half, row) in rows.iter().enumerate() {
                let at = first + 2 * pair + half;
                slopes.iter().enumerate().for_each(|(k, s)| score[k] -= s[at] * r[at]);
                row.iter().enumerate().for_each(|(k, s)| score[CAMERA + k] -= s * r[at]);
                misfit += r[at] * r[at];
            }
            shares.iter().enumerate().for_each(|(k, share)| score[ALL + k] = -share);
            score[ALL + of.body] += 1.0;
            score[SCATTER] = 0.5 * misfit - 1.0;
            (score, *of)
        };
        Some(all.shared_rows().zip(&of).enumerate().map(score).collect())
    }
}
