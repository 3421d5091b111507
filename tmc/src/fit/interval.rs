//! Student's t: how many standard errors reach how far with few points.

use std::f64::consts::FRAC_PI_2;

/// Upper 97.5 % point of the normal distribution.
const NORMAL: f64 = 1.959_963_984_540_054;
/// Degrees of freedom from which the expansion at infinity is exact to six digits.
const MANY: f64 = 200.0;
/// Intervals of Simpson's rule.
const PIECES: usize = 400;

/// The factor of a two-sided 95 % interval with that many degrees of freedom (at least 1).
///
/// With t = sqrt(n) tan a the distribution is the integral of cos(a)^(n-1), so that no gamma
/// function is needed. Many degrees: the Cornish-Fisher expansion (Abramowitz and Stegun
/// 26.7.5).
pub fn t_95(degrees: usize) -> f64 {
    let n = degrees.max(1) as f64;
    let z = NORMAL;
    if n >= MANY {
        let first = (z.powi(3) + z) / 4.0;
        let second = (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0;
        return z + first / n + second / (n * n);
    }
    let integral = |to: f64| {
        let step = to / PIECES as f64;
        let value = |i: usize| {
            let weight = if i == 0 || i == PIECES { 1.0 } else { 2.0 + 2.0 * (i % 2) as f64 };
            weight * (step * i as f64).cos().max(0.0).powf(n - 1.0)
        };
        (0..=PIECES).map(value).sum::<f64>() * step / 3.0
    };
    let wanted = 0.95 * integral(FRAC_PI_2);
    let (mut low, mut high) = (0.0, FRAC_PI_2);
    for _ in 0..60 {
        let middle = f64::midpoint(low, high);
        if integral(middle) < wanted { low = middle } else { high = middle }
    }
    n.sqrt() * low.tan()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_those_of_the_tables() {
        for (degrees, expected) in [
            (1, 12.706_205),
            (2, 4.302_653),
            (5, 2.570_582),
            (30, 2.042_272),
            (199, 1.971_957),
            (200, 1.971_896),
            (10_000, 1.960_201),
        ] {
            let found = t_95(degrees);
            assert!((found / expected - 1.0).abs() < 1e-6, "{degrees}: {found}");
        }
    }
}
