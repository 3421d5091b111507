//! EPnP: the pose of known points from their image points, focal length known.
//!
//! Owns the closed form of Lepetit, Moreno-Noguer and Fua, "EPnP: An Accurate O(n)
//! Solution to the PnP Problem", IJCV 81 (2009), with the Gauss-Newton step on the betas
//! of its section 4. Does not own outlier rejection (see `candidates`) nor the
//! refinement of the reprojection error (see `pose_refinement`).
//!
//! Limits: at least 4 points, not on one line. Points in a plane use three control
//! points. Two mirror solutions of a distant plane are not told apart.

use crate::camera::{Lens, Pose};
use crate::vehicle::Pair;
use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3, Vector4};

/// Fewest points.
pub const MIN_POINTS: usize = 4;

/// Below this ratio of the smallest to the largest scatter of the points they count as
/// lying in a plane (square of the lengths' ratio).
const PLANAR_RATIO: f64 = 1e-6;
/// Below this ratio of the middle to the largest scatter they lie on a line.
const LINEAR_RATIO: f64 = 1e-9;
/// Gauss-Newton steps on the betas; the paper reports convergence in about 10.
const BETA_STEPS: usize = 10;

/// The pose that EPnP gives and its mean reprojection error (px), or `None` when the
/// points are fewer than [`MIN_POINTS`], on one line, or give no pose in front of the
/// camera.
pub fn solve(pairs: &[Pair], lens: &Lens) -> Option<(Pose, f64)> {
    if pairs.len() < MIN_POINTS {
        return None;
    }
    let control = ControlPoints::of(pairs)?;
    let alphas: Vec<DVector<f64>> = pairs.iter().map(|p| control.barycentric(&p.world)).collect();
    let kernel = kernel(pairs, &alphas, lens, control.points.len());
    let distances = control.squared_distances();
    let mut best: Option<(Pose, f64)> = None;
    for n in 1..=control.points.len() {
        let Some(start) = initial_betas(&kernel, &distances, n) else { continue };
        let betas = gauss_newton(&kernel, &distances, start);
        for betas in [start, betas] {
            let Some(pose) = pose_of(&kernel, &betas, &alphas, pairs) else { continue };
            let error = mean_error_px(pairs, lens, &pose);
            if error.is_finite() && best.is_none_or(|(_, e)| error < e) {
                best = Some((pose, error));
            }
        }
    }
    best
}

/// Mean distance between labelled and projected points, px: the paper's Eq. 2d_loss
/// divided by the number of points. Infinite when a point falls behind the camera.
pub fn mean_error_px(pairs: &[Pair], lens: &Lens, pose: &Pose) -> f64 {
    let sum: f64 = pairs
        .iter()
        .map(|p| {
            lens.project(&pose.transform(&p.world))
                .map_or(f64::INFINITY, |uv| (uv - p.image).norm())
        })
        .sum();
    sum / pairs.len() as f64
}

/// Control points: the centroid and one point along each principal axis (section 3.1).
pub(crate) struct ControlPoints {
    pub(crate) points: Vec<Vector3<f64>>,
    /// Maps a point minus the centroid to the weights of control points 1.. .
    weights_from_offset: DMatrix<f64>,
}

impl ControlPoints {
    pub(crate) fn of(pairs: &[Pair]) -> Option<Self> {
        let n = pairs.len() as f64;
        let centroid = pairs.iter().map(|p| p.world).sum::<Vector3<f64>>() / n;
        let scatter = pairs
            .iter()
            .map(|p| (p.world - centroid) * (p.world - centroid).transpose())
            .sum::<Matrix3<f64>>()
            / n;
        let eigen = scatter.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let value = |k: usize| eigen.eigenvalues[order[k]].max(0.0);
        if value(1) <= LINEAR_RATIO * value(0) {
            return None;
        }
        let axes = if value(2) > PLANAR_RATIO * value(0) { 3 } else { 2 };
        let mut points = vec![centroid];
        let mut weights_from_offset = DMatrix::zeros(axes, 3);
        for (k, &index) in order.iter().enumerate().take(axes) {
            let axis = eigen.eigenvectors.column(index).into_owned();
            let length = value(k).sqrt();
            points.push(centroid + axis * length);
            weights_from_offset.row_mut(k).copy_from(&(axis / length).transpose());
        }
        Some(ControlPoints { points, weights_from_offset })
    }

    /// Weights of all control points, summing to one (Eq. 1 and 2).
    pub(crate) fn barycentric(&self, p: &Vector3<f64>) -> DVector<f64> {
        let rest = &self.weights_from_offset * (p - self.points[0]);
        let mut weights = DVector::zeros(self.points.len());
        weights[0] = 1.0 - rest.sum();
        weights.rows_mut(1, rest.len()).copy_from(&rest);
        weights
    }

