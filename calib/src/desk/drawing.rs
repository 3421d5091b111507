//! What the page has drawn, as cues of the road fit and as labelme's shapes.
//!
//! Owns the format `verge-desk` (the file `site.json`) and its checks. Does not own what the
//! shapes measure (see `look`).

use super::strips::{Strip, strips};
use crate::bodies::Body;
use crate::error::{Error, Result};
use crate::files::labelme::{LabelFile, Shape};
use crate::model::KEY_POINT_COUNT;
use crate::plain;
use crate::road::cue_files;
use crate::road::fit::{Cues, LaneCue, RectangleCue};
use crate::road::marks::Mark;
use crate::road::outline;
use crate::road::standards;
use crate::vehicle::{KeyPoint, Vehicle};
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Value of the field `format`.
pub const FORMAT: &str = "verge-desk";
/// The version that is written, and the newest that is read.
pub const VERSION: u32 = 1;
/// Most shapes of one kind, and most points of a shape: nobody draws more by hand.
const MOST: usize = 400;

/// A point of the picture, px.
pub type Px = [f64; 2];

/// Everything that is drawn, and what was typed beside it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drawing {
    /// [`FORMAT`].
    pub format: String,
    /// [`VERSION`].
    pub version: u32,
    /// Width and height of the pictures, px.
    pub image_size: [u32; 2],
    /// SHA-256 of the picture that it lies on, in hexadecimal digits: a person has looked.
    pub backdrop: String,
    /// Name of the site.
    #[serde(default)]
    pub site: String,
    /// Name of the camera.
    #[serde(default)]
    pub camera_id: String,
    /// Where the sensor will take pictures from; empty for the folder itself.
    #[serde(default)]
    pub source: String,
    /// Time between two pictures of the sensor, s; `None` for that of the folder.
    #[serde(default)]
    pub interval_s: Option<f64>,
    /// Known lengths.
    #[serde(default)]
    pub lengths: Vec<Length>,
    /// Lane lines.
    #[serde(default)]
    pub lines: Vec<Line>,
    /// Neighbouring lines, by their ids, with no lane between them.
    #[serde(default)]
    pub apart: Vec<[u32; 2]>,
    /// Right angles on the road, each by four corners in order, px.
    #[serde(default)]
    pub rectangles: Vec<[Px; 4]>,
    /// Vehicles with key points.
    #[serde(default)]
    pub vehicles: Vec<Labelled>,
    /// Width of the lanes where it is known, m.
    #[serde(default)]
    pub lane_width_m: Option<f64>,
    /// Height of the camera where it is known, m.
    #[serde(default)]
    pub height_m: Option<f64>,
    /// Whether the vehicles that a detector found are a cue.
    #[serde(default)]
    pub use_traffic: bool,
    /// Lanes.
    #[serde(default)]
    pub lanes: Vec<Lane>,
    /// What is burnt into the picture and no part of the scene, px.
    #[serde(default)]
    pub ignored: Vec<Vec<Px>>,
}

/// A length on the road; no cue until its metres or its standard are given.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Length {
    /// Its points, px; each segment has the length.
    pub points: Vec<Px>,
    /// The length, m.
    #[serde(default)]
    pub metres: Option<f64>,
    /// A standard whose pitch it shows.
    #[serde(default)]
    pub standard: Option<String>,
}

/// A lane line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Line {
    /// By which it is named in `apart`.
    pub id: u32,
    /// Its points, px.
    pub points: Vec<Px>,
}

/// A vehicle with key points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Labelled {
    /// `car`, `taxi`, `van`, `minibus`.
    pub body: String,
    /// Key points by their label, px.
    pub points: BTreeMap<u8, Px>,
}

/// A lane.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lane {
    /// Its number.
    pub number: u8,
    /// `toward` or `away`; empty until it is chosen.
    #[serde(default)]
    pub direction: String,
    /// Whether it may be wider at one end.
    #[serde(default)]
    pub widens: bool,
    /// Its outline, px.
    pub polygon: Vec<Px>,
}

impl Drawing {
    /// An empty one on a picture.
    pub fn empty(image_size: [u32; 2], backdrop: String) -> Self {
        Drawing {
            format: FORMAT.into(),
            version: VERSION,
            image_size,
            backdrop,
            site: String::new(),
            camera_id: String::new(),
            source: String::new(),
            interval_s: None,
            lengths: Vec::new(),
            lines: Vec::new(),
            apart: Vec::new(),
            rectangles: Vec::new(),
            vehicles: Vec::new(),
            lane_width_m: None,
            height_m: None,
            use_traffic: false,
            lanes: Vec::new(),
            ignored: Vec::new(),
        }
    }

