//! A lane on the road: from its polygon in the picture to its centre line in metres.
//!
//! Owns finding the two ends of the polygon, the centre line between its sides, and the
//! distance along it. Works on curves: all of it happens on the road plane. Does not own
//! the cells of a table (see `lane_table`).

use crate::camera::Camera;
use crate::error::{Error, Result};
use nalgebra::{Vector2, Vector3};
use verge::units::Direction;

/// Points of the centre line: 513 samples keep a 300 m lane to 0.6 m chords, whose arc
/// deviates under 1 mm on a curve of 100 m radius.
const SAMPLES: usize = 513;
/// Coarse step of the search for the nearest sample.
const STRIDE: usize = 16;

/// The centre line of a lane on the road plane.
#[derive(Clone, Debug)]
pub struct LaneAxis {
    /// Points in the direction of travel, m on the road plane.
    points: Vec<Vector2<f64>>,
    /// Distance along the line of each point, m.
    distance_m: Vec<f64>,
    /// Width of the lane from its upstream to its downstream end, m.
    widths_m: [f64; PROBES],
}

/// Places along a lane at which its width is taken.
pub const PROBES: usize = 17;

/// A place beside a centre line.
#[derive(Clone, Copy, Debug)]
pub struct Station {
    /// Distance along the centre line, m.
    pub s_m: f64,
    /// Direction of the centre line there, unit vector on the road plane.
    pub tangent: Vector2<f64>,
}

impl LaneAxis {
    /// From a polygon (px). The line starts at the upstream end: far from the camera when
    /// traffic comes towards it, else near.
    ///
    /// # Errors
    /// Names the lane, and the vertex that lies at or above the horizon.
    pub fn of_polygon(
        lane: &str,
        polygon: &[Vector2<f64>],
        direction: Direction,
        camera: &Camera,
    ) -> Result<Self> {
        let wrong = |problem: String| Error::Lane { lane: lane.to_owned(), problem };
        if polygon.len() < 4 {
            return Err(wrong(format!("{} corners, a lane has at least 4", polygon.len())));
        }
        let mut ground = Vec::with_capacity(polygon.len());
        for (index, uv) in polygon.iter().enumerate() {
            let on_road = camera.back_project(uv, 0.0).ok_or_else(|| Error::AboveHorizon {
                what: format!("lane {lane}, corner {}", index + 1),
                u: uv.x,
                v: uv.y,
            })?;
            ground.push(on_road.xy());
        }
        let (left, right) = sides(&ground)
            .ok_or_else(|| wrong("its corners span no area on the road; draw it again".into()))?;
        let fractions = (0..SAMPLES).map(|k| k as f64 / (SAMPLES - 1) as f64);
        let mut points: Vec<_> =
            fractions.map(|t| (at_fraction(&left, t) + at_fraction(&right, t)) * 0.5).collect();
        let probe = |k: usize| {
            let place = at_fraction(&left, k as f64 / (PROBES - 1) as f64);
            nearest_m(&right, place)
        };
        let mut widths_m: [f64; PROBES] = std::array::from_fn(probe);
        let foot = camera.pose.camera_centre().xy();
        let starts_near = (points[0] - foot).norm() < (points[SAMPLES - 1] - foot).norm();
        if starts_near == (direction == Direction::Toward) {
            points.reverse();
            widths_m.reverse();
        }
        let distance_m = distances(&points);
        Ok(LaneAxis { points, distance_m, widths_m })
    }

    /// Length of the centre line, m.
    pub fn length_m(&self) -> f64 {
        self.distance_m[SAMPLES - 1]
    }

    /// Width from the upstream to the downstream end, m.
    pub fn widths_m(&self) -> &[f64; PROBES] {
        &self.widths_m
    }

    /// The place at a distance along the centre line, m, and the line's direction there.
    pub fn at(&self, s_m: f64) -> (Vector2<f64>, Vector2<f64>) {
        let k = self.distance_m.partition_point(|d| *d <= s_m).clamp(1, SAMPLES - 1);
        let (d0, d1) = (self.distance_m[k - 1], self.distance_m[k]);
        let t = if d1 > d0 { ((s_m - d0) / (d1 - d0)).clamp(0.0, 1.0) } else { 0.0 };
        let (a, b) = (self.points[k - 1], self.points[k]);
        (a.lerp(&b, t), (b - a).try_normalize(1e-12).unwrap_or(Vector2::y()))
    }

