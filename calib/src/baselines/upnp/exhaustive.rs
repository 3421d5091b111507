//! UPnP's closed forms: factors of one, two or three null vectors and the focal length.
//!
//! The squared distances between control points are linear in the products b_ab of the factors
//! and in f^2 b_ab. One and two null vectors have as many products as there are distances, or
//! fewer: linear least squares. Three have 12 products for 6 distances. What is left open is
//! closed by what makes them products at all, b_ab b_cd = b_ac b_bd with and without f^2
//! (relinearisation): 60 quadratic equations, linear in the 28 products of the 7 unknown
//! coordinates of the solution space.
//!
//! Each solution determines factors and focal length in several ways, which agree on exact
//! points only. All are tried ("exhaustive"); the reprojection error chooses.
//!
//! Owns these closed forms. Does not own the choice nor the Gauss-Newton step (see `upnp`).

use super::{Unknowns, VECTORS};
use nalgebra::{DMatrix, DVector, SMatrix, SVector, Vector3};

/// Index pairs of the products of n factors, without the focal length.
fn products(n: usize) -> Vec<(usize, usize)> {
    (0..n).flat_map(|a| (a..n).map(move |b| (a, b))).collect()
}

/// The edges' squared lengths as a linear form in the products of n factors, first without,
/// then with the squared focal length.
fn form(edges: &[Vec<Vector3<f64>>], n: usize) -> DMatrix<f64> {
    let products = products(n);
    let k = products.len();
    let mut form = DMatrix::zeros(edges[0].len(), 2 * k);
    for row in 0..form.nrows() {
        for (column, &(a, b)) in products.iter().enumerate() {
            let (p, q) = (edges[a][row], edges[b][row]);
            let twice = if a == b { 1.0 } else { 2.0 };
            form[(row, column)] = twice * (p.x * q.x + p.y * q.y);
            form[(row, k + column)] = twice * p.z * q.z;
        }
    }
    form
}

/// Every reading of the closed form with n null vectors. `edges` are those between control
/// points in each null vector, `squared` their true squared lengths.
pub(super) fn solve(edges: &[Vec<Vector3<f64>>], squared: &[f64], n: usize) -> Vec<Unknowns> {
    if n < VECTORS {
        linear(edges, squared, n).map_or(Vec::new(), |x| readings(&x, n))
    } else {
        relinearised(edges, squared).iter().flat_map(|x| readings(x, n)).collect()
    }
}

fn linear(edges: &[Vec<Vector3<f64>>], squared: &[f64], n: usize) -> Option<Vec<f64>> {
    let rho = DVector::from_column_slice(squared);
    let x = form(edges, n).svd(true, true).solve(&rho, 1e-14).ok()?;
    Some(x.iter().copied().collect())
}

/// Products of three factors without and with f^2, and the one that makes them homogeneous.
const HOMOGENEOUS: usize = 13;
/// Dimension of the solution space of 6 equations in these.
const OPEN: usize = HOMOGENEOUS - 6;

/// The likely vectors of products with three null vectors.
fn relinearised(edges: &[Vec<Vector3<f64>>], squared: &[f64]) -> Vec<Vec<f64>> {
    // The last coordinate in units that make it about as large as the first product.
    let Some(unit) = linear(edges, squared, 1).map(|x| x[0].abs()).filter(|u| *u > 0.0) else {
        return Vec::new();
    };
    let mut system = DMatrix::zeros(HOMOGENEOUS, HOMOGENEOUS);
    system.view_mut((0, 0), (6, 12)).copy_from(&form(edges, VECTORS));
    for (row, square) in squared.iter().enumerate() {
        system[(row, 12)] = -square / unit;
    }
    let Some(open) = null_space(system, OPEN) else { return Vec::new() };
    // Quadratic equations on the coordinates in the open space.
    let monomials = products(OPEN);
    let quadrics = quadrics();
    let mut equations = DMatrix::zeros(quadrics.len(), monomials.len());
    for (row, [(i, j), (k, l)]) in quadrics.into_iter().enumerate() {
        for (column, &(a, b)) in monomials.iter().enumerate() {
            let product =
                |i: usize, j: usize| open[(i, a)] * open[(j, b)] + open[(i, b)] * open[(j, a)];
            let half = if a == b { 0.5 } else { 1.0 };
            equations[(row, column)] = half * (product(i, j) - product(k, l));
        }
    }
    let Some(found) = null_space(equations, 1) else { return Vec::new() };
    let mut gram = SMatrix::<f64, OPEN, OPEN>::zeros();
    for (value, &(a, b)) in found.iter().zip(&monomials) {
        gram[(a, b)] = *value;
        gram[(b, a)] = *value;
    }
    // Of rank one on exact points: each row, and the leading eigenvector, is the solution.
    let eigen = gram.symmetric_eigen();
    let leading = eigen.eigenvectors.column(eigen.eigenvalues.iamax()).into_owned();
    let rows = (0..OPEN).map(|k| gram.column(k).into_owned());
    std::iter::once(leading)
        .chain(rows)
        .filter_map(|c: SVector<f64, OPEN>| {
            let y = &open * c;
            let last = y[12] / unit;
            (last.abs() > f64::EPSILON * y.norm() / unit)
                .then(|| y.iter().take(12).map(|v| v / last).collect())
        })
        .collect()
}

