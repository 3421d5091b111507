//! Detections and unlabelled regions: JSON Lines, a frame a line.

use super::matching::Found;
use super::truth::Frames;
use std::collections::BTreeSet;
use std::path::Path;
use verge_desk::{Failure, read_text};

#[derive(serde::Deserialize)]
struct Line {
    frame: String,
    /// x0 y0 x1 y1 score class.
    boxes: Vec<(f64, f64, f64, f64, f64, String)>,
}

#[derive(serde::Deserialize)]
struct Regions {
    frame: String,
    boxes: Vec<[f64; 4]>,
}

/// Adds the detections to their frames. Lines of other frames are passed over; a labelled frame
/// without a line is an error, since it would count as empty in silence.
pub(super) fn read(path: &Path, frames: &mut Frames) -> Result<(), Failure> {
    let mut seen = BTreeSet::new();
    for (index, text) in read_text(path)?.lines().enumerate() {
        if text.trim().is_empty() {
            continue;
        }
        let line: Line = serde_json::from_str(text).map_err(|error| {
            let reason = format!(
                "{error}; expected {{\"frame\":\"name.jpg\",\"boxes\":[[x0,y0,x1,y1,score,\"class\"]]}}"
            );
            Failure::content(path, index + 1, reason)
        })?;
        let Some(frame) = frames.get_mut(&line.frame) else { continue };
        if !seen.insert(line.frame.clone()) {
            let reason = format!("{} stands twice; keep one line for it", line.frame);
            return Err(Failure::content(path, index + 1, reason));
        }
        for (x0, y0, x1, y1, score, _) in line.boxes {
            if ![x0, y0, x1, y1, score].iter().all(|v| v.is_finite()) || x1 < x0 || y1 < y0 {
                let reason = format!("box [{x0}, {y0}, {x1}, {y1}, {score}] is turned around");
                return Err(Failure::content(path, index + 1, reason));
            }
            frame.found.push(Found { bounds: [x0, y0, x1, y1], score });
        }
    }
    match frames.keys().find(|name| !seen.contains(*name)) {
        None => Ok(()),
        Some(missing) => {
            let reason = format!(
                "has no line for {missing} ({} of {} labelled frames are there); \
                 detect them all, or name those to score with --frames",
                seen.len(),
                frames.len()
            );
            Err(Failure::content(path, 0, reason))
        }
    }
}

/// Adds the regions without labels to their frames.
pub(super) fn read_ignored(path: &Path, frames: &mut Frames) -> Result<(), Failure> {
    for (index, text) in read_text(path)?.lines().enumerate() {
        if text.trim().is_empty() {
            continue;
        }
        let line: Regions = serde_json::from_str(text).map_err(|error| {
            let reason =
                format!("{error}; expected {{\"frame\":\"name.jpg\",\"boxes\":[[x0,y0,x1,y1]]}}");
            Failure::content(path, index + 1, reason)
        })?;
        if let Some(frame) = frames.get_mut(&line.frame) {
            frame.ignored.extend(line.boxes);
        }
    }
    Ok(())
}
