//! Residuals of traffic: the boxes of a detector against the bodies that they may show.
//!
//! Owns the mixture over bodies, the noise of a box, what all boxes of a camera share (the
//! fleet's mean size, the detector's way to draw), and the choice of boxes. Single boxes of
//! many vehicles, no tracks. Does not own the minimisation (see `solve`).

use super::bodies::{ALL, BODIES, class_index};
use super::cues::{BoxCue, LaneCue};
use super::hull::{Footing, log_box};
use super::lanes::{MIDDLE, OnRoad};
use super::view::View;
use crate::road::lane_table::contains;
use nalgebra::{Matrix2, SVector, Vector2};
use verge::units::Direction;

/// Unknowns that no picture shows, with their standard deviations: logarithms of the fleet's
/// mean width, length and height of cars; how the detector draws width and height, and how
/// both change with size (an e-fold); length and height of other bodies; hulls seen from the
/// front and from behind.
pub const SHARED_SD: [f64; SHARED] =
    [0.015, 0.055, 0.02, 0.03, 0.04, 0.03, 0.04, 0.08, 0.08, 0.03, 0.03];
/// How many they are.
pub const SHARED: usize = 11;
/// The unknowns as one vector.
pub type Shared = SVector<f64, SHARED>;

/// Smallest box that is used, px.
const MIN_BOX_PX: [f64; 2] = [9.0, 8.0];
/// A box nearer to the picture's border than this may be cut off, px.
const BORDER_PX: f64 = 2.5;
/// Part of a box below which its middle lower point is looked for in the lanes.
const FOOT_FRACTION: f64 = 0.12;
/// Most boxes that are used: they share their errors, so that more tell little.
pub const MAX_BOXES: usize = 120;
/// Boxes by which the starts are told apart.
pub const START_BOXES: usize = 36;
/// A body whose prior for a box is below this part of the likeliest body's is left out.
const NEGLIGIBLE: f64 = 0.02;
/// So many boxes' worth of evidence is the most that a camera's boxes give.
const EVIDENCE: f64 = 40.0;
/// Standard deviation of a box's edge: a part of its size.
const EDGE_REL_SD: f64 = 0.025;
/// Scatter of headings about the lane's, rad.
const HEADING_SD: f64 = 2.5 * std::f64::consts::PI / 180.0;
/// Part of the boxes that are no whole vehicle.
const OUTLIERS: f64 = 0.06;
/// A body with a smaller probability for a box is left out of a step.
const LEAST: f64 = 0.02;
/// The bodies' shares before any box is seen are worth so many boxes.
const SHARE_WORTH: f64 = 25.0;
/// The assumed scatter is worth so many boxes.
const SCATTER_WORTH: f64 = 20.0;
/// A residual beyond this tells no more, as a logarithm.
const MOST: f64 = 3.0;
/// Length by which a vehicle's middle is found for the lane's direction, m.
const USUAL_LENGTH_M: f64 = 4.5;

/// One box that is used.
#[derive(Clone, Debug)]
pub struct Seen {
    /// Logarithms of its width and height, px.
    log_size: [f64; 2],
    /// Middle of its lower edge, px.
    foot: Vector2<f64>,
    /// Index of its lane.
    lane: usize,
    /// Whether its lane comes towards the camera; one half where nobody knows.
    toward: f64,
    /// Logarithm of the probability of the detector's class for each body.
    log_class: [f64; BODIES],
    /// Its logarithm of width against the median, by which drawing errors change.
    excess: f64,
}

/// The boxes of a camera, chosen.
#[derive(Clone, Debug)]
pub struct Traffic {
    /// The boxes.
    pub seen: Vec<Seen>,
    edge_px: f64,
    min_car_px: f64,
}

