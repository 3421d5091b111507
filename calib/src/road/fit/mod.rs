//! The road fit: a camera from what a road shows, without a labelled vehicle.
//!
//! Not in the paper. One robust fit of focal length, height, tilt, roll, distortion and crest
//! with stated priors; lengths on the road, lane lines, rectangles, a mast's height, boxes of
//! traffic and labelled vehicles are its cues, each with its own uncertainty, none of them
//! needed. What the cues leave open shows in the covariance, and the verdict is by that alone.
//!
//! ```
//! use mvcalib::road::fit::{Cues, MarkCue, fit};
//! use nalgebra::Vector2;
//! let mark = |name: &str, a: [f64; 2], b: [f64; 2], metres: f64| {
//!     MarkCue::measured(name, vec![Vector2::from(a), Vector2::from(b)], metres)
//! };
//! let cues = Cues {
//!     marks: vec![
//!         mark("dash near", [157.6, 158.8], [145.1, 181.7], 6.0),
//!         mark("dash far", [173.2, 129.8], [167.1, 141.0], 6.0),
//!     ],
//!     ..Cues::default()
//! };
//! let found = fit(&cues, [320, 240])?;
//! assert!(found.errors().far.along.rel_sd > found.errors().near.along.rel_sd);
//! # Ok::<(), mvcalib::Error>(())
//! ```
//!
//! Owns the cues' list, the result and what it states. Does not own files (see `files`) nor
//! the command line.

mod advice;
mod bodies;
mod cues;
mod doubt;
mod hull;
mod lanes;
mod marks;
mod mixture;
mod prior;
mod problem;
mod solve;
mod traffic;
mod view;

pub use cues::{
    BoxCue, Class, Cues, Labelled, LaneCue, MEASURED_REL_SD, MarkCue, READING_PX, RectangleCue,
};
pub use doubt::{Doubt, Others};
pub use traffic::MAX_BOXES;

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::files::calibration::Calibration;
use crate::files::stated::{StatedError, StatedErrors, Uncertainty};
use crate::road::length_error::{CameraCovariance, LengthError, UncertainCamera};
use crate::trust::{self, Reason, Trust};
use doubt::Fitted;
use lanes::{Middle, OnRoad};
use nalgebra::{Matrix6, Vector2, Vector3};
use problem::Problem;
use solve::Optimum;
use view::{CAMERA, DISTORTION, LOG_F, View, camera, k1};

/// The name of the method in calibration files.
pub const METHOD: &str = "road";
/// Length of the stretches whose error is stated near, in the middle and far, m: a car and
/// its gap in slow traffic.
pub const STRETCH_M: f64 = 6.0;
/// A mark whose typical residual is beyond this many of its standard deviations contradicts
/// the others: one in 16,000 would by chance.
pub const CONTRADICTION: f64 = 4.0;

/// What a fit found.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The camera and how well it is known.
    pub known: UncertainCamera,
    /// Each mark, in the order of the cues.
    pub marks: Vec<MarkResidual>,
    /// Each lane that is steady, in the order of the cues.
    pub lanes: Vec<LaneResidual>,
    /// Each rectangle, in the order of the cues.
    pub rectangles: Vec<RectangleResidual>,
    /// The marks that everything else contradicts, and the standards that nothing else checks.
    pub doubts: Vec<Doubt>,
    /// What the traffic says.
    pub traffic: Option<TrafficResidual>,
    /// The cost at the optimum: negative logarithm of the posterior but for a constant.
    pub cost: f64,
    /// Evaluations of the residuals.
    pub evaluations: usize,
    /// Whether it may be used.
    pub trust: Trust,
    errors: RoadErrors,
}

/// How a mark fits.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkResidual {
    /// What it is called.
    pub name: String,
    /// Known length of a segment, m.
    pub known_m: f64,
    /// Measured length of each segment, m.
    pub measured_m: Vec<f64>,
    /// Typical residual in its own standard deviations.
    pub in_sd: f64,
}

/// How a lane fits.
#[derive(Clone, Debug, PartialEq)]
pub struct LaneResidual {
    /// What it is called.
    pub name: String,
    /// Width at its near end, on average and at its far end, m.
    pub width_m: [f64; 3],
}