    /// Squared distances of all pairs of control points, m^2.
    pub(crate) fn squared_distances(&self) -> Vec<f64> {
        pairs_of(self.points.len())
            .map(|(i, j)| (self.points[i] - self.points[j]).norm_squared())
            .collect()
    }
}

/// All index pairs i < j below n.
pub(crate) fn pairs_of(n: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..n).flat_map(move |i| (i + 1..n).map(move |j| (i, j)))
}

/// The null vectors v_k of M (Eq. 5 to 8), smallest eigenvalue first. Entry k holds the
/// camera coordinates of all control points in the k-th vector.
pub(crate) fn kernel(
    pairs: &[Pair],
    alphas: &[DVector<f64>],
    lens: &Lens,
    count: usize,
) -> Vec<Vec<Vector3<f64>>> {
    let mut m = DMatrix::<f64>::zeros(2 * pairs.len(), 3 * count);
    for (i, (pair, alpha)) in pairs.iter().zip(alphas).enumerate() {
        // Normalised image coordinates keep the columns of M alike in size.
        let ray = lens.ray(&pair.image);
        for j in 0..count {
            m[(2 * i, 3 * j)] = alpha[j];
            m[(2 * i, 3 * j + 2)] = -alpha[j] * ray.x;
            m[(2 * i + 1, 3 * j + 1)] = alpha[j];
            m[(2 * i + 1, 3 * j + 2)] = -alpha[j] * ray.y;
        }
    }
    let eigen = (m.transpose() * m).symmetric_eigen();
    let mut order: Vec<usize> = (0..3 * count).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    order[..count]
        .iter()
        .map(|&k| {
            let v = eigen.eigenvectors.column(k);
            (0..count).map(|j| Vector3::new(v[3 * j], v[3 * j + 1], v[3 * j + 2])).collect()
        })
        .collect()
}

/// Products beta_a beta_b that the case of n vectors solves for, first index first.
fn unknown_products(n: usize, vectors: usize) -> Vec<(usize, usize)> {
    match n {
        1 => vec![(0, 0)],
        2 => vec![(0, 0), (0, 1), (1, 1)],
        // As many unknowns as distances at most: the squares of the third and fourth
        // vector follow from the products with the first (relinearisation cut short).
        3 if vectors == 3 => vec![(0, 0), (0, 1), (0, 2)],
        3 => vec![(0, 0), (0, 1), (1, 1), (0, 2), (1, 2)],
        _ => vec![(0, 0), (0, 1), (0, 2), (0, 3)],
    }
}

/// First guess of the betas from n null vectors: linear in their products (section 3.3).
fn initial_betas(
    kernel: &[Vec<Vector3<f64>>],
    distances: &[f64],
    n: usize,
) -> Option<Vector4<f64>> {
    let products = unknown_products(n, kernel.len());
    let mut l = DMatrix::zeros(distances.len(), products.len());
    for (row, (i, j)) in pairs_of(kernel.len()).enumerate() {
        let d = |a: usize| kernel[a][i] - kernel[a][j];
        for (column, &(a, b)) in products.iter().enumerate() {
            l[(row, column)] = d(a).dot(&d(b)) * if a == b { 1.0 } else { 2.0 };
        }
    }
    let rho = DVector::from_column_slice(distances);
    let solution = l.svd(true, true).solve(&rho, 1e-12).ok()?;
    let first = solution[0].abs().sqrt();
    if first <= 0.0 {
        return None;
    }
    let sign = if solution[0] < 0.0 { -1.0 } else { 1.0 };
    let mut betas = Vector4::zeros();
    betas[0] = first;
    for (&(a, b), value) in products.iter().zip(solution.iter()) {
        if a == 0 && b > 0 {
            betas[b] = sign * value / first;
        }
    }
    Some(betas)
}

/// Gauss-Newton on the betas so that distances between control points are kept
/// (section 4, Eq. 15).
fn gauss_newton(
    kernel: &[Vec<Vector3<f64>>],
    distances: &[f64],
    mut betas: Vector4<f64>,
) -> Vector4<f64> {
    let n = kernel.len();
    for _ in 0..BETA_STEPS {
        let mut jacobian = DMatrix::zeros(distances.len(), n);
        let mut residual = DVector::zeros(distances.len());
        for (row, (i, j)) in pairs_of(n).enumerate() {
            let edge: Vector3<f64> = (0..n).map(|a| (kernel[a][i] - kernel[a][j]) * betas[a]).sum();
            residual[row] = distances[row] - edge.norm_squared();
            for a in 0..n {
                jacobian[(row, a)] = 2.0 * edge.dot(&(kernel[a][i] - kernel[a][j]));
            }
        }
        let Ok(step) = jacobian.svd(true, true).solve(&residual, 1e-12) else { break };
        for a in 0..n {
            betas[a] += step[a];
        }
        if step.norm() < 1e-12 * betas.norm() {
            break;
        }
    }
    betas
}

