//! Refinement of one vehicle's pose on its reprojection error (Gauss-Newton with
//! Levenberg-Marquardt damping), with the focal length fixed or free.
//!
//! Owns the least-squares problem of a single vehicle: PnP with 6 and PnPf with 7
//! unknowns. It is the "+GN" of the baselines. Does not own several vehicles at once (see
//! `joint`).

use crate::camera::{Lens, Pose};
use crate::vehicle::Pair;
use nalgebra::{Rotation3, SMatrix, SVector, Vector3};

/// What may move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Free {
    /// Rotation and translation only.
    Pose,
    /// Rotation, translation and focal length.
    PoseAndFocal,
}

/// A refined pose with its lens and what it cost.
#[derive(Clone, Copy, Debug)]
pub struct Refined {
    /// The lens, its focal length changed when it was free.
    pub lens: Lens,
    /// The pose.
    pub pose: Pose,
    /// Root mean square reprojection error, px.
    pub rms_px: f64,
    /// Steps taken.
    pub steps: usize,
}

const MAX_STEPS: usize = 60;
const INITIAL_DAMPING: f64 = 1e-3;
const MAX_DAMPING: f64 = 1e10;
/// Relative decrease of the cost below which the refinement has converged.
const COST_TOLERANCE: f64 = 1e-14;

/// Refines from a start. `None` when the start puts a point behind the camera.
pub fn refine(pairs: &[Pair], lens: Lens, pose: Pose, free: Free) -> Option<Refined> {
    let mut state = (lens, pose);
    let mut cost = cost(pairs, &state)?;
    let mut damping = INITIAL_DAMPING;
    let mut steps = 0;
    while steps < MAX_STEPS && damping < MAX_DAMPING {
        steps += 1;
        let (normal, gradient) = linearise(pairs, &state, free);
        let mut damped = normal;
        for k in 0..7 {
            damped[(k, k)] += damping * normal[(k, k)].max(1e-12);
        }
        let trial = damped.cholesky().map(|c| moved(&state, &-c.solve(&gradient)));
        let trial_cost = trial.as_ref().and_then(|t| self::cost(pairs, t));
        match (trial, trial_cost) {
            (Some(trial), Some(lower)) if lower < cost => {
                let converged = cost - lower <= COST_TOLERANCE * cost;
                (state, cost) = (trial, lower);
                damping = (damping * 0.2).max(1e-12);
                if converged {
                    break;
                }
            }
            _ => damping *= 8.0,
        }
    }
    let rms_px = (cost / pairs.len() as f64).sqrt();
    Some(Refined { lens: state.0, pose: state.1, rms_px, steps })
}

/// Sum of squared distances, px^2; `None` when a point is behind the camera.
fn cost(pairs: &[Pair], (lens, pose): &(Lens, Pose)) -> Option<f64> {
    pairs
        .iter()
        .map(|p| Some((lens.project(&pose.transform(&p.world))? - p.image).norm_squared()))
        .sum()
}

/// Normal matrix and gradient over (rotation, translation, log f).
fn linearise(
    pairs: &[Pair],
    (lens, pose): &(Lens, Pose),
    free: Free,
) -> (SMatrix<f64, 7, 7>, SVector<f64, 7>) {
    let mut normal = SMatrix::zeros();
    let mut gradient = SVector::zeros();
    for pair in pairs {
        let rotated = pose.rotation * pair.world;
        let p_cam = rotated + pose.translation;
        let Some(uv) = lens.project(&p_cam) else { continue };
        let by_point = lens.jacobian(&p_cam);
        let mut j = SMatrix::<f64, 2, 7>::zeros();
        j.fixed_columns_mut::<3>(0).copy_from(&(by_point * -rotated.cross_matrix()));
        j.fixed_columns_mut::<3>(3).copy_from(&by_point);
        if free == Free::PoseAndFocal {
            j.set_column(6, &(uv - lens.centre));
        }
        normal += j.transpose() * j;
        gradient += j.transpose() * (uv - pair.image);
    }
    if free == Free::Pose {
        normal[(6, 6)] = 1.0;
    }
    (normal, gradient)
}

fn moved((lens, pose): &(Lens, Pose), step: &SVector<f64, 7>) -> (Lens, Pose) {
    let turn = Rotation3::new(Vector3::new(step[0], step[1], step[2]));
    let pose = Pose {
        rotation: turn * pose.rotation,
        translation: pose.translation + Vector3::new(step[3], step[4], step[5]),
    };
    (Lens { f: lens.f * step[6].clamp(-1.0, 1.0).exp(), ..*lens }, pose)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    #[test]
    fn a_disturbed_start_returns_to_the_truth() {
        let lens = Lens { f: 400.0, centre: Vector2::new(160.0, 120.0), k1: 0.0 };
        let pose = Pose::from_vectors(Vector3::new(1.9, 0.2, -0.2), Vector3::new(-4.0, 6.0, 20.0));
        let model = crate::model::parse_models(include_str!("../../data/vehicles.json")).unwrap();
        let pairs: Vec<Pair> = model[0]
            .points
            .iter()
            .flatten()
            .map(|w| Pair { world: *w, image: lens.project(&pose.transform(w)).unwrap() })
            .collect();
        let start =
            Pose::from_vectors(Vector3::new(1.8, 0.25, -0.1), Vector3::new(-4.5, 6.5, 23.0));
        let fixed = refine(&pairs, lens, start, Free::Pose).unwrap();
        assert!(fixed.rms_px < 1e-6 && (fixed.pose.translation - pose.translation).norm() < 1e-4);
        let wrong = Lens { f: 330.0, ..lens };
        let free = refine(&pairs, wrong, start, Free::PoseAndFocal).unwrap();
        assert!(free.rms_px < 1e-5 && (free.lens.f - 400.0).abs() < 0.1, "{free:?}");
    }
}