    /// Reads and checks one.
    ///
    /// # Errors
    /// Says what is wrong with it.
    pub fn parse(json: &[u8]) -> std::result::Result<Self, String> {
        let drawing: Drawing = serde_json::from_slice(json).map_err(|e| plain::words(&e))?;
        if drawing.format != FORMAT || drawing.version > VERSION {
            let Drawing { format, version, .. } = drawing;
            return Err(format!("{format} {version}, this program reads {FORMAT} {VERSION}"));
        }
        let kinds = [
            drawing.lengths.len(),
            drawing.lines.len(),
            drawing.apart.len(),
            drawing.rectangles.len(),
            drawing.vehicles.len(),
            drawing.lanes.len(),
            drawing.ignored.len(),
        ];
        let longest = drawing.shapes().map(|s| s.len()).max().unwrap_or(0);
        if kinds.iter().any(|n| *n > MOST) || longest > MOST {
            return Err(format!("more than {MOST} shapes of one kind, or points of one shape"));
        }
        if drawing.shapes().flatten().flatten().any(|x| !x.is_finite()) {
            return Err("a point is not a number".into());
        }
        Ok(drawing)
    }

    /// Whether it has no shape.
    pub fn is_bare(&self) -> bool {
        self.shapes().next().is_none()
    }

    /// The points of every shape.
    fn shapes(&self) -> impl Iterator<Item = Vec<Px>> + '_ {
        let lengths = self.lengths.iter().map(|s| s.points.clone());
        let lines = self.lines.iter().map(|s| s.points.clone());
        let rectangles = self.rectangles.iter().map(|r| r.to_vec());
        let vehicles = self.vehicles.iter().map(|v| v.points.values().copied().collect());
        let lanes = self.lanes.iter().map(|l| l.polygon.clone());
        let ignored = self.ignored.iter().cloned();
        lengths.chain(lines).chain(rectangles).chain(vehicles).chain(lanes).chain(ignored)
    }

    /// Moves every point.
    pub fn map(&mut self, to: impl Fn(Px) -> Px) {
        let move_all = |points: &mut Vec<Px>| points.iter_mut().for_each(|p| *p = to(*p));
        self.lengths.iter_mut().for_each(|s| move_all(&mut s.points));
        self.lines.iter_mut().for_each(|s| move_all(&mut s.points));
        self.rectangles.iter_mut().flatten().for_each(|p| *p = to(*p));
        self.vehicles.iter_mut().flat_map(|v| v.points.values_mut()).for_each(|p| *p = to(*p));
        self.lanes.iter_mut().for_each(|l| move_all(&mut l.polygon));
        self.ignored.iter_mut().for_each(move_all);
    }

    /// The lanes between neighbouring lines.
    pub fn strips(&self) -> Vec<Strip> {
        strips(self.lines.iter().map(|l| (l.id, &l.points[..])), &self.apart)
    }

    /// What the road fit may use of it, without labelled vehicles and boxes.
    ///
    /// # Errors
    /// Names the standard that is not known.
    pub fn cues(&self) -> Result<Cues> {
        let mut cues = Cues {
            lane_width_m: self.lane_width_m.filter(|m| *m > 0.0),
            height_m: self.height_m.filter(|m| *m > 0.0),
            ..Cues::default()
        };
        for (k, length) in self.lengths.iter().enumerate() {
            if let Some(mark) = length.mark()? {
                cues.marks.push(mark.cue(k + 1));
            }
        }
        let rectangle = |(k, r): (usize, &[Px; 4])| RectangleCue {
            name: format!("rectangle {}", k + 1),
            corners: r.map(Vector2::from),
            sides_m: None,
        };
        cues.rectangles = self.rectangles.iter().enumerate().map(rectangle).collect();
        cues.lanes = self.strips().iter().map(Strip::cue).collect();
        Ok(cues)
    }

    /// The drawn lanes, as cues where there are no lane lines.
    pub fn outlines(&self) -> Vec<LaneCue> {
        let cue = |lane: &Lane| {
            let drawing = outline::read(&self.labelme([lane])).ok()?;
            cue_files::of_outline(drawing.lanes.first()?, self.image_size).ok()
        };
        self.lanes.iter().filter_map(cue).collect()
    }

    /// The vehicles that have key points.
    ///
    /// # Errors
    /// Names the body or the label that is not known.
    pub fn vehicles(&self) -> Result<Vec<Vehicle>> {
        let of = |(k, labelled): (usize, &Labelled)| {
            let name = format!("vehicle {}", k + 1);
            let body = Body::of_name(&labelled.body).ok_or_else(|| Error::Body {
                vehicle: name.clone(),
                flag: labelled.body.clone(),
                problem: "not a kind of vehicle".into(),
            })?;
            let points: Vec<KeyPoint> = labelled
                .points
                .iter()
                .map(|(&label, &uv)| KeyPoint { label, uv: uv.into() })
                .collect();
            match points.iter().find(|p| !(1..=KEY_POINT_COUNT).contains(&p.label.into())) {
                None => Ok(Vehicle { name, body, points }),
                Some(p) => Err(Error::KeyPoint {
                    vehicle: name,
                    label: p.label.to_string(),
                    problem: format!("not a key point; labels are 1 to {KEY_POINT_COUNT}"),
                }),
            }
        };
        self.vehicles.iter().enumerate().map(of).collect()
    }

    /// Lanes as labelme has them.
    pub fn labelme<'a>(&self, lanes: impl IntoIterator<Item = &'a Lane>) -> LabelFile {
        let flag = |name: &str| (name.to_owned(), true);
        let shape = |lane: &Lane| Shape {
            label: lane.number.to_string(),
            points: lane.polygon.clone(),
            shape_type: "polygon".into(),
            group_id: None,
            flags: [lane.direction.as_str(), if lane.widens { "widens" } else { "" }]
                .iter()
                .filter(|f| !f.is_empty())
                .map(|f| flag(f))
                .collect(),
        };
        let ignored = |polygon: &Vec<Px>| shape_of("ignore", polygon, "polygon");
        let [image_width, image_height] = self.image_size;
        let shapes = lanes.into_iter().map(shape).chain(self.ignored.iter().map(ignored));
        LabelFile { image_width, image_height, shapes: shapes.collect(), flags: BTreeMap::new() }
    }

    /// Known lengths with rectangles, and lane lines, as labelme has them; `None` where there are none.
    pub fn labelme_lines(&self) -> [Option<LabelFile>; 2] {
        let [image_width, image_height] = self.image_size;
        let file = |shapes: Vec<Shape>| {
            let flags = BTreeMap::new();
            (!shapes.is_empty()).then_some(LabelFile { image_width, image_height, shapes, flags })
        };
        let length = |length: &Length| {
            let metres = length.metres.map(|m| m.to_string());
            let label = length.standard.clone().or(metres)?;
            Some(shape_of(&label, &length.points, "linestrip"))
        };
        let side = |points: &[Vector2<f64>]| {
            let points: Vec<Px> = points.iter().map(|p| (*p).into()).collect();
            shape_of("line", &points, "linestrip")
        };
        let strips = self.strips();
        let sides = strips.iter().flat_map(|s| [side(&s.right), side(&s.left)]);
        let rectangle = |r: &[Px; 4]| shape_of("rectangle", r, "polygon");
        let known = self.lengths.iter().filter_map(length);
        let known = known.chain(self.rectangles.iter().map(rectangle));
        [file(known.collect()), file(sides.collect())]
    }
}

