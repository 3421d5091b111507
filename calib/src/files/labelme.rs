//! Labels in labelme's JSON: key points of vehicles, lane polygons, lane lines.
//!
//! Owns reading and the first checks of the files. Does not own what the shapes mean
//! to a solver, nor whether a vehicle can be posed (see `validation`).

use crate::bodies::Body;
use crate::error::{Error, Result};
use crate::model::KEY_POINT_COUNT;
use crate::plain;
use crate::vehicle::{KeyPoint, Vehicle};
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// One labelme file, as far as it is used here.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct LabelFile {
    /// Width of the labelled picture, px.
    pub image_width: u32,
    /// Height of the labelled picture, px.
    pub image_height: u32,
    /// The shapes, in file order.
    pub shapes: Vec<Shape>,
    /// Marks on the whole picture: the body of its vehicles, such as `van`, or the direction of
    /// its lanes.
    #[serde(default, deserialize_with = "null_is_empty")]
    pub flags: BTreeMap<String, bool>,
}

/// One labelme shape.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Shape {
    /// The label as written.
    pub label: String,
    /// Vertices (u, v), px.
    pub points: Vec<[f64; 2]>,
    /// `point`, `polygon`, `linestrip`, `line`, ...
    #[serde(default, deserialize_with = "null_is_empty")]
    pub shape_type: String,
    /// Which shapes belong together, for several vehicles in one file.
    #[serde(default, deserialize_with = "whole_number")]
    pub group_id: Option<i64>,
    /// Marks set by the person who labelled, such as `toward` on a lane or `van` on a
    /// vehicle's point.
    #[serde(default, deserialize_with = "null_is_empty")]
    pub flags: BTreeMap<String, bool>,
}

/// `null` stands for what is empty in the files of some versions.
fn null_is_empty<'de, D, T>(d: D) -> std::result::Result<T, D::Error>
where
    D: serde::Deserializer<'de>,
    T: Default + Deserialize<'de>,
{
    Ok(Option::<T>::deserialize(d)?.unwrap_or_default())
}

/// A group as a number, however it is written; an empty text is none.
fn whole_number<'de, D: serde::Deserializer<'de>>(
    d: D,
) -> std::result::Result<Option<i64>, D::Error> {
    let wrong = |what: &dyn std::fmt::Display| {
        serde::de::Error::custom(format!("group_id {what} is not a whole number"))
    };
    match serde_json::Value::deserialize(d)? {
        serde_json::Value::Null => Ok(None),
        serde_json::Value::String(text) if text.trim().is_empty() => Ok(None),
        serde_json::Value::String(text) => text.trim().parse().map(Some).map_err(|_| wrong(&text)),
        value => match value.as_f64().filter(|x| x.fract() == 0.0 && x.abs() < 1e15) {
            Some(x) => Ok(Some(x as i64)),
            None => Err(wrong(&value)),
        },
    }
}

/// What a JSON file that is not labelme's looks like, and what to do with it.
fn other_format(value: &serde_json::Value) -> Option<&'static str> {
    let object = value.as_object();
    let has = |key: &str| object.is_some_and(|o| o.contains_key(key));
    let entries = object.into_iter().flat_map(|o| o.values());
    let via = has("_via_img_metadata")
        || has("_via_settings")
        || entries.clone().any(|v| v.get("regions").is_some());
    if has("shapes") {
        let size = |key: &str| value.get(key).is_some_and(|v| !v.is_null());
        return (!size("imageWidth") || !size("imageHeight")).then_some(
            "no imageWidth and imageHeight, as labelme before version 4 writes it: open the \
             picture in labelme 5 and save it again",
        );
    }
    if has("annotations") && (has("images") || has("categories")) {
        return Some(
            "this is a COCO file and not labelme's: convert it (labelme's polygons have \
             shapes, labels and points)",
        );
    }
    if via {
        return Some(
            "this is a file of the VGG Image Annotator (VIA) and not labelme's: draw the shapes \
             in labelme, or convert it",
        );
    }
    Some("this is not a labelme file: it has no shapes")
}

