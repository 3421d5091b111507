//! Residuals of lengths and right angles on the road.
//!
//! Owns how reading errors of points become errors of lengths: neighbouring segments share a
//! point, and all segments of a mark share its standard's or tape's error. Does not own the
//! marks' file.

use super::cues::{MarkCue, READING_PX};
use super::view::View;
use nalgebra::{DMatrix, DVector, Vector2};

/// Step of the derivatives with respect to image points, px.
const STEP_PX: f64 = 0.05;
/// A length on a painted road is not known better than this, whatever is stated.
const LEAST_REL_SD: f64 = 2e-3;

/// Logarithms of measured over known length of each segment; `None` above the horizon.
pub fn log_ratios(mark: &MarkCue, view: &View) -> Option<DVector<f64>> {
    let ground: Vec<_> = mark.points.iter().map(|&p| view.ground(p)).collect::<Option<_>>()?;
    let ratio = |w: &[Vector2<f64>]| ((w[1] - w[0]).norm().max(1e-6) / mark.segment_m).ln();
    Some(DVector::from_iterator(ground.len() - 1, ground.windows(2).map(ratio)))
}

/// What whitens the residuals of a mark: the inverse of the Cholesky factor of their
/// covariance.
pub fn whitening(mark: &MarkCue, view: &View) -> Option<DMatrix<f64>> {
    let n = mark.points.len() - 1;
    let shared = mark.rel_sd.max(LEAST_REL_SD);
    let mut covariance = DMatrix::from_element(n, n, shared * shared);
    let mut moved = mark.clone();
    for k in 0..mark.points.len() {
        for axis in 0..2 {
            moved.points[k][axis] += STEP_PX;
            let up = log_ratios(&moved, view);
            moved.points[k][axis] -= 2.0 * STEP_PX;
            let down = log_ratios(&moved, view);
            moved.points[k][axis] += STEP_PX;
            let slope = (up? - down?) * (mark.px_sd / (2.0 * STEP_PX));
            covariance += &slope * slope.transpose();
        }
    }
    for k in 0..n {
        covariance[(k, k)] += LEAST_REL_SD * LEAST_REL_SD;
    }
    covariance.cholesky()?.l().try_inverse()
}

/// Residuals of a rectangle: the cosines of two opposite corners and the ratio of opposite
/// sides.
pub fn rectangle(corners: &[Vector2<f64>; 4], view: &View) -> Option<DVector<f64>> {
    let mut g = [Vector2::zeros(); 4];
    for (g, uv) in g.iter_mut().zip(corners) {
        *g = view.ground(*uv)?;
    }
    let side = |k: usize| g[(k + 1) % 4] - g[k];
    let cosine = |k: usize| {
        let (a, b) = (side(k), side((k + 3) % 4));
        a.dot(&b) / (a.norm() * b.norm()).max(1e-9)
    };
    let ratio = |k: usize| (side(k).norm() / side(k + 2).norm().max(1e-9)).ln();
    Some(DVector::from_vec(vec![cosine(0), cosine(2), ratio(0), side_ratio(side(1), side(3))]))
}

fn side_ratio(a: Vector2<f64>, b: Vector2<f64>) -> f64 {
    (a.norm() / b.norm().max(1e-9)).ln()
}

/// What whitens the residuals of a rectangle.
pub fn rectangle_whitening(corners: &[Vector2<f64>; 4], view: &View) -> Option<DMatrix<f64>> {
    // A painted or paved rectangle is square to about half a degree.
    let mut covariance = DMatrix::from_diagonal_element(4, 4, 0.01 * 0.01);
    let mut moved = *corners;
    for k in 0..4 {
        for axis in 0..2 {
            moved[k][axis] += STEP_PX;
            let up = rectangle(&moved, view);
            moved[k][axis] -= 2.0 * STEP_PX;
            let down = rectangle(&moved, view);
            moved[k][axis] += STEP_PX;
            let slope = (up? - down?) * (READING_PX / (2.0 * STEP_PX));
            covariance += &slope * slope.transpose();
        }
    }
    covariance.cholesky()?.l().try_inverse()
}
