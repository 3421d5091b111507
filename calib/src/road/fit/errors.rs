//! The error of lengths that a fit states: along the road and across it, near, in the middle and far.
//!
//! Owns where errors are stated, and the judgement of those across the road. Does not own how a
//! covariance becomes the error of a length (see `length_error`) nor the limits (see `trust`).

use super::STRETCH_M;
use super::cues::{Cues, LaneCue};
use super::lanes::{Middle, OnRoad};
use super::problem::Problem;
use super::view::View;
use crate::files::stated::{StatedError, StatedErrors, StatedLane, StatedWidth};
use crate::length_error::{LengthError, UncertainCamera};
use nalgebra::{Vector2, Vector3};

/// Error of lengths at one distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaceErrors {
    /// Where, px.
    pub at: [f64; 2],
    /// Of a stretch along the road.
    pub along: LengthError,
    /// Of a stretch across it.
    pub across: LengthError,
}

/// Error of lengths where the cues are.
#[derive(Clone, Debug, PartialEq)]
pub struct RoadErrors {
    /// At the near end.
    pub near: PlaceErrors,
    /// In the middle.
    pub middle: PlaceErrors,
    /// At the far end.
    pub far: PlaceErrors,
    /// Of the whole stretch from near to far.
    pub whole: LengthError,
    /// Of the width of each lane, in the order of the cues.
    pub lanes: Vec<WidthErrors>,
}

/// Error of the width of a lane.
#[derive(Clone, Debug, PartialEq)]
pub struct WidthErrors {
    /// What the lane is called.
    pub name: String,
    /// Where (px) and the error of the width there: near, in the middle and far.
    pub places: [([f64; 2], LengthError); 3],
}

/// The worst error across the road.
#[derive(Clone, Debug, PartialEq)]
pub struct Across {
    /// Where, in words.
    pub place: String,
    /// The ends of the stretch, px.
    pub at: [f64; 2],
    /// Its standard error.
    pub error: LengthError,
}

/// The three distances in words.
pub const DISTANCES: [&str; 3] = ["near", "middle", "far"];

impl RoadErrors {
    /// Where a length across the road is known worst: of the lanes' widths, or without lanes of a
    /// stretch at the three distances.
    pub fn worst_across(&self) -> Across {
        let of_road = [self.near, self.middle, self.far].map(|p| (p.at, p.across));
        let named = |name: &str, places: &[([f64; 2], LengthError); 3]| {
            let of = |(distance, &(at, error)): (&str, &([f64; 2], LengthError))| {
                let place = format!("{name}, {distance}");
                Across { place, at, error }
            };
            DISTANCES.into_iter().zip(places).map(of).collect::<Vec<_>>()
        };
        let lanes: Vec<Across> =
            self.lanes.iter().flat_map(|lane| named(&lane.name, &lane.places)).collect();
        let all = if lanes.is_empty() { named("the road", &of_road) } else { lanes };
        let worse = |a: Across, b: Across| if b.error.rel_sd > a.error.rel_sd { b } else { a };
        all.into_iter().reduce(worse).expect("three distances")
    }

    /// As a calibration file states them.
    pub(super) fn stated(&self) -> StatedErrors {
        let one = |p: &PlaceErrors| StatedError {
            at: p.at,
            along: p.along.rel_sd,
            across: p.across.rel_sd,
        };
        let lane = |lane: &WidthErrors| {
            let width = |(at, e): ([f64; 2], LengthError)| StatedWidth {
                at,
                width_m: e.length_m,
                rel_err: e.rel_sd,
            };
            let [near, middle, far] = lane.places.map(width);
            StatedLane { name: lane.name.clone(), near, middle, far }
        };
        StatedErrors {
            stretch_m: STRETCH_M,
            near: one(&self.near),
            middle: one(&self.middle),
            far: one(&self.far),
            lanes: self.lanes.iter().map(lane).collect(),
        }
    }
}

/// Near, middle and far on the road with the direction of the road there, m.
type Places = [(Vector2<f64>, Vector2<f64>); 3];

