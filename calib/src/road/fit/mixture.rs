//! Which body each box shows: a mixture, and the residuals that follow.
//!
//! Owns the bodies' shares, the noise of a box, how much evidence boxes give, and the outliers. Does
//! not own the choice of boxes (see `traffic`) nor the minimisation (see `solve`).

use super::bodies::{ALL, BODIES};
use super::hull::{Footing, LOOKS, Look};
use super::lanes::Middle;
use super::traffic::{OUTLINE, SHARED, Seen, Shared, Supports, Traffic, log_size};
use super::view::View;
use nalgebra::{Matrix2, Vector2};

/// So many boxes' worth of evidence is the most that a camera's boxes give.
const EVIDENCE: f64 = 40.0;
/// Standard deviation of a box's edge: a part of its size.
const EDGE_REL_SD: f64 = 0.025;
/// Scatter of headings about the lane's, rad.
const HEADING_SD: f64 = 2.5 * std::f64::consts::PI / 180.0;
/// Share of boxes that are not a whole vehicle.
const OUTLIERS: f64 = 0.06;
/// A body with a smaller probability for a box is left out of a step.
const LEAST: f64 = 0.02;
/// A box may be a body from this probability on.
const POSSIBLE: f64 = 1e-3;
/// The bodies' shares before any box is seen are worth so many boxes.
pub const SHARE_WORTH: f64 = 25.0;
/// The assumed scatter is worth so many boxes.
pub const SCATTER_WORTH: f64 = 20.0;

/// The points that bound the bodies of the pairs.
#[derive(Clone, Debug, Default)]
pub struct Bounding {
    of_pairs: Vec<Option<Supports>>,
    /// Whether they are used as they are, for a camera close by.
    pub is_held: bool,
}

/// What is held of the mixture while the unknowns move.
#[derive(Clone, Debug)]
pub struct Mixture {
    /// Inverse covariance of a box as a body, its upper factor, and the determinant's
    /// logarithm; by box and body.
    noise: Vec<[Option<Noise>; BODIES]>,
    /// Boxes that count: by where they stand, not by their own size, which would favour wide
    /// ones.
    active: Vec<bool>,
    /// Logarithms of the bodies' shares.
    log_share: [f64; BODIES],
    /// How much wider boxes scatter than assumed, squared.
    scatter: f64,
    /// Evidence of one box.
    weight: f64,
    /// The pairs of a box and a body that count, with their weights.
    pairs: Vec<Pair>,
    /// Every pair that is possible, each as one whole box, with its probability.
    possible: Vec<(Pair, f64)>,
}

#[derive(Clone, Copy, Debug)]
struct Noise {
    inverse: Matrix2<f64>,
    log_determinant: f64,
    /// Derivatives of the prediction with respect to the logarithms of the size.
    by_size: [Vector2<f64>; 3],
}

/// A box as a body, with the weight of that.
#[derive(Clone, Copy, Debug)]
struct Pair {
    seen: usize,
    body: usize,
    white: Matrix2<f64>,
    by_size: [Vector2<f64>; 3],
    excess: f64,
    toward: f64,
    look: Look,
}

/// A body that a box may be.
#[derive(Clone, Copy, Debug)]
pub struct Possible {
    /// Index of the box.
    pub seen: usize,
    /// Index of the body.
    pub body: usize,
    /// Its probability.
    pub p: f64,
}

impl Mixture {
    /// Nothing known but the shares, with the noise at a camera.
    pub fn new(traffic: &Traffic, view: &View, lanes: &[Option<Middle>], shared: &Shared) -> Self {
        let total: f64 = ALL.iter().map(|b| b.share).sum();
        let mut mixture = Mixture {
            noise: Vec::new(),
            active: Vec::new(),
            log_share: std::array::from_fn(|k| (ALL[k].share / total).ln()),
            scatter: 1.0,
            weight: 1.0,
            pairs: Vec::new(),
            possible: Vec::new(),
        };
        mixture.hold(traffic, view, lanes, shared);
        mixture
    }

