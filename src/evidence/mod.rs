//! Choice of the boxes that are vehicles, by one score: the net's own, the class, the size that a
//! vehicle has at that place, and the boxes beside it.
//!
//! Owns the score and the choice among overlapping boxes. Does not own its weights, which were
//! fitted to one net (its sidecar has them), nor who asks. Knows boxes, not pictures.
//!
//! A box's evidence is the logarithm of the odds that it is a vehicle that no better box has, as
//! logistic regression has it (`detector/README.md`, "Evidence"):
//!
//! ```text
//! evidence = bias + score * ln(s / (1 - s)) + car_px * ln(c / 32) + class
//!          + size * r + size_squared * r^2 + small * max(-r - 0.3, 0)^2       its size
//!          + inside * o + inside_squared * o^2 + overlap * u                  the box that it
//!          + beside * o * d + apart * o * |f| + behind * o * max(-f, 0)       lies in most
//!          + empty * l                                                        the empty road
//!          + chain * q + chain_inside * q * o                                 the queue around
//! ```
//!
//! `s` is the net's score; `c` the side of a car at the place, px of the net's input; `r` the
//! logarithm of the box's side over a car's; `o` and `u` the intersection with the better box
//! over the smaller and over the union; `d` how far their middles lie apart and `f` how far lower
//! the box ends, in sides of a car; `l` its likeness to the empty road
//! ([`crate::scene::EmptyRoad`]); `q` the better boxes that stand before and behind it as in a queue,
//! up to [`QUEUE`] of them, as a part of so many: vehicles in a queue hide each other, and what shows
//! of them looks like less than a vehicle. Boxes are taken by falling evidence of their own, so that a
//! box over two places comes behind the two boxes that fit their places, and gives way to them.

mod boxes;
mod size;

pub use boxes::{Detection, PixelBox};
pub use size::{CarSize, LEAST_SAMPLES};

use crate::units::VehicleClass;
use serde::Deserialize;

/// Side of a car in the net's input at which its weight is 0, px.
const CAR_PX: f32 = 32.0;
/// Logits are held between minus and plus this.
const LOGIT: f32 = 3.0;
/// Logarithms of sizes are held between minus and plus this.
const SIZES: f32 = 1.5;
/// Below this logarithm of its size a car's box is small.
const SMALL: f32 = -0.3;
/// Vehicles around a box that make the fullest queue.
pub const QUEUE: usize = 6;
/// How far before or behind a box they stand. On a flat road the distance along the camera's axis
/// is the focal length times a car's width over its side in the picture; with a focal length of
/// about a picture's width this is 12 m.
const QUEUE_REACH: f32 = 7.0;
/// How far to the side, in sides of a car.
const QUEUE_BESIDE: f32 = 1.5;
/// A box that overlaps the other by so much (over the smaller) is a part of it, or it of that one.
const QUEUE_INSIDE: f32 = 0.6;

/// The weights of a group of classes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClassWeights {
    /// Of the class itself.
    pub class: f32,
    /// Of the logarithm of the size, and of its square.
    pub size: f32,
    /// See `size`.
    pub size_squared: f32,
    /// Of the square of what is missing to a small box's size.
    pub small: f32,
}

/// The weights of a net's evidence.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Evidence {
    /// Least score of the net that is looked at, 0 to 1.
    pub floor: f32,
    /// Boxes that overlap a better one by more than this (IoU) are the same box twice.
    pub same: f32,
    /// Least probability that a box which counts is a vehicle, 0 to 1.
    pub least: f32,
    /// The odds without anything else.
    pub bias: f32,
    /// Of the net's score.
    pub score: f32,
    /// Of the side of a car in the net's input.
    pub car_px: f32,
    /// Of cars and vans, and of vehicles of unknown kind.
    pub car: ClassWeights,
    /// Of buses and lorries.
    pub large: ClassWeights,
    /// Of motorcycles.
    pub motorcycle: ClassWeights,
    /// Of the part that lies in a better box, and of its square.
    pub inside: f32,
    /// See `inside`.
    pub inside_squared: f32,
    /// Of the overlap with it (IoU).
    pub overlap: f32,
    /// Of standing beside it.
    pub beside: f32,
    /// Of ending above or below it.
    pub apart: f32,
    /// Of ending above it.
    pub behind: f32,
    /// Of the likeness to the empty road.
    pub empty: f32,
    /// Of the queue around it.
    #[serde(default)]
    pub chain: f32,
    /// Of the queue around a box that lies in a better one.
    #[serde(default)]
    pub chain_inside: f32,
}

/// The size of cars in a picture, for [`Evidence::select`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expected {
    /// Side of a car by place.
    pub size: CarSize,
    /// Columns of the picture, px.
    pub width: f32,
    /// Pixels of the net's input a pixel of the picture.
    pub input_px: f32,
}

impl Expected {
    /// Side of a car where `bounds` meets the road, px of the picture.
    fn car(&self, bounds: &PixelBox) -> f32 {
        self.size.at(bounds.contact(), self.width)
    }

