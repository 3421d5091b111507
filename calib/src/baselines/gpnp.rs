//! GPnP: pose and focal length of one vehicle from angles between its points.
//!
//! Owns the baseline after Zheng, Sugimoto, Sato and Okutomi, "A General and Simple Method
//! for Camera Pose and Focal Length Determination", CVPR 2014: with two points as a base,
//! each further point gives one polynomial in the base's depth ratio t and in w = f^2,
//! from the angle at the base (linear in the further point's depth) and its length.
//!
//! Reconstructed from the abstract and the geometry; the authors publish no code. They
//! find the stationary points of the polynomials' sum of squares by a Sylvester resultant;
//! here a grid over (log t, log f) finds the same minima and Newton steps polish them,
//! which loses nothing but elegance in two unknowns. Needs at least 4 points.

use crate::baselines::epnp::{mean_error_px, rigid_transform};
use crate::baselines::pose_refinement::{Free, refine};
use crate::baselines::upnp::Solution;
use crate::camera::Lens;
use crate::vehicle::Pair;
use nalgebra::{Matrix2, Vector2, Vector3};

/// Fewest points: two polynomials for two unknowns.
pub const MIN_POINTS: usize = 4;
/// Grid over the depth ratio of the base, log scale: 1/3 to 3 in steps of 1.8 %.
const RATIO: (f64, usize) = (1.1, 123);
/// Grid over the focal length in widths, log scale: 0.14 to 7.4 in steps of 6.6 %.
const FOCAL: (f64, usize) = (2.0, 63);
/// Local minima of the grid that are polished.
const MINIMA: usize = 8;
const NEWTON_STEPS: usize = 30;
const DIFFERENCE: f64 = 1e-5;

/// The solution with the smallest reprojection error; with `gauss_newton` refined on the
/// reprojection error over pose and focal length (GPnP+GN). `unit` is a lens whose
/// principal point counts and whose focal length (px) is the middle of the search.
pub fn solve(pairs: &[Pair], unit: &Lens, gauss_newton: bool) -> Option<Solution> {
    if pairs.len() < MIN_POINTS {
        return None;
    }
    let problem = Triplets::of(pairs, unit)?;
    let mut best: Option<Solution> = None;
    for start in problem.grid_minima() {
        let Some(mut found) = problem.reconstruct(problem.polish(start)) else { continue };
        if gauss_newton && let Some(r) = refine(pairs, found.lens, found.pose, Free::PoseAndFocal) {
            let error_px = mean_error_px(pairs, &r.lens, &r.pose);
            found = Solution { lens: r.lens, pose: r.pose, error_px };
        }
        if best.is_none_or(|b| found.error_px < b.error_px) {
            best = Some(found);
        }
    }
    best
}

/// A base of two points and what each further point must satisfy.
struct Triplets<'a> {
    pairs: &'a [Pair],
    unit: &'a Lens,
    /// Indices of the base's two points.
    base: (usize, usize),
    /// For each further point: its index, the projection of its offset on the base and its
    /// squared length, both in units of the base.
    further: Vec<(usize, f64, f64)>,
    /// Image coordinates in units of the focal length of `unit`.
    image: Vec<Vector2<f64>>,
}

