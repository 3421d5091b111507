//! Whether cues can be used at all, before any fit.
//!
//! Owns the refusals of single cues. Does not own what contradicts what (see `doubt`).

use super::cues::Cues;
use crate::error::{Error, Result};
use nalgebra::Vector2;

/// Whether the cues can be used at all.
pub(super) fn usable(cues: &Cues, image_size: [u32; 2]) -> Result<()> {
    let nothing = cues.marks.is_empty()
        && cues.lanes.is_empty()
        && cues.rectangles.is_empty()
        && cues.labelled.is_none();
    if nothing {
        return Err(Error::Usage(
            "nothing to calibrate from; give --lengths first (two or more known lengths on the \
             road, one near and one far), then --lane-lines"
                .into(),
        ));
    }
    for mark in &cues.marks {
        let positive = mark.segment_m > 0.0 && mark.segment_m.is_finite();
        if mark.points.len() < 2 || !positive {
            return Err(Error::Marks(format!(
                "{}: {} points, {} m; a length has two points and metres above 0",
                mark.name,
                mark.points.len(),
                mark.segment_m
            )));
        }
        let short = mark.points.windows(2).any(|w| (w[1] - w[0]).norm() < 1.0);
        if short {
            return Err(Error::Marks(format!(
                "{}: two of its points are less than a pixel apart",
                mark.name
            )));
        }
    }
    for rectangle in &cues.rectangles {
        let positive = |sides: [f64; 2]| sides.iter().all(|m| *m > 0.0 && m.is_finite());
        if !rectangle.sides_m.is_none_or(positive) {
            return Err(Error::Marks(format!(
                "{}: the sides of a rectangle are metres above 0",
                rectangle.name
            )));
        }
        let corner = |k: usize| rectangle.corners[k % 4];
        let turn = |k: usize| (corner(k + 1) - corner(k)).perp(&(corner(k + 2) - corner(k + 1)));
        let is_convex = (0..4).all(|k| turn(k) > 0.0) || (0..4).all(|k| turn(k) < 0.0);
        if !is_convex {
            return Err(Error::Marks(format!(
                "{}: its corners do not go round; click them in order, without crossing",
                rectangle.name
            )));
        }
    }
    for lane in &cues.lanes {
        let least = lane.right.len().min(lane.left.len());
        if least < 2 {
            let problem = format!("a side has {least} points, at least 2 are needed");
            return Err(Error::Lane { lane: lane.name.clone(), problem });
        }
    }
    let [width, height] = image_size.map(f64::from);
    // A corner may be hidden by the border; further out the picture is another one.
    let outside = |p: &Vector2<f64>| {
        let (x, y) = (p.x / width, p.y / height);
        !((-0.05..=1.05).contains(&x) && (-0.05..=1.05).contains(&y))
    };
    match cues.points().find(outside) {
        None => Ok(()),
        Some(p) => Err(Error::Marks(format!(
            "the point ({:.1}, {:.1}) px lies outside the {width} x {height} picture; the cues \
             are of another picture size",
            p.x, p.y
        ))),
    }
}
