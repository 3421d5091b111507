//! What to add to a fit that is not known well enough.
//!
//! Owns trying each further length: how much of the far end's error it would take away. Does
//! not own the limits (see `trust`).

use super::RoadErrors;
use super::STRETCH_M;
use super::cues::READING_PX;
use crate::road::length_error::{CameraCovariance, UncertainCamera};
use nalgebra::{Vector2, Vector3};

/// A length that somebody could add.
struct Candidate {
    text: &'static str,
    ends: [Vector2<f64>; 2],
}

/// The one further cue that leaves the smallest error of the whole stretch, in words.
pub fn best(known: &UncertainCamera, errors: &RoadErrors) -> Option<String> {
    let ground = |at: [f64; 2]| Some(known.camera.back_project(&at.into(), 0.0)?.xy());
    let (near, far) = (ground(errors.near.at)?, ground(errors.far.at)?);
    let along = (far - near).try_normalize(1e-6)?;
    let across = Vector2::new(along.y, -along.x);
    let pair = |at: Vector2<f64>, d: Vector2<f64>| [at, at + d * (2.0 * STRETCH_M)];
    let candidates = [
        Candidate {
            text: "one more length along the road at the far end",
            ends: pair(far, -along),
        },
        Candidate {
            text: "one more length along the road at the near end",
            ends: pair(near, along),
        },
        Candidate {
            text: "one more length across the road at the far end",
            ends: pair(far, across),
        },
        Candidate {
            text: "one more length across the road at the near end",
            ends: pair(near, across),
        },
        Candidate { text: "one long length along the whole road", ends: [near, far] },
    ];
    let whole = known.gradient(&[[errors.near.at.into(), errors.far.at.into()]])?;
    let after = |candidate: &Candidate| {
        let image = |p: Vector2<f64>| known.camera.project(&Vector3::new(p.x, p.y, 0.0));
        let [a, b] = [image(candidate.ends[0])?, image(candidate.ends[1])?];
        let gradient = known.gradient(&[[a, b]])?;
        // Read to a pixel at each end, measured to a per cent.
        let noise = (READING_PX * std::f64::consts::SQRT_2 / (a - b).norm().max(1.0)).hypot(0.01);
        let spread = known.covariance * gradient;
        let gain = spread * spread.transpose() / (gradient.dot(&spread) + noise * noise);
        let left: CameraCovariance = known.covariance - gain;
        let variance = whole.dot(&(left * whole));
        variance.is_finite().then_some((variance, candidate.text))
    };
    candidates
        .iter()
        .filter_map(after)
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, text)| text.to_owned())
}
