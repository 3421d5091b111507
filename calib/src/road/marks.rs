//! Checking a calibration against marks of known length on the road.
//!
//! Owns the marks file and the error measures of the paper's table of methods: RMSE, MAE,
//! MAPE, and beside them the bias of the mean length, because the paper's "MAE" agrees
//! with that and cannot be a mean of absolute errors (its RMSE is more than sqrt(12) times
//! larger, which 12 segments do not allow).

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::files::labelme::{LabelFile, Shape};
use crate::plain;
use crate::road::fit::{MarkCue, RectangleCue};
use crate::road::standards;
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Marks of known length.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Marks {
    /// The marks.
    #[serde(default)]
    pub marks: Vec<Mark>,
    /// Right angles on the road.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rectangles: Vec<Rectangle>,
}

/// A rectangle on the road.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Rectangle {
    /// Its corners (u, v) in order, px.
    pub points: [[f64; 2]; 4],
    /// Length of its first side (from the first corner to the second) and of its second, m, where
    /// they are measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sides_m: Option<[f64; 2]>,
    /// What it is called.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
}

impl Rectangle {
    /// From a labelme polygon of four corners: its label is `rectangle`, or holds the metres of the
    /// first and the second side (`rectangle 12 x 3.5 m`).
    fn of_shape(shape: &Shape) -> Result<Self> {
        let label = shape.label.trim();
        let wrong = |problem: &str| {
            let n = shape.points.len();
            Err(Error::Marks(format!("'{label}' ({}, {n} points): {problem}", shape.shape_type)))
        };
        if shape.shape_type == "rectangle" {
            return wrong(
                "labelme's rectangle is upright in the picture; draw the road's as a polygon of \
                 its four corners",
            );
        }
        let Ok(points) = <[[f64; 2]; 4]>::try_from(shape.points.as_slice()) else {
            return wrong("a rectangle on the road is a polygon of four corners");
        };
        // Words, then the sides: from the first digit on.
        let sides_m = match label.find(|c: char| c.is_ascii_digit()) {
            None => None,
            Some(first) => {
                let metres = |text: &str| {
                    let text = text.trim().trim_end_matches("metres").trim_end_matches('m');
                    text.trim_end().parse().ok()
                };
                let sides = label[first..]
                    .split_once(['x', 'X', '*'])
                    .and_then(|(a, b)| Some([metres(a)?, metres(b)?]));
                if sides.is_none() {
                    return wrong(
                        "its label is 'rectangle', or has both sides: 'rectangle 12 x 3.5 m', the \
                         first from the first corner to the second",
                    );
                }
                sides
            }
        };
        Ok(Rectangle { points, sides_m, name: Some(label.to_owned()) })
    }

    /// The cue of the road fit.
    pub fn cue(&self, number: usize) -> RectangleCue {
        let name = called("rectangle", number - 1, &self.name);
        RectangleCue { name, corners: self.points.map(Vector2::from), sides_m: self.sides_m }
    }
}

/// How far a point may lie beyond the edge of the picture, px: what is clicked on the edge.
const BEYOND_PX: f64 = 1.0;

/// A mark by its number, from 0 on, and its name.
fn called(kind: &str, index: usize, name: &Option<String>) -> String {
    let number = index + 1;
    match name.as_ref().filter(|name| !name.is_empty() && *name != kind) {
        Some(name) => format!("{kind} {number} ({name})"),
        None => format!("{kind} {number}"),
    }
}

/// With the file that it was read from.
fn of_file(path: &Path, error: Error) -> Error {
    match error {
        Error::Marks(problem) => Error::MarksIn { path: path.to_owned(), problem },
        other => other,
    }
}

/// A polyline on the road whose segments all have one length.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Mark {
    /// Points (u, v), px.
    pub points: Vec<[f64; 2]>,
    /// Length of each segment, m.
    #[serde(default)]
    pub segment_length_m: f64,
    /// In place of the length: a national standard's name, for points a pitch apart.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub standard: Option<String>,
    /// What it is called.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// How well the length is known, as a part of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rel_sd: Option<f64>,
    /// How well the points are read, px.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub px_sd: Option<f64>,
}

impl Mark {
    /// A polyline with segments of this length, m.
    pub fn new(points: Vec<[f64; 2]>, segment_length_m: f64) -> Self {
        Mark { points, segment_length_m, standard: None, name: None, rel_sd: None, px_sd: None }
    }

    /// From a labelme line: its label is the metres of each segment (`6`, `6.5 m`, `dash 6 m`)
    /// or a standard's name.
    fn of_shape(shape: &Shape) -> Self {
        let text = shape.label.trim();
        let number = text.trim_end_matches("metres").trim_end_matches('m').trim_end();
        let number = number.rsplit(|c: char| c.is_whitespace() || c == '=').next();
        let mut mark = Mark::new(shape.points.clone(), 0.0);
        mark.name = Some(text.to_owned());
        match number.and_then(|n| n.parse().ok()) {
            Some(metres) => mark.segment_length_m = metres,
            None => mark.standard = Some(text.to_owned()),
        }
        mark
    }

