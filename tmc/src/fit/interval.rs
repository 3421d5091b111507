//! Student's t: how many standard errors reach how far with few points.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// The factor of a two-sided 95 % interval with that many degrees of freedom (at least 1).
pub fn t_95(degrees: usize) -> f64 {
    let distribution = StudentsT::new(0.0, 1.0, degrees.max(1) as f64);
    distribution.expect("its scale and freedom are positive").inverse_cdf(0.975)
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
