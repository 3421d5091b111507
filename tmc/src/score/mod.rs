//! `verge-tmc score`: estimated density against ground truth, as in the paper's tables.
//!
//! Owns the command and the three measures. With e the estimate minus the truth of a window:
//! RMSE is the root of the mean e^2, MAE the mean |e|, both in veh/km/lane, MAPE the mean
//! |e| / truth in per cent. Windows in which the truth is 0 have no percentage and are left
//! out of MAPE. `read` reads both sides.

mod read;

use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::PathBuf;
use verge_desk::{Failure, print};

/// Arguments of `score`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Ground truth: the truth.jsonl of a simulated recording, or CSV with the columns from
    /// (UTC), lane, density_veh_km.
    #[arg(long, value_name = "FILE")]
    truth: PathBuf,
    /// Estimates: density messages, one a line (`verge replay --json`), or CSV as above.
    #[arg(long, value_name = "FILE")]
    density: PathBuf,
    /// One JSON object instead of the table.
    #[arg(long)]
    json: bool,
}

/// The three measures over a number of windows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// Windows that have both values.
    pub windows: usize,
    /// Root mean square error, veh/km/lane.
    pub rmse: f64,
    /// Mean absolute error, veh/km/lane.
    pub mae: f64,
    /// Mean absolute percentage error; none where the truth is always 0.
    pub mape: Option<f64>,
    /// Windows left out of MAPE because the truth is 0.
    pub truth_zero: usize,
}

/// Scores pairs of truth and estimate; `None` without a pair.
pub fn score(pairs: &[(f64, f64)]) -> Option<Score> {
    if pairs.is_empty() {
        return None;
    }
    let n = pairs.len() as f64;
    let shares: Vec<f64> =
        pairs.iter().filter(|(t, _)| *t > 0.0).map(|(t, e)| (e - t).abs() / t * 100.0).collect();
    Some(Score {
        windows: pairs.len(),
        rmse: (pairs.iter().map(|(t, e)| (e - t).powi(2)).sum::<f64>() / n).sqrt(),
        mae: pairs.iter().map(|(t, e)| (e - t).abs()).sum::<f64>() / n,
        mape: (!shares.is_empty()).then(|| shares.iter().sum::<f64>() / shares.len() as f64),
        truth_zero: pairs.len() - shares.len(),
    })
}

/// Runs `score`.
///
/// # Errors
/// [`Failure`]: a file cannot be read, or the two have no window in common.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let density = read::estimates(&arguments.density)?;
    let truth = read::truth(&arguments.truth, &density)?;
    let mut lanes: BTreeMap<u8, Vec<(f64, f64)>> = BTreeMap::new();
    let mut road: BTreeMap<i64, Vec<(f64, f64)>> = BTreeMap::new();
    let (mut unknown, mut without_truth) = (0usize, 0usize);
    for (&(from, lane), entry) in &density {
        match (truth.get(&(from, lane)), entry.density) {
            (None, _) => without_truth += 1,
            (_, None) => unknown += 1,
            (Some(&truth), Some(found)) => {
                lanes.entry(lane).or_default().push((truth, found));
                road.entry(from).or_default().push((truth, found));
            }
        }
    }
    let known: BTreeSet<(i64, u8)> = density.keys().copied().collect();
    let without_estimate = truth.keys().filter(|key| !known.contains(key)).count();
    // The road's density is the mean of its lanes, in windows that have them all.
    let count = lanes.len();
    let road: Vec<(f64, f64)> = road
        .into_values()
        .filter(|pairs| pairs.len() == count)
        .map(|pairs| {
            let mean = |f: fn(&(f64, f64)) -> f64| pairs.iter().map(f).sum::<f64>() / count as f64;
            (mean(|p| p.0), mean(|p| p.1))
        })
        .collect();
    let scores: Vec<(u8, Score)> =
        lanes.iter().filter_map(|(lane, pairs)| Some((*lane, score(pairs)?))).collect();
    if scores.is_empty() {
        let reason = format!(
            "has no window and lane in common with {}; are both in UTC, and is `from` the \
             beginning of the window?",
            arguments.truth.display()
        );
        return Err(Failure::content(&arguments.density, 0, reason));
    }
    let left_out = [
        ("without_density", unknown),
        ("without_truth", without_truth),
        ("without_estimate", without_estimate),
    ];
    print(&if arguments.json {
        as_json(&scores, score(&road), left_out)
    } else {
        as_table(&scores, score(&road), left_out)
    })
}

