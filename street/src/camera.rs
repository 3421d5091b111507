//! The pinhole camera with one radial term: pose, projection and rays.
//!
//! Owns the conventions. Image coordinates are continuous, the picture's top left corner is
//! (0, 0), the centre of pixel (i, j) is (i + 0.5, j + 0.5), the principal point is (w/2, h/2).
//! World: metres, Z up, the road is Z = 0. `p_in_cam = R p_in_world + t`, camera axes x right,
//! y down, z forward (as OpenCV). Distortion: `x_d = x (1 + k1 r^2)` in normalised coordinates.
//! Owns no faults (shake, PTZ): see `faults.rs`.

use nalgebra::{Matrix3, Point3, Rotation3, Vector3};

/// Points nearer to the image plane than this are not projected, m.
const NEAR_M: f64 = 0.5;

/// A camera with its pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Picture width, px.
    pub width: u32,
    /// Picture height, px.
    pub height: u32,
    /// Focal length, px.
    pub focal_px: f64,
    /// Radial distortion, dimensionless.
    pub k1: f64,
    /// Rotation from world to camera.
    pub rotation: Rotation3<f64>,
    /// Translation of `cam_from_world`, m.
    pub translation: Vector3<f64>,
}

/// Direction of a camera: angles in radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Attitude {
    /// Clockwise from the world's +Y, seen from above.
    pub pan: f64,
    /// Downwards from the horizon.
    pub tilt: f64,
    /// Clockwise rotation of the picture's content.
    pub roll: f64,
}

impl Attitude {
    /// The rotation `cam_from_world`.
    pub fn rotation(self) -> Rotation3<f64> {
        // Level camera looking along +Y: x right = +X, y down = -Z, z forward = +Y.
        let level = Rotation3::from_matrix_unchecked(Matrix3::new(
            1.0, 0.0, 0.0, //
            0.0, 0.0, -1.0, //
            0.0, 1.0, 0.0,
        ));
        let pan = Rotation3::from_axis_angle(&Vector3::z_axis(), self.pan);
        let tilt = Rotation3::from_axis_angle(&Vector3::x_axis(), self.tilt);
        let roll = Rotation3::from_axis_angle(&Vector3::z_axis(), self.roll);
        roll * tilt * level * pan
    }
}

impl Camera {
    /// A camera at a place of the world, looking as `attitude` says.
    pub fn new(
        size: (u32, u32),
        focal_px: f64,
        k1: f64,
        position: Point3<f64>,
        attitude: Attitude,
    ) -> Self {
        let rotation = attitude.rotation();
        let translation = -(rotation * position.coords);
        Camera { width: size.0, height: size.1, focal_px, k1, rotation, translation }
    }

    /// The camera's place in the world, m.
    pub fn position(&self) -> Point3<f64> {
        Point3::from(-(self.rotation.inverse() * self.translation))
    }

    /// This camera turned about its own centre: `turn` acts in camera axes, after the pose.
    pub fn turned(&self, turn: &Rotation3<f64>) -> Self {
        let mut camera = self.clone();
        camera.rotation = turn * self.rotation;
        camera.translation = turn * self.translation;
        camera
    }

    /// The Rodrigues vector of the rotation, as OpenCV's `rvec`.
    pub fn rvec(&self) -> Vector3<f64> {
        self.rotation.scaled_axis()
    }

    /// The image point of a world point, px; `None` behind or at the camera. May lie outside
    /// the picture.
    pub fn project(&self, world: &Point3<f64>) -> Option<[f64; 2]> {
        let p = self.rotation * world.coords + self.translation;
        if p.z < NEAR_M {
            return None;
        }
        let (x, y) = (p.x / p.z, p.y / p.z);
        let scale = self.focal_px * (1.0 + self.k1 * (x * x + y * y));
        Some([f64::from(self.width) / 2.0 + scale * x, f64::from(self.height) / 2.0 + scale * y])
    }

    /// True where the lens model holds for a world point: it is before the camera, and not so far
    /// aside that the radial term folds back what lies farther out.
    pub fn images(&self, world: &Point3<f64>) -> bool {
        let p = self.rotation * world.coords + self.translation;
        let r2 = (p.x / p.z).powi(2) + (p.y / p.z).powi(2);
        p.z >= NEAR_M && 1.0 + 3.0 * self.k1 * r2 > 0.0
    }

    /// The direction in camera axes (z = 1) that an image point shows, distortion undone.
    pub fn ray_in_cam(&self, image: [f64; 2]) -> Vector3<f64> {
        let xd = (image[0] - f64::from(self.width) / 2.0) / self.focal_px;
        let yd = (image[1] - f64::from(self.height) / 2.0) / self.focal_px;
        let rd = xd.hypot(yd);
        // Newton on r (1 + k1 r^2) = rd; scene checks keep it monotonic over the picture.
        let mut r = rd;
        if self.k1 != 0.0 {
            for _ in 0..8 {
                let slope = 1.0 + 3.0 * self.k1 * r * r;
                if slope.abs() < 1e-6 {
                    break;
                }
                r -= (r * (1.0 + self.k1 * r * r) - rd) / slope;
            }
        }
        let scale = if rd > 0.0 { r / rd } else { 1.0 };
        Vector3::new(xd * scale, yd * scale, 1.0)
    }

    /// The direction in world axes that an image point shows; not normalised.
    pub fn ray(&self, image: [f64; 2]) -> Vector3<f64> {
        self.rotation.inverse() * self.ray_in_cam(image)
    }

    /// The road point (X, Y) m that an image point shows, `None` at or above the horizon.
    pub fn ground(&self, image: [f64; 2]) -> Option<[f64; 2]> {
        let ray = self.ray(image);
        let eye = self.position();
        if ray.z > -1e-6 {
            return None;
        }
        let reach = -eye.z / ray.z;
        Some([eye.x + reach * ray.x, eye.y + reach * ray.y])
    }
}
