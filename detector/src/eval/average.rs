//! Precision, recall and average precision over many frames: `COCOeval.accumulate`.

use super::matching::{Frame, Outcome, Prepared, Size};

/// A subset of the data that gets a score of its own.
#[derive(Clone, Debug)]
pub struct Slice {
    /// `all`, `day`, `small`, `camera 1005`, ...
    pub name: String,
    /// Box sizes that count.
    pub size: Size,
}

/// How the operating points are taken.
#[derive(Clone, Copy, Debug)]
pub struct Rules {
    /// Score of `precision` and `recall`.
    pub score: f64,
    /// Precision at which the recall is stated.
    pub at_precision: f64,
    /// Detections a frame that count.
    pub max_detections: usize,
}

/// The figures of a slice. `None` where there is nothing to divide by.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Score {
    /// Frames.
    pub frames: usize,
    /// Vehicles that count.
    pub vehicles: usize,
    /// Average precision at overlap 0.5.
    pub ap50: Option<f64>,
    /// Mean of the average precisions at overlap 0.5, 0.55, ..., 0.95.
    pub ap50_95: Option<f64>,
    /// At the stated score and overlap 0.5.
    pub precision: Option<f64>,
    /// At the stated score and overlap 0.5.
    pub recall: Option<f64>,
    /// The largest recall whose precision is at least the stated one, overlap 0.5.
    pub recall_at_precision: Option<f64>,
    /// The score that gives it.
    pub score_at_precision: Option<f64>,
    /// (recall, precision) at overlap 0.5, by falling score.
    #[serde(skip)]
    pub curve: Vec<(f64, f64)>,
}

const OVERLAPS: usize = 10;
const RECALLS: usize = 101;

/// Scores the frames of a slice.
pub fn score(frames: &[&Frame], slice: &Slice, rules: Rules) -> Score {
    let prepared: Vec<Prepared> =
        frames.iter().map(|frame| Prepared::new(frame, slice.size, rules.max_detections)).collect();
    let vehicles: usize = prepared.iter().map(|frame| frame.counted).sum();
    let mut score = Score { frames: frames.len(), vehicles, ..Score::default() };
    if vehicles == 0 {
        return score;
    }
    let mut sum = 0.0;
    for step in 0..OVERLAPS {
        let mut outcomes: Vec<Outcome> =
            prepared.iter().flat_map(|frame| frame.outcomes(0.5 + 0.05 * step as f64)).collect();
        // A stable sort: equal scores stay in the order of the frames, as in pycocotools.
        outcomes.sort_by(|a, b| b.score.total_cmp(&a.score));
        let curve = curve(&outcomes, vehicles);
        let average = average_precision(&curve);
        sum += average;
        if step == 0 {
            score.ap50 = Some(average);
            operating_points(&mut score, &outcomes, &curve, rules);
            score.curve = curve;
        }
    }
    score.ap50_95 = Some(sum / OVERLAPS as f64);
    score
}

fn curve(outcomes: &[Outcome], vehicles: usize) -> Vec<(f64, f64)> {
    let mut hits = 0.0;
    outcomes
        .iter()
        .enumerate()
        .map(|(index, outcome)| {
            hits += f64::from(u8::from(outcome.hit));
            // pycocotools adds the spacing of doubles at 1 to the divisor.
            (hits / vehicles as f64, hits / ((index + 1) as f64 + f64::EPSILON))
        })
        .collect()
}

/// Precision made to fall, then its mean at recall 0, 0.01, ..., 1.
fn average_precision(curve: &[(f64, f64)]) -> f64 {
    let mut falling: Vec<f64> = curve.iter().map(|point| point.1).collect();
    for i in (1..falling.len()).rev() {
        falling[i - 1] = falling[i - 1].max(falling[i]);
    }
    let at = |step: usize| {
        let recall = step as f64 / (RECALLS - 1) as f64;
        let first = curve.partition_point(|point| point.0 < recall);
        falling.get(first).copied().unwrap_or(0.0)
    };
    (0..RECALLS).map(at).sum::<f64>() / RECALLS as f64
}

fn operating_points(score: &mut Score, outcomes: &[Outcome], curve: &[(f64, f64)], rules: Rules) {
    let above = outcomes.partition_point(|outcome| outcome.score >= rules.score);
    let point = above.checked_sub(1).map(|last| curve[last]);
    score.precision = point.map(|point| point.1);
    score.recall = Some(point.map_or(0.0, |point| point.0));
    let last = curve.iter().rposition(|point| point.1 >= rules.at_precision);
    score.recall_at_precision = Some(last.map_or(0.0, |last| curve[last].0));
    score.score_at_precision = last.map(|last| outcomes[last].score);
}