/// The mean of the lanes' measures: the paper's "Average".
fn average(scores: &[(u8, Score)]) -> Score {
    let mean = |f: &dyn Fn(&Score) -> f64| {
        scores.iter().map(|(_, score)| f(score)).sum::<f64>() / scores.len() as f64
    };
    let all = scores.iter().all(|(_, score)| score.mape.is_some());
    Score {
        windows: scores.iter().map(|(_, score)| score.windows).sum(),
        rmse: mean(&|s| s.rmse),
        mae: mean(&|s| s.mae),
        mape: all.then(|| mean(&|s| s.mape.unwrap_or_default())),
        truth_zero: scores.iter().map(|(_, score)| score.truth_zero).sum(),
    }
}

fn as_json(scores: &[(u8, Score)], road: Option<Score>, left_out: [(&str, usize); 3]) -> String {
    let one = |score: &Score| {
        json!({"windows": score.windows, "rmse_veh_km": score.rmse, "mae_veh_km": score.mae,
               "mape_pct": score.mape, "truth_zero": score.truth_zero})
    };
    let lanes: Vec<_> = scores
        .iter()
        .map(|(lane, score)| {
            let mut entry = one(score);
            entry["lane"] = (*lane).into();
            entry
        })
        .collect();
    let left_out: BTreeMap<_, _> = left_out.into_iter().collect();
    let whole = json!({"lanes": lanes, "average": one(&average(scores)),
                       "road": road.as_ref().map(one), "left_out": left_out});
    format!("{whole}\n")
}

fn as_table(scores: &[(u8, Score)], road: Option<Score>, left_out: [(&str, usize); 3]) -> String {
    let mut out = String::from("lane       windows     RMSE      MAE     MAPE   (veh/km/lane)\n");
    let mut line = |name: String, score: &Score| {
        let mape = score.mape.map_or("-".to_owned(), |mape| format!("{mape:.2} %"));
        // Writing to a string does not fail.
        let _ = writeln!(
            out,
            "{name:<10} {:>7} {:>8.2} {:>8.2} {mape:>9}",
            score.windows, score.rmse, score.mae
        );
    };
    for (lane, score) in scores {
        line(format!("#{lane}"), score);
    }
    line("Average".into(), &average(scores));
    if let Some(road) = road {
        line("Road".into(), &road);
    }
    let zero = average(scores).truth_zero;
    let counts: Vec<String> = left_out
        .into_iter()
        .chain([("truth_zero_without_percentage", zero)])
        .filter(|(_, count)| *count > 0)
        .map(|(name, count)| format!("{count} {}", name.replace('_', " ")))
        .collect();
    if !counts.is_empty() {
        let _ = writeln!(out, "left out: {}", counts.join(", "));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measures_are_those_of_the_definitions() {
        let score = score(&[(2.0, 1.0), (10.0, 13.0), (0.0, 2.0)]).unwrap();
        assert_eq!(score.windows, 3);
        assert!((score.rmse - (14.0f64 / 3.0).sqrt()).abs() < 1e-12);
        assert!((score.mae - 2.0).abs() < 1e-12);
        // The paper's example: 1 for 2 is 50 %; the truth of 0 has no percentage.
        assert!((score.mape.unwrap() - 40.0).abs() < 1e-12);
        assert_eq!(score.truth_zero, 1);
        assert_eq!(super::score(&[]), None);
    }
}
