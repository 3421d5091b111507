//! The geometry of drawn lanes, judged: what a lane would measure, and whether it can be one.
//!
//! Owns the numbers of each lane (width, length, resolution, size of a car, stated error) and
//! their limits. Does not own outlines (see `outline`) nor the table (see `lane_table`).

use super::drawn_lane::DrawnLane;
use super::lane_axis::PROBES;

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::length_error::UncertainCamera;
use crate::trust::MAX_REL_ERR;
use nalgebra::{Vector2, Vector3};
use std::fmt;
use verge::density::Division;
use verge::lane::Lane;
use verge::units::Direction;

/// Narrowest and widest mean width of a lane, m: a narrow urban lane that is drawn inside its
/// lines, and a wide one with its shoulder.
pub const WIDTH_RANGE_M: [f64; 2] = [1.8, 5.5];
/// Widest part of a lane against its narrowest: beyond it a lane covers two, or a taper.
pub const MAX_WIDENING: f64 = 1.6;
/// Most metres along the lane that one pixel may span: beyond it a car is two pixels long.
pub const MAX_SPAN_M: f64 = 2.5;
/// Fewest pixels that a car is wide at the far end.
pub const MIN_CAR_PX: f64 = 4.0;
/// Shortest lane that tells a density, m.
pub const MIN_LENGTH_M: f64 = 5.0;
/// A car as in `paper`'s models: width, length, height, m.
const CAR_M: [f64; 3] = [1.8, 4.6, 1.5];

/// What a drawn lane would measure.
#[derive(Clone, Debug, PartialEq)]
pub struct Geometry {
    /// Its number.
    pub lane: u8,
    /// Which way its traffic moves.
    pub direction: Direction,
    /// Length of its middle, m.
    pub length_m: f64,
    /// Width near the camera, m.
    pub near_width_m: f64,
    /// Width far from the camera, m.
    pub far_width_m: f64,
    /// Narrowest and widest width, ends left out, m.
    pub width_range_m: [f64; 2],
    /// Road length along the lane that one pixel spans at its far end, m.
    pub far_span_m: f64,
    /// Width and height of a car in the picture there, px.
    pub far_car_px: [f64; 2],
    /// Standard error of its length as a part of it, where the calibration states one.
    pub rel_err: Option<f64>,
    /// The same of each cell along it, from the upstream end.
    pub cell_rel_err: Vec<f64>,
}

/// One lane with the verdict on it.
#[derive(Clone, Debug)]
pub struct Judged {
    /// Its numbers.
    pub geometry: Geometry,
    /// Why it cannot be used; `None` where it can.
    pub problem: Option<String>,
}

/// Judges every lane. `known` is the calibration's covariance, `cell_length_m` about how long
/// the cells of the table will be.
pub fn judge_lanes(
    lanes: &[DrawnLane],
    camera: &Camera,
    known: Option<&UncertainCamera>,
    cell_length_m: f32,
) -> Vec<Judged> {
    lanes
        .iter()
        .map(|lane| {
            let geometry = measure(lane, camera, known, cell_length_m);
            let problem = problem(&geometry, lane.widens);
            Judged { geometry, problem }
        })
        .collect()
}

/// The first lane that cannot be used, as an error.
pub fn require(judged: &[Judged]) -> Result<()> {
    match judged.iter().find_map(|j| Some((j.geometry.lane, j.problem.clone()?))) {
        None => Ok(()),
        Some((lane, problem)) => Err(Error::Lane { lane: lane.to_string(), problem }),
    }
}

