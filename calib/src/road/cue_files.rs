//! The files that the road fit reads: lane lines and a detector's boxes.
//!
//! Owns turning them into cues. Lane lines are labelme lines by twos, or the polygons of a
//! lane file, whose sides are found; boxes are what `verge detect` and `verge replay` write.
//! Does not own marks (see `road::marks`) nor the fit.

use crate::error::{Error, Result};
use crate::files::labelme::{LabelFile, Shape};
use crate::plain;
use crate::road::fit::{BoxCue, Class, LaneCue};
use crate::road::lane_axis;
use crate::road::outline::{self, Outline};
use nalgebra::Vector2;
use serde::Deserialize;
use std::path::Path;
use verge::units::Direction;

/// Reads lane lines as lanes.
pub fn lanes(path: &Path, image_size: [u32; 2]) -> Result<Vec<LaneCue>> {
    let file = LabelFile::read(path)?;
    if file.image_size() != image_size {
        let what = path.display().to_string();
        return Err(Error::ImageSize { what, actual: file.image_size(), expected: image_size });
    }
    of_file(&file)
}

/// The lanes of a labelme file: polygons of a lane file where it has any, else lines by twos.
pub fn of_file(file: &LabelFile) -> Result<Vec<LaneCue>> {
    if file.shapes.iter().any(|s| s.shape_type == "polygon") {
        let drawing = outline::read(file)?;
        return drawing.lanes.iter().map(|o| of_outline(o, file.image_size())).collect();
    }
    let direction = |k: usize| {
        let lines: Vec<_> = file
            .shapes
            .iter()
            .filter(|s| matches!(s.shape_type.as_str(), "line" | "linestrip"))
            .collect();
        let flag = |name: &str| {
            let of = |s: &Shape| s.flags.get(name).copied().unwrap_or(false);
            lines.iter().skip(2 * k).take(2).copied().any(of)
                || file.flags.get(name).copied().unwrap_or(false)
        };
        match (flag("toward"), flag("away")) {
            (true, false) => Direction::Toward,
            (false, true) => Direction::Away,
            _ => Direction::Unknown,
        }
    };
    let pairs = file.line_pairs()?;
    Ok(pairs
        .into_iter()
        .enumerate()
        .map(|(k, [right, left])| LaneCue {
            name: format!("lane lines {} and {}", 2 * k + 1, 2 * k + 2),
            right: near_to_far(right),
            left: near_to_far(left),
            direction: direction(k),
            steady: true,
        })
        .collect())
}

/// Lines are drawn either way; the near end is lower in the picture.
fn near_to_far(mut line: Vec<Vector2<f64>>) -> Vec<Vector2<f64>> {
    if line.first().zip(line.last()).is_some_and(|(a, b)| a.y < b.y) {
        line.reverse();
    }
    line
}

/// The two sides of a lane's outline as lane lines.
///
/// The sides are found on a nominal road, that of a camera whose horizon lies above the
/// picture: perspective is what makes a lane's far end shorter than its sides.
pub fn of_outline(outline: &Outline, image_size: [u32; 2]) -> Result<LaneCue> {
    let [width, height] = image_size.map(f64::from);
    let top = outline.polygon.iter().map(|p| p.y).fold(f64::INFINITY, f64::min);
    // On this road x = (u - w/2) / (v - horizon), y = 1 / (v - horizon), in units of a width.
    let horizon = top.min(0.25 * height) - 0.1 * height;
    let ground = |p: &Vector2<f64>| {
        let depth = width / (p.y - horizon);
        Vector2::new((p.x - 0.5 * width) / width * depth, 1.1 * depth)
    };
    let on_road: Vec<Vector2<f64>> = outline.polygon.iter().map(ground).collect();
    let (left, right) = lane_axis::sides(&on_road).ok_or_else(|| Error::Lane {
        lane: outline.label.clone(),
        problem: "its corners span no area; draw it again".into(),
    })?;
    let back = |side: Vec<Vector2<f64>>| {
        let image = |g: &Vector2<f64>| {
            let depth = g.y / 1.1;
            Vector2::new(0.5 * width + g.x / depth * width, horizon + width / depth)
        };
        near_to_far(side.iter().map(image).collect())
    };
    Ok(LaneCue {
        name: format!("lane {}", outline.id.get()),
        right: back(right),
        left: back(left),
        direction: outline.direction,
        steady: !outline.widens,
    })
}

#[derive(Deserialize)]
struct Frame {
    #[serde(default)]
    boxes: Vec<(f64, f64, f64, f64, f64, String)>,
}

/// Lowest score of a box that is taken for a vehicle.
pub const MIN_SCORE: f64 = 0.3;

/// Reads the boxes of a detector in pictures of `size`, px: one JSON line a frame, as `verge detect`
/// writes them.
///
/// # Errors
/// [`Error::Json`] names the line of a box that is none or lies outside such pictures; a file without
/// any is refused too.
pub fn boxes(path: &Path, size: [u32; 2]) -> Result<Vec<BoxCue>> {
    let text = verge_desk::read_text(path)?;
    let [width, height] = size.map(f64::from);
    let mut all = Vec::new();
    for (frame, line) in text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()) {
        let parsed: Frame = serde_json::from_str(line).map_err(|e| Error::Json {
            path: path.to_owned(),
            detail: format!("line {}: {}", frame + 1, plain::words(&e)),
        })?;
        for (x0, y0, x1, y1, score, class) in parsed.boxes {
            let corners = [x0, y0, x1, y1];
            if !corners.iter().all(|c| c.is_finite()) || x1 <= x0 || y1 <= y0 {
                let detail = format!("line {}: the box {corners:?} is none", frame + 1);
                return Err(Error::Json { path: path.to_owned(), detail });
            }
            if x1 > width + 1.0 || y1 > height + 1.0 {
                let detail = format!(
                    "line {}: the box {corners:?} lies outside pictures of {width}x{height}; are these \
                     boxes of this camera?",
                    frame + 1
                );
                return Err(Error::Json { path: path.to_owned(), detail });
            }
            if score >= MIN_SCORE {
                all.push(BoxCue { frame, corners, class: Class::of_name(&class) });
            }
        }
    }
    if all.is_empty() {
        let detail = format!("no box in it has a score of {MIN_SCORE} or more");
        return Err(Error::Json { path: path.to_owned(), detail });
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::road::lane_axis::tests::{camera, picture};
    use verge::units::LaneId;

    #[test]
    fn the_sides_of_an_outline_are_its_long_edges() {
        let camera = camera();
        let ground =
            [[1.6, 25.0], [1.6, 50.0], [1.6, 75.0], [-1.6, 75.0], [-1.6, 50.0], [-1.6, 25.0]];
        let polygon = picture(&camera, &ground);
        let outline = Outline {
            label: "1".into(),
            id: LaneId::new(1).unwrap(),
            direction: Direction::Away,
            widens: false,
            polygon: polygon.clone(),
        };
        let lane = of_outline(&outline, camera.image_size).unwrap();
        for side in [&lane.right, &lane.left] {
            assert_eq!(side.len(), 3);
            assert!(side[0].y > side[2].y);
            for p in side {
                assert!(polygon.iter().any(|q| (q - p).norm() < 1e-6), "{p}");
            }
        }
    }
}
