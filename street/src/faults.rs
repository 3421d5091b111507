//! Faults of the camera at an instant: sway, a turn to another view, a stuck or
//! black picture.
//!
//! Owns the camera that took a frame, which may differ from the camera as installed. Owns no
//! drawing.

use nalgebra::{Rotation3, Vector3};

use crate::camera::Camera;
use crate::random;
use crate::scene::{Ptz, Scene};

/// Frequency of a lamp pole's sway in wind, Hz.
const SWAY_HZ: f64 = 1.3;

/// The kind of picture that a frame has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Picture {
    /// The street as it is.
    Live,
    /// The last live frame again.
    Frozen,
    /// Nothing.
    Black,
}

/// The camera and the state of the picture at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// The camera before sway: as installed, or after a PTZ move.
    pub aim: Camera,
    /// Rotation of the sway in camera axes.
    pub sway: Rotation3<f64>,
    /// The kind of picture.
    pub picture: Picture,
}

impl View {
    /// The view of a scene at a time after the first frame, s.
    pub fn at(scene: &Scene, seed: u64, time_s: f64) -> Self {
        let faults = &scene.faults;
        let mut aim = scene.camera();
        let away = |ptz: &Ptz| time_s >= ptz.at_s && ptz.until_s.is_none_or(|until| time_s < until);
        if let Some(ptz) = faults.ptz.filter(away) {
            let mut moved = scene.clone();
            moved.camera.pan_deg += ptz.pan_deg;
            moved.camera.tilt_deg += ptz.tilt_deg;
            moved.camera.roll_deg += ptz.roll_deg;
            moved.camera.focal_px *= ptz.zoom;
            aim = moved.camera();
        }
        let sway = if faults.shake_px > 0.0 {
            let reach = faults.shake_px / aim.focal_px;
            let wave = |salt: u64| f64::from(random::smooth(time_s * SWAY_HZ, 0.5, seed ^ salt));
            let (across, down) = (2.0 * wave(0x51) - 1.0, 2.0 * wave(0x52) - 1.0);
            Rotation3::new(Vector3::new(reach * down, reach * across, 0.0))
        } else {
            Rotation3::identity()
        };
        let within = |from: Option<f64>| {
            from.is_some_and(|from| time_s >= from)
                && faults.until_s.is_none_or(|until| time_s < until)
        };
        let picture = if within(faults.black_from_s) {
            Picture::Black
        } else if within(faults.frozen_from_s) {
            Picture::Frozen
        } else {
            Picture::Live
        };
        View { aim, sway, picture }
    }

    /// The camera that took the frame.
    pub fn camera(&self) -> Camera {
        self.aim.turned(&self.sway)
    }
}
