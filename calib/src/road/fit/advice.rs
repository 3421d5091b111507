//! What to add to a fit that is not known well enough.
//!
//! Owns trying each further cue: how much of an error it would take away. Does
//! not own the limits (see `trust`).

use super::STRETCH_M;
use super::cues::{Cues, LANE_WIDTH_M, READING_PX, STATED_WIDTH_SD_M};
use super::errors::RoadErrors;
use crate::length_error::{CameraCovariance, UncertainCamera};
use nalgebra::{Vector2, Vector3, Vector6};

/// A length that somebody could add.
struct Candidate {
    text: &'static str,
    ends: [Vector2<f64>; 2],
    /// How well it would be known, as a part of it.
    rel_sd: f64,
}

/// How well a tape measures a length, as a part of it.
const TAPE_REL_SD: f64 = 0.01;

/// The one further cue that leaves the smallest error of the whole stretch, in words.
pub fn best_along(known: &UncertainCamera, errors: &RoadErrors) -> Option<String> {
    let whole = known.gradient(&[[errors.near.at.into(), errors.far.at.into()]])?;
    best(known, candidates(known, errors)?, &whole)
}

/// The one further cue that leaves the smallest error across the road where it is worst, in words.
pub fn best_across(known: &UncertainCamera, cues: &Cues, errors: &RoadErrors) -> Option<String> {
    let worst = errors.worst_across();
    let mut all = candidates(known, errors)?;
    let (near, across) = (ground(known, errors.near.at)?, across(known, errors)?);
    if !cues.lanes.is_empty() && cues.lane_width_m.is_none() {
        let [width_m, _] = LANE_WIDTH_M;
        let half = across * (0.5 * width_m);
        let rel_sd = STATED_WIDTH_SD_M / width_m;
        let text = "the width of the lanes (--lane-width)";
        all.push(Candidate { text, ends: [near - half, near + half], rel_sd });
    }
    let (at, half) = (ground(known, worst.at)?, across * (0.5 * worst.error.length_m));
    let ends = [image(known, at - half)?, image(known, at + half)?];
    best(known, all, &known.gradient(&[ends])?)
}

fn ground(known: &UncertainCamera, at: [f64; 2]) -> Option<Vector2<f64>> {
    Some(known.camera.back_project(&at.into(), 0.0)?.xy())
}

fn image(known: &UncertainCamera, p: Vector2<f64>) -> Option<Vector2<f64>> {
    known.camera.project(&Vector3::new(p.x, p.y, 0.0))
}

fn across(known: &UncertainCamera, errors: &RoadErrors) -> Option<Vector2<f64>> {
    let (near, far) = (ground(known, errors.near.at)?, ground(known, errors.far.at)?);
    let along = (far - near).try_normalize(1e-6)?;
    Some(Vector2::new(along.y, -along.x))
}

/// Lengths that somebody could measure with a tape.
fn candidates(known: &UncertainCamera, errors: &RoadErrors) -> Option<Vec<Candidate>> {
    let (near, far) = (ground(known, errors.near.at)?, ground(known, errors.far.at)?);
    let across = across(known, errors)?;
    let along = Vector2::new(-across.y, across.x);
    let pair = |at: Vector2<f64>, d: Vector2<f64>| [at, at + d * (2.0 * STRETCH_M)];
    let lengths = [
        ("one more length along the road at the far end", pair(far, -along)),
        ("one more length along the road at the near end", pair(near, along)),
        ("one more length across the road at the far end", pair(far, across)),
        ("one more length across the road at the near end", pair(near, across)),
        ("one long length along the whole road", [near, far]),
    ];
    let rel_sd = TAPE_REL_SD;
    Some(lengths.into_iter().map(|(text, ends)| Candidate { text, ends, rel_sd }).collect())
}

/// The candidate that leaves the smallest error of what changes so with the unknowns.
fn best(
    known: &UncertainCamera,
    candidates: Vec<Candidate>,
    target: &Vector6<f64>,
) -> Option<String> {
    let after = |candidate: &Candidate| {
        let [a, b] = [image(known, candidate.ends[0])?, image(known, candidate.ends[1])?];
        let gradient = known.gradient(&[[a, b]])?;
        let reading = READING_PX * std::f64::consts::SQRT_2 / (a - b).norm().max(1.0);
        let noise = reading.hypot(candidate.rel_sd);
        let spread = known.covariance * gradient;
        let gain = spread * spread.transpose() / (gradient.dot(&spread) + noise * noise);
        let left: CameraCovariance = known.covariance - gain;
        let variance = target.dot(&(left * target));
        variance.is_finite().then_some((variance, candidate.text))
    };
    candidates
        .iter()
        .filter_map(after)
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, text)| text.to_owned())
}
