//! The unknowns of the joint method: one camera over one road, and the vehicles on it.
//!
//! Owns the parametrisation. The world's origin is on the road below the camera and the
//! camera looks along +Y (pan 0 is a free choice), so a uniform slope or bank of the road
//! is part of tilt and roll. Does not own what is observed.

use super::shape::{Coefficients, FLEET, MODES};
use crate::camera::{Camera, Lens, Pose};
use nalgebra::{Matrix3, Rotation3, SVector, Vector2, Vector3};

/// Unknowns that all vehicles share: log f, tilt, roll, log height, k1 of the camera;
/// heading and curvature of the road; the fleet's own size.
pub const CAMERA: usize = FLEET_AT + FLEET;
/// Where the fleet's unknowns start.
pub const FLEET_AT: usize = 7;
/// Unknowns of a vehicle: x, y, yaw, shape coefficients, shift of its picture (du, dv).
pub const VEHICLE: usize = 3 + MODES + 2;

/// A change of the camera's unknowns.
pub type CameraStep = SVector<f64, CAMERA>;
/// A change of a vehicle's unknowns.
pub type VehicleStep = SVector<f64, VEHICLE>;

/// The unknowns that all vehicles share: the camera's and the road's.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CameraState {
    /// Logarithm of the focal length (px).
    pub log_f: f64,
    /// Angle of the optical axis below the road plane, rad.
    pub tilt: f64,
    /// Rotation of the picture about the optical axis, rad.
    pub roll: f64,
    /// Logarithm of the height over the road (m).
    pub log_height: f64,
    /// Radial distortion, see [`Lens::k1`].
    pub k1: f64,
    /// Heading of the road below the camera against the camera's, rad.
    pub heading: f64,
    /// Change of the road's heading with the distance from the camera, rad per m.
    pub curvature: f64,
    /// How the fleet as a whole differs from the mean shape: coefficients of the last
    /// [`FLEET`] modes, in a single car's standard deviations.
    pub fleet: SVector<f64, FLEET>,
}

/// A vehicle's unknowns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VehicleState {
    /// Middle of the footprint on the road, m.
    pub position: Vector2<f64>,
    /// Rotation of the vehicle's frame about Z, rad.
    pub yaw: f64,
    /// Shape coefficients, standard deviations.
    pub shape: Coefficients,
    /// How far the camera's sway moved this vehicle's picture, px.
    pub shift: Vector2<f64>,
}

/// Rotation `cam_from_world` and its derivatives by tilt and roll.
pub struct Orientation {
    /// The rotation.
    pub rotation: Matrix3<f64>,
    /// Its derivative by tilt.
    pub by_tilt: Matrix3<f64>,
    /// Its derivative by roll.
    pub by_roll: Matrix3<f64>,
}

impl CameraState {
    /// A vehicle's shape with the fleet's part in it.
    pub fn shape_of(&self, vehicle: &VehicleState) -> Coefficients {
        let mut shape = vehicle.shape;
        let mut last = shape.fixed_rows_mut::<FLEET>(MODES - FLEET);
        last += self.fleet;
        shape
    }

    /// From the vector of the shared unknowns, in the order of the fields.
    pub fn of_vector(v: &CameraStep) -> Self {
        CameraState {
            log_f: v[0],
            tilt: v[1],
            roll: v[2],
            log_height: v[3],
            k1: v[4],
            heading: v[5],
            curvature: v[6],
            fleet: v.fixed_rows::<FLEET>(FLEET_AT).into_owned(),
        }
    }

    /// As the vector of the shared unknowns.
    pub fn vector(&self) -> CameraStep {
        let CameraState { log_f, tilt, roll, log_height, k1, heading, curvature, fleet } = *self;
        let own = [log_f, tilt, roll, log_height, k1, heading, curvature];
        CameraStep::from_iterator(own.into_iter().chain(fleet.iter().copied()))
    }

    /// Height over the road, m.
    pub fn height_m(&self) -> f64 {
        self.log_height.exp()
    }

    /// The rotation with its derivatives.
    pub fn orientation(&self) -> Orientation {
        let (st, ct) = self.tilt.sin_cos();
        let (sr, cr) = self.roll.sin_cos();
        let tilted = Matrix3::new(1.0, 0.0, 0.0, 0.0, -st, -ct, 0.0, ct, -st);
        let tilted_by = Matrix3::new(0.0, 0.0, 0.0, 0.0, -ct, st, 0.0, -st, -ct);
        let rolled = Matrix3::new(cr, -sr, 0.0, sr, cr, 0.0, 0.0, 0.0, 1.0);
        let rolled_by = Matrix3::new(-sr, -cr, 0.0, cr, -sr, 0.0, 0.0, 0.0, 0.0);
        Orientation {
            rotation: rolled * tilted,
            by_tilt: rolled * tilted_by,
            by_roll: rolled_by * tilted,
        }
    }

    /// The camera in the crate's convention.
    pub fn camera(&self, image_size: [u32; 2]) -> Camera {
        let rotation = Rotation3::from_matrix_unchecked(self.orientation().rotation);
        let translation = rotation * Vector3::new(0.0, 0.0, -self.height_m());
        let lens = Lens { k1: self.k1, ..Lens::centred(self.log_f.exp(), image_size) };
        Camera { image_size, lens, pose: Pose { rotation, translation }, crest_per_m: 0.0 }
    }
}

impl VehicleState {
    /// The state moved by a step.
    pub fn moved(&self, step: &VehicleStep) -> Self {
        VehicleState {
            position: self.position + Vector2::new(step[0], step[1]),
            yaw: self.yaw + step[2],
            shape: self.shape + step.fixed_rows::<MODES>(3),
            shift: self.shift + Vector2::new(step[3 + MODES], step[4 + MODES]),
        }
    }

    /// The direction the vehicle's length lies along on the road, unit vector.
    pub fn heading(&self) -> Vector2<f64> {
        Vector2::new(-self.yaw.sin(), self.yaw.cos())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_camera_stands_over_the_origin_and_looks_down() {
        let state = CameraState {
            log_f: 400f64.ln(),
            tilt: 0.3,
            roll: 0.05,
            log_height: 2.5,
            ..CameraState::default()
        };
        let camera = state.camera([320, 240]);
        let centre = camera.pose.camera_centre();
        assert!(centre.xy().norm() < 1e-9 && (centre.z - 2.5f64.exp()).abs() < 1e-9);
        assert!((camera.tilt_rad() - 0.3).abs() < 1e-9);
        assert!((camera.pose.rotation.matrix().determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn orientation_derivatives_match_differences() {
        let at = |tilt, roll| {
            CameraState { log_f: 6.0, tilt, roll, log_height: 2.0, ..CameraState::default() }
                .orientation()
        };
        let (h, o) = (1e-6, at(0.3, 0.1));
        let by_tilt = (at(0.3 + h, 0.1).rotation - at(0.3 - h, 0.1).rotation) / (2.0 * h);
        let by_roll = (at(0.3, 0.1 + h).rotation - at(0.3, 0.1 - h).rotation) / (2.0 * h);
        assert!((by_tilt - o.by_tilt).norm() < 1e-8 && (by_roll - o.by_roll).norm() < 1e-8);
    }
}