/// Pose from the betas: camera coordinates of the points, then the rigid transform
/// (Horn's problem, by SVD).
fn pose_of(
    kernel: &[Vec<Vector3<f64>>],
    betas: &Vector4<f64>,
    alphas: &[DVector<f64>],
    pairs: &[Pair],
) -> Option<Pose> {
    let count = kernel.len();
    let control: Vec<Vector3<f64>> =
        (0..count).map(|j| (0..count).map(|k| kernel[k][j] * betas[k]).sum()).collect();
    let mut in_camera: Vec<Vector3<f64>> = alphas
        .iter()
        .map(|alpha| control.iter().zip(alpha.iter()).map(|(c, a)| c * *a).sum())
        .collect();
    if in_camera.iter().map(|p| p.z).sum::<f64>() < 0.0 {
        in_camera.iter_mut().for_each(|p| *p = -*p);
    }
    let pose = rigid_transform(pairs.iter().map(|p| p.world), in_camera.iter().copied())?;
    pairs.iter().all(|p| pose.transform(&p.world).z > 0.0).then_some(pose)
}

/// The rotation and translation that bring `from` closest to `to` in least squares.
pub(crate) fn rigid_transform(
    from: impl ExactSizeIterator<Item = Vector3<f64>> + Clone,
    to: impl ExactSizeIterator<Item = Vector3<f64>> + Clone,
) -> Option<Pose> {
    let n = from.len() as f64;
    let mean_from = from.clone().sum::<Vector3<f64>>() / n;
    let mean_to = to.clone().sum::<Vector3<f64>>() / n;
    let covariance: Matrix3<f64> =
        from.zip(to).map(|(a, b)| (b - mean_to) * (a - mean_from).transpose()).sum();
    if !covariance.iter().all(|x| x.is_finite()) {
        return None;
    }
    let svd = covariance.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let sign = (u.determinant() * v_t.determinant()).signum();
    let rotation = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t;
    let translation = mean_to - rotation * mean_from;
    Some(Pose { rotation: Rotation3::from_matrix_unchecked(rotation), translation })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn scene(
        rng: &mut ChaCha8Rng,
        n: usize,
        depth_m: f64,
        planar: bool,
    ) -> (Vec<Pair>, Lens, Pose) {
        let lens = Lens { f: 800.0, centre: Vector2::new(320.0, 240.0), k1: 0.0 };
        let mut coordinate = |s: f64| rng.random_range(-s..s);
        let pose = Pose::from_vectors(
            Vector3::new(coordinate(2.0), coordinate(2.0), coordinate(2.0)),
            Vector3::new(coordinate(2.0), coordinate(2.0), depth_m),
        );
        let pairs = (0..n)
            .map(|_| {
                let z = if planar { 0.0 } else { coordinate(1.0) };
                let world = Vector3::new(coordinate(2.0), coordinate(2.0), z);
                Pair { world, image: lens.project(&pose.transform(&world)).unwrap() }
            })
            .collect();
        (pairs, lens, pose)
    }

    #[test]
    fn exact_points_give_the_exact_pose_near_and_far() {
        let mut rng = ChaCha8Rng::seed_from_u64(2009);
        for depth_m in [5.0, 10.0, 40.0, 150.0] {
            for n in [6, 7, 8, 20] {
                let (pairs, lens, truth) = scene(&mut rng, n, depth_m, false);
                let (pose, error_px) = solve(&pairs, &lens).unwrap();
                assert!(error_px < 1e-4, "n {n} depth {depth_m}: {error_px} px");
                assert!((pose.translation - truth.translation).norm() < 1e-3 * depth_m);
            }
        }
    }

    #[test]
    fn points_in_a_plane_are_solved() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for depth_m in [5.0, 20.0] {
            let (pairs, lens, _) = scene(&mut rng, 8, depth_m, true);
            assert!(solve(&pairs, &lens).unwrap().1 < 1e-6);
        }
    }

    #[test]
    fn points_on_a_line_and_three_points_are_refused() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let (mut pairs, lens, _) = scene(&mut rng, 6, 20.0, false);
        assert!(solve(&pairs[..3], &lens).is_none());
        for (i, p) in pairs.iter_mut().enumerate() {
            p.world = Vector3::new(i as f64, 2.0 * i as f64, 0.0);
        }
        assert!(solve(&pairs, &lens).is_none());
    }
}
