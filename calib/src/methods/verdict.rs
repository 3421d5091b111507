//! The verdict on a camera from labelled vehicles.
//!
//! Owns the order of the rules and those that look at vehicles. Does not own the reasons, the
//! limits nor the rules for every camera (see `trust`).

use crate::camera::Camera;
use crate::problem::Problem;
use crate::trust::{
    MAX_MISFIT_WIDTH_FRACTION, MIN_VEHICLES, Reason, Trust, height, uncertain, uncertain_far,
};

/// What the rules look at.
#[derive(Clone, Copy, Debug)]
pub struct Evidence<'a> {
    /// Stated standard error of a length, as a part of it; `None`: the method states none.
    pub rel_err: Option<f64>,
    /// The same at the far end of what the camera resolves.
    pub far_rel_err: Option<f64>,
    /// The vehicle whose key points fit worst, and their root mean square misfit, px.
    pub worst: Option<(&'a str, f64)>,
    /// The bounds of the focal length in the search, px.
    pub focal_bounds: Option<[f64; 2]>,
}

/// The verdict: the first reason against the calibration. A method that states its error is
/// judged by that; only one that states none is judged by its number of vehicles.
pub fn verdict(problem: &Problem, camera: &Camera, evidence: &Evidence<'_>) -> Trust {
    Trust::of(
        few_vehicles(problem, evidence)
            .or_else(|| height(camera))
            .or_else(|| focal_bound(camera, evidence))
            .or_else(|| misfit(problem, evidence))
            .or_else(|| uncertain(evidence.rel_err, || None))
            .or_else(|| uncertain_far(evidence.far_rel_err?, further))
            .or_else(|| above_horizon(problem, camera)),
    )
}

/// What improves the far end where vehicles are labelled.
fn further() -> Option<String> {
    Some("vehicles further away, two traced lane lines or a known length".into())
}

fn few_vehicles(problem: &Problem, evidence: &Evidence<'_>) -> Option<Reason> {
    let actual = problem.vehicles.len();
    (evidence.rel_err.is_none() && actual < MIN_VEHICLES).then_some(Reason::FewVehicles { actual })
}

fn focal_bound(camera: &Camera, evidence: &Evidence<'_>) -> Option<Reason> {
    let f_px = camera.lens.f;
    let at_bound = |&[low, high]: &[f64; 2]| f_px < low * 1.001 || f_px > high * 0.999;
    evidence.focal_bounds.filter(at_bound).map(|_| Reason::FocalBound { f_px })
}

fn misfit(problem: &Problem, evidence: &Evidence<'_>) -> Option<Reason> {
    let limit_px = MAX_MISFIT_WIDTH_FRACTION * problem.width_px();
    let (vehicle, misfit_px) = evidence.worst.filter(|(_, m)| m.is_nan() || *m > limit_px)?;
    Some(Reason::Misfit { vehicle: vehicle.to_owned(), misfit_px, limit_px })
}

/// The first key point that this camera sees at or above its horizon: no vehicle of the
/// road can be there.
fn above_horizon(problem: &Problem, camera: &Camera) -> Option<Reason> {
    problem.vehicles.iter().find_map(|vehicle| {
        let point = vehicle.points.iter().find(|p| camera.back_project(&p.uv, 0.0).is_none())?;
        let vehicle = vehicle.name.clone();
        Some(Reason::AboveHorizon { vehicle, label: point.label, uv: point.uv.into() })
    })
}
