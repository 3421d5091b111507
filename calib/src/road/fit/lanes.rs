//! Residuals of lane lines: the width of a lane is constant along it.
//!
//! Owns the lanes on the road (smooth curves through drawn points), their widths and how
//! drawing errors become errors of widths: each point its own, and a part that all points of
//! a line share. Does not own lanes of a table (see `road::lane_axis`).

use super::cues::{LaneCue, TRACE_PX, TRACE_SHARED_PX};
use super::view::View;
use nalgebra::{DMatrix, DVector, Vector2};

/// Points of a lane's middle by which vehicles find their direction.
pub const MIDDLE: usize = 24;
/// Pieces of a smooth curve between two drawn points.
const PIECES: usize = 5;
/// Nothing painted keeps a width better, m.
const PAINT_SD_M: f64 = 0.05;
/// Standard deviation of a lane's growth in width from end to end, m.
const TAPER_SD_M: f64 = 0.10;
/// The mean width is left to the width's own prior: its variance here, m^2.
const OPEN_M2: f64 = 1e4;
/// Length along a line, as a part of it, over which what drawing shares keeps its side.
const SHARED_REACH: f64 = 0.5;
/// Weight of a place where one px across is more than any lane, m.
const LOST_M: f64 = 50.0;

/// One lane on the road.
#[derive(Clone, Debug)]
pub struct OnRoad {
    right: Vec<Vector2<f64>>,
    /// The left line as a smooth curve.
    left: Vec<Vector2<f64>>,
    /// Width at each point of the right line, m; below 0 where that point lies beyond the
    /// ends of the left line.
    pub widths: Vec<f64>,
}

impl OnRoad {
    /// `None` where a point lies above the horizon.
    pub fn of(lane: &LaneCue, view: &View) -> Option<Self> {
        let ground = |line: &[Vector2<f64>]| -> Option<Vec<Vector2<f64>>> {
            line.iter().map(|&p| view.ground(p)).collect()
        };
        let right = ground(&lane.right)?;
        let left = smooth(&ground(&lane.left)?);
        let widths = right.iter().map(|&p| distance(p, &left)).collect();
        Some(OnRoad { right, left, widths })
    }

    /// Its middle.
    pub fn middle(&self) -> Middle {
        let (a, b) = (resample(&self.left), resample(&smooth(&self.right)));
        let points = std::array::from_fn(|k| (a[k] + b[k]) * 0.5);
        let edges = std::array::from_fn(|k| {
            let [from, to]: [Vector2<f64>; 2] = [points[k], points[k + 1]];
            let length = (to - from).norm() + 1e-9;
            let (at, unit) = ((from + to) * 0.5, (to - from) / length);
            Edge { at: [at.x, at.y], unit: [unit.x, unit.y], reach: length.powi(4) / 16.0 + 1e-4 }
        });
        Middle { points, edges }
    }

    /// Mean width and the widths with those beyond the ends set to it, m.
    pub fn usable(&self) -> (f64, Vec<f64>) {
        let beside: Vec<f64> = self.widths.iter().copied().filter(|w| *w > 0.0).collect();
        let all: Vec<f64> = self.widths.iter().map(|w| w.abs()).collect();
        let chosen = if beside.len() < 2 { &all } else { &beside };
        let mean = chosen.iter().sum::<f64>() / chosen.len() as f64;
        if beside.len() < 2 {
            return (mean, all);
        }
        (mean, self.widths.iter().map(|w| if *w > 0.0 { *w } else { mean }).collect())
    }
}

/// The middle of a lane.
#[derive(Clone, Debug)]
pub struct Middle {
    /// Points near to far, m.
    points: [Vector2<f64>; MIDDLE],
    edges: [Edge; MIDDLE - 1],
}

/// One edge of a middle.
#[derive(Clone, Copy, Debug)]
struct Edge {
    at: [f64; 2],
    unit: [f64; 2],
    /// Within what distance it counts fully, to the fourth power.
    reach: f64,
}

