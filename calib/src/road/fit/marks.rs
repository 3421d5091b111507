//! Residuals of lengths and right angles on the road.
//!
//! Owns how reading errors of points become errors of lengths: neighbouring segments share a
//! point, and all segments of a mark share its standard's or tape's error. Does not own the
//! marks' file.

use super::cues::{MEASURED_REL_SD, MarkCue, READING_PX, RectangleCue};
use super::view::View;
use nalgebra::{DMatrix, DVector, Vector2};

/// Step of the derivatives with respect to image points, px.
const STEP_PX: f64 = 0.05;
/// A length on a painted road is not known better than this, whatever is stated.
const LEAST_REL_SD: f64 = 2e-3;
/// A painted or paved rectangle is square to about half a degree, and its opposite sides are alike
/// to a per cent.
const SQUARE_SD: f64 = 0.01;

/// Logarithms of measured over known length of each segment; `None` above the horizon.
pub fn log_ratios(mark: &MarkCue, view: &View) -> Option<DVector<f64>> {
    let ground: Vec<_> = mark.points.iter().map(|&p| view.ground(p)).collect::<Option<_>>()?;
    let ratio = |w: &[Vector2<f64>]| ((w[1] - w[0]).norm().max(1e-6) / mark.segment_m).ln();
    Some(DVector::from_iterator(ground.len() - 1, ground.windows(2).map(ratio)))
}

/// Typical size of whitened residuals: 1 for a cue that fits.
pub fn typical(white: &DVector<f64>) -> f64 {
    (white.norm_squared() / white.len().max(1) as f64).sqrt()
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

/// Residuals of a rectangle: the cosines of two opposite corners, the ratios of opposite sides and,
/// where the sides are known, the logarithms of measured over known length.
pub fn rectangle(cue: &RectangleCue, view: &View) -> Option<DVector<f64>> {
    let mut g = [Vector2::zeros(); 4];
    for (g, uv) in g.iter_mut().zip(&cue.corners) {
        *g = view.ground(*uv)?;
    }
    let side = |k: usize| g[(k + 1) % 4] - g[k % 4];
    let length = |k: usize| side(k).norm().max(1e-9);
    let cosine = |k: usize| side(k).dot(&side(k + 3)) / (length(k) * length(k + 3));
    let ratio = |k: usize| (length(k) / length(k + 2)).ln();
    let mut residuals = vec![cosine(0), cosine(2), ratio(0), ratio(1)];
    if let Some(known) = cue.sides_m {
        let mean = |k: usize| 0.5 * (length(k) + length(k + 2));
        residuals.extend(known.iter().enumerate().map(|(k, m)| (mean(k) / m).ln()));
    }
    Some(DVector::from_vec(residuals))
}

/// What whitens the residuals of a rectangle.
pub fn rectangle_whitening(cue: &RectangleCue, view: &View) -> Option<DMatrix<f64>> {
    let n = rectangle(cue, view)?.len();
    let mut covariance = DMatrix::from_fn(n, n, |i, j| match (i < 4, i == j) {
        (true, true) => SQUARE_SD.powi(2),
        (false, true) => MEASURED_REL_SD.powi(2),
        _ => 0.0,
    });
    let mut moved = cue.clone();
    for k in 0..4 {
        for axis in 0..2 {
            moved.corners[k][axis] += STEP_PX;
            let up = rectangle(&moved, view);
            moved.corners[k][axis] -= 2.0 * STEP_PX;
            let down = rectangle(&moved, view);
            moved.corners[k][axis] += STEP_PX;
            let slope = (up? - down?) * (READING_PX / (2.0 * STEP_PX));
            covariance += &slope * slope.transpose();
        }
    }
    covariance.cholesky()?.l().try_inverse()
}