impl<'a> Triplets<'a> {
    fn of(pairs: &'a [Pair], unit: &'a Lens) -> Option<Self> {
        let n = pairs.len();
        let all = (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b)));
        let apart = |&(a, b): &(usize, usize)| (pairs[a].image - pairs[b].image).norm_squared();
        let base = all.max_by(|x, y| apart(x).total_cmp(&apart(y)))?;
        let edge = pairs[base.1].world - pairs[base.0].world;
        let squared = edge.norm_squared();
        if squared <= 0.0 {
            return None;
        }
        let further = (0..n)
            .filter(|k| *k != base.0 && *k != base.1)
            .map(|k| {
                let offset = pairs[k].world - pairs[base.0].world;
                (k, offset.dot(&edge) / squared, offset.norm_squared() / squared)
            })
            .collect();
        let image = pairs.iter().map(|p| (p.image - unit.centre) / unit.f).collect();
        Some(Triplets { pairs, unit, base, further, image })
    }

    /// Direction to a point for a focal length in units of `unit`.
    fn ray(&self, k: usize, focal: f64) -> Vector3<f64> {
        Vector3::new(self.image[k].x, self.image[k].y, focal)
    }

    /// Depth of a further point against the base's first point, from the angle constraint,
    /// and the denominator that the polynomial is multiplied by.
    fn depth(&self, k: usize, along: f64, edge: &Vector3<f64>, focal: f64) -> (f64, f64) {
        let denominator = edge.dot(&self.ray(k, focal));
        let numerator = along * edge.norm_squared() + edge.dot(&self.ray(self.base.0, focal));
        (numerator / denominator, denominator)
    }

    /// Sum of squares of the triplets' polynomials, each divided by its natural size.
    fn cost(&self, at: Vector2<f64>) -> f64 {
        let (ratio, focal) = (at.x.exp(), at.y.exp());
        let origin = self.ray(self.base.0, focal);
        let edge = self.ray(self.base.1, focal) * ratio - origin;
        let squared = edge.norm_squared();
        self.further
            .iter()
            .map(|&(k, along, length2)| {
                let (depth, denominator) = self.depth(k, along, &edge, focal);
                let gap = (self.ray(k, focal) * depth - origin).norm_squared() - length2 * squared;
                let weight = denominator * denominator
                    / (squared * squared * self.ray(k, focal).norm_squared());
                (gap * weight).powi(2)
            })
            .sum()
    }

    fn grid_minima(&self) -> Vec<Vector2<f64>> {
        let at = |i: usize, j: usize| {
            let along =
                |(half, n): (f64, usize), k: usize| half * (2.0 * k as f64 / (n - 1) as f64 - 1.0);
            Vector2::new(along(RATIO, i), along(FOCAL, j))
        };
        let (n, m) = (RATIO.1, FOCAL.1);
        let costs: Vec<Vec<f64>> =
            (0..n).map(|i| (0..m).map(|j| self.cost(at(i, j))).collect()).collect();
        let mut minima: Vec<(f64, Vector2<f64>)> = Vec::new();
        for i in 0..n {
            for j in 0..m {
                let around = (i.saturating_sub(1)..(i + 2).min(n))
                    .flat_map(|a| (j.saturating_sub(1)..(j + 2).min(m)).map(move |b| (a, b)));
                if around.map(|(a, b)| costs[a][b]).all(|c| c >= costs[i][j]) {
                    minima.push((costs[i][j], at(i, j)));
                }
            }
        }
        minima.sort_by(|a, b| a.0.total_cmp(&b.0));
        minima.truncate(MINIMA);
        minima.into_iter().map(|(_, p)| p).collect()
    }

    /// Damped Newton steps on the cost, by differences.
    fn polish(&self, mut at: Vector2<f64>) -> Vector2<f64> {
        let (dx, dy) = (Vector2::new(DIFFERENCE, 0.0), Vector2::new(0.0, DIFFERENCE));
        let mut cost = self.cost(at);
        let mut damping = 1e-3;
        for _ in 0..NEWTON_STEPS {
            let c = |p: Vector2<f64>| self.cost(at + p);
            let gradient = Vector2::new(c(dx) - c(-dx), c(dy) - c(-dy)) / (2.0 * DIFFERENCE);
            let h2 = DIFFERENCE * DIFFERENCE;
            let xx = (c(dx) - 2.0 * cost + c(-dx)) / h2;
            let yy = (c(dy) - 2.0 * cost + c(-dy)) / h2;
            let xy = (c(dx + dy) - c(dx - dy) - c(dy - dx) + c(-dx - dy)) / (4.0 * h2);
            let hessian = Matrix2::new(xx + damping, xy, xy, yy + damping);
            let Some(step) = hessian.try_inverse().map(|inverse| -(inverse * gradient)) else {
                break;
            };
            let step = step * (0.2 / step.norm().max(0.2));
            let trial = self.cost(at + step);
            if trial < cost {
                (at, cost) = (at + step, trial);
                damping *= 0.3;
            } else {
                damping = (damping * 10.0).max(1e-12);
            }
        }
        at
    }

    fn reconstruct(&self, at: Vector2<f64>) -> Option<Solution> {
        let (ratio, focal) = (at.x.exp(), at.y.exp());
        let edge = self.ray(self.base.1, focal) * ratio - self.ray(self.base.0, focal);
        let mut seen = vec![Vector3::zeros(); self.pairs.len()];
        seen[self.base.0] = self.ray(self.base.0, focal);
        seen[self.base.1] = self.ray(self.base.1, focal) * ratio;
        for &(k, along, _) in &self.further {
            seen[k] = self.ray(k, focal) * self.depth(k, along, &edge, focal).0;
        }
        // Up to here in units of the base's first depth; the base sets the metres.
        let (a, b) = (self.pairs[self.base.0].world, self.pairs[self.base.1].world);
        let scale = (b - a).norm() / edge.norm();
        let seen: Vec<_> = seen.into_iter().map(|p| p * scale).collect();
        let pose = rigid_transform(self.pairs.iter().map(|p| p.world), seen.iter().copied())?;
        let lens = Lens { f: self.unit.f * focal, ..*self.unit };
        let error_px = mean_error_px(self.pairs, &lens, &pose);
        error_px.is_finite().then_some(Solution { lens, pose, error_px })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Pose;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn exact_points_give_focal_length_and_pose() {
        let mut rng = ChaCha8Rng::seed_from_u64(2014);
        let unit = Lens { f: 640.0, centre: Vector2::new(320.0, 240.0), k1: 0.0 };
        for f in [400.0, 640.0, 1200.0] {
            for n in [5, 6, 10] {
                let lens = Lens { f, ..unit };
                let mut random = |s: f64| rng.random_range(-s..s);
                let pose = Pose::from_vectors(
                    Vector3::new(random(1.0), random(1.0), random(1.0)),
                    Vector3::new(random(0.5), random(0.5), 7.0),
                );
                let pairs: Vec<Pair> = (0..n)
                    .map(|_| Vector3::new(random(2.0), random(2.0), random(2.0)))
                    .map(|world| {
                        let image = lens.project(&pose.transform(&world)).unwrap();
                        Pair { world, image }
                    })
                    .collect();
                let found = solve(&pairs, &unit, false).unwrap();
                assert!(found.error_px < 0.5, "{f} {n}: {found:?}");
                let found = solve(&pairs, &unit, true).unwrap();
                assert!(found.error_px < 1e-6, "{f} {n}: {found:?}");
                assert!((found.lens.f / f - 1.0).abs() < 1e-4, "{f} {n}: {found:?}");
            }
        }
    }
}