impl Middle {
    /// Its length, m.
    pub fn length_m(&self) -> f64 {
        self.points.windows(2).map(|w| (w[1] - w[0]).norm()).sum()
    }

    /// Near, middle and far places with the lane's direction there. The ends are drawn in by a
    /// twentieth, so that a stretch about them stays on the lane.
    pub fn places(&self) -> [(Vector2<f64>, Vector2<f64>); 3] {
        [1, MIDDLE / 2, MIDDLE - 2].map(|k| {
            let along = self.points[k + 1] - self.points[k - 1];
            (self.points[k], along.try_normalize(1e-9).unwrap_or(Vector2::y()))
        })
    }

    /// The lane's direction near a place: that of its edges, the nearest most.
    pub fn direction(&self, near: Vector2<f64>) -> Vector2<f64> {
        let (mut x, mut y) = (0.0, 0.0);
        for edge in &self.edges {
            let (dx, dy) = (edge.at[0] - near.x, edge.at[1] - near.y);
            let away = dx * dx + dy * dy;
            let weight = 1.0 / (away * away + edge.reach);
            x += edge.unit[0] * weight;
            y += edge.unit[1] * weight;
        }
        Vector2::new(x, y).try_normalize(1e-12).unwrap_or(Vector2::y())
    }
}

/// What whitens a lane's widths, and the width at which it was made.
#[derive(Clone, Debug)]
pub struct Held {
    white: DMatrix<f64>,
    width_m: f64,
}

/// The noise of a lane's widths at a camera.
pub fn hold(lane: &LaneCue, view: &View) -> Option<Held> {
    let on_road = OnRoad::of(lane, view)?;
    let n = lane.right.len();
    let right = across_m(&lane.right, view)?;
    let left = across_m(&lane.left, view)?;
    let left: Vec<f64> = (0..n).map(|k| at(&left, k as f64 / (n - 1).max(1) as f64)).collect();
    let along = fractions(&lane.right, view)?;
    let covariance = DMatrix::from_fn(n, n, |i, j| {
        let near = (-((along[i] - along[j]) / SHARED_REACH).abs()).exp();
        let shared = TRACE_SHARED_PX.powi(2) * near * (right[i] * right[j] + left[i] * left[j]);
        let taper = TAPER_SD_M.powi(2) * (along[i] - 0.5) * (along[j] - 0.5);
        let own = if i == j {
            TRACE_PX.powi(2) * (right[i].powi(2) + left[i].powi(2)) + PAINT_SD_M.powi(2)
        } else {
            0.0
        };
        own + shared + taper + OPEN_M2
    });
    let white = covariance.cholesky()?.l().try_inverse()?;
    Some(Held { white, width_m: on_road.usable().0 })
}

impl Held {
    /// Whitened residuals of a lane's widths: as parts of their mean, so that a smaller world
    /// does not look like a better one.
    pub fn residuals(&self, on_road: &OnRoad) -> (DVector<f64>, f64) {
        let (mean, widths) = on_road.usable();
        let parts = widths.iter().map(|w| self.width_m * (w / mean - 1.0));
        (&self.white * DVector::from_iterator(widths.len(), parts), mean)
    }
}

/// Metres across the lane that one px is worth at each point of a line.
fn across_m(line: &[Vector2<f64>], view: &View) -> Option<Vec<f64>> {
    let ground: Vec<_> = line.iter().map(|&p| view.ground(p)).collect::<Option<_>>()?;
    let last = ground.len() - 1;
    let one = |k: usize| {
        let along = ground[(k + 1).min(last)] - ground[k.saturating_sub(1)];
        let normal = Vector2::new(along.y, -along.x).try_normalize(1e-9).unwrap_or(Vector2::x());
        view.metres_per_px(line[k], ground[k], normal).unwrap_or(LOST_M).min(LOST_M)
    };
    Some((0..=last).map(one).collect())
}

