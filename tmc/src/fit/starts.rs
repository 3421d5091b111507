//! Where descents begin.
//!
//! Greenshields starts at its solution, a straight line. The others start from a grid: the
//! free-flow speed near the upper speeds, the jam density from the densest point up, and what else
//! they have from its usual range.

use super::least_squares::Point;
use super::model::{Model, Parameters};

/// Slopes of speed over spacing, 1/h.
const LAMBDAS: [f64; 4] = [500.0, 1500.0, 4000.0, 10_000.0];
/// Speeds of waves in congestion, km/h: 15 to 25 on motorways.
const WAVES_KMH: [f64; 4] = [8.0, 15.0, 22.0, 35.0];
/// Capacities as shares of the largest flow.
const SHARES: [f64; 3] = [0.6, 0.8, 0.95];

/// Where descents begin, from points sorted by density.
///
/// # Errors
/// A speed that does not fall, where a straight line is asked for.
pub(super) fn starts(model: Model, sorted: &[Point]) -> Result<Vec<Parameters>, String> {
    if model == Model::Greenshields {
        let n = sorted.len() as f64;
        let mean = |f: fn(&Point) -> f64| sorted.iter().map(f).sum::<f64>() / n;
        let (k, v) = (mean(|p| p.0), mean(|p| p.1));
        let spread: f64 = sorted.iter().map(|p| (p.0 - k).powi(2)).sum();
        let slope = sorted.iter().map(|p| (p.0 - k) * (p.1 - v)).sum::<f64>() / spread;
        if slope >= 0.0 {
            return Err("speed does not fall with density, so that greenshields does not apply; \
                        it needs traffic dense enough to slow down"
                .into());
        }
        let free = v - slope * k;
        return Ok(vec![[free, -free / slope, 0.0, 0.0]]);
    }
    let densest = sorted.last().map_or(1.0, |p| p.0);
    let mut speeds: Vec<f64> = sorted.iter().map(|p| p.1).collect();
    speeds.sort_by(f64::total_cmp);
    let upper = |share: f64| speeds[((speeds.len() - 1) as f64 * share) as usize].max(1.0);
    let flow = sorted.iter().map(|p| p.0 * p.1).fold(1.0, f64::max);
    let mut starts: Vec<Parameters> = Vec::new();
    for v_f in [upper(0.5), upper(0.95), upper(1.0) * 1.1] {
        for k_j in [densest * 1.05, densest * 1.5, densest * 4.0, 150.0] {
            match model {
                Model::Greenshields => {}
                Model::Newell => starts.extend(LAMBDAS.map(|lambda| [v_f, k_j, lambda, 0.0])),
                Model::Daganzo => starts.extend(WAVES_KMH.map(|w| [v_f, k_j, w, 0.0])),
                Model::VanAerde => {
                    for share in [0.6, 0.8, 0.95] {
                        starts.extend(SHARES.map(|q| [v_f, k_j, share * v_f, q * flow]));
                    }
                }
            }
        }
    }
    starts.retain(|start| model.is_possible(*start));
    Ok(starts)
}
