//! Outlines of lanes as people draw them: which shapes are lanes, and whether they can be.
//!
//! Owns reading a labelme file's shapes as outlines with a number, a direction and what is to
//! be ignored; refuses by its name what is not known, because a guess here is a wrong number
//! later. Does not own what an outline means on the road (see `lane_axis`, `judge`).

use crate::error::{Error, Result};
use crate::files::labelme::{LabelFile, Shape};
use nalgebra::Vector2;
use std::collections::BTreeMap;
use verge::units::{Direction, LaneId, MAX_LANES};

/// Label of what is burnt into the picture and no part of the scene.
const IGNORE: &str = "ignore";
/// The flags of a lane.
const TOWARD: &str = "toward";
const AWAY: &str = "away";
/// A lane that is wider at one end on the real road.
const WIDENS: &str = "widens";
const KNOWN: [&str; 3] = [TOWARD, AWAY, WIDENS];

/// A lane in the picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Outline {
    /// The label as written.
    pub label: String,
    /// The lane's number.
    pub id: LaneId,
    /// Which way its traffic moves.
    pub direction: Direction,
    /// Whether its file marks it as wider at one end.
    pub widens: bool,
    /// Its outline inside the picture, px.
    pub polygon: Vec<Vector2<f64>>,
}

/// Everything that a lane file says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Drawing {
    /// The lanes, by rising number.
    pub lanes: Vec<Outline>,
    /// What is to be ignored, px.
    pub ignored: Vec<Vec<Vector2<f64>>>,
}

/// Reads the shapes of a labelme file.
///
/// A lane is a polygon, or the two lines of its edges with the same label. Its number is the
/// integer at the end of its label (`1`, `lane 1`, `lane_1`); the flag `toward` or `away`, its
/// own or else the file's, says which way its traffic moves. Polygons and rectangles labelled
/// `ignore` are left out of the scene.
///
/// # Errors
/// Names the shape, label or flag that is not known.
pub fn read(file: &LabelFile) -> Result<Drawing> {
    let mut drawing = Drawing::default();
    let mut edges: BTreeMap<String, Vec<&Shape>> = BTreeMap::new();
    let default = flags(&file.flags, "the file's flags")?;
    for shape in &file.shapes {
        let wrong = |problem: String| Error::Lane { lane: shape.label.clone(), problem };
        if !shape.points.iter().flatten().all(|x| x.is_finite()) {
            return Err(wrong("a corner is not a finite number; draw it again".into()));
        }
        let ignore = shape.label.trim().eq_ignore_ascii_case(IGNORE);
        match shape.shape_type.as_str() {
            "polygon" if ignore => drawing.ignored.push(corners(shape)),
            "rectangle" if ignore => drawing.ignored.push(rectangle(shape)?),
            "polygon" => drawing.lanes.push(outline(shape, corners(shape), default, file)?),
            "line" | "linestrip" if !ignore => {
                edges.entry(shape.label.trim().to_owned()).or_default().push(shape);
            }
            "" => {
                return Err(wrong(
                    "it has no shape_type, as labelme before version 3.4 writes it: open it in \
                     labelme 5 and save it again"
                        .into(),
                ));
            }
            other => {
                return Err(wrong(format!(
                    "it is a {other}; draw a lane as a polygon, or both its edges as lines"
                )));
            }
        }
    }
    for (label, edges) in edges {
        let [a, b] = edges[..] else {
            let problem = format!("{} line(s) have this label; a lane has two edges", edges.len());
            return Err(Error::Lane { lane: label, problem });
        };
        drawing.lanes.push(outline(a, between(a, b), default, file)?);
    }
    drawing.lanes.sort_by_key(|l| l.id);
    if let Some(pair) = drawing.lanes.windows(2).find(|pair| pair[0].id == pair[1].id) {
        let problem = "is drawn twice; give each lane its own number".into();
        return Err(Error::Lane { lane: pair[1].label.clone(), problem });
    }
    Ok(drawing)
}

fn corners(shape: &Shape) -> Vec<Vector2<f64>> {
    shape.points.iter().map(|&p| p.into()).collect()
}

fn rectangle(shape: &Shape) -> Result<Vec<Vector2<f64>>> {
    let [[x0, y0], [x1, y1]] = shape.points[..] else {
        let problem = format!("a rectangle has 2 corners, this one {}", shape.points.len());
        return Err(Error::Lane { lane: shape.label.clone(), problem });
    };
    Ok([[x0, y0], [x1, y0], [x1, y1], [x0, y1]].map(Vector2::from).to_vec())
}

/// The outline between two lines.
fn between(a: &Shape, b: &Shape) -> Vec<Vector2<f64>> {
    let (mut a, mut b) = (corners(a), corners(b));
    let (Some(&end), Some(&first), Some(&last)) = (a.last(), b.first(), b.last()) else {
        return Vec::new();
    };
    // The second runs back.
    if (first - end).norm() > (last - end).norm() {
        b.reverse();
    }
    a.append(&mut b);
    a
}