    /// The cue of the road fit.
    pub fn cue(&self, number: usize) -> MarkCue {
        let name = called("mark", number - 1, &self.name);
        let points = self.points.iter().map(|&p| p.into()).collect();
        let mut cue = MarkCue::measured(name, points, self.segment_length_m);
        cue.rel_sd = self.rel_sd.unwrap_or(cue.rel_sd);
        cue.px_sd = self.px_sd.unwrap_or(cue.px_sd);
        cue.standard = self.standard.clone();
        cue
    }
}

/// How far measured lengths are from the known ones.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Accuracy {
    /// Root mean square error, m.
    pub rmse_m: f64,
    /// Mean absolute error, m.
    pub mae_m: f64,
    /// Mean absolute error in per cent of the known length.
    pub mape_pct: f64,
    /// Mean signed error, m (the paper's "MAE" is its absolute value).
    pub bias_m: f64,
    /// Mean signed error in per cent of the known length.
    pub bias_pct: f64,
    /// How many segments were measured.
    pub segments: usize,
}

impl Marks {
    /// Reads and checks a marks file, or the lines of a labelme file.
    ///
    /// # Errors
    /// Names the file, and the mark with what is wrong with it.
    pub fn read(path: &Path) -> Result<Self> {
        Self::parsed(path).map_err(|error| of_file(path, error))
    }

    /// Refuses points that no picture of this size has: there a length is whatever the plane of the
    /// road makes of it.
    ///
    /// # Errors
    /// Names the file that they were read from, and the first such mark and point.
    pub fn require_within(&self, [width, height]: [u32; 2], path: &Path) -> Result<()> {
        let is_in = |x: f64, most: u32| (-BEYOND_PX..=f64::from(most) + BEYOND_PX).contains(&x);
        let out = |points: &[[f64; 2]]| {
            points.iter().copied().find(|&[u, v]| !is_in(u, width) || !is_in(v, height))
        };
        let marks = self.marks.iter().enumerate();
        let mut marks =
            marks.filter_map(|(k, mark)| Some((called("mark", k, &mark.name), out(&mark.points)?)));
        let rectangles = self.rectangles.iter().enumerate();
        let mut rectangles = rectangles.filter_map(|(k, rectangle)| {
            Some((called("rectangle", k, &rectangle.name), out(&rectangle.points)?))
        });
        let Some((name, [u, v])) = marks.next().or_else(|| rectangles.next()) else {
            return Ok(());
        };
        let problem = format!(
            "{name} has a point at ({u:.1}, {v:.1}) px, outside of the calibration's picture of \
             {width}x{height} px: move it, or give marks of this camera"
        );
        Err(of_file(path, Error::Marks(problem)))
    }

    fn parsed(path: &Path) -> Result<Self> {
        let bytes = verge_desk::read_bytes(path)?;
        let wrong = |detail: String| Error::Json { path: path.to_owned(), detail };
        let labelled = serde_json::from_slice::<serde_json::Value>(&bytes)
            .is_ok_and(|value| value.get("shapes").is_some());
        let mut marks = if labelled {
            let file = LabelFile::parse(&bytes).map_err(wrong)?;
            let kind = |s: &Shape| match s.shape_type.as_str() {
                "line" | "linestrip" => Some(false),
                "polygon" | "rectangle" => Some(true),
                _ => None,
            };
            if let Some(other) = file.shapes.iter().find(|s| kind(s).is_none()) {
                return Err(Error::Marks(format!(
                    "'{}' is a {}; a length is a line or linestrip labelled with its metres, a \
                     rectangle a polygon of four corners",
                    other.label, other.shape_type
                )));
            }
            let of = |is_area| file.shapes.iter().filter(move |s| kind(s) == Some(is_area));
            let rectangles = of(true).map(Rectangle::of_shape).collect::<Result<_>>()?;
            Marks { marks: of(false).map(Mark::of_shape).collect(), rectangles }
        } else {
            serde_json::from_slice(&bytes).map_err(|e| wrong(plain::words(&e)))?
        };
        for mark in &mut marks.marks {
            let Some(name) = &mark.standard else { continue };
            let standard = standards::find(name)?;
            mark.segment_length_m = standard.pitch_m();
            mark.rel_sd = mark.rel_sd.or(Some(standard.tolerance));
        }
        marks.check()?;
        Ok(marks)
    }

    /// The cues of the road fit.
    pub fn cues(&self) -> Vec<MarkCue> {
        self.marks.iter().enumerate().map(|(k, m)| m.cue(k + 1)).collect()
    }

    /// The same of the rectangles.
    pub fn rectangle_cues(&self) -> Vec<RectangleCue> {
        self.rectangles.iter().enumerate().map(|(k, r)| r.cue(k + 1)).collect()
    }

