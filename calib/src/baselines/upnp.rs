//! UPnP: pose and focal length of one vehicle at once, in closed form.
//!
//! Owns the baseline of Penate-Sanchez, Andrade-Cetto and Moreno-Noguer, "Exhaustive
//! Linearization for Robust Camera Pose and Focal Length Estimation", TPAMI 35 (2013).
//! (Not Kneip's Universal PnP of the same name; and OpenCV's SOLVEPNP_UPNP runs EPnP.)
//!
//! As EPnP, with the depth of each control point divided by the focal length among the
//! unknowns; the distances between control points then fix the scale and the focal length.
//! Closed forms for one, two and three null vectors (N = 1, 2, 3) are in `exhaustive`. Needs
//! at least 6 points that are not in a plane.

mod exhaustive;

use crate::baselines::epnp::{ControlPoints, kernel, mean_error_px, pairs_of, rigid_transform};
use crate::camera::{Lens, Pose};
use crate::vehicle::Pair;
use nalgebra::{DMatrix, DVector, Vector3};
use std::ops::RangeInclusive;

/// Fewest points: 12 equations for the 12 unknowns of the control points.
pub const MIN_POINTS: usize = 6;
/// Null vectors that are combined at most.
const VECTORS: usize = 3;
const STEPS: usize = 20;

/// A camera from a single vehicle.
#[derive(Clone, Copy, Debug)]
pub struct Solution {
    /// The lens with its focal length.
    pub lens: Lens,
    /// The pose.
    pub pose: Pose,
    /// Mean reprojection error, px.
    pub error_px: f64,
}

/// The closed form; with `gauss_newton` the combination of null vectors and the focal
/// length are refined on the distances between control points (UPnP+GN). `centre` is a
/// lens whose principal point counts and whose focal length only sets a unit.
pub fn solve(pairs: &[Pair], centre: &Lens, gauss_newton: bool) -> Option<Solution> {
    if pairs.len() < MIN_POINTS {
        return None;
    }
    solve_with(pairs, centre, gauss_newton, 1..=VECTORS)
}

/// The same from these numbers of null vectors.
fn solve_with(
    pairs: &[Pair],
    centre: &Lens,
    gauss_newton: bool,
    vectors_used: RangeInclusive<usize>,
) -> Option<Solution> {
    let control = ControlPoints::of(pairs).filter(|c| c.points.len() == 4)?;
    let alphas: Vec<DVector<f64>> = pairs.iter().map(|p| control.barycentric(&p.world)).collect();
    let vectors = kernel(pairs, &alphas, centre, 4);
    let edges = Edges::of(&vectors, control.squared_distances());
    let camera_of = |u: &Unknowns| {
        reconstruct(pairs, centre, &alphas, &vectors, u).map(|solution| (*u, solution))
    };
    let least_error = |all: Vec<(Unknowns, Solution)>| {
        all.into_iter().min_by(|a, b| a.1.error_px.total_cmp(&b.1.error_px))
    };
    let of_each = vectors_used.filter_map(|n| {
        let readings = exhaustive::solve(&edges.by_vector, &edges.squared, n);
        let (unknowns, solution) = least_error(readings.iter().filter_map(camera_of).collect())?;
        if gauss_newton {
            camera_of(&edges.gauss_newton(unknowns))
        } else {
            Some((unknowns, solution))
        }
    });
    least_error(of_each.collect()).map(|(_, solution)| solution)
}

/// Factors of the null vectors, and the focal length in units of the given lens.
#[derive(Clone, Copy, Debug)]
struct Unknowns {
    betas: [f64; VECTORS],
    focal: f64,
}

/// Edges between control points in each null vector, and their true squared lengths.
struct Edges {
    by_vector: Vec<Vec<Vector3<f64>>>,
    squared: Vec<f64>,
}

impl Edges {
    fn of(kernel: &[Vec<Vector3<f64>>], squared: Vec<f64>) -> Self {
        let by_vector = kernel[..VECTORS]
            .iter()
            .map(|v| pairs_of(4).map(|(i, j)| v[i] - v[j]).collect())
            .collect();
        Edges { by_vector, squared }
    }