impl Traffic {
    /// The boxes that are whole, large enough, not hidden below by a nearer one and inside a
    /// lane; spread over the picture where there are too many.
    pub fn choose(boxes: &[BoxCue], lanes: &[LaneCue], image_size: [u32; 2]) -> Self {
        let width = f64::from(image_size[0]);
        let outlines: Vec<Vec<Vector2<f64>>> = lanes
            .iter()
            .map(|l| l.right.iter().chain(l.left.iter().rev()).copied().collect())
            .collect();
        let mut seen: Vec<Seen> = whole(boxes, image_size)
            .into_iter()
            .filter_map(|b| {
                let [x0, y0, x1, y1] = b.corners;
                let foot = Vector2::new(0.5 * (x0 + x1), y1);
                let inside = Vector2::new(foot.x, y1 - FOOT_FRACTION * (y1 - y0));
                let lane = outlines.iter().position(|o| contains(o, inside))?;
                let toward = match lanes[lane].direction {
                    Direction::Toward => 1.0,
                    Direction::Away => 0.0,
                    Direction::Unknown => 0.5,
                };
                let of_body =
                    |k: usize| b.class.map_or(0.0, |c| ALL[k].seen_as[class_index(c)].ln());
                Some(Seen {
                    log_size: [(x1 - x0).ln(), (y1 - y0).ln()],
                    foot,
                    lane,
                    toward,
                    log_class: likely(std::array::from_fn(of_body)),
                    excess: 0.0,
                })
            })
            .collect();
        spread(&mut seen, MAX_BOXES);
        let mut widths: Vec<f64> = seen.iter().map(|s| s.log_size[0]).collect();
        widths.sort_by(f64::total_cmp);
        let median = widths.get(widths.len() / 2).copied().unwrap_or(0.0);
        seen.iter_mut().for_each(|s| s.excess = s.log_size[0] - median);
        Traffic {
            seen,
            edge_px: if width < 500.0 { 0.6 } else { 0.9 },
            min_car_px: 10.0 * (width / 320.0).sqrt(),
        }
    }

    /// A part of the boxes, for the starts.
    pub fn some(&self) -> Self {
        let mut seen = self.seen.clone();
        spread(&mut seen, START_BOXES);
        Traffic { seen, ..*self }
    }

    /// The middles of the lower edges, px.
    pub fn seen_feet(&self) -> impl Iterator<Item = Vector2<f64>> + '_ {
        self.seen.iter().map(|s| s.foot)
    }

    /// Where each box stands; `None` above the horizon or on a lane that is.
    fn footings(&self, view: &View, lanes: &[Option<OnRoad>]) -> Vec<Option<[Footing; 2]>> {
        let of = |seen: &Seen| {
            let middle = &lanes[seen.lane].as_ref()?.middle;
            let ground = view.ground(seen.foot)?;
            let mut away = direction(middle, ground);
            away = direction(middle, ground + away * (0.45 * USUAL_LENGTH_M));
            let one = |toward| Footing { ground, away, toward };
            Some([one(true), one(false)])
        };
        self.seen.iter().map(of).collect()
    }

    /// Prediction for one box as one body: the mean of both directions where nobody knows it.
    fn predict(
        &self,
        view: &View,
        k: usize,
        at: &[Footing; 2],
        body: usize,
        size: [f64; 3],
        shared: &Shared,
    ) -> Option<[f64; 2]> {
        let seen = &self.seen[k];
        let one = |toward: usize| {
            let mut size = size;
            size[1] += shared[9 + toward];
            log_box(view, &at[toward], &ALL[body], size)
        };
        if seen.toward == 1.0 {
            return one(0);
        }
        if seen.toward == 0.0 {
            return one(1);
        }
        let (a, b) = (one(0)?, one(1)?);
        Some([0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])])
    }

    /// What is observed less what is predicted, and held within what tells something.
    fn residual(&self, k: usize, predicted: Option<[f64; 2]>, shared: &Shared) -> Vector2<f64> {
        let seen = &self.seen[k];
        let Some(p) = predicted.filter(|p| p.iter().all(|x| x.is_finite())) else {
            return Vector2::repeat(MOST);
        };
        let drawn = [shared[3] + shared[5] * seen.excess, shared[4] + shared[6] * seen.excess];
        let one = |a: usize| (seen.log_size[a] - drawn[a] - p[a]).clamp(-MOST, MOST);
        Vector2::new(one(0), one(1))
    }
}

