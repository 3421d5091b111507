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
//! Owns the fit as a whole and its verdict. Does not own files (see `files`) nor the command line.

mod advice;
mod bodies;
mod check;
mod cues;
mod doubt;
mod errors;
mod hull;
mod lanes;
mod marks;
mod mixture;
mod observed;
mod prior;
mod problem;
mod residuals;
mod solve;
#[cfg(test)]
mod tests;
mod traffic;
mod view;
mod width;

pub use cues::{
    BoxCue, Class, Cues, Labelled, LaneCue, MEASURED_REL_SD, MarkCue, READING_PX, RectangleCue,
    STATED_WIDTH_SD_M,
};
pub use doubt::{Doubt, Others};
pub use errors::{Across, DISTANCES, PlaceErrors, RoadErrors, WidthErrors};
pub use residuals::{LaneResidual, MarkResidual, RectangleResidual, TrafficResidual};
pub use traffic::MAX_BOXES;

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::files::calibration::Calibration;
use crate::files::stated::Uncertainty;
use crate::length_error::{CameraCovariance, UncertainCamera};
use crate::trust::{self, Reason, Trust};
use doubt::Fitted;
use nalgebra::Matrix6;
use problem::Problem;
use view::{DISTORTION, LOG_F, View, camera, k1};

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

/// Fits a camera to what the road shows.
///
/// # Errors
/// Says what is missing, or which cue cannot lie on any road.
pub fn fit(cues: &Cues, image_size: [u32; 2]) -> Result<Fit> {
    let (mut found, _) = fit_of(cues, image_size, true)?;
    // It bends the camera, so that whatever else is refused may follow from it.
    if let Some(reason) = width::contradicted(cues, image_size) {
        found.trust = Trust::Refused(reason);
    }
    Ok(found)
}

/// The fit with its view, where lanes are not compared with the other cues; `unchecked`: with a look for
/// standards that nothing checks, which takes two fits for each.
fn fit_of(cues: &Cues, image_size: [u32; 2], unchecked: bool) -> Result<(Fit, View)> {
    check::usable(cues, image_size)?;
    let open = || Error::Solver {
        method: METHOD,
        detail: "the labelled vehicles leave the camera open; label more of them".into(),
    };
    let mut problem = Problem::new(cues, image_size).ok_or_else(open)?;
    let none = || Error::Solver {
        method: METHOD,
        detail: "no camera over a road sees all of these points below its horizon; look for one \
                 that is not on the road, and for lengths that are not in metres"
            .into(),
    };
    let optimum = problem.solve().ok_or_else(none)?;
    let own_covariance = optimum.covariance().ok_or_else(none)?;
    let unknowns = optimum.camera();
    let view = View::new(&unknowns, image_size);
    let covariance = in_lens_terms(&unknowns, image_size, &own_covariance);
    let known = UncertainCamera { camera: camera(&unknowns, image_size), covariance };
    let errors = errors::of(&known, cues, &problem, &view).ok_or_else(none)?;
    let marks = residuals::marks(cues, &view);
    let rectangles = residuals::rectangles(cues, &view);
    let trust = verdict(&known, cues, &errors, (&marks, &rectangles));
    let information = own_covariance.try_inverse().ok_or_else(none)?;
    let weights = &problem.mark_weight;
    let fitted = Fitted { camera: &unknowns, information: &information, image_size, weights };
    let mut doubts = fitted.contradicted(&cues.marks);
    if doubts.is_empty() && unchecked {
        doubts = doubt::unchecked(cues, image_size, optimum.cost);
    }
    let found = Fit {
        doubts,
        marks,
        lanes: residuals::lanes(cues, &view),
        rectangles,
        traffic: residuals::traffic(&optimum),
        cost: optimum.cost,
        evaluations: problem.evaluations,
        trust,
        known,
        errors,
    };
    Ok((found, view))
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

fn verdict(
    known: &UncertainCamera,
    cues: &Cues,
    errors: &RoadErrors,
    (marks, rectangles): (&[MarkResidual], &[RectangleResidual]),
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
    let along = || advice::best_along(known, errors);
    Trust::of(
        trust::height(&known.camera)
            .or_else(contradiction)
            .or_else(crooked)
            .or_else(|| trust::uncertain(Some(errors.whole.rel_sd), along))
            .or_else(|| trust::uncertain_far(errors.far.along.rel_sd, along))
            .or_else(|| {
                let Across { place, error, .. } = errors.worst_across();
                let of = [error.length_m, error.rel_sd];
                trust::uncertain_across(place, of, || advice::best_across(known, cues, errors))
            }),
    )
}