    fn gauss_newton(&self, mut now: Unknowns) -> Unknowns {
        for _ in 0..STEPS {
            let mut jacobian = DMatrix::zeros(6, VECTORS + 1);
            let mut residual = DVector::zeros(6);
            for row in 0..6 {
                let edge: Vector3<f64> =
                    (0..VECTORS).map(|a| self.by_vector[a][row] * now.betas[a]).sum();
                let z2 = edge.z * edge.z;
                let f2 = now.focal * now.focal;
                residual[row] = self.squared[row] - (edge.xy().norm_squared() + f2 * z2);
                for a in 0..VECTORS {
                    let v = self.by_vector[a][row];
                    jacobian[(row, a)] = 2.0 * (edge.x * v.x + edge.y * v.y + f2 * edge.z * v.z);
                }
                jacobian[(row, VECTORS)] = 2.0 * now.focal * z2;
            }
            let Ok(step) = jacobian.svd(true, true).solve(&residual, 1e-12) else { break };
            let next = Unknowns {
                betas: std::array::from_fn(|a| now.betas[a] + step[a]),
                focal: now.focal + step[VECTORS],
            };
            if next.focal <= 0.0 || !step.iter().all(|s| s.is_finite()) {
                break;
            }
            now = next;
        }
        now
    }
}

fn reconstruct(
    pairs: &[Pair],
    centre: &Lens,
    alphas: &[DVector<f64>],
    vectors: &[Vec<Vector3<f64>>],
    unknowns: &Unknowns,
) -> Option<Solution> {
    let lens = Lens { f: centre.f * unknowns.focal, ..*centre };
    let control: Vec<Vector3<f64>> = (0..4)
        .map(|j| {
            let p: Vector3<f64> = (0..VECTORS).map(|a| vectors[a][j] * unknowns.betas[a]).sum();
            Vector3::new(p.x, p.y, p.z * unknowns.focal)
        })
        .collect();
    let mut seen: Vec<Vector3<f64>> = alphas
        .iter()
        .map(|alpha| control.iter().zip(alpha.iter()).map(|(c, a)| c * *a).sum())
        .collect();
    if seen.iter().map(|p| p.z).sum::<f64>() < 0.0 {
        seen.iter_mut().for_each(|p| *p = -*p);
    }
    let pose = rigid_transform(pairs.iter().map(|p| p.world), seen.iter().copied())?;
    let error_px = mean_error_px(pairs, &lens, &pose);
    error_px.is_finite().then_some(Solution { lens, pose, error_px })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn scene(rng: &mut ChaCha8Rng, centre: &Lens, f: f64, count: usize) -> (Vec<Pair>, Pose) {
        let lens = Lens { f, ..*centre };
        let mut random = |s: f64| rng.random_range(-s..s);
        let pose = Pose::from_vectors(
            Vector3::new(random(1.0), random(1.0), random(1.0)),
            Vector3::new(random(0.5), random(0.5), 6.0),
        );
        let pairs = (0..count)
            .map(|_| Vector3::new(random(2.0), random(2.0), random(2.0)))
            .map(|world| Pair { world, image: lens.project(&pose.transform(&world)).unwrap() })
            .collect();
        (pairs, pose)
    }

    const CENTRE: Lens = Lens { f: 640.0, centre: Vector2::new(320.0, 240.0), k1: 0.0 };

    #[test]
    fn exact_points_with_depth_give_focal_length_and_pose() {
        let mut rng = ChaCha8Rng::seed_from_u64(2013);
        for f in [400.0, 640.0, 1200.0] {
            for _ in 0..10 {
                let (pairs, pose) = scene(&mut rng, &CENTRE, f, 10);
                for gauss_newton in [false, true] {
                    let found = solve(&pairs, &CENTRE, gauss_newton).unwrap();
                    assert!((found.lens.f / f - 1.0).abs() < 1e-4, "{f}: {found:?}");
                    assert!((found.pose.translation - pose.translation).norm() < 1e-3);
                }
                for n in 1..=VECTORS {
                    let found = solve_with(&pairs, &CENTRE, false, n..=n).unwrap();
                    assert!((found.lens.f / f - 1.0).abs() < 1e-3, "{n} vectors, {f}: {found:?}");
                }
            }
        }
    }

    #[test]
    fn five_points_leave_two_null_vectors_which_both_larger_cases_solve() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for f in [400.0, 640.0, 1200.0] {
            for trial in 0..10 {
                let (pairs, pose) = scene(&mut rng, &CENTRE, f, 5);
                for n in 2..=VECTORS {
                    let found = solve_with(&pairs, &CENTRE, false, n..=n).unwrap();
                    let place = format!("{n} vectors, {f}, {trial}: {found:?}");
                    assert!((found.lens.f / f - 1.0).abs() < 1e-3, "{place}");
                    assert!((found.pose.translation - pose.translation).norm() < 1e-2, "{place}");
                }
            }
        }
    }
}
