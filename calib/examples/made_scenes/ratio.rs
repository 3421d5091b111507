//! How joint's median error compares with the best of several methods on the same scenes.
//!
//! Owns the ratio of medians and its bootstrap interval. The scenes are drawn again together
//! with all their errors (paired), and the best method is chosen again in each draw: who is
//! best is itself uncertain.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Draws of the bootstrap.
const DRAWS: usize = 4000;

/// The ratio and its 95 % interval, of (ours, others) for each scene; `None` without scenes.
pub fn of_medians<const N: usize>(rows: &[(f64, [f64; N])]) -> Option<[f64; 3]> {
    if rows.is_empty() {
        return None;
    }
    let ratio = |drawn: &[usize]| {
        let best = (0..N).map(|k| median(drawn.iter().map(|&i| rows[i].1[k]).collect()));
        median(drawn.iter().map(|&i| rows[i].0).collect()) / best.fold(f64::INFINITY, f64::min)
    };
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut drawn: Vec<f64> = (0..DRAWS)
        .map(|_| ratio(&rows.iter().map(|_| rng.random_range(0..rows.len())).collect::<Vec<_>>()))
        .collect();
    drawn.sort_by(f64::total_cmp);
    let at = ratio(&(0..rows.len()).collect::<Vec<_>>());
    Some([at, drawn[DRAWS / 40], drawn[DRAWS - 1 - DRAWS / 40]])
}

/// The median.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