fn measure(
    lane: &DrawnLane,
    camera: &Camera,
    known: Option<&UncertainCamera>,
    cell_length_m: f32,
) -> Geometry {
    let axis = &lane.axis;
    let length_m = axis.length_m();
    let widths = axis.widths_m();
    // The centre line runs downstream: a lane towards the camera begins at its far end.
    let far_first = lane.direction == Direction::Toward;
    let (near_width_m, far_width_m) = {
        let (upstream, downstream) = (widths[1], widths[PROBES - 2]);
        if far_first { (downstream, upstream) } else { (upstream, downstream) }
    };
    // Ends may be cut askew.
    let inner = &widths[2..PROBES - 2];
    let narrowest = inner.iter().copied().fold(f64::INFINITY, f64::min);
    let widest = inner.iter().copied().fold(0.0, f64::max);
    let (far, along) = axis.at(if far_first { 0.0 } else { length_m });
    let far_span_m = super::lane_axis::LaneAxis::span_m(camera, far, along);
    let described = Lane { id: lane.id, direction: lane.direction, length_m: length_m as f32 };
    let cells = Division::of(&described, cell_length_m).count();
    let place = |k: usize| axis.at(length_m * k as f64 / cells as f64).0;
    let error = |a: usize, b: usize| Some(known?.between(place(a), place(b))?.rel_sd);
    let cell_rel_err: Option<Vec<f64>> = (0..cells).map(|k| error(k, k + 1)).collect();
    Geometry {
        lane: lane.id.get(),
        direction: lane.direction,
        length_m,
        near_width_m,
        far_width_m,
        width_range_m: [narrowest, widest],
        far_span_m,
        far_car_px: car_px(camera, far, along),
        rel_err: error(0, cells),
        cell_rel_err: cell_rel_err.unwrap_or_default(),
    }
}

/// Size of a car's box in the picture where it stands on the road, px.
fn car_px(camera: &Camera, at: Vector2<f64>, along: Vector2<f64>) -> [f64; 2] {
    let across = Vector2::new(along.y, -along.x);
    let [width, length, height] = CAR_M;
    let (mut low, mut high) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
    for corner in 0..8 {
        let side =
            |bit: i32, size: f64| if corner >> bit & 1 == 0 { -0.5 * size } else { 0.5 * size };
        let p = at + across * side(0, width) + along * side(1, length);
        let z = if corner >> 2 & 1 == 0 { 0.0 } else { height };
        if let Some(uv) = camera.project(&Vector3::new(p.x, p.y, z)) {
            low = low.inf(&uv);
            high = high.sup(&uv);
        }
    }
    (high - low).into()
}

fn problem(g: &Geometry, widens: bool) -> Option<String> {
    let [narrowest, widest] = g.width_range_m;
    // An uncertain scale must not refuse a lane for its width.
    let doubt = 1.0 + 2.0 * g.rel_err.unwrap_or(0.0);
    let [least, most] = WIDTH_RANGE_M;
    if g.length_m < MIN_LENGTH_M {
        return Some(format!(
            "it would be {:.1} m long, at least {MIN_LENGTH_M} m are needed; draw more of it",
            g.length_m
        ));
    }
    if g.far_span_m > MAX_SPAN_M {
        return Some(format!(
            "1 px is {:.1} m along the road at its far end (limit {MAX_SPAN_M} m); end it nearer",
            g.far_span_m
        ));
    }
    if g.far_car_px[0] < MIN_CAR_PX {
        return Some(format!(
            "a car is {:.1} px wide at its far end (limit {MIN_CAR_PX} px); end it nearer",
            g.far_car_px[0]
        ));
    }
    if !widens && widest > MAX_WIDENING * narrowest {
        return Some(format!(
            "it is {narrowest:.1} m wide at one place and {widest:.1} m at another: it covers two \
             lanes in part, or a taper; end it there, or set the flag widens if the road does so"
        ));
    }
    if !widens && widest > most * doubt {
        return Some(format!(
            "it is {widest:.1} m wide (limit {most} m): it covers two lanes; draw each by itself"
        ));
    }
    if let Some(e) = g.rel_err.filter(|e| *e > MAX_REL_ERR) {
        return Some(format!(
            "its length is known to {:.0} % only (limit {:.0} %); end it nearer, or calibrate with \
             a known length at its far end",
            100.0 * e,
            100.0 * MAX_REL_ERR
        ));
    }
    (widest < least / doubt).then(|| {
        format!("it is {widest:.1} m wide (limit {least} m); draw it along the lane's lines")
    })
}

