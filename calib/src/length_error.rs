//! The stated error of lengths on the road, from a camera's covariance.
//!
//! Owns propagating the covariance of (log f, tilt, roll, log height, k1, crest) to any length
//! seen between two image points, to first order. Does not own the covariance (see `joint`
//! and `road::fit`).

use crate::camera::Camera;
use nalgebra::{Matrix6, Rotation3, Vector2, Vector3, Vector6};

/// Covariance of (log f, tilt, roll, log height, k1, crest in 1/m).
pub type CameraCovariance = Matrix6<f64>;

/// Length of the stretch far ahead, m.
const STRETCH_M: f64 = 10.0;
/// Road length that one pixel spans at the far end of what a camera resolves, m.
const SPAN_M: f64 = 1.0;
/// Steps of the central differences.
const STEP: [f64; 6] = [1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-8];

/// A camera with the covariance of its unknowns.
#[derive(Clone, Debug)]
pub struct UncertainCamera {
    /// The camera.
    pub camera: Camera,
    /// How well it is known.
    pub covariance: CameraCovariance,
}

/// Error of one length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LengthError {
    /// The length as the camera measures it, m.
    pub length_m: f64,
    /// Standard error as a part of it.
    pub rel_sd: f64,
}

impl UncertainCamera {
    /// Logarithm of the mean length of stretches, each given by its ends (px).
    fn log_mean(camera: &Camera, stretches: &[[Vector2<f64>; 2]]) -> Option<f64> {
        let length = |[a, b]: &[Vector2<f64>; 2]| {
            Some((camera.back_project(a, 0.0)? - camera.back_project(b, 0.0)?).norm())
        };
        let sum: Option<f64> = stretches.iter().map(length).sum();
        Some((sum? / stretches.len() as f64).ln())
    }

    /// How the logarithm of the mean length of stretches changes with each unknown.
    pub fn gradient(&self, stretches: &[[Vector2<f64>; 2]]) -> Option<Vector6<f64>> {
        let mut gradient = Vector6::zeros();
        for k in 0..6 {
            let moved = |by: f64| {
                let mut step = Vector6::zeros();
                step[k] = by * STEP[k];
                Self::log_mean(&perturbed(&self.camera, &step), stretches)
            };
            gradient[k] = (moved(1.0)? - moved(-1.0)?) / (2.0 * STEP[k]);
        }
        Some(gradient)
    }

    /// The mean length of stretches, each given by its ends (px), and its error; `None` above
    /// the horizon.
    pub fn of_stretches(&self, stretches: &[[Vector2<f64>; 2]]) -> Option<LengthError> {
        let length_m = Self::log_mean(&self.camera, stretches)?.exp();
        let gradient = self.gradient(stretches)?;
        let rel_sd = gradient.dot(&(self.covariance * gradient)).max(0.0).sqrt();
        rel_sd.is_finite().then_some(LengthError { length_m, rel_sd })
    }

    /// Error of a 10 m stretch straight ahead at the far end of what the camera resolves: where
    /// one pixel spans a metre of the road.
    pub fn far_ahead(&self) -> Option<LengthError> {
        let centre = self.camera.pose.camera_centre();
        let axis = self.camera.pose.rotation.inverse() * Vector3::z();
        let ahead = axis.xy().try_normalize(1e-9)?;
        let far_m = (self.camera.lens.f * centre.z * SPAN_M).sqrt();
        let at = |m: f64| centre.xy() + ahead * m;
        self.between(at(far_m - 0.5 * STRETCH_M), at(far_m + 0.5 * STRETCH_M))
    }

    /// The same for a stretch between two places on the road, m.
    pub fn between(&self, a: Vector2<f64>, b: Vector2<f64>) -> Option<LengthError> {
        let image = |p: Vector2<f64>| self.camera.project(&Vector3::new(p.x, p.y, 0.0));
        self.of_stretches(&[[image(a)?, image(b)?]])
    }
}

/// A camera with its unknowns moved; it stays above the same point of the road and keeps its
/// heading.
fn perturbed(camera: &Camera, step: &Vector6<f64>) -> Camera {
    let up = camera.pose.rotation * Vector3::z();
    let tilt = (-up.z).clamp(-1.0, 1.0).asin();
    let roll = up.x.atan2(-up.y);
    let tip = |tilt: f64, roll: f64| {
        // The camera looks along Y over a level road, then tilts and rolls.
        let level = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
        let tilted = Rotation3::from_axis_angle(&Vector3::x_axis(), tilt) * level;
        Rotation3::from_axis_angle(&Vector3::z_axis(), roll) * tilted
    };
    let turn = tip(tilt + step[1], roll + step[2]) * tip(tilt, roll).inverse();
    let mut moved = *camera;
    moved.lens.f *= step[0].exp();
    moved.lens.k1 += step[4];
    moved.crest_per_m += step[5];
    let mut centre = camera.pose.camera_centre();
    centre.z *= step[3].exp();
    moved.pose.rotation = turn * camera.pose.rotation;
    moved.pose.translation = -(moved.pose.rotation * centre);
    moved
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::road::lane_axis::tests::camera;

    #[test]
    fn the_height_alone_scales_every_length() {
        let mut covariance = CameraCovariance::zeros();
        covariance[(3, 3)] = 0.05 * 0.05;
        let uncertain = UncertainCamera { camera: camera(), covariance };
        let error = uncertain.between(Vector2::new(0.0, 30.0), Vector2::new(1.0, 50.0)).unwrap();
        assert!((error.rel_sd - 0.05).abs() < 1e-6, "{error:?}");
        assert!((error.length_m - 401f64.sqrt()).abs() < 1e-6);
    }

    #[test]
    fn a_tilt_moves_the_road_as_geometry_says() {
        // Y = h / tan(tilt) on the optical axis.
        let camera = camera();
        let step = Vector6::new(0.0, 1e-4, 0.0, 0.0, 0.0, 0.0);
        let axis = camera.lens.centre;
        let at = |c: &Camera| c.back_project(&axis, 0.0).unwrap().y;
        let expected = 12.0 / (20f64.to_radians() + 1e-4).tan();
        assert!((at(&perturbed(&camera, &step)) - expected).abs() < 1e-6);
        assert!((at(&perturbed(&camera, &Vector6::zeros())) - at(&camera)).abs() < 1e-9);
    }
}
