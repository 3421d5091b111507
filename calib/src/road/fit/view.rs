//! The camera of the road fit: six unknowns, and the mapping between picture and road.
//!
//! Owns projection and back-projection in the fit's own terms. World: metres, origin on the
//! road below the camera, Y along the camera's heading on the ground, Z above the road. Does
//! not own the unknowns' priors (see `prior`) nor their estimation.

use crate::camera::{Camera, Lens, Pose};
use nalgebra::{Matrix3, Rotation3, SVector, Vector2, Vector3};

/// Unknowns of the camera: log f, tilt, roll, log height, distortion, crest.
pub const CAMERA: usize = 6;
/// Position of each unknown.
pub const LOG_F: usize = 0;
/// Tilt below the horizontal, rad.
pub const TILT: usize = 1;
/// Roll, rad.
pub const ROLL: usize = 2;
/// Logarithm of the height above the road, m.
pub const LOG_HEIGHT: usize = 3;
/// Radial displacement at half the picture's width, as a part of it; barrel is below 0.
pub const DISTORTION: usize = 4;
/// Curvature of the road's profile, 1/m: it lies at -crest y^2 / 2.
pub const CREST: usize = 5;
/// The unknowns as one vector.
pub type Unknowns = SVector<f64, CAMERA>;

/// Steps of numerical derivatives: small against what the cues tell apart, large against
/// rounding.
pub const STEP: [f64; CAMERA] = [1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-8];

/// Points nearer to the camera's plane than this are held there, m.
const MIN_DEPTH_M: f64 = 0.3;
/// The lens may not shrink a direction below this part of itself.
const MIN_SCALE: f64 = 0.4;
/// Newton steps of the lens' inverse, and fixed-point steps onto a curved road.
const INVERSE_STEPS: usize = 6;

/// A camera with everything that projection needs at hand.
#[derive(Clone, Copy, Debug)]
pub struct View {
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
    /// Rotation and translation by rows.
    rows: [[f64; 4]; 3],
    f: f64,
    centre: Vector2<f64>,
    half_width: f64,
    height: f64,
    distortion: f64,
    crest: f64,
}

impl View {
    /// The camera of these unknowns over pictures of this size (px).
    pub fn new(unknowns: &Unknowns, image_size: [u32; 2]) -> Self {
        let [width, height] = image_size.map(f64::from);
        let (st, ct) = unknowns[TILT].sin_cos();
        let (sr, cr) = unknowns[ROLL].sin_cos();
        let level = Matrix3::new(1.0, 0.0, 0.0, 0.0, -st, -ct, 0.0, ct, -st);
        let roll = Matrix3::new(cr, -sr, 0.0, sr, cr, 0.0, 0.0, 0.0, 1.0);
        let rotation = roll * level;
        let h = unknowns[LOG_HEIGHT].exp();
        let translation = rotation * Vector3::new(0.0, 0.0, -h);
        let row = |k: usize| [rotation[(k, 0)], rotation[(k, 1)], rotation[(k, 2)], translation[k]];
        View {
            rotation,
            translation,
            rows: [row(0), row(1), row(2)],
            f: unknowns[LOG_F].exp(),
            centre: Vector2::new(0.5 * width, 0.5 * height),
            half_width: 0.5 * width,
            height: h,
            distortion: unknowns[DISTORTION],
            crest: unknowns[CREST],
        }
    }

    /// The picture's middle, px.
    pub fn centre(&self) -> Vector2<f64> {
        self.centre
    }

    /// Height above the road, m.
    pub fn height_m(&self) -> f64 {
        self.height
    }

    /// The image point (px) of a point, x and y on the ground and z above the road, m. What
    /// lies behind the camera is held before it.
    pub fn project(&self, p: Vector3<f64>) -> Vector2<f64> {
        // By coordinates: with vectors a development build spends its time in checks.
        let z = p.z - 0.5 * self.crest * p.y * p.y;
        let [u, v, depth] = self.rows.map(|[a, b, c, d]| a * p.x + b * p.y + c * z + d);
        let scale = self.f / depth.max(MIN_DEPTH_M);
        let (u, v) = (u * scale, v * scale);
        let bent = 1.0 + self.distortion * (u * u + v * v) / (self.half_width * self.half_width);
        let bent = bent.max(MIN_SCALE);
        Vector2::new(self.centre.x + u * bent, self.centre.y + v * bent)
    }