    fn check(&self) -> Result<()> {
        if self.marks.is_empty() && self.rectangles.is_empty() {
            return Err(Error::Marks(
                "there are none in it: \"marks\" and \"rectangles\" are empty or missing, and it has no \
                 lines of labelme"
                    .into(),
            ));
        }
        for (index, mark) in self.marks.iter().enumerate() {
            let number = index + 1;
            if mark.points.len() < 2 {
                let n = mark.points.len();
                return Err(Error::Marks(format!(
                    "mark {number} has {n} points, two make a length"
                )));
            }
            if !mark.points.iter().flatten().all(|x| x.is_finite()) {
                return Err(Error::Marks(format!(
                    "mark {number} has a point that is not a number"
                )));
            }
            if mark.points.windows(2).any(|w| w[0] == w[1]) {
                return Err(Error::Marks(format!("mark {number} has two points at one place")));
            }
            let length = mark.segment_length_m;
            if !(length > 0.0 && length.is_finite()) {
                return Err(Error::Marks(format!("mark {number} has segments of {length} m")));
            }
            let positive = |sd: Option<f64>| sd.is_none_or(|sd| sd > 0.0 && sd.is_finite());
            if !positive(mark.rel_sd) || !positive(mark.px_sd) {
                return Err(Error::Marks(format!("mark {number}: rel_sd and px_sd are above 0")));
            }
        }
        let corners = self.rectangles.iter().flat_map(|r| r.points.iter().flatten());
        if corners.copied().any(|x| !x.is_finite()) {
            return Err(Error::Marks("a rectangle has a corner that is not a number".into()));
        }
        Ok(())
    }

    /// The segments: both ends (px) and the known length (m). The sides of rectangles, where they
    /// are known, follow the marks.
    pub fn segments(&self) -> impl Iterator<Item = Segment> + '_ {
        let first = self.marks.len() + 1;
        let sides = self.rectangles.iter().enumerate().flat_map(move |(r, rectangle)| {
            let corner = |k: usize| Vector2::from(rectangle.points[k % 4]);
            (0..4).filter_map(move |k| {
                let length_m = rectangle.sides_m?[k % 2];
                let ends = [corner(k), corner(k + 1)];
                Some(Segment { mark: first + r, point: k + 1, ends, length_m })
            })
        });
        let marks = self.marks.iter().enumerate().flat_map(|(m, mark)| {
            mark.points.windows(2).enumerate().map(move |(p, ends)| Segment {
                mark: m + 1,
                point: p + 1,
                ends: [ends[0].into(), ends[1].into()],
                length_m: mark.segment_length_m,
            })
        });
        marks.chain(sides)
    }

    /// Measures every segment with a camera.
    ///
    /// # Errors
    /// [`Error::AboveHorizon`] names the mark and the point that do not lie on the road.
    pub fn verify(&self, camera: &Camera) -> Result<Accuracy> {
        let mut errors = Vec::new();
        for segment in self.segments() {
            errors.push((segment.measure(camera)? - segment.length_m, segment.length_m));
        }
        Ok(Accuracy::of(&errors))
    }
}

/// One stretch of road of known length.
#[derive(Clone, Copy, Debug)]
pub struct Segment {
    /// Number of the mark, from 1.
    pub mark: usize,
    /// Number of its first point in the mark, from 1.
    pub point: usize,
    /// Both ends in the picture, px.
    pub ends: [Vector2<f64>; 2],
    /// The known length, m.
    pub length_m: f64,
}

impl Segment {
    /// Its length as a camera sees it, m.
    pub fn measure(&self, camera: &Camera) -> Result<f64> {
        let on_road = |k: usize| -> Result<Vector3<f64>> {
            let uv = self.ends[k];
            camera.back_project(&uv, 0.0).ok_or_else(|| Error::AboveHorizon {
                what: format!("mark {}, point {}", self.mark, self.point + k),
                u: uv.x,
                v: uv.y,
            })
        };
        Ok((on_road(0)? - on_road(1)?).norm())
    }
}

impl Accuracy {
    /// From pairs of error and known length, both m. All zero when there are none.
    pub fn of(errors: &[(f64, f64)]) -> Self {
        let n = (errors.len() as f64).max(1.0);
        let mean = |f: fn(&(f64, f64)) -> f64| errors.iter().map(f).sum::<f64>() / n;
        Accuracy {
            rmse_m: mean(|(e, _)| e * e).sqrt(),
            mae_m: mean(|(e, _)| e.abs()),
            mape_pct: 100.0 * mean(|(e, l)| e.abs() / l),
            bias_m: mean(|(e, _)| *e),
            bias_pct: 100.0 * mean(|(e, l)| e / l),
            segments: errors.len(),
        }
    }
}

#[cfg(test)]
#[path = "marks_tests.rs"]
mod tests;