    /// The place on the centre line nearest to a point of the road (m).
    pub fn station(&self, p: Vector2<f64>) -> Station {
        let squared = |k: usize| (self.points[k] - p).norm_squared();
        let nearest_of = |range: &mut dyn Iterator<Item = usize>| {
            range.min_by(|&a, &b| squared(a).total_cmp(&squared(b))).unwrap_or(0)
        };
        let coarse = nearest_of(&mut (0..SAMPLES).step_by(STRIDE));
        let near =
            nearest_of(&mut (coarse.saturating_sub(STRIDE)..(coarse + STRIDE + 1).min(SAMPLES)));
        let mut best = (f64::INFINITY, Station { s_m: 0.0, tangent: Vector2::x() });
        for k in near.saturating_sub(1)..(near + 1).min(SAMPLES - 1) {
            let edge = self.points[k + 1] - self.points[k];
            let length = edge.norm();
            if length == 0.0 {
                continue;
            }
            let t = ((p - self.points[k]).dot(&edge) / (length * length)).clamp(0.0, 1.0);
            let away = (self.points[k] + edge * t - p).norm_squared();
            if away < best.0 {
                let s_m = self.distance_m[k] + t * length;
                best = (away, Station { s_m, tangent: edge / length });
            }
        }
        best.1
    }

    /// Points of the centre line every `step_m` metres, on the road plane.
    pub fn every(&self, step_m: f64) -> impl Iterator<Item = Vector2<f64>> + '_ {
        let count = (self.length_m() / step_m) as usize + 1;
        (0..count).map(move |k| self.at(k as f64 * step_m).0)
    }

    /// Road length along the lane that one pixel spans at a place, m.
    pub fn span_m(camera: &Camera, p: Vector2<f64>, tangent: Vector2<f64>) -> f64 {
        let world = Vector3::new(p.x, p.y, 0.0);
        let direction = camera.pose.rotation * Vector3::new(tangent.x, tangent.y, 0.0);
        let per_metre = camera.lens.jacobian(&camera.transform(&world)) * direction;
        1.0 / per_metre.norm()
    }
}

/// Left and right side of a lane.
pub(crate) type Sides = (Vec<Vector2<f64>>, Vec<Vector2<f64>>);

/// The two long sides of a polygon on the road, running the same way. Of all pairs of edges taken as
/// the ends, the right one leaves two sides that stay closest to each other.
pub(crate) fn sides(polygon: &[Vector2<f64>]) -> Option<Sides> {
    let n = polygon.len();
    let mut best: Option<(f64, _)> = None;
    for i in 0..n {
        for j in i + 2..n {
            if (j + 1) % n == i {
                continue;
            }
            let left: Vec<_> = (i + 1..=j).map(|k| polygon[k]).collect();
            let right: Vec<_> = (j + 1..=i + n).rev().map(|k| polygon[k % n]).collect();
            let gap = mean_gap(&left, &right);
            if gap > 0.0 && best.as_ref().is_none_or(|(g, _)| gap < *g) {
                best = Some((gap, (left, right)));
            }
        }
    }
    best.map(|(_, sides)| sides)
}

fn mean_gap(left: &[Vector2<f64>], right: &[Vector2<f64>]) -> f64 {
    const PLACES: usize = 33;
    let fractions = (0..PLACES).map(|k| k as f64 / (PLACES - 1) as f64);
    fractions.map(|t| (at_fraction(left, t) - at_fraction(right, t)).norm()).sum::<f64>()
        / PLACES as f64
}

/// The point at a fraction of the length of a polyline.
fn at_fraction(line: &[Vector2<f64>], fraction: f64) -> Vector2<f64> {
    let total: f64 = line.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
    let mut rest = fraction * total;
    for w in line.windows(2) {
        let length = (w[1] - w[0]).norm();
        if rest <= length && length > 0.0 {
            return w[0].lerp(&w[1], rest / length);
        }
        rest -= length;
    }
    line[line.len() - 1]
}

/// Distance of a place from a polyline, m.
fn nearest_m(line: &[Vector2<f64>], p: Vector2<f64>) -> f64 {
    line.windows(2)
        .map(|w| {
            let edge = w[1] - w[0];
            let t = (p - w[0]).dot(&edge) / edge.norm_squared().max(f64::MIN_POSITIVE);
            (w[0] + edge * t.clamp(0.0, 1.0) - p).norm()
        })
        .fold(f64::INFINITY, f64::min)
}

