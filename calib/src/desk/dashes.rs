//! The dashes of the drawn lines in the picture without traffic.
//!
//! Owns which lines are looked along, and the answer. Does not own finding dashes (see
//! `road::dashes`); what pitch they have a person says.

use super::backdrop::Backdrop;
use super::drawing::{Drawing, Px};
use super::look;
use crate::error::Result;
use crate::road::dashes::{Picture, find};
use crate::road::fit::BoxCue;
use nalgebra::Vector2;
use serde::Serialize;

/// What one line shows.
#[derive(Debug, Serialize)]
pub struct LineDashes {
    /// The line's id.
    pub line: u32,
    /// Middles of its dashes, px; none where it shows none.
    pub points: Vec<Px>,
    /// From one to the next by the camera as it is known now, m.
    pub pitch_m: Option<f64>,
    /// Why it shows none.
    pub problem: Option<String>,
}

/// Looks along every line of a drawing.
///
/// # Errors
/// Where the drawing gives no camera yet.
pub fn dashes(drawing: &Drawing, boxes: &[BoxCue], backdrop: &Backdrop) -> Result<Vec<LineDashes>> {
    let camera = look::camera(drawing, boxes)?;
    let picture = Picture { rgb: &backdrop.rgb, size: backdrop.image_size };
    let of = |line: &super::drawing::Line| {
        let points: Vec<Vector2<f64>> = line.points.iter().map(|&p| p.into()).collect();
        match find(&picture, &points, &camera) {
            Ok(found) => LineDashes {
                line: line.id,
                points: found.middles.into_iter().map(Px::from).collect(),
                pitch_m: Some(found.pitch_m),
                problem: None,
            },
            Err(why) => {
                let problem = Some(why.to_string());
                LineDashes { line: line.id, points: Vec::new(), pitch_m: None, problem }
            }
        }
    };
    Ok(drawing.lines.iter().map(of).collect())
}