    /// How many boxes count.
    pub fn used(&self) -> usize {
        self.active.iter().filter(|a| **a).count()
    }

    /// The bodies' shares.
    pub fn shares(&self) -> [f64; BODIES] {
        self.log_share.map(f64::exp)
    }

    /// Takes the noise of every box as every body at this camera.
    pub fn hold(
        &mut self,
        traffic: &Traffic,
        view: &View,
        lanes: &[Option<Middle>],
        shared: &Shared,
    ) {
        let footings = traffic.footings(view, lanes);
        self.noise.clear();
        let mut car_px = Vec::new();
        for (k, at) in footings.iter().enumerate() {
            let mut row = [None; BODIES];
            if let Some(at) = at {
                let possible = |body: &usize| traffic.seen[k].log_class[*body].is_finite();
                for body in (0..BODIES).filter(possible) {
                    row[body] = noise(traffic, view, k, at, body, shared);
                }
                let car = traffic.predict(view, k, at, 0, log_size(0, shared), shared);
                car_px.push(car.map_or(0.0, |(p, _)| p[0].exp()));
            } else {
                car_px.push(0.0);
            }
            self.noise.push(row);
        }
        self.active = car_px.iter().map(|px| *px >= traffic.min_car_px).collect();
        let enough = 10.min(traffic.seen.len() / 2);
        if self.used() < enough {
            let mut sorted = car_px.clone();
            sorted.sort_by(|a, b| b.total_cmp(a));
            let least = sorted[enough.min(sorted.len() - 1)];
            self.active = car_px.iter().map(|px| *px >= least && *px > 0.0).collect();
        }
        self.weight = (EVIDENCE / self.used().max(1) as f64).min(1.0);
    }

    /// The probabilities of the bodies for each box, the shares and the scatter that follow;
    /// gives the logarithm of the mixture's likelihood. `heat` above 1 keeps every body in the
    /// game.
    pub fn expect(
        &mut self,
        traffic: &Traffic,
        view: &View,
        lanes: &[Option<Middle>],
        shared: &Shared,
        heat: f64,
        learn: bool,
    ) -> f64 {
        let footings = traffic.footings(view, lanes);
        let sizes: [[f64; 3]; BODIES] = std::array::from_fn(|b| log_size(b, shared));
        let told = traffic.seen.iter().any(|s| s.log_class.iter().any(|l| *l < 0.0));
        let outlier = OUTLIERS.ln() - 2.0 * 1.5f64.ln() + if told { 0.2f64.ln() } else { 0.0 };
        self.pairs.clear();
        let (mut total, mut misfit, mut counted) = (0.0, 0.0, 0.0);
        let mut share = [0.0; BODIES];
        let mut weighed: Vec<(Pair, f64)> = Vec::new();
        self.possible.clear();
        for k in (0..traffic.seen.len()).filter(|&k| self.active[k]) {
            let Some(at) = &footings[k] else { continue };
            let mut row = [(f64::NEG_INFINITY, 0.0); BODIES];
            for body in 0..BODIES {
                let Some(noise) = &self.noise[k][body] else { continue };
                let predicted = traffic.predict(view, k, at, body, sizes[body], shared);
                let predicted = predicted.map(|(predicted, _)| predicted);
                let r = traffic.residual(k, &at[0].look, predicted, shared);
                let m0 = r.dot(&(noise.inverse * r));
                let wide = heat * self.scatter;
                let log = self.log_share[body] + traffic.seen[k].log_class[body]
                    - 0.5 * (m0 / wide + noise.log_determinant)
                    - (wide * std::f64::consts::TAU).ln()
                    + (1.0 - OUTLIERS).ln();
                row[body] = (log, m0);
            }
            let top = row.iter().fold(outlier, |t, (l, _)| t.max(*l));
            let sum = row.iter().map(|(l, _)| (l - top).exp()).sum::<f64>() + (outlier - top).exp();
            total += top + sum.ln();
            for body in 0..BODIES {
                let p = (row[body].0 - top).exp() / sum;
                share[body] += p;
                let gamma = p * ALL[body].trust;
                misfit += gamma * row[body].1;
                counted += gamma;
                if p > POSSIBLE
                    && let Some(noise) = &self.noise[k][body]
                    && let Some(factor) = noise.inverse.cholesky()
                {
                    let white = factor.l().transpose();
                    let Seen { excess, toward, .. } = traffic.seen[k];
                    let by_size = noise.by_size;
                    let pair =
                        Pair { seen: k, body, white, by_size, excess, toward, look: at[0].look };
                    self.possible.push((pair, p));
                    if gamma > LEAST {
                        weighed.push((pair, gamma));
                    }
                }
            }
        }
        if learn {
            let boxes: f64 = share.iter().sum();
            let part = (400.0 / boxes.max(1.0)).min(1.0);
            let worth: [f64; BODIES] =
                std::array::from_fn(|b| share[b] * part + SHARE_WORTH * ALL[b].share);
            let all: f64 = worth.iter().sum();
            self.log_share = worth.map(|w| (w / all).ln());
            self.scatter = if heat == 1.0 {
                ((SCATTER_WORTH + misfit) / (SCATTER_WORTH + 2.0 * counted)).clamp(0.2, 4.0)
            } else {
                1.0
            };
        }
        for (mut pair, gamma) in weighed {
            pair.white *= (gamma * self.weight / self.scatter).sqrt();
            self.pairs.push(pair);
        }
        for (pair, _) in &mut self.possible {
            pair.white /= self.scatter.sqrt();
        }
        self.weight * total
    }