/// What flags say: a direction, and whether a lane widens.
type Said = (Option<Direction>, bool);

fn flags(flags: &BTreeMap<String, bool>, of: &str) -> Result<Said> {
    let wrong = |problem: String| Error::Lane { lane: of.to_owned(), problem };
    let set: Vec<&str> = flags.iter().filter(|(_, on)| **on).map(|(f, _)| f.as_str()).collect();
    if let Some(flag) = set.iter().find(|f| !KNOWN.contains(f)) {
        return Err(wrong(format!(
            "the flag '{flag}' is not known; flags are {}",
            KNOWN.join(", ")
        )));
    }
    let direction = match (set.contains(&TOWARD), set.contains(&AWAY)) {
        (true, true) => return Err(wrong(format!("both {TOWARD} and {AWAY} are set"))),
        (true, false) => Some(Direction::Toward),
        (false, true) => Some(Direction::Away),
        (false, false) => None,
    };
    Ok((direction, set.contains(&WIDENS)))
}

fn outline(
    shape: &Shape,
    polygon: Vec<Vector2<f64>>,
    default: Said,
    file: &LabelFile,
) -> Result<Outline> {
    let wrong = |problem: String| Error::Lane { lane: shape.label.clone(), problem };
    let digits = shape.label.trim_end().rsplit(|c: char| !c.is_ascii_digit()).next();
    let id = digits.and_then(|d| d.parse().ok()).and_then(LaneId::new).ok_or_else(|| {
        wrong(format!("no lane number at the end of the label; lanes are 1 to {MAX_LANES}"))
    })?;
    let (own, widens) = flags(&shape.flags, &shape.label)?;
    let direction = own.or(default.0).ok_or_else(|| {
        wrong(format!("it has no direction; set the flag {TOWARD} or {AWAY} of it or of the file"))
    })?;
    if polygon.len() < 4 {
        return Err(wrong(format!("{} corners, a lane has at least 4", polygon.len())));
    }
    if let Some((a, b)) = crossing(&polygon) {
        return Err(wrong(format!(
            "its outline crosses itself between the corners {a} and {} and the corners {b} and {}; \
             draw the corners in order",
            a + 1,
            if b == polygon.len() { 1 } else { b + 1 },
        )));
    }
    let polygon = inside(&polygon, file.image_size().map(f64::from));
    if polygon.len() < 4 {
        return Err(wrong("it lies outside the picture; draw it on the picture".into()));
    }
    Ok(Outline { label: shape.label.clone(), id, direction, widens: widens || default.1, polygon })
}

/// Two edges of an outline that cross, by the number of their first corner.
fn crossing(polygon: &[Vector2<f64>]) -> Option<(usize, usize)> {
    let n = polygon.len();
    let edge = |k: usize| (polygon[k], polygon[(k + 1) % n]);
    let side = |(a, b): (Vector2<f64>, Vector2<f64>), p: Vector2<f64>| (b - a).perp(&(p - a));
    for i in 0..n {
        for j in i + 2..n {
            if (j + 1) % n == i {
                continue;
            }
            let (e, f) = (edge(i), edge(j));
            let apart = |e, f: (Vector2<f64>, Vector2<f64>)| side(e, f.0) * side(e, f.1) < 0.0;
            if apart(e, f) && apart(f, e) {
                return Some((i + 1, j + 1));
            }
        }
    }
    None
}

/// Whether a point lies inside a polygon (even-odd rule).
pub(crate) fn contains(polygon: &[Vector2<f64>], p: Vector2<f64>) -> bool {
    let mut inside = false;
    let mut previous = polygon[polygon.len() - 1];
    for &corner in polygon {
        let crosses = (corner.y > p.y) != (previous.y > p.y);
        if crosses {
            let t = (p.y - corner.y) / (previous.y - corner.y);
            inside ^= p.x < corner.x + t * (previous.x - corner.x);
        }
        previous = corner;
    }
    inside
}

/// The part of a polygon inside the picture (Sutherland and Hodgman 1974).
fn inside(polygon: &[Vector2<f64>], size: [f64; 2]) -> Vec<Vector2<f64>> {
    let mut polygon = polygon.to_vec();
    for (axis, limit, sign) in
        [(0, 0.0, 1.0), (0, size[0], -1.0), (1, 0.0, 1.0), (1, size[1], -1.0)]
    {
        let depth = |p: &Vector2<f64>| sign * (p[axis] - limit);
        let mut kept: Vec<Vector2<f64>> = Vec::with_capacity(polygon.len() + 2);
        for (k, p) in polygon.iter().enumerate() {
            let previous = &polygon[(k + polygon.len() - 1) % polygon.len()];
            let (now, before) = (depth(p), depth(previous));
            if (now >= 0.0) != (before >= 0.0) {
                kept.push(previous.lerp(p, before / (before - now)));
            }
            if now >= 0.0 {
                kept.push(*p);
            }
        }
        polygon = kept;
    }
    polygon.dedup_by(|a, b| (*a - *b).norm() < 1e-9);
    polygon
}

#[cfg(test)]
mod tests;
