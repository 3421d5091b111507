//! Vehicles of a queue that others hide: estimated from the road that cannot be seen.
//!
//! Owns the estimate. Knows boxes that count and where they stand in their lanes, not pictures;
//! [`crate::density`] uses the estimate.
//!
//! Every detector misses a vehicle that cannot be seen: behind a lorry or a van in a queue
//! the next vehicle shows a strip of its roof or nothing. Distance sampling has two cures for it
//! (Buckland, Rexstad, Marques and Oedekoven, "Distance Sampling: Methods and Applications", 2015):
//! density is vehicles over the road that was seen, and what is known of the animals' spacing fills the
//! rest. Here the second one: road behind a vehicle is empty in free flow, where drivers keep their
//! distance, so that a ratio of lengths would add vehicles that are not there, and in a queue it holds
//! vehicles at the queue's own spacing.
//!
//! Along a lane, from the camera on, the distance from one counted vehicle to the next, less what the
//! nearer one is longer than a car, is compared with the median `q` of such distances around it,
//! those of a queue ([`TIGHT_M`]) within [`REACH_M`]; fewer than [`LEAST_TIGHT`] of them are no queue. A
//! distance of `n + 1` times `q` has places for `n` more vehicles (the last one from `PLACE` on), and a
//! place counts where boxes that stand nearer hide at least [`COVERED`] of a car in it: where it shows
//! more, it would have been found. The four numbers were chosen on seven recordings of the simulated
//! street (seeds 601 to 606, 608); where every vehicle is found they add 2 to 4 veh/km to a queue of 110.

use crate::evidence::{CarSize, PixelBox};
use crate::lane::{Description, Place};
use crate::units::{ImagePoint, LaneId, MAX_LANES, VehicleClass};

/// Distance from one vehicle of a queue to the next, contact to contact, m: a car and the 2 m between
/// standing cars are 6.5 to 7; below the least two boxes are one vehicle.
pub const TIGHT_M: core::ops::RangeInclusive<f32> = 5.5..=10.0;
/// How far along the lane a queue is looked for, m.
pub const REACH_M: f32 = 60.0;
/// Fewest distances that make a queue.
pub const LEAST_TIGHT: usize = 3;
/// Part of a car that must be hidden in a place: of vehicles that show more, one in ten is missed.
pub const COVERED: f32 = 0.25;
/// Part of a place from which it is one.
const PLACE: f32 = 0.4;
/// One standard error of the number of hidden vehicles, as a part of it: over seven recordings of the
/// simulated street the estimate was 0.5 to 1.3 of what was missed (`models/README.md`, "Counts").
pub const HIDDEN_REL_ERR: f32 = 0.5;
/// Most vehicles of a lane that are looked at: more stand on no 600 m of it.
const MOST: usize = 96;
/// Pieces of a lane whose middles are known.
const PIECES: usize = 128;
/// Shortest piece, m.
const PIECE_M: f32 = 1.0;
/// Length of a car, m.
const CAR_M: f32 = VehicleClass::Car.nominal_length_m();
/// Height of a car's roof, in its sides: 1.45 m of the 2.35 m that are a side in a lane of 3.5 m.
const ROOF: f32 = 0.62;
/// Heights at which a car is looked at.
const HEIGHTS: usize = 10;
/// A box that ends so much lower, in sides of a car, stands nearer.
const NEARER: f32 = 0.15;

/// A vehicle that counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Its box, px of the lane table's picture.
    pub bounds: PixelBox,
    /// Kind of vehicle.
    pub class: VehicleClass,
    /// Where it meets the road; `None` outside the lanes.
    pub place: Option<Place>,
}

/// The middle of a lane in the picture.
#[derive(Clone, Debug)]
struct Line {
    lane: LaneId,
    length_m: f32,
    piece_m: f32,
    /// Whether `s` grows towards the camera.
    toward: bool,
    /// The middle of each piece by rising `s`; `None` where the picture shows none of it.
    middles: heapless::Vec<Option<ImagePoint>, PIECES>,
}

impl Line {
    /// Distance along the lane from its end at the camera, m.
    fn distance(&self, s_m: f32) -> f32 {
        if self.toward { self.length_m - s_m } else { s_m }
    }

    /// The middle of the lane that far from the camera.
    fn middle(&self, distance_m: f32) -> Option<ImagePoint> {
        let s_m = self.distance(distance_m);
        let last = self.middles.len().saturating_sub(1);
        let piece = ((s_m / self.piece_m).max(0.0) as usize).min(last);
        self.middles.get(piece).copied().flatten()
    }
}

/// The lanes of a table as a camera sees them.
#[derive(Clone, Debug)]
pub struct Queues {
    lines: heapless::Vec<Line, MAX_LANES>,
    car: CarSize,
    /// Columns of the table's picture.
    width: f32,
}

/// One vehicle of a lane.
#[derive(Clone, Copy, Debug)]
struct Standing {
    distance_m: f32,
    /// Its length beyond a car's.
    longer_m: f32,
}

