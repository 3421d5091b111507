//! The verdict on a calibration: whether lengths measured with it may be used.
//!
//! Owns the rules and their limits. Does not own what happens to a calibration that fails
//! them (`table` refuses it unless forced).

use crate::calibration::TRUSTED;
use crate::camera::Camera;
use crate::problem::Problem;

/// Fewest vehicles: one or two leave the focal length open.
pub const MIN_VEHICLES: usize = 3;
/// Largest stated standard error of a length: beyond it a density is off by more than the
/// paper's own error of 8 to 16 %.
pub const MAX_REL_ERR: f64 = 0.15;
/// A camera over a road stands between these heights, m.
pub const HEIGHT_RANGE_M: [f64; 2] = [2.0, 80.0];
/// Largest typical misfit of a key point as a part of the picture's width: 3.2 px of 320.
pub const MAX_MISFIT_WIDTH_FRACTION: f64 = 0.01;

/// What the rules look at.
#[derive(Clone, Copy, Debug)]
pub struct Evidence<'a> {
    /// Stated standard error of a length, as a part of it.
    pub rel_err: Option<f64>,
    /// The vehicle whose key points fit worst, and their root mean square misfit, px.
    pub worst: Option<(&'a str, f64)>,
    /// The bounds of the focal length in the search, px.
    pub focal_bounds: Option<[f64; 2]>,
}

/// `ok`, or the first reason against the calibration, with its numbers.
pub fn verdict(problem: &Problem, camera: &Camera, evidence: &Evidence<'_>) -> String {
    let vehicles = problem.vehicles.len();
    if vehicles < MIN_VEHICLES {
        return format!(
            "{vehicles} vehicle(s) do not determine the focal length; label at least {MIN_VEHICLES}"
        );
    }
    let height = camera.height_m();
    if !(HEIGHT_RANGE_M[0]..=HEIGHT_RANGE_M[1]).contains(&height) {
        return format!("the camera would stand {height:.1} m above the road");
    }
    let at_bound = evidence
        .focal_bounds
        .is_some_and(|[low, high]| camera.lens.f < low * 1.001 || camera.lens.f > high * 0.999);
    if at_bound {
        return format!("the focal length {:.0} px ended at its bound", camera.lens.f);
    }
    let limit_px = MAX_MISFIT_WIDTH_FRACTION * problem.width_px();
    if let Some((name, misfit)) = evidence.worst.filter(|(_, m)| m.is_nan() || *m > limit_px) {
        return format!(
            "the key points of {name} miss their fit by {misfit:.1} px (limit {limit_px:.1} px)"
        );
    }
    if let Some(rel_err) = evidence.rel_err.filter(|e| e.is_nan() || *e > MAX_REL_ERR) {
        return format!(
            "lengths are uncertain by {:.0} % (limit {:.0} %)",
            100.0 * rel_err,
            100.0 * MAX_REL_ERR
        );
    }
    if let Some(point) = above_horizon(problem, camera) {
        return point;
    }
    TRUSTED.to_owned()
}

/// The first key point that this camera sees at or above its horizon: no vehicle of the
/// road can be there.
fn above_horizon(problem: &Problem, camera: &Camera) -> Option<String> {
    problem.vehicles.iter().find_map(|vehicle| {
        let point = vehicle.points.iter().find(|p| camera.back_project(&p.uv, 0.0).is_none())?;
        Some(format!(
            "{}, key point {} at ({:.1}, {:.1}) px lies above the horizon",
            vehicle.name, point.label, point.uv.x, point.uv.y
        ))
    })
}
