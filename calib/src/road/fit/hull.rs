//! The box that a body on the road would show.
//!
//! Owns projecting a hull and standing it where a box's lower edge says. Does not own which
//! bodies there are (see `bodies`) nor what is done with the misfit (see `traffic`).

use super::bodies::Body;
use super::view::View;
use nalgebra::{Vector2, Vector3};

/// Times that the hull is moved so that its lower edge meets the box's: what one leaves is
/// below 0.1 px for a car.
const MOVES: usize = 1;
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
}

/// Logarithms of the width and the height (px) of the box of a body with these logarithms of
/// width, length and height (m), standing so that the middle of its box's lower edge is the
/// footing. `None` above the horizon.
pub fn log_box(
    view: &View,
    footing: &Footing,
    body: &Body,
    log_size: [f64; 3],
) -> Option<[f64; 2]> {
    let [width, length, height] = log_size.map(f64::exp);
    let towards_rear = if footing.toward { footing.away } else { -footing.away };
    let across = Vector2::new(towards_rear.y, -towards_rear.x);
    let mut middle = footing.ground + footing.away * (FOOT * length);
    let mut moves = 0;
    loop {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for &[along, half, up] in body.points {
            let on_axis = middle + towards_rear * ((along - 0.5) * length);
            let aside = across * (0.5 * half * width);
            for p in [on_axis + aside, on_axis - aside] {
                let uv = view.project(Vector3::new(p.x, p.y, up * height));
                low = [low[0].min(uv.x), low[1].min(uv.y)];
                high = [high[0].max(uv.x), high[1].max(uv.y)];
            }
        }
        if moves == MOVES {
            return Some([(high[0] - low[0]).ln(), (high[1] - low[1]).max(1e-3).ln()]);
        }
        let foot = view.ground(Vector2::new(0.5 * (low[0] + high[0]), high[1]))?;
        middle += footing.ground - foot;
        moves += 1;
    }
}