    /// Whether one of two boxes stands before or behind the other as vehicles in a queue do.
    fn in_one_queue(&self, one: &PixelBox, other: &PixelBox) -> bool {
        let (a, b) = (self.car(one), self.car(other));
        let apart = (self.width / a - self.width / b).abs();
        let beside = (one.contact().u - other.contact().u).abs() * 2.0 / (a + b);
        apart < QUEUE_REACH && beside < QUEUE_BESIDE
    }
}

impl Evidence {
    /// Evidence of a box by itself; `likeness` is that to the empty road.
    fn alone(&self, box_: &Detection, expected: Option<&Expected>, likeness: f32) -> f32 {
        let Detection { bounds, score, class } = box_;
        let odds = *score / (1.0 - *score).max(1e-6);
        let logit = libm::logf(odds.max(1e-6)).clamp(-LOGIT, LOGIT);
        let side = bounds.side();
        let (size, car_px) = expected.map_or((0.0, 0.0), |expected| {
            let car = expected.car(bounds);
            let ln = |ratio: f32| libm::logf(ratio).clamp(-SIZES, SIZES);
            (ln(side / car), ln(car * expected.input_px / CAR_PX))
        });
        let weights = match class {
            VehicleClass::Vehicle | VehicleClass::Car | VehicleClass::Van => &self.car,
            VehicleClass::Bus | VehicleClass::Truck => &self.large,
            VehicleClass::Motorcycle => &self.motorcycle,
        };
        let small = (SMALL - size).max(0.0);
        self.bias
            + self.score * logit
            + self.car_px * car_px
            + weights.class
            + weights.size * size
            + weights.size_squared * size * size
            + weights.small * small * small
            + self.empty * likeness
    }

    /// Evidence from the boxes that were `kept` before: the one it lies in most, and the queue.
    fn beside(
        &self,
        bounds: &PixelBox,
        kept: &[Detection],
        expected: Option<&Expected>,
        car: impl Fn(&PixelBox) -> f32,
    ) -> f32 {
        let mut most: Option<(f32, &PixelBox)> = None;
        let mut queue = 0;
        for other in kept {
            let inside = other.bounds.ios(bounds);
            if inside > most.map_or(0.0, |(inside, _)| inside) {
                most = Some((inside, &other.bounds));
            }
            let stands = |expected: &Expected| expected.in_one_queue(bounds, &other.bounds);
            if inside < QUEUE_INSIDE && expected.is_some_and(stands) {
                queue += 1;
            }
        }
        let queue = queue.min(QUEUE) as f32 / QUEUE as f32;
        let Some((inside, other)) = most else { return self.chain * queue };
        let car = car(bounds).max(car(other));
        let beside = ((bounds.contact().u - other.contact().u).abs() / car).min(SIZES);
        let lower = (bounds.y1 - other.y1) / car;
        self.inside * inside
            + self.inside_squared * inside * inside
            + self.overlap * other.iou(bounds)
            + self.beside * inside * beside
            + self.apart * inside * lower.abs().min(SIZES)
            + self.behind * inside * (-lower).max(0.0)
            + self.chain * queue
            + self.chain_inside * queue * inside
    }

    /// Sorts `boxes` so that the vehicles come first, best first, each with the probability that
    /// it is one as its score, and returns how many there are: those of at least `least`. Scores
    /// come in as the net's; `likeness` is that of a box to the empty road, 0 to 1. Costs the product
    /// of the boxes and the vehicles.
    pub fn select(
        &self,
        boxes: &mut [Detection],
        expected: Option<&Expected>,
        likeness: impl Fn(&PixelBox) -> f32,
        least: f32,
    ) -> usize {
        for box_ in &mut *boxes {
            box_.score = self.alone(box_, expected, likeness(&box_.bounds));
        }
        boxes.sort_unstable_by(Detection::best_first);
        let threshold = logit(least);
        let car = |bounds: &PixelBox| {
            expected.map_or_else(|| bounds.side(), |expected| expected.car(bounds))
        };
        let mut count = 0;
        for at in 0..boxes.len() {
            let Some((kept, [candidate, ..])) = boxes.split_at_mut_checked(at) else { break };
            let kept = kept.get(..count).unwrap_or(&[]);
            let evidence = candidate.score + self.beside(&candidate.bounds, kept, expected, car);
            if evidence >= threshold {
                candidate.score = evidence;
                boxes.swap(count, at);
                count += 1;
            }
        }
        let vehicles = boxes.get_mut(..count).unwrap_or(&mut []);
        for vehicle in &mut *vehicles {
            vehicle.score = 1.0 / (1.0 + libm::expf(-vehicle.score));
        }
        vehicles.sort_unstable_by(Detection::best_first);
        count
    }
}

/// Logarithm of the odds of a probability.
fn logit(p: f32) -> f32 {
    libm::logf(p.max(1e-6) / (1.0 - p).max(1e-6))
}

#[cfg(test)]
mod tests;