/// How a rectangle fits.
#[derive(Clone, Debug, PartialEq)]
pub struct RectangleResidual {
    /// What it is called.
    pub name: String,
    /// Mean length of its first side and the one opposite, and of the other two, m.
    pub sides_m: [f64; 2],
    /// The same as stated.
    pub known_m: Option<[f64; 2]>,
    /// Angle at its first corner, degrees.
    pub angle_deg: f64,
    /// Typical residual in its own standard deviations.
    pub in_sd: f64,
}

/// What the traffic says.
#[derive(Clone, Debug, PartialEq)]
pub struct TrafficResidual {
    /// Boxes that count.
    pub used: usize,
    /// Each body's name and its share of them.
    pub shares: Vec<(&'static str, f64)>,
    /// How much longer this camera makes the fleet's cars than fleets are, as a part, and the
    /// standard deviation of fleets: beyond two of these a length is wrong, not the fleet.
    pub car_length: [f64; 2],
}

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
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoadErrors {
    /// At the near end.
    pub near: PlaceErrors,
    /// In the middle.
    pub middle: PlaceErrors,
    /// At the far end.
    pub far: PlaceErrors,
    /// Of the whole stretch from near to far.
    pub whole: LengthError,
}

impl RoadErrors {
    fn stated(&self) -> StatedErrors {
        let one = |p: &PlaceErrors| StatedError {
            at: p.at,
            along: p.along.rel_sd,
            across: p.across.rel_sd,
        };
        StatedErrors {
            stretch_m: STRETCH_M,
            near: one(&self.near),
            middle: one(&self.middle),
            far: one(&self.far),
        }
    }
}

/// Fits a camera to what the road shows.
///
/// # Errors
/// Says what is missing, or which cue cannot lie on any road.
pub fn fit(cues: &Cues, image_size: [u32; 2]) -> Result<Fit> {
    check(cues, image_size)?;
    let open = || Error::Solver {
        method: METHOD,
        detail: "the labelled vehicles leave the camera open; label more of them".into(),
    };
    let mut problem = Problem::new(cues, image_size).ok_or_else(open)?;
    let none = || Error::Solver {
        method: METHOD,
        detail: "no camera over a road sees all of these points below its horizon; look for one \
                 that is not on the road"
            .into(),
    };
    let optimum = problem.solve().ok_or_else(none)?;
    let own_covariance = optimum.covariance().ok_or_else(none)?;
    let unknowns = optimum.camera();
    let view = View::new(&unknowns, image_size);
    let covariance = in_lens_terms(&unknowns, image_size, &own_covariance);
    let known = UncertainCamera { camera: camera(&unknowns, image_size), covariance };
    let places = places(cues, &problem, &view).ok_or_else(none)?;
    let errors = errors(&known, &places).ok_or_else(none)?;
    let marks = mark_residuals(cues, &view);
    let rectangles = rectangle_residuals(cues, &view);
    let trust = verdict(&known, &errors, &marks, &rectangles);
    let information = own_covariance.try_inverse().ok_or_else(none)?;
    let weights = &problem.mark_weight;
    let fitted = Fitted { camera: &unknowns, information: &information, image_size, weights };
    let mut doubts = fitted.contradicted(&cues.marks);
    if doubts.is_empty() {
        doubts = doubt::unchecked(cues, image_size, optimum.cost);
    }
    Ok(Fit {
        doubts,
        marks,
        lanes: lane_residuals(cues, &view),
        rectangles,
        traffic: traffic_residual(&optimum),
        cost: optimum.cost,
        evaluations: problem.evaluations,
        trust,
        known,
        errors,
    })
}

impl Fit {
    /// The camera.
    pub fn camera(&self) -> &Camera {
        &self.known.camera
    }

    /// Error of lengths near, in the middle and far.
    pub fn errors(&self) -> &RoadErrors {
        &self.errors
    }