    /// The road point (m) that is seen at an image point (px); `None` at and above the horizon.
    pub fn ground(&self, uv: Vector2<f64>) -> Option<Vector2<f64>> {
        let (mut x, mut y) =
            ((uv.x - self.centre.x) / self.half_width, (uv.y - self.centre.y) / self.half_width);
        if self.distortion != 0.0 {
            let bent = (x * x + y * y).sqrt();
            let mut r = bent;
            for _ in 0..INVERSE_STEPS {
                let slope = 1.0 + 3.0 * self.distortion * r * r;
                if slope < 0.05 {
                    return None;
                }
                let step = (r * (1.0 + self.distortion * r * r) - bent) / slope;
                r -= step;
                if step.abs() < 1e-14 {
                    break;
                }
            }
            if bent > 1e-12 {
                (x, y) = (x * r / bent, y * r / bent);
            }
        }
        let widths = self.half_width / self.f;
        let (x, y) = (x * widths, y * widths);
        let [a, b, c] = &self.rows;
        let along = |k: usize| a[k] * x + b[k] * y + c[k];
        let ray = Vector3::new(along(0), along(1), along(2));
        if ray.z > -1e-6 {
            return None;
        }
        let mut reach = -self.height / ray.z;
        if self.crest != 0.0 {
            for _ in 0..INVERSE_STEPS {
                let y = ray.y * reach;
                let z = -0.5 * self.crest * y * y;
                if z > 0.7 * self.height || z < -2.0 * self.height {
                    return None;
                }
                reach = (z - self.height) / ray.z;
            }
        }
        (reach > 0.0).then(|| ray.xy() * reach)
    }

    /// Metres that a place on the road moves in the direction `along` (a unit vector) when its
    /// image point moves by one px in the worst direction.
    pub fn metres_per_px(
        &self,
        uv: Vector2<f64>,
        at: Vector2<f64>,
        along: Vector2<f64>,
    ) -> Option<f64> {
        let moved = |d: Vector2<f64>| Some((self.ground(uv + d)? - at).dot(&along) / 0.25);
        let (du, dv) = (moved(Vector2::new(0.25, 0.0))?, moved(Vector2::new(0.0, 0.25))?);
        Some(du.hypot(dv))
    }
}

/// The camera of these unknowns as the rest of the crate knows it.
pub fn camera(unknowns: &Unknowns, image_size: [u32; 2]) -> Camera {
    let view = View::new(unknowns, image_size);
    let lens = Lens { k1: k1(unknowns, image_size), ..Lens::centred(view.f, image_size) };
    let rotation = Rotation3::from_matrix_unchecked(view.rotation);
    let pose = Pose { rotation, translation: view.translation };
    Camera { image_size, lens, pose, crest_per_m: unknowns[CREST] }
}

/// The lens' radial coefficient, see [`Lens::k1`].
pub fn k1(unknowns: &Unknowns, image_size: [u32; 2]) -> f64 {
    let widths = unknowns[LOG_F].exp() / (0.5 * f64::from(image_size[0]));
    unknowns[DISTORTION] * widths * widths
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ground_inverts_project_and_the_camera_is_the_same() {
        let unknowns = Unknowns::from([400f64.ln(), 0.25, 0.03, 11f64.ln(), -0.04, 1e-4]);
        let view = View::new(&unknowns, [320, 240]);
        let camera = camera(&unknowns, [320, 240]);
        for (x, y) in [(0.0, 30.0), (-5.0, 60.0), (4.0, 90.0)] {
            let uv = view.project(Vector3::new(x, y, 0.0));
            let back = view.ground(uv).expect("on the road");
            assert!((back - Vector2::new(x, y)).norm() < 1e-3, "{back}");
            let other = camera.project(&Vector3::new(x, y, 0.0)).expect("in front");
            assert!((other - uv).norm() < 1e-9, "{uv} {other}");
            let p = camera.back_project(&uv, 0.0).expect("on the road");
            assert!((p.xy() - back).norm() < 1e-3, "{p} {back}");
        }
    }
}
