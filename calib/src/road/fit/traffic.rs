//! Traffic as a cue: the boxes of a detector, and what each body would show in their place.
//!
//! Owns the choice of boxes, what all boxes of a camera share (the fleet's mean size, the
//! detector's way to draw) and the misfit of one. Single boxes of many vehicles, no tracks. Does not
//! own which body a box is (see `mixture`).

use super::bodies::{ALL, BODIES, class_index};
use super::cues::{BoxCue, LaneCue};
use super::hull::{Footing, LOOKS, Look, Support, log_box, log_box_by, look};
use super::lanes::Middle;
use super::view::View;
use crate::road::outline::contains;
use nalgebra::{SVector, Vector2};
use verge::units::Direction;

/// Unknowns that no picture shows, with their standard deviations: logarithms of the fleet's
/// mean width, length and height of cars; how the detector draws width and height, and how
/// both change with size (an e-fold); length and height of other bodies; hulls seen from the
/// front and from behind; widths, then heights, by the side that is seen (see [`Look`]).
pub const SHARED_SD: [f64; SHARED] = {
    let sizes_and_drawing = [0.015, 0.055, 0.02, 0.03, 0.04, 0.03, 0.04, 0.08, 0.08, 0.03, 0.03];
    let mut sd = [OUTLINE_SD; SHARED];
    sd.split_at_mut(OUTLINE).0.copy_from_slice(&sizes_and_drawing);
    sd
};
/// How far a hull's box is off against the same hull's box from another side. The boxes of the made
/// street, with true cameras, were 0.035 narrower head-on and 0.03 wider obliquely than our hulls of
/// the same fleet. All boxes of a camera that show one side share it.
const OUTLINE_SD: f64 = 0.02;
/// Where the outlines' errors are among the shared unknowns: of widths, then of heights.
pub const OUTLINE: usize = 11;
/// How many they are.
pub const SHARED: usize = OUTLINE + 2 * LOOKS;
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
/// A residual beyond this tells no more, as a logarithm.
const MOST: f64 = 3.0;
/// Length by which a vehicle's middle is found for the lane's direction, m.
const USUAL_LENGTH_M: f64 = 4.5;

/// The points that bound a body, coming and going.
pub type Supports = [Support; 2];

/// One box that is used.
#[derive(Clone, Debug)]
pub struct Seen {
    /// Logarithms of its width and height, px.
    pub log_size: [f64; 2],
    /// Middle of its lower edge, px.
    pub foot: Vector2<f64>,
    /// Index of its lane.
    lane: usize,
    /// Whether its lane comes towards the camera; one half where nobody knows.
    pub toward: f64,
    /// Logarithm of the probability of the detector's class for each body.
    pub log_class: [f64; BODIES],
    /// Its logarithm of width against the median, by which drawing errors change.
    pub excess: f64,
}

/// The boxes of a camera, chosen.
#[derive(Clone, Debug)]
pub struct Traffic {
    /// The boxes.
    pub seen: Vec<Seen>,
    /// How well a box's edges are drawn, px, beside a part of its size.
    pub edge_px: f64,
    /// Width of a car, px, from which on boxes count.
    pub min_car_px: f64,
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
    pub fn footings(&self, view: &View, lanes: &[Option<Middle>]) -> Vec<Option<[Footing; 2]>> {
        let of = |seen: &Seen| {
            let middle = lanes[seen.lane].as_ref()?;
            let ground = view.ground(seen.foot)?;
            let first = middle.direction(ground);
            let away = middle.direction(ground + first * (0.45 * USUAL_LENGTH_M));
            let look = look(view.height_m(), ground, away, seen.toward);
            let one = |toward| Footing { ground, away, toward, look };
            Some([one(true), one(false)])
        };
        self.seen.iter().map(of).collect()
    }

    /// Prediction for one box as one body: the mean of both directions where nobody knows it; with
    /// the points that bound the body in either direction.
    pub fn predict(
        &self,
        view: &View,
        k: usize,
        at: &[Footing; 2],
        body: usize,
        size: [f64; 3],
        shared: &Shared,
    ) -> Option<([f64; 2], Supports)> {
        let mut supports: [Option<Support>; 2] = [None; 2];
        let predicted = self.either(k, size, shared, |toward, size| {
            let (predicted, support) = log_box(view, &at[toward], &ALL[body], size)?;
            supports[toward] = Some(support);
            Some(predicted)
        })?;
        let [a, b] = supports;
        Some((predicted, [a.or(b)?, b.or(a)?]))
    }

    /// The same close to where the bounding points were found.
    pub fn predict_by(
        &self,
        (view, k): (&View, usize),
        at: &[Footing; 2],
        body: usize,
        size: [f64; 3],
        shared: &Shared,
        supports: &Supports,
    ) -> Option<[f64; 2]> {
        self.either(k, size, shared, |toward, size| {
            log_box_by(view, &at[toward], &ALL[body], size, &supports[toward])
        })
    }

    fn either(
        &self,
        k: usize,
        size: [f64; 3],
        shared: &Shared,
        mut one: impl FnMut(usize, [f64; 3]) -> Option<[f64; 2]>,
    ) -> Option<[f64; 2]> {
        let mut as_seen = |toward: usize| {
            let [w, l, h] = size;
            one(toward, [w, l + shared[9 + toward], h])
        };
        match self.seen[k].toward {
            1.0 => as_seen(0),
            0.0 => as_seen(1),
            _ => {
                let (a, b) = (as_seen(0)?, as_seen(1)?);
                Some([0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])])
            }
        }
    }

    /// What is observed less what is predicted, and held within what tells something.
    pub fn residual(
        &self,
        k: usize,
        look: &Look,
        predicted: Option<[f64; 2]>,
        shared: &Shared,
    ) -> Vector2<f64> {
        let seen = &self.seen[k];
        let Some(p) = predicted.filter(|p| p.iter().all(|x| x.is_finite())) else {
            return Vector2::repeat(MOST);
        };
        let outline = |a: usize| -> f64 {
            let first = OUTLINE + a * LOOKS;
            look.iter().enumerate().map(|(j, l)| shared[first + j] * l).sum()
        };
        let drawn = [0, 1].map(|a| shared[3 + a] + shared[5 + a] * seen.excess + outline(a));
        let one = |a: usize| (seen.log_size[a] - drawn[a] - p[a]).clamp(-MOST, MOST);
        Vector2::new(one(0), one(1))
    }
}

/// Logarithms of a body's size with what the fleet differs in.
pub fn log_size(body: usize, shared: &Shared) -> [f64; 3] {
    let [w, l, h] = ALL[body].size_m.map(f64::ln);
    if ALL[body].car {
        [w + shared[0], l + shared[1], h + shared[2]]
    } else {
        [w + shared[0], l + shared[7], h + shared[8]]
    }
}

/// The bodies that a box may be by its class, the others at minus infinity.
fn likely(log_class: [f64; BODIES]) -> [f64; BODIES] {
    let prior = |k: usize| log_class[k] + ALL[k].share.ln();
    let top = (0..BODIES).map(prior).fold(f64::NEG_INFINITY, f64::max);
    std::array::from_fn(|k| {
        if prior(k) < top + NEGLIGIBLE.ln() { f64::NEG_INFINITY } else { log_class[k] }
    })
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