/// The errors at a camera; `None` where the cues give no place below its horizon.
pub(super) fn of(
    known: &UncertainCamera,
    cues: &Cues,
    problem: &Problem<'_>,
    view: &View,
) -> Option<RoadErrors> {
    let places = places(cues, problem, view)?;
    let at = |&(p, along): &(Vector2<f64>, Vector2<f64>)| {
        let across = Vector2::new(along.y, -along.x);
        // A stretch at the end of what is seen may reach beyond the horizon's error.
        let of = |d: Vector2<f64>| stretch(known, p, d, STRETCH_M);
        let uv = known.camera.project(&Vector3::new(p.x, p.y, 0.0))?;
        Some(PlaceErrors { at: uv.into(), along: of(along)?, across: of(across)? })
    };
    let [near, middle, far] = &places;
    Some(RoadErrors {
        near: at(near)?,
        middle: at(middle)?,
        far: at(far)?,
        whole: known.between(near.0, far.0)?,
        lanes: cues.lanes.iter().filter_map(|lane| widths(known, lane, view)).collect(),
    })
}

fn stretch(
    known: &UncertainCamera,
    p: Vector2<f64>,
    along: Vector2<f64>,
    length_m: f64,
) -> Option<LengthError> {
    let half = along * (0.5 * length_m);
    known.between(p - half, p + half)
}

/// Error of the width of a lane.
fn widths(known: &UncertainCamera, lane: &LaneCue, view: &View) -> Option<WidthErrors> {
    let on_road = OnRoad::of(lane, view)?;
    let (mean, widths) = on_road.usable();
    let places = on_road.middle().places();
    let width_m = [*widths.first()?, mean, *widths.last()?];
    let of = |k: usize| {
        let (p, along) = places[k];
        let error = stretch(known, p, Vector2::new(along.y, -along.x), width_m[k])?;
        let uv = known.camera.project(&Vector3::new(p.x, p.y, 0.0))?;
        Some((uv.into(), error))
    };
    Some(WidthErrors { name: lane.name.clone(), places: [of(0)?, of(1)?, of(2)?] })
}

/// Where errors are stated: along the lanes, or where the lengths are.
fn places(cues: &Cues, problem: &Problem<'_>, view: &View) -> Option<Places> {
    let middle = |l: &LaneCue| Some(OnRoad::of(l, view)?.middle());
    let on_road: Vec<Middle> = cues.lanes.iter().filter_map(middle).collect();
    if let Some(longest) = on_road.iter().max_by(|a, b| a.length_m().total_cmp(&b.length_m())) {
        return Some(longest.places());
    }
    let mut points: Vec<Vector2<f64>> =
        cues.points().chain(problem.traffic().seen_feet()).collect();
    if points.is_empty() {
        // Labelled vehicles alone: the lower three quarters of the picture.
        points = lower_picture(view);
    }
    let mut ground: Vec<Vector2<f64>> = points.iter().filter_map(|&p| view.ground(p)).collect();
    ground.sort_by(|a, b| a.y.total_cmp(&b.y));
    let (first, last) = (*ground.first()?, *ground.last()?);
    let along = road_direction(cues, view);
    let middle = (first + last) * 0.5;
    Some([(first, along), (middle, along), (last, along)])
}

fn lower_picture(view: &View) -> Vec<Vector2<f64>> {
    let centre = view.centre();
    vec![Vector2::new(centre.x, centre.y), Vector2::new(centre.x, 1.8 * centre.y)]
}

/// The direction of most of the marked lengths that run away from the camera.
fn road_direction(cues: &Cues, view: &View) -> Vector2<f64> {
    let mut sum = Vector2::zeros();
    for mark in &cues.marks {
        for w in mark.points.windows(2) {
            if let (Some(a), Some(b)) = (view.ground(w[0]), view.ground(w[1])) {
                let d = if b.y < a.y { a - b } else { b - a };
                if d.y > d.x.abs() {
                    sum += d;
                }
            }
        }
    }
    sum.try_normalize(1e-9).unwrap_or(Vector2::y())
}