fn distances(points: &[Vector2<f64>]) -> Vec<f64> {
    let mut sum = 0.0;
    let mut all = vec![0.0];
    for w in points.windows(2) {
        sum += (w[1] - w[0]).norm();
        all.push(sum);
    }
    all
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::camera::{Lens, Pose};

    /// 12 m above the road, looking along +Y, 20 degrees down.
    pub(crate) fn camera() -> Camera {
        let tilt = 20f64.to_radians();
        let rotation = nalgebra::Rotation3::from_matrix_unchecked(nalgebra::Matrix3::new(
            1.0,
            0.0,
            0.0, //
            0.0,
            -tilt.sin(),
            -tilt.cos(), //
            0.0,
            tilt.cos(),
            -tilt.sin(),
        ));
        let translation = -(rotation * Vector3::new(0.0, 0.0, 12.0));
        let image_size = [320, 240];
        Camera {
            image_size,
            lens: Lens::centred(350.0, image_size),
            pose: Pose { rotation, translation },
            crest_per_m: 0.0,
        }
    }

    pub(crate) fn picture(camera: &Camera, ground: &[[f64; 2]]) -> Vec<Vector2<f64>> {
        ground.iter().map(|&[x, y]| camera.project(&Vector3::new(x, y, 0.0)).unwrap()).collect()
    }

    #[test]
    fn a_straight_lane_measures_its_length_from_the_right_end() {
        let camera = camera();
        let polygon = picture(&camera, &[[-1.5, 25.0], [1.5, 25.0], [1.5, 75.0], [-1.5, 75.0]]);
        for (direction, s_at_30) in
            [(Direction::Away, 5.0), (Direction::Unknown, 5.0), (Direction::Toward, 45.0)]
        {
            let axis = LaneAxis::of_polygon("1", &polygon, direction, &camera).unwrap();
            assert!((axis.length_m() - 50.0).abs() < 1e-6);
            let station = axis.station(Vector2::new(0.7, 30.0));
            assert!((station.s_m - s_at_30).abs() < 1e-6, "{direction:?} {}", station.s_m);
        }
    }

    #[test]
    fn a_curve_is_measured_along_its_arc() {
        let camera = camera();
        let radius = 60.0;
        let arc = |r: f64, steps: &mut dyn Iterator<Item = usize>| -> Vec<[f64; 2]> {
            steps
                .map(|k| {
                    let a = 0.6 * k as f64 / 40.0;
                    [radius - r * a.cos(), 25.0 + r * a.sin()]
                })
                .collect()
        };
        let mut ground = arc(radius - 1.6, &mut (0..=40));
        ground.extend(arc(radius + 1.6, &mut (0..=40).rev()));
        let polygon = picture(&camera, &ground);
        let axis = LaneAxis::of_polygon("2", &polygon, Direction::Away, &camera).unwrap();
        assert!((axis.length_m() - 0.6 * radius).abs() < 0.01, "{}", axis.length_m());
        let station = axis
            .station(Vector2::new(radius - radius * 0.3f64.cos(), 25.0 + radius * 0.3f64.sin()));
        assert!((station.s_m - 0.3 * radius).abs() < 0.01);
    }

    #[test]
    fn one_pixel_spans_what_projection_says() {
        let camera = camera();
        let (p, t) = (Vector2::new(1.0, 50.0), Vector2::new(0.0, 1.0));
        let a = camera.project(&Vector3::new(1.0, 49.9, 0.0)).unwrap();
        let b = camera.project(&Vector3::new(1.0, 50.1, 0.0)).unwrap();
        let expected = 0.2 / (a - b).norm();
        assert!((LaneAxis::span_m(&camera, p, t) / expected - 1.0).abs() < 1e-4);
    }

    #[test]
    fn a_corner_in_the_sky_is_named() {
        let camera = camera();
        let mut polygon = picture(&camera, &[[-1.5, 25.0], [1.5, 25.0], [1.5, 75.0], [-1.5, 75.0]]);
        polygon[2].y = -30.0;
        let error = LaneAxis::of_polygon("3", &polygon, Direction::Away, &camera).unwrap_err();
        assert!(error.to_string().contains("lane 3, corner 3"), "{error}");
    }
}
