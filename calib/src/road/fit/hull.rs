//! The box that a body on the road would show.
//!
//! Owns projecting a hull, standing it where a box's lower edge says, and which of its points bound
//! the box. Does not own which bodies there are (see `bodies`) nor what is done with the misfit
//! (see `traffic`).

use super::bodies::Body;
use super::view::View;
use nalgebra::{Vector2, Vector3};

/// Where the middle of the lower edge lies on the body, as a part of the length: the first
/// guess of the move.
const FOOT: f64 = 0.42;

/// Where a vehicle's box touches the road, and which way its lane runs there.
#[derive(Clone, Copy, Debug)]
pub struct Footing {
    /// The road point below the middle of the box's lower edge, m.
    pub ground: Vector2<f64>,
    /// Direction of the lane away from the camera, a unit vector.
    pub away: Vector2<f64>,
    /// Whether it comes towards the camera.
    pub toward: bool,
    /// From where it is seen.
    pub look: Look,
}

/// How many functions of the side that is seen the error of an outline has.
pub const LOOKS: usize = 4;
/// Values of these functions for one vehicle, see [`look`].
pub type Look = [f64; LOOKS];

/// Below this angle to its heading a vehicle is seen from the front or the rear alone, rad.
const HEAD_ON: f64 = 0.1;
/// An angle at which a vehicle's side takes as much of the box as its front, rad.
const OBLIQUE: f64 = 0.3;
/// A usual angle of a look down at a road, rad.
const USUAL_STEEPNESS: f64 = 0.22;

/// From where a vehicle on the road is seen: head-on (1 to 0), obliquely (from 0), how steeply (in
/// factors of two) and from which end (-1 to 1). Between these the error of an outline is smooth.
pub fn look(height: f64, ground: Vector2<f64>, away: Vector2<f64>, toward: f64) -> Look {
    let aside = ground.perp(&away).atan2(ground.dot(&away)).abs();
    let steepness = (height / ground.norm().max(1e-3)).atan();
    [
        (1.0 - aside / HEAD_ON).max(0.0),
        (aside / OBLIQUE).min(1.5),
        (steepness / USUAL_STEEPNESS).log2().clamp(-2.0, 2.0),
        2.0 * toward - 1.0,
    ]
}

/// The points of a hull that bound its box: left, right, top and low. Near a camera for which they
/// were found they stay the same, so that derivatives need no others.
type Bounding = [usize; 4];

/// The bounding points where the hull stands at first, and where it was moved to.
#[derive(Clone, Copy, Debug)]
pub struct Support {
    first: Bounding,
    moved: Bounding,
}

/// A body of one size on the road.
struct Standing<'a> {
    view: &'a View,
    body: &'a Body,
    /// Width, length, height, m.
    size: [f64; 3],
    towards_rear: Vector2<f64>,
    across: Vector2<f64>,
}

impl Standing<'_> {
    fn project(&self, middle: Vector2<f64>, index: usize) -> Vector2<f64> {
        let [width, length, height] = self.size;
        let [along, half, up] = self.body.points[index / 2];
        let aside = if index.is_multiple_of(2) { 0.5 } else { -0.5 } * half * width;
        let along = (along - 0.5) * length;
        let x = middle.x + self.towards_rear.x * along + self.across.x * aside;
        let y = middle.y + self.towards_rear.y * along + self.across.y * aside;
        self.view.project(Vector3::new(x, y, up * height))
    }

    /// Left, right, top and low of all points, px, and which they are.
    fn bounds(&self, middle: Vector2<f64>) -> ([f64; 4], Bounding) {
        let mut edge = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
        let mut bounding = [0; 4];
        for index in 0..2 * self.body.points.len() {
            let uv = self.project(middle, index);
            let further = [uv.x < edge[0], uv.x > edge[1], uv.y < edge[2], uv.y > edge[3]];
            for (k, value) in [uv.x, uv.x, uv.y, uv.y].into_iter().enumerate() {
                if further[k] {
                    (edge[k], bounding[k]) = (value, index);
                }
            }
        }
        (edge, bounding)
    }

    /// The same of points that are known to bound it.
    fn bounds_by(&self, middle: Vector2<f64>, bounding: &Bounding) -> [f64; 4] {
        let [left, right, top, low] = bounding.map(|index| self.project(middle, index));
        [left.x, right.x, top.y, low.y]
    }

    /// Moves the hull so that its lower edge meets the footing: what is left after one move is
    /// below 0.1 px for a car.
    fn onto(&self, footing: &Footing, middle: Vector2<f64>, at: &[f64; 4]) -> Option<Vector2<f64>> {
        let foot = self.view.ground(Vector2::new(0.5 * (at[0] + at[1]), at[3]))?;
        Some(middle + footing.ground - foot)
    }
}

fn standing<'a>(
    view: &'a View,
    footing: &Footing,
    body: &'a Body,
    log_size: [f64; 3],
) -> (Standing<'a>, Vector2<f64>) {
    let size = log_size.map(f64::exp);
    let towards_rear = if footing.toward { footing.away } else { -footing.away };
    let across = Vector2::new(towards_rear.y, -towards_rear.x);
    let middle = footing.ground + footing.away * (FOOT * size[1]);
    (Standing { view, body, size, towards_rear, across }, middle)
}

fn log_of([left, right, top, low]: [f64; 4]) -> [f64; 2] {
    [(right - left).ln(), (low - top).max(1e-3).ln()]
}

/// Logarithms of the width and the height (px) of the box of a body with these logarithms of
/// width, length and height (m), standing so that the middle of its box's lower edge is the
/// footing; and the points that bound it. `None` above the horizon.
pub fn log_box(
    view: &View,
    footing: &Footing,
    body: &Body,
    log_size: [f64; 3],
) -> Option<([f64; 2], Support)> {
    let (standing, middle) = standing(view, footing, body, log_size);
    let (edges, first) = standing.bounds(middle);
    let (edges, moved) = standing.bounds(standing.onto(footing, middle, &edges)?);
    Some((log_of(edges), Support { first, moved }))
}

/// The same for a camera or a size close to that for which the bounding points were found.
pub fn log_box_by(
    view: &View,
    footing: &Footing,
    body: &Body,
    log_size: [f64; 3],
    support: &Support,
) -> Option<[f64; 2]> {
    let (standing, middle) = standing(view, footing, body, log_size);
    let edges = standing.bounds_by(middle, &support.first);
    let moved = standing.onto(footing, middle, &edges)?;
    Some(log_of(standing.bounds_by(moved, &support.moved)))
}