    /// The content of a calibration file.
    pub fn calibration(&self) -> Calibration {
        let mut calibration = Calibration::of_camera(self.camera(), METHOD);
        calibration.loss = Some(self.cost);
        calibration.rel_err = Some(self.errors.whole.rel_sd);
        calibration.evaluations = self.evaluations;
        calibration.trust = self.trust.clone();
        calibration.warnings = self.doubts.iter().map(Doubt::to_string).collect();
        calibration.uncertainty = Some(Uncertainty::of(&self.known, None));
        calibration.errors = Some(self.errors.stated());
        calibration
    }
}

/// Whether the cues can be used at all.
fn check(cues: &Cues, image_size: [u32; 2]) -> Result<()> {
    let nothing = cues.marks.is_empty()
        && cues.lanes.is_empty()
        && cues.rectangles.is_empty()
        && cues.labelled.is_none();
    if nothing {
        return Err(Error::Usage(
            "nothing to calibrate from; give --lengths first (two or more known lengths on the \
             road, one near and one far), then --lane-lines"
                .into(),
        ));
    }
    for mark in &cues.marks {
        let positive = mark.segment_m > 0.0 && mark.segment_m.is_finite();
        if mark.points.len() < 2 || !positive {
            return Err(Error::Marks(format!(
                "{}: {} points, {} m; a length has two points and metres above 0",
                mark.name,
                mark.points.len(),
                mark.segment_m
            )));
        }
        let short = mark.points.windows(2).any(|w| (w[1] - w[0]).norm() < 1.0);
        if short {
            return Err(Error::Marks(format!(
                "{}: two of its points are less than a pixel apart",
                mark.name
            )));
        }
    }
    for rectangle in &cues.rectangles {
        let positive = |sides: [f64; 2]| sides.iter().all(|m| *m > 0.0 && m.is_finite());
        if !rectangle.sides_m.is_none_or(positive) {
            return Err(Error::Marks(format!(
                "{}: the sides of a rectangle are metres above 0",
                rectangle.name
            )));
        }
        let corner = |k: usize| rectangle.corners[k % 4];
        let turn = |k: usize| (corner(k + 1) - corner(k)).perp(&(corner(k + 2) - corner(k + 1)));
        let is_convex = (0..4).all(|k| turn(k) > 0.0) || (0..4).all(|k| turn(k) < 0.0);
        if !is_convex {
            return Err(Error::Marks(format!(
                "{}: its corners do not go round; click them in order, without crossing",
                rectangle.name
            )));
        }
    }
    for lane in &cues.lanes {
        let least = lane.right.len().min(lane.left.len());
        if least < 2 {
            let problem = format!("a side has {least} points, at least 2 are needed");
            return Err(Error::Lane { lane: lane.name.clone(), problem });
        }
    }
    let [width, height] = image_size.map(f64::from);
    // A corner may be hidden by the border; further out the picture is another one.
    let outside = |p: &Vector2<f64>| {
        let (x, y) = (p.x / width, p.y / height);
        !((-0.05..=1.05).contains(&x) && (-0.05..=1.05).contains(&y))
    };
    match cues.points().find(outside) {
        None => Ok(()),
        Some(p) => Err(Error::Marks(format!(
            "the point ({:.1}, {:.1}) px lies outside the {width} x {height} picture; the cues \
             are of another picture size",
            p.x, p.y
        ))),
    }
}

/// The covariance with the lens' own coefficient in place of the fit's.
fn in_lens_terms(
    unknowns: &view::Unknowns,
    image_size: [u32; 2],
    covariance: &Matrix6<f64>,
) -> CameraCovariance {
    let mut change = Matrix6::identity();
    let k1 = k1(unknowns, image_size);
    let widths = unknowns[LOG_F].exp() / (0.5 * f64::from(image_size[0]));
    change[(DISTORTION, DISTORTION)] = widths * widths;
    change[(DISTORTION, LOG_F)] = 2.0 * k1;
    change * covariance * change.transpose()
}

/// Near, middle and far on the road with the direction of the road there, m.
type Places = [(Vector2<f64>, Vector2<f64>); 3];

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

fn errors(known: &UncertainCamera, places: &Places) -> Option<RoadErrors> {
    let at = |&(p, along): &(Vector2<f64>, Vector2<f64>)| {
        let across = Vector2::new(along.y, -along.x);
        let stretch = |d: Vector2<f64>| {
            // A stretch at the end of what is seen may reach beyond the horizon's error.
            known.between(p - d * (0.5 * STRETCH_M), p + d * (0.5 * STRETCH_M))
        };
        let uv = known.camera.project(&Vector3::new(p.x, p.y, 0.0))?;
        Some(PlaceErrors { at: uv.into(), along: stretch(along)?, across: stretch(across)? })
    };
    let [near, middle, far] = places;
    Some(RoadErrors {
        near: at(near)?,
        middle: at(middle)?,
        far: at(far)?,
        whole: known.between(near.0, far.0)?,
    })
}

fn mark_residuals(cues: &Cues, view: &View) -> Vec<MarkResidual> {
    let of = |mark: &MarkCue| {
        let logs = marks::log_ratios(mark, view)?;
        let white = marks::whitening(mark, view)? * &logs;
        Some(MarkResidual {
            name: mark.name.clone(),
            known_m: mark.segment_m,
            measured_m: logs.iter().map(|l| mark.segment_m * l.exp()).collect(),
            in_sd: marks::typical(&white),
        })
    };
    cues.marks.iter().filter_map(of).collect()
}

fn rectangle_residuals(cues: &Cues, view: &View) -> Vec<RectangleResidual> {
    let of = |cue: &RectangleCue| {
        let white = marks::rectangle_whitening(cue, view)? * marks::rectangle(cue, view)?;
        let mut g = [Vector2::zeros(); 4];
        for (g, uv) in g.iter_mut().zip(&cue.corners) {
            *g = view.ground(*uv)?;
        }
        let side = |k: usize| g[(k + 1) % 4] - g[k];
        let mean = |k: usize| 0.5 * (side(k).norm() + side(k + 2).norm());
        Some(RectangleResidual {
            name: cue.name.clone(),
            sides_m: [mean(0), mean(1)],
            known_m: cue.sides_m,
            angle_deg: side(0).angle(&-side(3)).to_degrees(),
            in_sd: marks::typical(&white),
        })
    };
    cues.rectangles.iter().filter_map(of).collect()
}

fn lane_residuals(cues: &Cues, view: &View) -> Vec<LaneResidual> {
    let of = |lane: &LaneCue| {
        let on_road = OnRoad::of(lane, view)?;
        let (mean, widths) = on_road.usable();
        let name = lane.name.clone();
        Some(LaneResidual { name, width_m: [*widths.first()?, mean, *widths.last()?] })
    };
    cues.lanes.iter().filter(|l| l.steady).filter_map(of).collect()
}

fn traffic_residual(optimum: &Optimum) -> Option<TrafficResidual> {
    let mixture = optimum.mixture.as_ref()?;
    let shares = mixture.shares();
    Some(TrafficResidual {
        used: mixture.used(),
        shares: bodies::ALL.iter().zip(shares).map(|(b, s)| (b.name, s)).collect(),
        car_length: [optimum.theta[CAMERA + 1], traffic::SHARED_SD[1]],
    })
}

fn verdict(
    known: &UncertainCamera,
    errors: &RoadErrors,
    marks: &[MarkResidual],
    rectangles: &[RectangleResidual],
) -> Trust {
    let worst = marks.iter().max_by(|a, b| a.in_sd.total_cmp(&b.in_sd));
    let contradiction = || {
        let mark = worst.filter(|m| m.in_sd > CONTRADICTION)?;
        let measured_m = mark.measured_m.iter().sum::<f64>() / mark.measured_m.len() as f64;
        Some(Reason::Contradiction { name: mark.name.clone(), known_m: mark.known_m, measured_m })
    };
    let crooked = || {
        let worst = rectangles.iter().max_by(|a, b| a.in_sd.total_cmp(&b.in_sd))?;
        let RectangleResidual { name, angle_deg, sides_m, .. } = worst.clone();
        (worst.in_sd > CONTRADICTION).then_some(Reason::Crooked { name, angle_deg, sides_m })
    };
    let advice = || advice::best(known, errors);
    Trust::of(
        trust::height(&known.camera)
            .or_else(contradiction)
            .or_else(crooked)
            .or_else(|| trust::uncertain(Some(errors.whole.rel_sd), advice))
            .or_else(|| trust::uncertain_far(errors.far.along.rel_sd, advice)),
    )
}
