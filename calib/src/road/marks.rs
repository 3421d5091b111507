//! Checking a calibration against marks of known length on the road.
//!
//! Owns the marks file and the error measures of the paper's table of methods: RMSE, MAE,
//! MAPE, and beside them the bias of the mean length, because the paper's "MAE" agrees
//! with that and cannot be a mean of absolute errors (its RMSE is more than sqrt(12) times
//! larger, which 12 segments do not allow).

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::files::labelme::{LabelFile, Shape};
use crate::road::fit::MarkCue;
use crate::road::standards;
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Marks of known length.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Marks {
    /// The marks.
    pub marks: Vec<Mark>,
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
        let name = self.name.as_ref().filter(|n| !n.is_empty());
        let name = name.map_or(format!("mark {number}"), |n| format!("mark {number} ({n})"));
        let points = self.points.iter().map(|&p| p.into()).collect();
        let mut cue = MarkCue::measured(name, points, self.segment_length_m);
        cue.rel_sd = self.rel_sd.unwrap_or(cue.rel_sd);
        cue.px_sd = self.px_sd.unwrap_or(cue.px_sd);
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
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = verge_desk::read_bytes(path)?;
        let wrong = |detail: String| Error::Json { path: path.to_owned(), detail };
        let labelled = serde_json::from_slice::<serde_json::Value>(&bytes)
            .is_ok_and(|value| value.get("shapes").is_some());
        let mut marks = if labelled {
            let file = LabelFile::parse(&bytes).map_err(wrong)?;
            let line = |s: &&Shape| matches!(s.shape_type.as_str(), "line" | "linestrip");
            if let Some(other) = file.shapes.iter().find(|s| !line(s)) {
                return Err(Error::Marks(format!(
                    "'{}' is a {}; a length is a line or linestrip labelled with its metres",
                    other.label, other.shape_type
                )));
            }
            Marks { marks: file.shapes.iter().map(Mark::of_shape).collect() }
        } else {
            serde_json::from_slice(&bytes).map_err(|e| wrong(e.to_string()))?
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

    fn check(&self) -> Result<()> {
        if self.marks.is_empty() {
            return Err(Error::Marks("none in the file".into()));
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
            let length = mark.segment_length_m;
            if !(length > 0.0 && length.is_finite()) {
                return Err(Error::Marks(format!("mark {number} has segments of {length} m")));
            }
            let positive = |sd: Option<f64>| sd.is_none_or(|sd| sd > 0.0 && sd.is_finite());
            if !positive(mark.rel_sd) || !positive(mark.px_sd) {
                return Err(Error::Marks(format!("mark {number}: rel_sd and px_sd are above 0")));
            }
        }
        Ok(())
    }

    /// The segments: both ends (px) and the known length (m).
    pub fn segments(&self) -> impl Iterator<Item = Segment> + '_ {
        self.marks.iter().enumerate().flat_map(|(m, mark)| {
            mark.points.windows(2).enumerate().map(move |(p, ends)| Segment {
                mark: m + 1,
                point: p + 1,
                ends: [ends[0].into(), ends[1].into()],
                length_m: mark.segment_length_m,
            })
        })
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
mod tests {
    use super::*;

    #[test]
    fn the_measures_are_the_textbook_ones() {
        let a = Accuracy::of(&[(0.5, 5.0), (-1.0, 10.0)]);
        assert!((a.rmse_m - 0.625f64.sqrt()).abs() < 1e-12);
        assert_eq!((a.mae_m, a.mape_pct, a.bias_m, a.bias_pct), (0.75, 10.0, -0.25, 0.0));
        assert_eq!(a.segments, 2);
    }

    #[test]
    fn impossible_marks_are_named() {
        let mark = |points, metres| Marks { marks: vec![Mark::new(points, metres)] };
        assert!(mark(vec![[1.0, 2.0]], 6.0).check().is_err());
        assert!(mark(vec![[1.0, 2.0], [3.0, 4.0]], 0.0).check().is_err());
        assert!(mark(vec![[1.0, f64::NAN], [3.0, 4.0]], 6.0).check().is_err());
    }
}
