//! What the joint method says of its own error: the error of any length on the road.
//!
//! Owns propagating the camera's covariance to lengths (Laplace's approximation of the
//! posterior). Does not own the covariance itself.

use super::scene::{CAMERA, CameraState, CameraStep, VehicleState};
use super::solver::CameraInformation;
use nalgebra::{Vector2, Vector3};

/// Covariance of the camera's unknowns.
#[derive(Clone, Copy, Debug)]
pub struct CameraCovariance(pub CameraInformation);

/// Step of the central differences.
const DIFFERENCE: f64 = 1e-5;
/// Length along each vehicle's heading that the stated error refers to, m: a gap between
/// two cars in slow traffic.
const REFERENCE_LENGTH_M: f64 = 10.0;

impl CameraCovariance {
    /// Relative standard error of the mean length of stretches of road, each given by its
    /// two ends in the picture (px): the standard error of the logarithm.
    pub fn relative_sd(
        &self,
        camera: &CameraState,
        image_size: [u32; 2],
        stretches: &[[Vector2<f64>; 2]],
    ) -> Option<f64> {
        let mean_length = |v: CameraStep| -> Option<f64> {
            let view = CameraState::of_vector(&v).camera(image_size);
            let lengths = stretches.iter().map(|[a, b]| {
                Some((view.back_project(a, 0.0)? - view.back_project(b, 0.0)?).norm())
            });
            Some(lengths.sum::<Option<f64>>()? / stretches.len() as f64)
        };
        let mut gradient = CameraStep::zeros();
        for k in 0..CAMERA {
            let (mut up, mut down) = (camera.vector(), camera.vector());
            up[k] += DIFFERENCE;
            down[k] -= DIFFERENCE;
            gradient[k] = (mean_length(up)?.ln() - mean_length(down)?.ln()) / (2.0 * DIFFERENCE);
        }
        Some((gradient.dot(&(self.0 * gradient))).max(0.0).sqrt())
    }

    /// The same for lengths along the vehicles' headings where they stand: the one number
    /// that a calibration states.
    pub fn relative_sd_at(
        &self,
        camera: &CameraState,
        image_size: [u32; 2],
        vehicles: &[VehicleState],
    ) -> Option<f64> {
        let view = camera.camera(image_size);
        let stretches: Vec<_> = vehicles
            .iter()
            .filter_map(|v| {
                let end = |side: f64| {
                    let p = v.position + v.heading() * (side * REFERENCE_LENGTH_M);
                    view.project(&Vector3::new(p.x, p.y, 0.0))
                };
                Some([end(-0.5)?, end(0.5)?])
            })
            .collect();
        if stretches.is_empty() {
            return None;
        }
        self.relative_sd(camera, image_size, &stretches)
    }

    /// Standard deviation of one unknown.
    pub fn sd(&self, k: usize) -> f64 {
        self.0[(k, k)].max(0.0).sqrt()
    }
}