impl Queues {
    /// For a table that `description` describes, with cars of that size; `place` is its look-up.
    pub fn new(
        description: &Description,
        place: impl Fn(ImagePoint) -> Option<Place>,
        car: CarSize,
    ) -> Self {
        let size = description.image_size;
        let mut lines = heapless::Vec::new();
        for lane in &description.lanes {
            let piece_m = (lane.length_m / PIECES as f32).max(PIECE_M);
            let count = (libm::ceilf(lane.length_m / piece_m) as usize).clamp(1, PIECES);
            let mut sums = [(0.0f32, 0.0f32, 0.0f32); PIECES];
            for v in 0..size.height {
                for u in 0..size.width {
                    let point = ImagePoint { u: f32::from(u) + 0.5, v: f32::from(v) + 0.5 };
                    let Some(at) = place(point).filter(|at| at.lane == lane.id) else { continue };
                    let piece = ((at.s_m / piece_m) as usize).min(count - 1);
                    if let Some(sum) = sums.get_mut(piece) {
                        *sum = (sum.0 + point.u, sum.1 + point.v, sum.2 + 1.0);
                    }
                }
            }
            let middle =
                |&(u, v, n): &(f32, f32, f32)| (n > 0.0).then(|| ImagePoint { u: u / n, v: v / n });
            let middles: heapless::Vec<_, PIECES> = sums.iter().take(count).map(middle).collect();
            let mut shown = middles.iter().flatten();
            let first = shown.next().map_or(0.0, |point| point.v);
            let toward = shown.next_back().map_or(first, |point| point.v) > first;
            let line = Line { lane: lane.id, length_m: lane.length_m, piece_m, toward, middles };
            // As many places as lanes: there is always room.
            let _ = lines.push(line);
        }
        Self { lines, car, width: f32::from(size.width) }
    }

    /// Calls `hidden` with lane and distance from its upstream end, m, of each vehicle that is likely
    /// to stand there, hidden by those that were `seen`. Costs the product of the places and `seen`.
    pub fn estimate(&self, seen: &[Seen], mut hidden: impl FnMut(LaneId, f32)) {
        for line in &self.lines {
            let mut standing: heapless::Vec<Standing, MOST> = seen
                .iter()
                .filter_map(|seen| {
                    Some((seen.class, seen.place.filter(|at| at.lane == line.lane)?))
                })
                .take(MOST)
                .map(|(class, at)| Standing {
                    distance_m: line.distance(at.s_m),
                    longer_m: longer_than_a_car(class),
                })
                .collect();
            standing.sort_unstable_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
            for (number, pair) in standing.windows(2).enumerate() {
                let [near, far] = pair else { continue };
                let Some(spacing_m) = spacing_around(&standing, number) else { continue };
                let rest_m = far.distance_m - near.distance_m - near.longer_m;
                let places = libm::floorf(rest_m / spacing_m - PLACE);
                for place in 1..=(places.clamp(0.0, MOST as f32) as usize) {
                    let part = place as f32 / (places + 1.0);
                    let distance_m = near.distance_m + near.longer_m + rest_m * part;
                    if self.covered(line, distance_m, seen) >= COVERED {
                        hidden(line.lane, line.distance(distance_m));
                    }
                }
            }
        }
    }

    /// The part of a car at that distance that nearer boxes hide, 0 to 1.
    fn covered(&self, line: &Line, distance_m: f32, seen: &[Seen]) -> f32 {
        let ends = [distance_m, distance_m + CAR_M].map(|m| line.middle(m));
        let [Some(near), Some(far)] = ends else { return 0.0 };
        let car = |at| self.car.at(at, self.width);
        // From where it meets the road to the far edge of its roof.
        let up = far.v - ROOF * car(far) - near.v;
        let nearer = near.v + NEARER * car(near);
        let is_covered = |height: usize| {
            let part = (height as f32 + 0.5) / HEIGHTS as f32;
            let (u, v) = (near.u + part * (far.u - near.u), near.v + part * up);
            seen.iter().any(|Seen { bounds, .. }| {
                let PixelBox { x0, y0, x1, y1 } = *bounds;
                y1 > nearer && x0 < u && u < x1 && y0 < v && v < y1
            })
        };
        (0..HEIGHTS).filter(|&height| is_covered(height)).count() as f32 / HEIGHTS as f32
    }
}

fn longer_than_a_car(class: VehicleClass) -> f32 {
    (class.nominal_length_m() - VehicleClass::Car.nominal_length_m()).max(0.0)
}

/// The median distance of the queue around the pair of that number, itself left out; `None` where
/// there is no queue.
fn spacing_around(standing: &[Standing], number: usize) -> Option<f32> {
    let pair = |pair: &[Standing]| match pair {
        [near, far] => {
            let apart = far.distance_m - near.distance_m;
            (near.distance_m + apart / 2.0, apart - near.longer_m)
        }
        _ => (f32::INFINITY, 0.0),
    };
    let (middle, _) = standing.windows(2).nth(number).map(pair)?;
    let mut tight: heapless::Vec<f32, MOST> = standing
        .windows(2)
        .map(pair)
        .enumerate()
        .filter(|&(other, (at, _))| other != number && (at - middle).abs() < REACH_M)
        .map(|(_, (_, apart))| apart)
        .filter(|apart| TIGHT_M.contains(apart))
        .collect();
    if tight.len() < LEAST_TIGHT {
        return None;
    }
    tight.sort_unstable_by(f32::total_cmp);
    let half = tight.len() / 2;
    let upper = tight.get(half).copied()?;
    let lower = tight.get(half.checked_sub(1)?).copied()?;
    Some(if tight.len().is_multiple_of(2) { (lower + upper) / 2.0 } else { upper })
}

#[cfg(test)]
mod tests;
