//! The pinhole camera over a road: projection and back-projection.
//!
//! Owns the lens, the pose and the mapping between the picture and planes of
//! known height. Does not own how they are estimated.
//!
//! Pixel convention, stated once for the crate: continuous image coordinates with
//! (0, 0) at the top left corner of the picture, so pixel (i, j) has its centre at
//! (i + 0.5, j + 0.5), and the principal point is (w/2, h/2) as in the paper
//! (Eq. full_PnP_eq). World: metres, Z up, Z = 0 the road. Where the road's profile is
//! curved, Z is measured from the road, which lies `crest_per_m` Y^2 / 2 below the plane that
//! touches it at Y = 0.

use nalgebra::{Matrix2, Matrix3, Rotation3, Vector2, Vector3};

/// How the lens maps a direction to the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Focal length, px.
    pub f: f64,
    /// Principal point (cx, cy), px.
    pub centre: Vector2<f64>,
    /// First radial coefficient: x_distorted = x (1 + k1 r^2), x = X/Z. No unit.
    pub k1: f64,
}

impl Lens {
    /// A lens without distortion, the principal point in the middle of the picture.
    pub fn centred(f: f64, image_size: [u32; 2]) -> Self {
        let [w, h] = image_size.map(f64::from);
        Lens { f, centre: Vector2::new(w / 2.0, h / 2.0), k1: 0.0 }
    }

    /// The image point (px) of a point in camera coordinates (m), or `None` when it
    /// is not in front of the camera.
    pub fn project(&self, p_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        // Written so that NaN is not in front either.
        (p_cam.z > MIN_DEPTH_M).then(|| {
            let xy = p_cam.xy() / p_cam.z;
            self.centre + xy * (self.f * (1.0 + self.k1 * xy.norm_squared()))
        })
    }

    /// The direction (x, y, 1) in camera coordinates that is seen at an image point.
    pub fn ray(&self, uv: &Vector2<f64>) -> Vector3<f64> {
        let distorted = (uv - self.centre) / self.f;
        let mut xy = distorted;
        if self.k1 != 0.0 {
            // Fixed-point inversion; contracts while 3 |k1| r^2 < 1.
            for _ in 0..UNDISTORT_STEPS {
                xy = distorted / (1.0 + self.k1 * xy.norm_squared());
            }
        }
        Vector3::new(xy.x, xy.y, 1.0)
    }

    /// d(u, v) / d(x, y, z) at a point in camera coordinates, 2 x 3, px per m.
    pub fn jacobian(&self, p_cam: &Vector3<f64>) -> nalgebra::Matrix2x3<f64> {
        let (iz, x, y) = (1.0 / p_cam.z, p_cam.x / p_cam.z, p_cam.y / p_cam.z);
        let r2 = x * x + y * y;
        let s = 1.0 + self.k1 * r2;
        let cross = 2.0 * self.k1;
        let d = Matrix2::new(s + cross * x * x, cross * x * y, cross * x * y, s + cross * y * y);
        let pinhole = nalgebra::Matrix2x3::new(iz, 0.0, -x * iz, 0.0, iz, -y * iz);
        self.f * d * pinhole
    }
}

/// Points closer to the camera plane than this are not projected, m.
const MIN_DEPTH_M: f64 = 1e-6;
/// Iterations of the distortion inverse; 20 reach 1e-12 for |k1| r^2 < 0.1.
const UNDISTORT_STEPS: usize = 20;

/// A rigid transform `cam_from_world`: p_cam = R p_world + t.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Rotation part R.
    pub rotation: Rotation3<f64>,
    /// Translation part t, m.
    pub translation: Vector3<f64>,
}

impl Pose {
    /// From OpenCV's rvec (the rotation vector of the paper's Proposition 1, rad) and
    /// tvec (m).
    pub fn from_vectors(rvec: Vector3<f64>, tvec: Vector3<f64>) -> Self {
        Pose { rotation: Rotation3::new(rvec), translation: tvec }
    }

    /// The rotation vector, rad.
    pub fn rvec(&self) -> Vector3<f64> {
        self.rotation.scaled_axis()
    }

    /// The point in camera coordinates, m.
    pub fn transform(&self, p_world: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * p_world + self.translation
    }

    /// Where the camera stands in world coordinates, m.
    pub fn camera_centre(&self) -> Vector3<f64> {
        -(self.rotation.inverse() * self.translation)
    }
}

