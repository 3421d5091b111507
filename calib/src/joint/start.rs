//! Where the joint method starts: one guess of camera and vehicles for each focal length.
//!
//! Owns turning single poses of the mean car into one camera over one road. Does not own
//! the choice among the results.

use super::scene::{CameraState, VehicleState};
use super::shape::{Coefficients, ShapePrior};
use crate::baselines::epnp;
use crate::baselines::pose_refinement::{Free, refine};
use crate::camera::Lens;
use crate::vehicle::{Pair, Vehicle};
use nalgebra::{Vector2, Vector3};

/// A vehicle whose mean shape misses its points by more than this part of the picture's width
/// says nothing about the camera.
const USELESS_WIDTH_FRACTION: f64 = 0.03;

/// Camera and vehicles at a focal length (px), or `None` when no vehicle can be posed from
/// above.
pub fn at_focal_length(
    f: f64,
    image_size: [u32; 2],
    vehicles: &[Vehicle],
    shapes: &[ShapePrior],
) -> Option<(CameraState, Vec<VehicleState>)> {
    let lens = Lens::centred(f, image_size);
    let limit = USELESS_WIDTH_FRACTION * f64::from(image_size[0]);
    let mut ups = Vec::new();
    let mut heights = Vec::new();
    for (vehicle, shape) in vehicles.iter().zip(shapes) {
        let pairs: Vec<Pair> = vehicle
            .points
            .iter()
            .filter_map(|p| {
                let world = shape.point(p.label, &Coefficients::zeros())?;
                Some(Pair { world, image: p.uv })
            })
            .collect();
        let best = epnp::solve(&pairs, &lens)
            .into_iter()
            .filter_map(|(pose, _)| refine(&pairs, lens, pose, Free::Pose))
            .filter(|r| r.pose.camera_centre().z > 0.0 && r.rms_px < limit)
            .min_by(|a, b| a.rms_px.total_cmp(&b.rms_px));
        if let Some(refined) = best {
            ups.push(refined.pose.rotation * Vector3::z());
            heights.push(refined.pose.camera_centre().z);
        }
    }
    if ups.is_empty() {
        return None;
    }
    let up = Vector3::from_fn(|k, _| median(ups.iter().map(|u| u[k]).collect())).normalize();
    // Up as the camera sees it: (sin roll cos tilt, -cos roll cos tilt, -sin tilt).
    let tilt = (-up.z).clamp(-1.0, 1.0).asin().max(MIN_TILT);
    let roll = up.x.atan2(-up.y);
    let log_height = median(heights).ln();
    let mut camera =
        CameraState { log_f: f.ln(), tilt, roll, log_height, ..CameraState::default() };
    let states = vehicles.iter().zip(shapes).map(|(v, s)| on_road(&camera, image_size, v, s));
    let states = states.collect::<Option<Vec<_>>>()?;
    // The road's heading: mean of the doubled angles, since traffic may oppose.
    let (sine, cosine) = states
        .iter()
        .fold((0.0, 0.0), |(s, c), v| (s + (2.0 * v.yaw).sin(), c + (2.0 * v.yaw).cos()));
    camera.heading = 0.5 * sine.atan2(cosine);
    Some((camera, states))
}

/// A start needs the road in view: at least this far below the horizontal, rad.
const MIN_TILT: f64 = 0.02;

/// Position and yaw of a vehicle from its points, back-projected at the mean car's heights.
fn on_road(
    camera: &CameraState,
    image_size: [u32; 2],
    vehicle: &Vehicle,
    shape: &ShapePrior,
) -> Option<VehicleState> {
    let view = camera.camera(image_size);
    let mut from = Vec::new();
    let mut to = Vec::new();
    for p in &vehicle.points {
        let Some(model) = shape.point(p.label, &Coefficients::zeros()) else { continue };
        let Some(ground) = view.back_project(&p.uv, model.z) else { continue };
        from.push(model.xy());
        to.push(ground.xy());
    }
    if from.len() < 2 {
        return None;
    }
    let mean = |points: &[Vector2<f64>]| points.iter().sum::<Vector2<f64>>() / points.len() as f64;
    let (mean_from, mean_to) = (mean(&from), mean(&to));
    let (mut sine, mut cosine) = (0.0, 0.0);
    for (a, b) in from.iter().zip(&to) {
        let (a, b) = (a - mean_from, b - mean_to);
        cosine += a.dot(&b);
        sine += a.perp(&b);
    }
    let yaw = sine.atan2(cosine);
    let position = mean_to - nalgebra::Rotation2::new(yaw) * mean_from;
    let (shape, shift) = (Coefficients::zeros(), Vector2::zeros());
    Some(VehicleState { position, yaw, shape, shift })
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
