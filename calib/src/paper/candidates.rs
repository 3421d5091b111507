//! Stage 1 of MVCalib, candidate generation: a pose of every vehicle under every model at
//! a default focal length (paper, section MVCalib, "Candidate generation").
//!
//! Owns the two ways to make EPnP robust: RANSAC as the paper says, and the best of all
//! 4-subsets as the authors' program does. Does not own EPnP itself.

use crate::baselines::epnp;
use crate::camera::{Lens, Pose};
use crate::error::{Error, Result};
use crate::problem::Problem;
use crate::vehicle::Pair;
use rand::{SeedableRng, seq::index};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// How wrong labels are kept out of the pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strategy {
    /// Random samples of 4, then EPnP on the largest consensus set (the paper).
    Ransac,
    /// EPnP on every set of 4 points, scored on all points (the authors' program).
    Subsets,
}

/// Random samples of RANSAC. A vehicle has at most 715 sets of 4 points out of 13; with
/// one wrong point in seven, 100 samples miss a clean set with probability 1e-37.
const RANSAC_SAMPLES: usize = 100;
/// A point agrees with a pose within this part of the picture's width: 1 %, 3.2 px of 320.
const INLIER_WIDTH_FRACTION: f64 = 0.01;

/// A pose of one vehicle under one model.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// Index of the vehicle.
    pub vehicle: usize,
    /// Index of the model.
    pub model: usize,
    /// Focal length, px.
    pub f: f64,
    /// The pose over that vehicle's own patch of road.
    pub pose: Pose,
    /// Mean reprojection error over all labelled points, px.
    pub error_px: f64,
}

/// Generates a candidate for each vehicle and model at focal length `f0`, px. Pairs
/// without a pose are left out; a vehicle without any candidate is an error.
pub fn generate(
    problem: &Problem,
    f0: f64,
    strategy: Strategy,
    seed: u64,
) -> Result<Vec<Candidate>> {
    let lens = Lens { f: f0, ..problem.lens(f0) };
    let jobs: Vec<(usize, usize)> = (0..problem.vehicles.len())
        .flat_map(|v| (0..problem.models.len()).map(move |m| (v, m)))
        .collect();
    let tolerance_px = INLIER_WIDTH_FRACTION * f64::from(problem.image_size[0]);
    let found: Vec<Candidate> = jobs
        .par_iter()
        .filter_map(|&(vehicle, model)| {
            let pairs = problem.models[model].pairs(&problem.vehicles[vehicle]);
            let (pose, error_px) = match strategy {
                Strategy::Ransac => {
                    let mut rng = ChaCha8Rng::seed_from_u64(seed);
                    rng.set_stream((vehicle * problem.models.len() + model) as u64);
                    ransac(&pairs, &lens, tolerance_px, &mut rng)
                }
                Strategy::Subsets => best_subset(&pairs, &lens),
            }?;
            Some(Candidate { vehicle, model, f: f0, pose, error_px })
        })
        .collect();
    for (index, vehicle) in problem.vehicles.iter().enumerate() {
        if !found.iter().any(|c| c.vehicle == index) {
            return Err(Error::NoPose {
                vehicle: vehicle.name.clone(),
                models: problem.models.len(),
                detail: "EPnP puts it under the road or behind the camera; check its labels".into(),
            });
        }
    }
    Ok(found)
}

/// A camera over a road looks at it from above.
fn from_above(pose: &Pose) -> bool {
    pose.camera_centre().z > 0.0
}

/// EPnP on random samples of 4; the pose from the largest consensus set, scored on all
/// points (Fischler and Bolles 1981).
pub fn ransac(
    pairs: &[Pair],
    lens: &Lens,
    tolerance_px: f64,
    rng: &mut ChaCha8Rng,
) -> Option<(Pose, f64)> {
    if pairs.len() < epnp::MIN_POINTS {
        return None;
    }
    let mut best: Option<(usize, f64, Vec<Pair>)> = None;
    for _ in 0..RANSAC_SAMPLES {
        let sample: Vec<Pair> =
            index::sample(rng, pairs.len(), epnp::MIN_POINTS).iter().map(|i| pairs[i]).collect();
        let Some((pose, _)) = epnp::solve(&sample, lens).filter(|(p, _)| from_above(p)) else {
            continue;
        };
        let inliers: Vec<Pair> = pairs
            .iter()
            .filter(|p| epnp::mean_error_px(&[**p], lens, &pose) <= tolerance_px)
            .copied()
            .collect();
        if inliers.len() < epnp::MIN_POINTS {
            continue;
        }
        let error = epnp::mean_error_px(&inliers, lens, &pose);
        if best.as_ref().is_none_or(|(n, e, _)| (inliers.len(), -error) > (*n, -*e)) {
            best = Some((inliers.len(), error, inliers));
        }
    }
    let inliers = best.map_or_else(|| pairs.to_vec(), |(_, _, inliers)| inliers);
    let (pose, _) = epnp::solve(&inliers, lens).filter(|(p, _)| from_above(p))?;
    Some((pose, epnp::mean_error_px(pairs, lens, &pose)))
}

/// The best of EPnP on all sets of 4 points, by the mean error over all points.
pub fn best_subset(pairs: &[Pair], lens: &Lens) -> Option<(Pose, f64)> {
    let n = pairs.len();
    let mut best: Option<(Pose, f64)> = None;
    for a in 0..n {
        for b in a + 1..n {
            for c in b + 1..n {
                for d in c + 1..n {
                    let subset = [pairs[a], pairs[b], pairs[c], pairs[d]];
                    let Some((pose, _)) = epnp::solve(&subset, lens) else { continue };
                    let error = epnp::mean_error_px(pairs, lens, &pose);
                    if from_above(&pose) && best.is_none_or(|(_, e)| error < e) {
                        best = Some((pose, error));
                    }
                }
            }
        }
    }
    best.filter(|(_, e)| e.is_finite())
}
