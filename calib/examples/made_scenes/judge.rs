//! How well joint did on a made scene, and whether its stated error holds.

use crate::made_scene::{Kind, MadeScene};
use mvcalib::joint::Joint;

/// Standard errors to either side of a 90 % interval.
pub const NINETY: f64 = 1.645;

/// Joint on one scene; infinite where it found nothing.
pub struct Judged {
    /// MAPE of the road marks, %.
    pub mape: f64,
    /// Stated standard error of the mean length, as a part of it.
    pub stated: f64,
    /// Error of the mean length in stated standard errors.
    pub z: f64,
}

impl Judged {
    pub fn of(scene: &MadeScene, kind: &Kind, found: Option<&Joint>) -> Self {
        let nothing = [f64::INFINITY; 3];
        let [mape, stated, z] = found.and_then(|j| check(scene, kind, j)).unwrap_or(nothing);
        Judged { mape, stated, z }
    }
}

/// The part of the scenes in which the 90 % interval holds the true mean length.
pub fn held(all: &[Judged]) -> f64 {
    all.iter().filter(|j| j.z.abs() < NINETY).count() as f64 / all.len() as f64
}

fn check(scene: &MadeScene, kind: &Kind, found: &Joint) -> Option<[f64; 3]> {
    let camera = found.camera();
    let stretches: Vec<_> = scene.marks.segments().map(|s| s.ends).collect();
    let lengths = scene.marks.segments().map(|s| s.measure(&camera).ok());
    let mean = lengths.sum::<Option<f64>>()? / stretches.len() as f64;
    let state = &found.estimate.camera;
    let sd = found.covariance.relative_sd(state, kind.image_size, &stretches)?;
    let mape = scene.marks.verify(&camera).ok()?.mape_pct;
    Some([mape, sd, (mean / kind.segment_m).ln() / sd])
}