    /// The mixture whose pairs are all that are possible, each as one whole box; and what each is.
    pub fn possible(&self) -> (Mixture, Vec<Possible>) {
        let pairs = self.possible.iter().map(|(pair, _)| *pair).collect();
        let of = |&(pair, p): &(Pair, f64)| Possible { seen: pair.seen, body: pair.body, p };
        let of = self.possible.iter().map(of).collect();
        (Mixture { pairs, possible: Vec::new(), ..self.clone() }, of)
    }

    /// Evidence of one box.
    pub fn weight(&self) -> f64 {
        self.weight
    }

    /// Whitened residuals of the pairs that count. `bounding` takes the points that bound them, or
    /// gives them where they are held.
    pub fn residuals(
        &self,
        traffic: &Traffic,
        view: &View,
        lanes: &[Option<Middle>],
        shared: &Shared,
        bounding: &mut Bounding,
        out: &mut Vec<f64>,
    ) {
        let footings = traffic.footings(view, lanes);
        let sizes: [[f64; 3]; BODIES] = std::array::from_fn(|b| log_size(b, shared));
        if !bounding.is_held {
            bounding.of_pairs.clear();
        }
        for (k, pair) in self.pairs.iter().enumerate() {
            let Pair { seen, body, .. } = *pair;
            let predicted = footings[seen].as_ref().and_then(|at| {
                if bounding.is_held {
                    let supports = bounding.of_pairs[k].as_ref()?;
                    return traffic.predict_by(
                        (view, seen),
                        at,
                        body,
                        sizes[body],
                        shared,
                        supports,
                    );
                }
                let found = traffic.predict(view, seen, at, body, sizes[body], shared);
                bounding.of_pairs.push(found.map(|(_, supports)| supports));
                found.map(|(predicted, _)| predicted)
            });
            if !bounding.is_held && bounding.of_pairs.len() <= k {
                bounding.of_pairs.push(None);
            }
            let look = footings[seen].as_ref().map_or(pair.look, |at| at[0].look);
            let r = pair.white * traffic.residual(seen, &look, predicted, shared);
            out.extend([r.x, r.y]);
        }
    }

    /// How many pairs count.
    pub fn pairs(&self) -> usize {
        self.pairs.len()
    }

