//! The known picture that every model searches when it is loaded.
//!
//! Owns the picture and the comparison with what the sidecar says is in it. A net whose
//! numbers run away, or that finds other vehicles than it did when its sidecar was written, is
//! refused before it measures anything.

use super::sidecar::SelfTest;
use crate::daemon::frame::{Detection, Picture, PixelBox};

/// A piece of a frame of the simulated street (`tests/data/freeway`), RGB.
const PIXELS: &[u8] = include_bytes!("self_test.rgb");
const WIDTH: usize = 160;
const HEIGHT: usize = 120;

/// How far a box may lie from the one that is known: overlap, and score. Floats round
/// differently from processor to processor; bytes do not.
const OVERLAP: f32 = 0.9;
const APART: f32 = 0.03;

pub(super) fn picture() -> Picture {
    Picture { width: WIDTH, height: HEIGHT, rgb: PIXELS.to_vec() }
}

/// Compares what was found with what is known.
///
/// # Errors
/// The difference.
pub(super) fn compare(found: &[Detection], known: &SelfTest) -> Result<(), String> {
    if found.len() != known.boxes.len() {
        return Err(format!(
            "in the known picture it finds {} vehicles and not {}",
            found.len(),
            known.boxes.len()
        ));
    }
    for &[x0, y0, x1, y1, score] in &known.boxes {
        let bounds = PixelBox { x0, y0, x1, y1 };
        let is_it =
            |d: &&Detection| d.bounds.iou(&bounds) >= OVERLAP && (d.score - score).abs() <= APART;
        if found.iter().find(is_it).is_none() {
            return Err(format!(
                "in the known picture it does not find the vehicle from {x0}, {y0} to {x1}, {y1} px with \
                 score {score}"
            ));
        }
    }
    Ok(())
}