/// What all vectors of products satisfy, as y_i y_j = y_k y_l: the minors of the matrix of
/// products b_ab (a and f^2 a down, b across) and of that with f^2 down and ab across.
fn quadrics() -> Vec<[(usize, usize); 2]> {
    let index = |a: usize, b: usize| {
        let (a, b) = (a.min(b), a.max(b));
        [0, 3, 5][a] + b - a
    };
    let at = |row: usize, column: usize| 6 * (row / VECTORS) + index(row % VECTORS, column);
    let mut all = Vec::new();
    for (p, q) in pairs(2 * VECTORS) {
        for (r, s) in pairs(VECTORS) {
            all.push([(at(p, r), at(q, s)), (at(p, s), at(q, r))]);
        }
    }
    for (r, s) in pairs(6) {
        all.push([(r, 6 + s), (s, 6 + r)]);
    }
    all
}

fn pairs(n: usize) -> impl Iterator<Item = (usize, usize)> {
    crate::baselines::epnp::pairs_of(n)
}

/// Orthonormal vectors that the matrix all but annihilates, as columns.
fn null_space(matrix: DMatrix<f64>, count: usize) -> Option<DMatrix<f64>> {
    if !matrix.iter().all(|x| x.is_finite()) {
        return None;
    }
    let v_t = matrix.svd(false, true).v_t?;
    let n = v_t.nrows();
    Some(v_t.rows(n - count, count).transpose())
}

/// The ways to read factors and focal length from the products of n factors.
fn readings(x: &[f64], n: usize) -> Vec<Unknowns> {
    let products = products(n);
    let (plain, with_f2) = x.split_at(products.len());
    let squared = |values: &[f64]| -> f64 { values.iter().map(|v| v * v).sum() };
    let together: f64 = plain.iter().zip(with_f2).map(|(p, q)| p * q).sum();
    let ratios = plain.iter().zip(with_f2).map(|(p, q)| q / p);
    let mut focals: Vec<f64> = std::iter::once(together / squared(plain))
        .chain(ratios)
        .filter(|r| r.is_finite() && *r > 0.0)
        .map(f64::sqrt)
        .collect();
    focals.dedup();
    let factors = |values: &[f64], a: usize| -> Option<[f64; VECTORS]> {
        let of = |b: usize| {
            let place = products.iter().position(|&p| p == (a.min(b), a.max(b)));
            place.map_or(0.0, |k| values[k])
        };
        let own = of(a).abs().sqrt();
        let sign = of(a).signum();
        (own > 0.0).then(|| std::array::from_fn(|b| if b == a { own } else { sign * of(b) / own }))
    };
    let mut all = Vec::new();
    for &focal in &focals {
        for a in 0..n {
            let as_with: Vec<f64> = with_f2.iter().map(|v| v / (focal * focal)).collect();
            all.extend(factors(plain, a).map(|betas| Unknowns { betas, focal }));
            all.extend(factors(&as_with, a).map(|betas| Unknowns { betas, focal }));
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn exact_distances_give_all_factors_and_the_focal_length() {
        let mut rng = ChaCha8Rng::seed_from_u64(12);
        for n in 1..=VECTORS {
            for trial in 0..40 {
                let edges: Vec<Vec<Vector3<f64>>> = (0..VECTORS)
                    .map(|_| {
                        (0..6)
                            .map(|_| Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0)))
                            .collect()
                    })
                    .collect();
                let betas: [f64; VECTORS] =
                    std::array::from_fn(|a| if a < n { rng.random_range(0.5..3.0) } else { 0.0 });
                let focal: f64 = rng.random_range(0.5..2.0);
                let squared: Vec<f64> = (0..6)
                    .map(|row| {
                        let edge: Vector3<f64> =
                            (0..VECTORS).map(|a| edges[a][row] * betas[a]).sum();
                        edge.xy().norm_squared() + (focal * edge.z).powi(2)
                    })
                    .collect();
                let found = solve(&edges, &squared, n);
                let off = |u: &Unknowns| {
                    let sign = if u.betas[0] < 0.0 { -1.0 } else { 1.0 };
                    (0..VECTORS).map(|a| (sign * u.betas[a] - betas[a]).abs()).sum::<f64>()
                        + (u.focal - focal).abs()
                };
                let best = found.iter().map(off).fold(f64::INFINITY, f64::min);
                assert!(best < 1e-6, "{n} vectors, trial {trial}: off by {best}");
                // On exact distances all readings agree, not only one of them.
                let worst = found.iter().map(off).fold(0.0, f64::max);
                assert!(worst < 1e-3, "{n} vectors, trial {trial}: a reading off by {worst}");
            }
        }
    }
}