fn shape_of(label: &str, points: &[Px], shape_type: &str) -> Shape {
    Shape {
        label: label.into(),
        points: points.to_vec(),
        shape_type: shape_type.into(),
        group_id: None,
        flags: BTreeMap::new(),
    }
}

impl Length {
    /// As a mark, once its length is known.
    fn mark(&self) -> Result<Option<Mark>> {
        if self.points.len() < 2 {
            return Ok(None);
        }
        if let Some(name) = &self.standard {
            let standard = standards::find(name)?;
            let mut mark = Mark::new(self.points.clone(), standard.pitch_m());
            mark.rel_sd = Some(standard.tolerance);
            mark.name = Some(standard.name.clone());
            mark.standard = Some(standard.name.clone());
            return Ok(Some(mark));
        }
        let metres = self.metres.filter(|m| *m > 0.0 && m.is_finite());
        Ok(metres.map(|metres| Mark::new(self.points.clone(), metres)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawing() -> Drawing {
        Drawing::empty([320, 240], "00".into())
    }

    #[test]
    fn a_length_without_metres_is_no_cue() {
        let mut d = drawing();
        let points = vec![[157.6, 158.8], [145.1, 181.7]];
        d.lengths.push(Length { points: points.clone(), metres: None, standard: None });
        assert!(d.cues().unwrap().marks.is_empty());
        d.lengths.push(Length { points, metres: None, standard: Some("us-lane".into()) });
        let cues = d.cues().unwrap();
        assert_eq!(cues.marks.len(), 1);
        assert!((cues.marks[0].segment_m - 12.192).abs() < 1e-9 && cues.marks[0].rel_sd == 0.03);
        d.lengths[1].standard = Some("xx".into());
        assert!(d.cues().is_err());
    }

    #[test]
    fn what_is_no_drawing_is_refused() {
        let good = serde_json::to_string(&drawing()).unwrap();
        assert_eq!(Drawing::parse(good.as_bytes()), Ok(drawing()));
        for (from, to, expected) in [
            ("verge-desk", "verge-lanes", "this program reads verge-desk 1"),
            ("\"version\":1", "\"version\":2", "verge-desk 2"),
            ("\"lanes\":[]", "\"lanes\":[{\"number\":1,\"polygon\":[[1e999,0]]}]", "number"),
            ("\"site\"", "\"seite\"", "is not known here"),
        ] {
            let error = Drawing::parse(good.replace(from, to).as_bytes()).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn every_point_moves() {
        let mut d = drawing();
        d.lines.push(Line { id: 1, points: vec![[1.0, 2.0]] });
        d.ignored.push(vec![[1.0, 2.0]]);
        d.rectangles.push([[1.0, 2.0]; 4]);
        d.map(|[u, v]| [u + 1.0, v - 1.0]);
        assert!(d.shapes().flatten().all(|p| p == [2.0, 1.0]));
    }
}
