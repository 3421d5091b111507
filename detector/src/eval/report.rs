//! The figures as a table or as JSON.

use super::average::{Score, Slice};

/// One line a slice.
pub(super) fn table(scores: &[(Slice, Score)]) -> String {
    let wide = scores.iter().map(|(slice, _)| slice.name.len()).max().unwrap_or(0).max(5);
    let mut text = format!(
        "{:<wide$}  {:>6}  {:>8}  {:>6}  {:>9}  {:>9}  {:>6}  {:>8}  {:>8}\n",
        "slice",
        "frames",
        "vehicles",
        "AP50",
        "AP50:95",
        "precision",
        "recall",
        "recall@p",
        "score@p"
    );
    for (slice, score) in scores {
        text += &format!(
            "{:<wide$}  {:>6}  {:>8}  {:>6}  {:>9}  {:>9}  {:>6}  {:>8}  {:>8}\n",
            slice.name,
            score.frames,
            score.vehicles,
            figure(score.ap50),
            figure(score.ap50_95),
            figure(score.precision),
            figure(score.recall),
            figure(score.recall_at_precision),
            figure(score.score_at_precision),
        );
    }
    text
}

fn figure(value: Option<f64>) -> String {
    value.map_or("-".to_owned(), |value| format!("{value:.3}"))
}

/// `{"all": {..}, "day": {..}, ..}` in one line.
pub(super) fn json(scores: &[(Slice, Score)]) -> String {
    let fields: Vec<String> = scores
        .iter()
        .map(|(slice, score)| {
            format!("{}:{}", serde_json::json!(slice.name), serde_json::json!(score))
        })
        .collect();
    format!("{{{}}}\n", fields.join(","))
}