impl fmt::Display for Geometry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let direction = match self.direction {
            Direction::Toward => "toward",
            Direction::Away => "away",
            Direction::Unknown => "no direction",
        };
        write!(
            f,
            "lane {} ({direction}): {:.1} m long, {:.1} m wide near and {:.1} m far; at the far \
             end 1 px is {:.2} m along the road, a car is {:.0} x {:.0} px",
            self.lane,
            self.length_m,
            self.near_width_m,
            self.far_width_m,
            self.far_span_m,
            self.far_car_px[0],
            self.far_car_px[1],
        )?;
        match self.rel_err {
            Some(e) => write!(f, "; length +- {:.1} % ({:.1} m)", 100.0 * e, e * self.length_m),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::road::lane_axis::LaneAxis;
    use crate::road::lane_axis::tests::{camera, picture};
    use verge::units::LaneId;
    use verge_desk::Exit;

    fn lane(ground: &[[f64; 2]], widens: bool) -> DrawnLane {
        let camera = camera();
        let polygon = picture(&camera, ground);
        let direction = Direction::Toward;
        let axis = LaneAxis::of_polygon("1", &polygon, direction, &camera).unwrap();
        DrawnLane { id: LaneId::new(1).unwrap(), direction, widens, polygon, axis }
    }

    fn verdict(ground: &[[f64; 2]], widens: bool) -> Judged {
        judge_lanes(&[lane(ground, widens)], &camera(), None, 10.0).remove(0)
    }

    #[test]
    fn an_ordinary_lane_is_measured() {
        let judged = verdict(&[[-1.6, 25.0], [1.6, 25.0], [1.6, 75.0], [-1.6, 75.0]], false);
        assert_eq!(judged.problem, None);
        let g = judged.geometry;
        assert!((g.length_m - 50.0).abs() < 1e-6 && (g.near_width_m - 3.2).abs() < 1e-6);
        // (Y^2 + h^2) / (f h) m a pixel on the axis, less towards the picture's upper edge.
        assert!((g.far_span_m - 1.37).abs() < 0.08, "{g}");
        // 1.8 m at the car's near end, 73 m away.
        assert!((g.far_car_px[0] - 1.8 * 350.0 / 72.5).abs() < 0.2, "{g}");
        require(&[verdict(&[[-1.6, 25.0], [1.6, 25.0], [1.6, 75.0], [-1.6, 75.0]], false)])
            .unwrap();
    }

    #[test]
    fn lanes_that_cannot_be_are_refused_with_their_numbers() {
        let two = [[-3.2, 25.0], [3.2, 25.0], [3.2, 75.0], [-3.2, 75.0]];
        let part = [[-1.6, 25.0], [1.6, 25.0], [1.6, 45.0], [5.0, 47.0], [5.0, 75.0], [-1.6, 75.0]];
        let far = [[-1.6, 25.0], [1.6, 25.0], [1.6, 130.0], [-1.6, 130.0]];
        let strip = [[-0.5, 25.0], [0.5, 25.0], [0.5, 75.0], [-0.5, 75.0]];
        let short = [[-1.6, 25.0], [1.6, 25.0], [1.6, 28.0], [-1.6, 28.0]];
        for (ground, expected) in [
            (&two[..], "6.4 m wide (limit 5.5 m): it covers two lanes"),
            (&part[..], "it covers two lanes in part"),
            (&far[..], "1 px is 3.8 m along the road"),
            (&strip[..], "1.0 m wide (limit 1.8 m)"),
            (&short[..], "m long, at least 5 m are needed"),
        ] {
            let problem = verdict(ground, false).problem.unwrap();
            assert!(problem.contains(expected), "{problem}");
        }
        assert_eq!(verdict(&part, true).problem, None);
        assert_eq!(require(&[verdict(&two, false)]).unwrap_err().exit_code(), 65);
    }
}
