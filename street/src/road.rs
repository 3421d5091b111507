//! The road in the plane: a reference line of straights and arcs, and lanes beside it.
//!
//! Owns the geometry between (s, d) along and across the road and world metres. `s` grows away
//! from the camera, `d` is positive to the right of that direction. Each lane has its own arc
//! length, because the outer lane of a curve is longer. Owns no traffic and no drawing.

/// Sampling step of the reference line, m.
const STEP_M: f64 = 0.5;

/// One piece of the reference line.
#[derive(Debug, Clone, Copy, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Piece {
    /// Length, m.
    pub length_m: f64,
    /// Curvature 1/R, 1/m: positive turns right, 0 is straight.
    #[serde(default)]
    pub curvature_per_m: f64,
    /// Curvature at the piece's end (clothoid); the same as at its start when absent.
    pub end_curvature_per_m: Option<f64>,
}

/// A place on the road with the direction of growing `s`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// World X, m.
    pub x: f64,
    /// World Y, m.
    pub y: f64,
    /// Direction of growing `s`, radians clockwise from +Y.
    pub heading: f64,
}

impl Place {
    /// The point `d` metres to the right of this place.
    pub fn beside(&self, d: f64) -> [f64; 2] {
        [self.x + d * self.heading.cos(), self.y - d * self.heading.sin()]
    }
}

/// The reference line, sampled.
#[derive(Debug, Clone)]
pub struct Road {
    places: Vec<Place>,
}

impl Road {
    /// Lays the pieces end to end from a start point and heading (radians clockwise from +Y).
    pub fn new(start: [f64; 2], heading: f64, pieces: &[Piece]) -> Self {
        let mut place = Place { x: start[0], y: start[1], heading };
        let mut places = vec![place];
        for piece in pieces {
            let steps = (piece.length_m / STEP_M).round().max(1.0) as usize;
            let end = piece.end_curvature_per_m.unwrap_or(piece.curvature_per_m);
            for step in 0..steps {
                let along = (step as f64 + 0.5) / steps as f64;
                let turn = STEP_M * (piece.curvature_per_m * (1.0 - along) + end * along);
                let middle = place.heading + turn / 2.0;
                place.x += STEP_M * middle.sin();
                place.y += STEP_M * middle.cos();
                place.heading += turn;
                places.push(place);
            }
        }
        Road { places }
    }

    /// Length of the reference line, m.
    pub fn length_m(&self) -> f64 {
        (self.places.len() - 1) as f64 * STEP_M
    }

    /// The place at `s` metres; clamped to the ends.
    pub fn at(&self, s: f64) -> Place {
        let t = (s / STEP_M).clamp(0.0, (self.places.len() - 1) as f64);
        let i = (t as usize).min(self.places.len() - 2);
        let (a, b, f) = (self.places[i], self.places[i + 1], t - i as f64);
        Place {
            x: a.x + f * (b.x - a.x),
            y: a.y + f * (b.y - a.y),
            heading: a.heading + f * (b.heading - a.heading),
        }
    }

    /// (s, d) of a world point, by a walk along the line from the index in `hint`, which is
    /// moved to the foot found. Neighbouring queries should share a hint.
    pub fn locate(&self, point: [f64; 2], hint: &mut usize) -> (f64, f64) {
        let gap = |i: usize| {
            let p = &self.places[i];
            (p.x - point[0]).powi(2) + (p.y - point[1]).powi(2)
        };
        let last = self.places.len() - 1;
        let mut i = (*hint).min(last);
        for stride in [64, 16, 4, 1] {
            loop {
                let here = gap(i);
                if i + stride <= last && gap(i + stride) < here {
                    i += stride;
                } else if i >= stride && gap(i - stride) < here {
                    i -= stride;
                } else {
                    break;
                }
            }
        }
        *hint = i;
        let p = &self.places[i];
        let (sin, cos) = p.heading.sin_cos();
        let (dx, dy) = (point[0] - p.x, point[1] - p.y);
        (i as f64 * STEP_M + dx * sin + dy * cos, dx * cos - dy * sin)
    }
}

/// Direction of a lane's traffic, seen from the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Direction {
    /// Towards the camera: fronts are seen.
    Toward,
    /// Away from the camera: tails are seen.
    Away,
}

/// The centre line of one lane with its own arc length.
#[derive(Debug, Clone)]
pub struct LaneLine {
    offset_m: f64,
    /// Arc length of the lane at each sample of the reference line.
    arc_m: Vec<f64>,
}

impl LaneLine {
    /// The line `offset_m` to the right of the reference line.
    pub fn new(road: &Road, offset_m: f64) -> Self {
        let mut arc_m = vec![0.0];
        let mut at = road.places[0].beside(offset_m);
        let mut sum = 0.0;
        for place in &road.places[1..] {
            let next = place.beside(offset_m);
            sum += (next[0] - at[0]).hypot(next[1] - at[1]);
            arc_m.push(sum);
            at = next;
        }
        LaneLine { offset_m, arc_m }
    }

    /// Length of the lane, m.
    pub fn length_m(&self) -> f64 {
        self.arc_m[self.arc_m.len() - 1]
    }

    /// The reference `s` that belongs to a distance along this lane; linear beyond the ends.
    pub fn reference_s(&self, lane_s: f64) -> f64 {
        let last = self.arc_m.len() - 1;
        if lane_s <= 0.0 {
            return lane_s;
        }
        if lane_s >= self.arc_m[last] {
            return last as f64 * STEP_M + lane_s - self.arc_m[last];
        }
        let i = self.arc_m.partition_point(|arc| *arc <= lane_s).clamp(1, last);
        let (a, b) = (self.arc_m[i - 1], self.arc_m[i]);
        (i as f64 - 1.0 + (lane_s - a) / (b - a)) * STEP_M
    }

    /// The place at a distance along this lane, `aside_m` to the right of its centre.
    pub fn at(&self, road: &Road, lane_s: f64, aside_m: f64) -> Place {
        let s = self.reference_s(lane_s);
        let place = road.at(s);
        let [x, y] = place.beside(self.offset_m + aside_m);
        // Beyond the ends the road goes straight on.
        let over = s - s.clamp(0.0, road.length_m());
        Place {
            x: x + over * place.heading.sin(),
            y: y + over * place.heading.cos(),
            heading: place.heading,
        }
    }

    /// Distance of the lane's centre right of the reference line, m.
    pub fn offset_m(&self) -> f64 {
        self.offset_m
    }
}

#[cfg(test)]
mod tests {
    use super::{LaneLine, Piece, Road};

    #[test]
    fn an_offset_lane_of_an_arc_has_its_own_length() {
        let arc = Piece { length_m: 100.0, curvature_per_m: 0.01, end_curvature_per_m: None };
        let road = Road::new([0.0, 0.0], 0.0, &[arc]);
        // Right of a right turn is the inside: R = 100 - 5.
        let lane = LaneLine::new(&road, 5.0);
        assert!((lane.length_m() - 95.0).abs() < 0.01, "{}", lane.length_m());
        let place = lane.at(&road, 47.5, 0.0);
        let mut hint = 0;
        let (s, d) = road.locate([place.x, place.y], &mut hint);
        assert!((s - 50.0).abs() < 0.02 && (d - 5.0).abs() < 0.01, "{s} {d}");
    }
}