/// Place of each point along its line, from 0 to 1.
fn fractions(line: &[Vector2<f64>], view: &View) -> Option<Vec<f64>> {
    let ground: Vec<_> = line.iter().map(|&p| view.ground(p)).collect::<Option<_>>()?;
    let mut along = vec![0.0];
    for w in ground.windows(2) {
        along.push(along[along.len() - 1] + (w[1] - w[0]).norm());
    }
    let total = along[along.len() - 1].max(1e-9);
    Some(along.into_iter().map(|s| s / total).collect())
}

/// The value of a sequence at a fraction of its length.
fn at(values: &[f64], fraction: f64) -> f64 {
    let x = fraction * (values.len() - 1) as f64;
    let k = (x as usize).min(values.len().saturating_sub(2));
    let next = values.get(k + 1).copied().unwrap_or(values[k]);
    values[k] + (next - values[k]) * (x - k as f64)
}

/// A smooth curve through a line's points (Catmull-Rom): points are joined on the road, not
/// in the picture, where a chord across a bend cuts decimetres.
pub fn smooth(line: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    let n = line.len();
    if n < 3 {
        return line.to_vec();
    }
    let mut curve = Vec::with_capacity((n - 1) * PIECES + 1);
    for k in 0..n - 1 {
        let (b, c) = (line[k], line[k + 1]);
        let a = if k > 0 { line[k - 1] } else { b * 2.0 - c };
        let d = if k + 2 < n { line[k + 2] } else { c * 2.0 - b };
        // By coordinates: with vectors a development build spends its time in checks.
        let of = |[a, b, c, d]: [f64; 4]| {
            [2.0 * b, c - a, 2.0 * a - 5.0 * b + 4.0 * c - d, 3.0 * b - a - 3.0 * c + d]
        };
        let (x, y) = (of([a.x, b.x, c.x, d.x]), of([a.y, b.y, c.y, d.y]));
        for piece in 0..PIECES {
            let t = piece as f64 / PIECES as f64;
            let at = |p: [f64; 4]| 0.5 * (p[0] + t * (p[1] + t * (p[2] + t * p[3])));
            curve.push(Vector2::new(at(x), at(y)));
        }
    }
    curve.push(line[n - 1]);
    curve
}

/// Points evenly along a line.
fn resample(line: &[Vector2<f64>]) -> [Vector2<f64>; MIDDLE] {
    let mut along = Vec::with_capacity(line.len());
    let mut sum = 0.0;
    along.push(0.0);
    for w in line.windows(2) {
        sum += (w[1] - w[0]).norm();
        along.push(sum);
    }
    let mut k = 0;
    std::array::from_fn(|i| {
        let s = sum * i as f64 / (MIDDLE - 1) as f64;
        while k + 2 < line.len() && along[k + 1] < s {
            k += 1;
        }
        let length = along[k + 1] - along[k];
        let t = if length > 1e-12 { ((s - along[k]) / length).min(1.0) } else { 0.0 };
        line[k].lerp(&line[k + 1], t)
    })
}

/// Distance of a point from a line whose ends extend without limit; below 0 where the nearest place
/// lies more than a metre beyond an end.
fn distance(p: Vector2<f64>, line: &[Vector2<f64>]) -> f64 {
    let last = line.len() - 2;
    let mut best = (f64::INFINITY, 0.0, 0.0);
    let mut from = line[0];
    for (k, &to) in line[1..].iter().enumerate() {
        let (ex, ey) = (to.x - from.x, to.y - from.y);
        let squared = (ex * ex + ey * ey).max(1e-18);
        let mut t = ((p.x - from.x) * ex + (p.y - from.y) * ey) / squared;
        if k > 0 {
            t = t.max(0.0);
        }
        if k < last {
            t = t.min(1.0);
        }
        let (dx, dy) = (from.x + ex * t - p.x, from.y + ey * t - p.y);
        let away = dx * dx + dy * dy;
        if away < best.0 {
            best = (away, t, squared);
        }
        from = to;
    }
    let (away, t, length) = (best.0.sqrt(), best.1, best.2.sqrt());
    if t * length < -1.0 || (t - 1.0) * length > 1.0 { -away } else { away }
}