    /// Derivatives of the residuals with respect to what boxes share, two rows a pair.
    pub fn shared_rows(&self) -> impl Iterator<Item = [[f64; SHARED]; 2]> + '_ {
        self.pairs.iter().map(|pair| {
            let [w, l, h] = pair.by_size;
            let (car, other) = if ALL[pair.body].car { (1.0, 0.0) } else { (0.0, 1.0) };
            let mut columns = [Vector2::zeros(); SHARED];
            let sizes_and_drawing = [
                -w,
                -l * car,
                -h * car,
                Vector2::new(-1.0, 0.0),
                Vector2::new(0.0, -1.0),
                Vector2::new(-pair.excess, 0.0),
                Vector2::new(0.0, -pair.excess),
                -l * other,
                -h * other,
                -l * pair.toward,
                -l * (1.0 - pair.toward),
            ];
            columns[..OUTLINE].copy_from_slice(&sizes_and_drawing);
            for (j, look) in pair.look.into_iter().enumerate() {
                columns[OUTLINE + j] = Vector2::new(-look, 0.0);
                columns[OUTLINE + LOOKS + j] = Vector2::new(0.0, -look);
            }
            let white = columns.map(|c| pair.white * c);
            [white.map(|c| c.x), white.map(|c| c.y)]
        })
    }

    /// Median misfit of the widths of cars at a camera, as a logarithm: how much too near it
    /// stands.
    pub fn width_excess(
        traffic: &Traffic,
        view: &View,
        lanes: &[Option<Middle>],
        shared: &Shared,
    ) -> Option<f64> {
        let footings = traffic.footings(view, lanes);
        let mut all: Vec<f64> = (0..traffic.seen.len())
            .filter_map(|k| {
                let at = footings[k].as_ref()?;
                let (p, _) = traffic.predict(view, k, at, 0, log_size(0, shared), shared)?;
                Some(traffic.seen[k].log_size[0] - p[0])
            })
            .filter(|e| e.is_finite())
            .collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() * 7 / 20).copied()
    }
}

/// Noise of one box as one body: sizes of single vehicles, headings, and the box's edges.
fn noise(
    traffic: &Traffic,
    view: &View,
    k: usize,
    at: &[Footing; 2],
    body: usize,
    shared: &Shared,
) -> Option<Noise> {
    let size = log_size(body, shared);
    let (base, supports) = traffic.predict(view, k, at, body, size, shared)?;
    let base = Vector2::from(base);
    let near = |view: &View, at: &[Footing; 2], size: [f64; 3]| {
        traffic.predict_by((view, k), at, body, size, shared, &supports).map(Vector2::from)
    };
    let mut covariance = Matrix2::zeros();
    let mut by_size = [Vector2::zeros(); 3];
    for axis in 0..3 {
        let mut other = size;
        other[axis] += 0.02;
        let moved = near(view, at, other)?;
        by_size[axis] = (moved - base) / 0.02;
        let one = by_size[axis] * ALL[body].scatter[axis];
        covariance += one * one.transpose();
    }
    let (sine, cosine) = HEADING_SD.sin_cos();
    let turned = at.map(|a| Footing {
        away: Vector2::new(
            cosine * a.away.x - sine * a.away.y,
            sine * a.away.x + cosine * a.away.y,
        ),
        ..a
    });
    let turn = near(view, &turned, size)? - base;
    covariance += turn * turn.transpose();
    let [width, height] = traffic.seen[k].log_size.map(f64::exp);
    let edge = |px: f64| (traffic.edge_px.powi(2) + 0.5 * (EDGE_REL_SD * px).powi(2)).sqrt();
    // The lower edge moves the vehicle too, hence both residuals.
    let (vertical, horizontal) = (edge(height), edge(width));
    let lower = {
        let below = view.ground(traffic.seen[k].foot + Vector2::new(0.0, 1.0))?;
        let moved = at.map(|a| Footing { ground: below, ..a });
        let by_foot = near(view, &moved, size)? - base;
        Vector2::new(0.0, 1.0 / height) - by_foot
    };
    covariance += lower * lower.transpose() * vertical.powi(2);
    covariance[(1, 1)] += (vertical / height).powi(2);
    covariance[(0, 0)] += 2.0 * (horizontal / width).powi(2);
    let inverse = covariance.try_inverse()?;
    let log_determinant = covariance.determinant().ln();
    log_determinant.is_finite().then_some(Noise { inverse, log_determinant, by_size })
}
