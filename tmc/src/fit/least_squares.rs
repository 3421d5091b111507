//! Weighted nonlinear least squares by Levenberg and Marquardt (Marquardt 1963), for at
//! most [`MOST`] parameters.
//!
//! Owns one descent from one start. Parameters stay positive: a step out of range is
//! refused like one that climbs.

use super::model::{MOST, Model, Parameters};

/// Density, veh/km/lane, and speed, km/h.
pub type Point = (f64, f64);
/// A row and a column a parameter.
pub type Matrix = [[f64; MOST]; MOST];

/// Most steps of a descent.
const MOST_STEPS: usize = 500;
/// It ends when neither sum nor parameters change by more than this fraction.
const TOLERANCE: f64 = 1e-12;
/// Damping at which no step is small enough: the descent ends.
const MOST_DAMPING: f64 = 1e16;

/// Where a descent ended.
#[derive(Clone, Copy, Debug)]
pub struct Descent {
    /// The parameters.
    pub parameters: Parameters,
    /// The sum of weighted squared residuals, (km/h)^2.
    pub sum: f64,
}

/// Goes down from `start`; `weight` is each point's weight by its index.
pub fn descend(
    model: Model,
    points: &[Point],
    weight: &dyn Fn(usize) -> f64,
    start: Parameters,
) -> Descent {
    let mut at = Descent { parameters: start, sum: sum(model, points, weight, start) };
    let mut damping = 1e-3;
    for _ in 0..MOST_STEPS {
        let (normal, slope) = normal_equations(model, points, weight, at.parameters);
        let mut moved = false;
        while damping < MOST_DAMPING {
            let mut damped = normal;
            for (i, row) in damped.iter_mut().enumerate().take(model.count()) {
                row[i] += damping * row[i].max(f64::MIN_POSITIVE);
            }
            let step = inverse(damped, model.count()).map(|inverse| times(&inverse, slope));
            let next = step.map(|step| std::array::from_fn(|i| at.parameters[i] + step[i]));
            let next = next.filter(|next| model.is_possible(*next));
            let lower = next.map(|next| (next, sum(model, points, weight, next)));
            if let Some((next, lower)) = lower.filter(|&(_, lower)| lower <= at.sum) {
                let still = (0..model.count()).all(|i| {
                    (next[i] - at.parameters[i]).abs() <= TOLERANCE.sqrt() * next[i].abs()
                });
                moved = !(still && at.sum - lower <= TOLERANCE * at.sum);
                at = Descent { parameters: next, sum: lower };
                damping = (damping * 0.2).max(1e-15);
                break;
            }
            damping *= 5.0;
        }
        if !moved {
            break;
        }
    }
    at
}

fn sum(
    model: Model,
    points: &[Point],
    weight: &dyn Fn(usize) -> f64,
    parameters: Parameters,
) -> f64 {
    let square = |(index, &(k, v)): (usize, &Point)| {
        weight(index) * (v - model.speed(parameters, k)).powi(2)
    };
    points.iter().enumerate().map(square).sum()
}

/// J'WJ and J'Wr of the residuals r = v - v(k) with J the derivatives of v(k).
pub fn normal_equations(
    model: Model,
    points: &[Point],
    weight: &dyn Fn(usize) -> f64,
    parameters: Parameters,
) -> (Matrix, Parameters) {
    let (mut normal, mut slope) = ([[0.0; MOST]; MOST], [0.0; MOST]);
    for (index, &(k, v)) in points.iter().enumerate() {
        let weight = weight(index);
        let residual = v - model.speed(parameters, k);
        let gradient = model.gradient(parameters, k);
        for i in 0..MOST {
            slope[i] += weight * gradient[i] * residual;
            for j in 0..MOST {
                normal[i][j] += weight * gradient[i] * gradient[j];
            }
        }
    }
    (normal, slope)
}

/// The inverse of the first `count` rows and columns, 0 elsewhere; `None` where the matrix,
/// scaled to a diagonal of 1, is singular to rounding.
pub fn inverse(matrix: Matrix, count: usize) -> Option<Matrix> {
    let scale: Parameters = std::array::from_fn(|i| matrix[i][i].sqrt());
    if scale[..count].iter().any(|&s| !(s.is_finite() && s > 0.0)) {
        return None;
    }
    let mut left = [[0.0; MOST]; MOST];
    let mut right = [[0.0; MOST]; MOST];
    for i in 0..count {
        right[i][i] = 1.0;
        for j in 0..count {
            left[i][j] = matrix[i][j] / (scale[i] * scale[j]);
        }
    }
    for pivot in 0..count {
        let best = (pivot..count)
            .max_by(|&a, &b| left[a][pivot].abs().total_cmp(&left[b][pivot].abs()))?;
        left.swap(pivot, best);
        right.swap(pivot, best);
        let divisor = left[pivot][pivot];
        if divisor.abs() < 1e-13 {
            return None;
        }
        for j in 0..count {
            left[pivot][j] /= divisor;
            right[pivot][j] /= divisor;
        }
        for row in (0..count).filter(|&row| row != pivot) {
            let factor = left[row][pivot];
            for j in 0..count {
                left[row][j] -= factor * left[pivot][j];
                right[row][j] -= factor * right[pivot][j];
            }
        }
    }
    for i in 0..count {
        for j in 0..count {
            right[i][j] /= scale[i] * scale[j];
        }
    }
    Some(right)
}

/// A matrix times a column.
pub fn times(matrix: &Matrix, column: Parameters) -> Parameters {
    matrix.map(|row| (0..MOST).map(|j| row[j] * column[j]).sum())
}