impl LabelFile {
    /// Reads one file.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = verge_desk::read_bytes(path)?;
        Self::parse(&bytes).map_err(|detail| Error::Json { path: path.to_owned(), detail })
    }

    /// Reads a file's content; the error says what it is instead.
    pub fn parse(bytes: &[u8]) -> std::result::Result<Self, String> {
        let text = std::str::from_utf8(bytes).map_err(|e| {
            format!(
                "not UTF-8 at byte {}: save it as UTF-8 (an older labelme on Windows writes the \
                 system's code page)",
                e.valid_up_to()
            )
        })?;
        // Some editors put a byte order mark before the text.
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let value: serde_json::Value = serde_json::from_str(text).map_err(|e| {
            let number = if text.contains("NaN") || text.contains("Infinity") {
                "; a point is NaN or infinite: draw that shape again"
            } else {
                ""
            };
            format!("{}{number}", plain::words(&e))
        })?;
        if let Some(other) = other_format(&value) {
            return Err(other.to_owned());
        }
        // From the text again: its messages have line and column.
        serde_json::from_str(text).map_err(|e| plain::words(&e))
    }

    /// Width and height of the picture, px.
    pub fn image_size(&self) -> [u32; 2] {
        [self.image_width, self.image_height]
    }

    /// The vehicles of this file: its point shapes, grouped by `group_id`. A flag on one of
    /// a vehicle's points states its body, else a flag of the file, else it is a car.
    pub fn vehicles(&self, stem: &str) -> Result<Vec<Vehicle>> {
        let mut groups: BTreeMap<Option<i64>, Vec<KeyPoint>> = BTreeMap::new();
        let mut flags: BTreeMap<Option<i64>, BTreeSet<&str>> = BTreeMap::new();
        for shape in self.shapes.iter().filter(|s| matches!(s.shape_type.as_str(), "point" | "")) {
            let points = groups.entry(shape.group_id).or_default();
            let vehicle = vehicle_name(stem, shape.group_id);
            points.push(key_point(&vehicle, shape, self.image_size(), points)?);
            flags.entry(shape.group_id).or_default().extend(set(&shape.flags));
        }
        let of_file: BTreeSet<&str> = set(&self.flags).collect();
        groups
            .into_iter()
            .map(|(group, mut points)| {
                points.sort_by_key(|p| p.label);
                let name = vehicle_name(stem, group);
                let own = flags.get(&group).filter(|f| !f.is_empty()).unwrap_or(&of_file);
                Ok(Vehicle { body: body(&name, own)?, name, points })
            })
            .collect()
    }

    /// Pairs of open lines that run side by side: the first with the second, the third with
    /// the fourth, and so on in file order, px.
    ///
    /// # Errors
    /// When a line has fewer than 3 points, or one is left over.
    pub fn line_pairs(&self) -> Result<Vec<LinePair>> {
        let lines = self.lines();
        let [.., last] = &lines[..] else {
            return Err(Error::Marks("the file of lane lines holds no linestrip".into()));
        };
        if lines.len() % 2 == 1 {
            let n = lines.len();
            let last = last.len();
            return Err(Error::Marks(format!(
                "{n} lane lines; they go by twos, the last one ({last} points) has no partner"
            )));
        }
        if let Some(k) = lines.iter().position(|l| l.len() < MIN_LINE_POINTS) {
            let n = lines[k].len();
            return Err(Error::Marks(format!(
                "lane line {} has {n} points, trace at least {MIN_LINE_POINTS}",
                k + 1
            )));
        }
        let mut lines = lines.into_iter();
        Ok(std::iter::from_fn(|| Some([lines.next()?, lines.next()?])).collect())
    }

    /// The open lines (`linestrip` or `line`) of this file, px.
    fn lines(&self) -> Vec<Vec<Vector2<f64>>> {
        self.shapes
            .iter()
            .filter(|s| matches!(s.shape_type.as_str(), "linestrip" | "line"))
            .map(|s| s.points.iter().map(|&p| Vector2::from(p)).collect())
            .collect()
    }
}

/// Two lines of the road that keep their distance, px.
pub type LinePair = [Vec<Vector2<f64>>; 2];

/// Fewest points of a traced line: two ends say nothing about a constant spacing.
const MIN_LINE_POINTS: usize = 3;

fn vehicle_name(stem: &str, group: Option<i64>) -> String {
    group.map_or_else(|| stem.to_owned(), |g| format!("{stem}#{g}"))
}

/// The names of the flags that are set.
fn set(flags: &BTreeMap<String, bool>) -> impl Iterator<Item = &str> {
    flags.iter().filter(|(_, on)| **on).map(|(name, _)| name.as_str())
}

fn body(vehicle: &str, flags: &BTreeSet<&str>) -> Result<Body> {
    let wrong = |flag: &str, problem: String| Error::Body {
        vehicle: vehicle.to_owned(),
        flag: flag.to_owned(),
        problem,
    };
    let known = || Body::ALL.map(Body::name).join(", ");
    let mut bodies = flags.iter().map(|flag| {
        Body::of_name(flag)
            .ok_or_else(|| wrong(flag, format!("not a kind of vehicle; known are {}", known())))
    });
    let first = bodies.next().transpose()?.unwrap_or_default();
    match bodies.next().transpose()? {
        None => Ok(first),
        Some(second) => {
            Err(wrong(second.name(), format!("it is flagged as a {} too", first.name())))
        }
    }
}

/// How far outside the picture a label may lie, px: a corner hidden by the border.
const OUTSIDE_TOLERANCE_PX: f64 = 1.0;