/// A calibrated camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Width and height of the picture, px.
    pub image_size: [u32; 2],
    /// The lens.
    pub lens: Lens,
    /// The pose over the road.
    pub pose: Pose,
    /// Curvature of the road's profile along Y, 1/m: above 0 a crest, 0 a level road.
    pub crest_per_m: f64,
}

/// Steps onto a curved road; 6 reach 1e-6 m where the road falls by less than the camera's
/// height.
const PROFILE_STEPS: usize = 6;

impl Camera {
    /// The image point (px) of a world point (m), or `None` behind the camera.
    pub fn project(&self, p_world: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.lens.project(&self.transform(p_world))
    }

    /// A world point in camera coordinates, m.
    pub fn transform(&self, p_world: &Vector3<f64>) -> Vector3<f64> {
        let below = 0.5 * self.crest_per_m * p_world.y * p_world.y;
        self.pose.transform(&Vector3::new(p_world.x, p_world.y, p_world.z - below))
    }

    /// The world point (m) at height `z_m` above the road that is seen at an image
    /// point (px): the paper's Eq. backproj with Z known, two equations in X and Y.
    /// `None` when the ray does not reach that height in front of the camera, that is
    /// at or above the horizon.
    pub fn back_project(&self, uv: &Vector2<f64>, z_m: f64) -> Option<Vector3<f64>> {
        let centre = self.pose.camera_centre();
        let ray = self.pose.rotation.inverse() * self.lens.ray(uv);
        let mut steps = (z_m - centre.z) / ray.z;
        if !steps.is_finite() || steps <= 0.0 {
            return None;
        }
        if self.crest_per_m != 0.0 {
            for _ in 0..PROFILE_STEPS {
                let y = centre.y + ray.y * steps;
                let profile = z_m - 0.5 * self.crest_per_m * y * y;
                // Beyond the top of a crest, or where a sag would meet the camera.
                if (profile - z_m).abs() > 2.0 * centre.z {
                    return None;
                }
                steps = (profile - centre.z) / ray.z;
            }
            if steps <= 0.0 {
                return None;
            }
        }
        let p = centre + ray * steps;
        Some(Vector3::new(p.x, p.y, z_m))
    }

    /// The focal length matrix K of the paper's Eq. full_PnP_eq (without distortion).
    pub fn intrinsic_matrix(&self) -> Matrix3<f64> {
        let Lens { f, centre, .. } = self.lens;
        Matrix3::new(f, 0.0, centre.x, 0.0, f, centre.y, 0.0, 0.0, 1.0)
    }

    /// Height of the camera above the road, m.
    pub fn height_m(&self) -> f64 {
        self.pose.camera_centre().z
    }

    /// Angle of the optical axis below the horizontal, rad.
    pub fn tilt_rad(&self) -> f64 {
        let axis = self.pose.rotation.inverse() * Vector3::z();
        (-axis.z).clamp(-1.0, 1.0).asin()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn over_a_road() -> Camera {
        Camera {
            image_size: [320, 240],
            lens: Lens::centred(401.86, [320, 240]),
            pose: Pose::from_vectors(
                Vector3::new(1.8936, 0.1869, -0.1925),
                Vector3::new(-3.901, 6.036, 44.410),
            ),
            crest_per_m: 0.0,
        }
    }

    #[test]
    fn back_projection_inverts_projection_at_any_height() {
        let mut camera = over_a_road();
        for k1 in [0.0, -0.12, 0.08] {
            camera.lens.k1 = k1;
            for (x, y, z) in [(0.0, 0.0, 0.0), (3.0, -12.0, 0.9), (-5.0, 20.0, 1.5)] {
                let p = Vector3::new(x, y, z);
                let uv = camera.project(&p).expect("in front of the camera");
                let q = camera.back_project(&uv, z).expect("below the horizon");
                assert!((p - q).norm() < 1e-9, "{p} {q}");
            }
        }
    }

    #[test]
    fn the_sky_is_not_on_the_road() {
        assert_eq!(over_a_road().back_project(&Vector2::new(160.0, -400.0), 0.0), None);
    }

    #[test]
    fn lens_jacobian_matches_differences() {
        let lens = Lens { f: 400.0, centre: Vector2::new(160.0, 120.0), k1: -0.2 };
        let p = Vector3::new(2.0, -3.0, 20.0);
        let j = lens.jacobian(&p);
        for axis in 0..3 {
            let mut d = Vector3::zeros();
            d[axis] = 1e-5;
            let diff = (lens.project(&(p + d)).unwrap() - lens.project(&(p - d)).unwrap()) / 2e-5;
            assert!((j.column(axis) - diff).norm() < 1e-6);
        }
    }
}