/// Logarithms of a body's size with what the fleet differs in.
fn log_size(body: usize, shared: &Shared) -> [f64; 3] {
    let [w, l, h] = ALL[body].size_m.map(f64::ln);
    if ALL[body].car {
        [w + shared[0], l + shared[1], h + shared[2]]
    } else {
        [w + shared[0], l + shared[7], h + shared[8]]
    }
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
}

impl Mixture {
    /// Nothing known but the shares, with the noise at a camera.
    pub fn new(traffic: &Traffic, view: &View, lanes: &[Option<OnRoad>], shared: &Shared) -> Self {
        let total: f64 = ALL.iter().map(|b| b.share).sum();
        let mut mixture = Mixture {
            noise: Vec::new(),
            active: Vec::new(),
            log_share: std::array::from_fn(|k| (ALL[k].share / total).ln()),
            scatter: 1.0,
            weight: 1.0,
            pairs: Vec::new(),
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
        lanes: &[Option<OnRoad>],
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
                car_px.push(car.map_or(0.0, |p| p[0].exp()));
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
        lanes: &[Option<OnRoad>],
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
        for k in (0..traffic.seen.len()).filter(|&k| self.active[k]) {
            let Some(at) = &footings[k] else { continue };
            let mut row = [(f64::NEG_INFINITY, 0.0); BODIES];
            for body in 0..BODIES {
                let Some(noise) = &self.noise[k][body] else { continue };
                let predicted = traffic.predict(view, k, at, body, sizes[body], shared);
                let r = traffic.residual(k, predicted, shared);
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
                if gamma > LEAST
                    && let Some(noise) = &self.noise[k][body]
                    && let Some(factor) = noise.inverse.cholesky()
                {
                    let white = factor.l().transpose();
                    let Seen { excess, toward, .. } = traffic.seen[k];
                    let by_size = noise.by_size;
                    let pair = Pair { seen: k, body, white, by_size, excess, toward };
                    weighed.push((pair, gamma));
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
        self.weight * total
    }

    /// Whitened residuals of the pairs that count.
    pub fn residuals(
        &self,
        traffic: &Traffic,
        view: &View,
        lanes: &[Option<OnRoad>],
        shared: &Shared,
        out: &mut Vec<f64>,
    ) {
        let footings = traffic.footings(view, lanes);
        let sizes: [[f64; 3]; BODIES] = std::array::from_fn(|b| log_size(b, shared));
        for pair in &self.pairs {
            let at = &footings[pair.seen];
            let predicted = at.as_ref().and_then(|at| {
                traffic.predict(view, pair.seen, at, pair.body, sizes[pair.body], shared)
            });
            let r = pair.white * traffic.residual(pair.seen, predicted, shared);
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
            let columns: [Vector2<f64>; SHARED] = [
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
            let white = columns.map(|c| pair.white * c);
            [white.map(|c| c.x), white.map(|c| c.y)]
        })
    }

    /// Median misfit of the widths of cars at a camera, as a logarithm: how much too near it
    /// stands.
    pub fn width_excess(
        traffic: &Traffic,
        view: &View,
        lanes: &[Option<OnRoad>],
        shared: &Shared,
    ) -> Option<f64> {
        let footings = traffic.footings(view, lanes);
        let mut all: Vec<f64> = (0..traffic.seen.len())
            .filter_map(|k| {
                let at = footings[k].as_ref()?;
                let p = traffic.predict(view, k, at, 0, log_size(0, shared), shared)?;
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
    let base = Vector2::from(traffic.predict(view, k, at, body, size, shared)?);
    let mut covariance = Matrix2::zeros();
    let mut by_size = [Vector2::zeros(); 3];
    for axis in 0..3 {
        let mut other = size;
        other[axis] += 0.02;
        let moved = Vector2::from(traffic.predict(view, k, at, body, other, shared)?);
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
    let turn = Vector2::from(traffic.predict(view, k, &turned, body, size, shared)?) - base;
    covariance += turn * turn.transpose();
    let [width, height] = traffic.seen[k].log_size.map(f64::exp);
    let edge = |px: f64| (traffic.edge_px.powi(2) + 0.5 * (EDGE_REL_SD * px).powi(2)).sqrt();
    // The lower edge moves the vehicle too, hence both residuals.
    let (vertical, horizontal) = (edge(height), edge(width));
    let lower = {
        let below = view.ground(traffic.seen[k].foot + Vector2::new(0.0, 1.0))?;
        let moved = at.map(|a| Footing { ground: below, ..a });
        let by_foot = Vector2::from(traffic.predict(view, k, &moved, body, size, shared)?) - base;
        Vector2::new(0.0, 1.0 / height) - by_foot
    };
    covariance += lower * lower.transpose() * vertical.powi(2);
    covariance[(1, 1)] += (vertical / height).powi(2);
    covariance[(0, 0)] += 2.0 * (horizontal / width).powi(2);
    let inverse = covariance.try_inverse()?;
    let log_determinant = covariance.determinant().ln();
    log_determinant.is_finite().then_some(Noise { inverse, log_determinant, by_size })
}

/// The bodies that a box may be by its class, the others at minus infinity.
fn likely(log_class: [f64; BODIES]) -> [f64; BODIES] {
    let prior = |k: usize| log_class[k] + ALL[k].share.ln();
    let top = (0..BODIES).map(prior).fold(f64::NEG_INFINITY, f64::max);
    std::array::from_fn(|k| {
        if prior(k) < top + NEGLIGIBLE.ln() { f64::NEG_INFINITY } else { log_class[k] }
    })
}

/// Direction of a lane near a place: its edges, the nearest most.
fn direction(middle: &[Vector2<f64>; MIDDLE], at: Vector2<f64>) -> Vector2<f64> {
    let mut sum = Vector2::zeros();
    for w in middle.windows(2) {
        let edge = w[1] - w[0];
        let length = edge.norm() + 1e-9;
        let away = ((w[0] + w[1]) * 0.5 - at).norm_squared();
        sum += edge * (1.0 / (length * (away * away + length.powi(4) / 16.0 + 1e-4)));
    }
    sum.try_normalize(1e-12).unwrap_or(Vector2::y())
}

/// Boxes that are whole in the picture, large enough and not hidden below by a nearer one.
fn whole(boxes: &[BoxCue], image_size: [u32; 2]) -> Vec<&BoxCue> {
    let [width, height] = image_size.map(f64::from);
    let mut by_frame: std::collections::BTreeMap<usize, Vec<&BoxCue>> = Default::default();
    for b in boxes {
        by_frame.entry(b.frame).or_default().push(b);
    }
    let mut kept = Vec::new();
    for frame in by_frame.values() {
        for (i, b) in frame.iter().enumerate() {
            let [x0, y0, x1, y1] = b.corners;
            let (w, h) = (x1 - x0, y1 - y0);
            let inside = x0 > BORDER_PX
                && y0 > BORDER_PX
                && x1 < width - BORDER_PX
                && y1 < height - BORDER_PX;
            let hidden = frame.iter().enumerate().any(|(j, other)| {
                let [u0, v0, u1, v1] = other.corners;
                let overlap = x1.min(u1) - x0.max(u0);
                i != j && v1 > y1 && overlap > 0.12 * w && v0 < y1 - 0.03 * h
            });
            if inside && w >= MIN_BOX_PX[0] && h >= MIN_BOX_PX[1] && !hidden {
                kept.push(*b);
            }
        }
    }
    kept
}

/// Leaves so many boxes, evenly over the picture's rows.
fn spread(seen: &mut Vec<Seen>, most: usize) {
    if seen.len() <= most {
        return;
    }
    seen.sort_by(|a, b| a.foot.y.total_cmp(&b.foot.y).then(a.foot.x.total_cmp(&b.foot.x)));
    let n = seen.len();
    let chosen = (0..most).map(|k| seen[k * n / most].clone()).collect();
    *seen = chosen;
}