fn key_point(
    vehicle: &str,
    shape: &Shape,
    size: [u32; 2],
    others: &[KeyPoint],
) -> Result<KeyPoint> {
    let wrong = |problem: String| Error::KeyPoint {
        vehicle: vehicle.to_owned(),
        label: shape.label.clone(),
        problem,
    };
    let label = shape
        .label
        .trim()
        .parse::<u8>()
        .ok()
        .filter(|l| (1..=KEY_POINT_COUNT).contains(&usize::from(*l)))
        .ok_or_else(|| wrong(format!("not a key point; labels are 1 to {KEY_POINT_COUNT}")))?;
    let [[u, v]] = shape.points[..] else {
        return Err(wrong(format!("{} coordinates, a point has one", shape.points.len())));
    };
    if !u.is_finite() || !v.is_finite() {
        return Err(wrong("not a finite number; label it again".into()));
    }
    let [w, h] = size.map(f64::from);
    let inside =
        |x: f64, limit: f64| (-OUTSIDE_TOLERANCE_PX..=limit + OUTSIDE_TOLERANCE_PX).contains(&x);
    if !inside(u, w) || !inside(v, h) {
        return Err(wrong(format!("({u:.1}, {v:.1}) px lies outside the {w} x {h} picture")));
    }
    if others.iter().any(|p| p.label == label) {
        return Err(wrong(
            "labelled twice; give each vehicle of a picture its own file or group_id".into(),
        ));
    }
    Ok(KeyPoint { label, uv: Vector2::new(u, v) })
}

/// Reads every `*.json` of a folder in the order of the names: the vehicles and the one
/// picture size they share.
pub fn read_vehicles(folder: &Path) -> Result<(Vec<Vehicle>, [u32; 2])> {
    let mut vehicles = Vec::new();
    let mut size = None;
    for path in json_files(folder)? {
        let file = LabelFile::read(&path)?;
        let expected = *size.get_or_insert(file.image_size());
        if file.image_size() != expected {
            let what = path.display().to_string();
            return Err(Error::ImageSize { what, actual: file.image_size(), expected });
        }
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        vehicles.extend(file.vehicles(&stem)?);
    }
    match size {
        Some(size) if !vehicles.is_empty() => Ok((vehicles, size)),
        _ => Err(Error::EmptyFolder { path: folder.to_owned(), wanted: "labelled vehicle" }),
    }
}

fn json_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let read = |source| verge_desk::Failure::reading(folder, source);
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(read)? {
        let path = entry.map_err(read)?.path();
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json")) {
            paths.push(path);
        }
    }
    paths.sort();
    if paths.is_empty() {
        return Err(Error::EmptyFolder { path: folder.to_owned(), wanted: "label file (*.json)" });
    }
    Ok(paths)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(shapes: &str) -> LabelFile {
        let text = format!(r#"{{"imageWidth":320,"imageHeight":240,"shapes":[{shapes}]}}"#);
        serde_json::from_str(&text).unwrap()
    }

    #[test]
    fn groups_become_vehicles() {
        let f = file(
            r#"{"label":"2","points":[[3,4]],"group_id":1,"shape_type":"point"},
               {"label":"1","points":[[1,2]],"group_id":1,"shape_type":"point"},
               {"label":"1","points":[[5,6]],"group_id":2,"shape_type":"point"}"#,
        );
        let v = f.vehicles("frame").unwrap();
        assert_eq!(v.iter().map(|v| v.name.as_str()).collect::<Vec<_>>(), ["frame#1", "frame#2"]);
        assert_eq!(v[0].points[0], KeyPoint { label: 1, uv: Vector2::new(1.0, 2.0) });
    }

    #[test]
    fn flags_state_the_body_of_a_point_before_that_of_the_file() {
        let points = |flags: &str| {
            file(&format!(
                r#"{{"label":"1","points":[[1,2]],"group_id":1,"flags":{{{flags}}}}},
                   {{"label":"2","points":[[3,4]],"group_id":1,"flags":{{}}}},
                   {{"label":"1","points":[[5,6]],"group_id":2}}"#
            ))
        };
        let bodies = |f: &LabelFile| -> Vec<Body> {
            f.vehicles("frame").unwrap().iter().map(|v| v.body).collect()
        };
        assert_eq!(bodies(&points("")), [Body::Car; 2]);
        let mut f = points(r#""van":true,"taxi":false"#);
        assert_eq!(bodies(&f), [Body::Van, Body::Car]);
        f.flags.insert("taxi".into(), true);
        assert_eq!(bodies(&f), [Body::Van, Body::Taxi]);
        let message = points(r#""lorry":true"#).vehicles("frame").unwrap_err().to_string();
        assert!(message.contains("frame#1") && message.contains("'lorry'"), "{message}");
        assert!(message.contains("car, taxi, van, minibus"), "{message}");
        let both = points(r#""van":true,"taxi":true"#).vehicles("frame").unwrap_err().to_string();
        assert!(both.contains("'van'") && both.contains("taxi too"), "{both}");
    }

    #[test]
    fn bad_labels_name_vehicle_and_point() {
        for (shapes, expected) in [
            (r#"{"label":"wheel","points":[[1,1]]}"#, "not a key point"),
            (r#"{"label":"3","points":[[1,1]]},{"label":"3","points":[[2,2]]}"#, "labelled twice"),
            (r#"{"label":"3","points":[[900,1]]}"#, "outside"),
            (r#"{"label":"3","points":[[1,1],[2,2]]}"#, "2 coordinates"),
        ] {
            let message = file(shapes).vehicles("car_7").unwrap_err().to_string();
            assert!(message.contains("car_7") && message.contains(expected), "{message}");
        }
    }
}
