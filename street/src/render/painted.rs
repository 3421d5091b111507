//! Words, arrows and symbols painted in lanes: which places of the road they cover.
//!
//! Owns their shapes in the frame of their reader: x to the right, y ahead, m. Surfaces and wear by
//! traffic are `ground.rs`. Sizes after the usual ones on roads of 50 km/h (TSRGD 2016, schedules
//! 9 and 11; MUTCD 2009, 3B): letters are stretched along the road.

use crate::font::{self, Stroke};
use crate::random::smooth;
use crate::road::{Direction, LaneLine};
use crate::scene::{Painted, PaintedKind, Scene, Turn};
use crate::vehicle::paint::Rgb;

/// Gap between two lines of a word, share of the length of a line.
const LINE_GAP: f64 = 0.5;

/// Thickness of the lines of a box junction, m, and distance between them.
const HATCH_M: [f64; 2] = [0.15, 1.6];

/// Width of a bar of a zebra crossing and of the gap, m.
const ZEBRA_M: f64 = 0.5;

/// Width of a give-way triangle with its gap, m.
const TOOTH_M: f64 = 0.7;

/// A mark on the road, ready to be asked for.
pub struct Mark {
    s: f64,
    d: f64,
    /// Its reader drives towards the camera.
    toward: bool,
    half_m: [f64; 2],
    shape: Shape,
    colour: Rgb,
    worn: f32,
}

enum Shape {
    Whole,
    /// Strokes, their size in their own units, and half their thickness.
    Strokes(Vec<Stroke>, [f64; 2], f64),
    /// Polygons in a frame from -1 to 1 along both axes.
    Polygons(Vec<Vec<[f64; 2]>>),
    Hatching,
    Teeth,
    Bars,
}

/// The marks of a scene in the order of their painting.
pub fn marks(scene: &Scene, lines: &[LaneLine]) -> Vec<Mark> {
    scene.painted.iter().map(|painted| mark(painted, scene, lines)).collect()
}

fn mark(painted: &Painted, scene: &Scene, lines: &[LaneLine]) -> Mark {
    let lane = painted.lane.map(|number| (&scene.lanes[number - 1], &lines[number - 1]));
    let lane_m = lane.map_or(3.5, |(spec, _)| spec.width_m);
    let (usual, shape) = match painted.kind {
        PaintedKind::Word => {
            let (strokes, size) = word(&painted.text);
            let lines = painted.text.split(' ').count() as f64;
            let width = (0.32 * size[0]).min(0.85 * lane_m);
            let length = painted.length_m.unwrap_or(2.8) * (lines + LINE_GAP * (lines - 1.0));
            return placed(
                painted,
                lane,
                [painted.width_m.unwrap_or(width), length],
                Shape::Strokes(strokes, size, font::HALF_STROKE),
            );
        }
        PaintedKind::Arrow => ([1.3, 4.0], Shape::Polygons(arrow(painted.turn))),
        PaintedKind::Cycle => {
            let (strokes, size) = bicycle();
            ([1.1, 2.2], Shape::Strokes(strokes, size, 0.3))
        }
        PaintedKind::Hatching => ([lane_m, 9.0], Shape::Hatching),
        PaintedKind::StopLine => ([lane_m, 0.4], Shape::Whole),
        PaintedKind::GiveWay => ([lane_m, 0.8], Shape::Teeth),
        PaintedKind::Zebra => ([lane_m, 3.0], Shape::Bars),
    };
    let size = [painted.width_m.unwrap_or(usual[0]), painted.length_m.unwrap_or(usual[1])];
    placed(painted, lane, size, shape)
}

fn placed(
    painted: &Painted,
    lane: Option<(&crate::scene::LaneSpec, &LaneLine)>,
    size_m: [f64; 2],
    shape: Shape,
) -> Mark {
    Mark {
        s: painted.at_m,
        d: lane.map_or(painted.offset_m.unwrap_or(0.0), |(_, line)| line.offset_m()),
        toward: lane.is_some_and(|(spec, _)| spec.direction == Direction::Toward),
        half_m: size_m.map(|m| m / 2.0),
        shape,
        colour: if painted.yellow { [0.62, 0.43, 0.06] } else { [0.7, 0.7, 0.68] },
        worn: painted.worn as f32,
    }
}

impl Mark {
    /// Its colour and cover at a place of the road; `point` is the same place in the world.
    pub fn at(&self, s: f64, d: f64, point: [f64; 2], salt: u64) -> Option<(Rgb, f32)> {
        let way = if self.toward { -1.0 } else { 1.0 };
        let (x, y) = (way * (d - self.d), way * (s - self.s));
        let [wide, long] = self.half_m;
        if x.abs() > wide || y.abs() > long || !self.covers(x, y) {
            return None;
        }
        // Paint goes in flakes, and sooner where wheels roll.
        let flake = smooth(point[0] / 0.22, point[1] / 0.22, salt ^ 41);
        let patch = smooth(point[0] / 1.6, point[1] / 1.6, salt ^ 42);
        let lost = ((self.worn * 1.9 - 0.45 - 0.5 * flake - 0.45 * patch) * 3.0).clamp(0.0, 1.0);
        Some((self.colour, 0.94 * (1.0 - 0.25 * self.worn) * (1.0 - 0.92 * lost)))
    }

    fn covers(&self, x: f64, y: f64) -> bool {
        let [wide, long] = self.half_m;
        match &self.shape {
            Shape::Whole => true,
            Shape::Strokes(strokes, size, half) => {
                let unit = [(x / wide + 1.0) / 2.0 * size[0], (y / long + 1.0) / 2.0 * size[1]];
                font::inked(strokes, unit, *half)
            }
            Shape::Polygons(polygons) => {
                polygons.iter().any(|polygon| font::in_polygon(polygon, [x / wide, y / long]))
            }
            Shape::Hatching => {
                let [thick, apart] = HATCH_M;
                let diagonal = std::f64::consts::SQRT_2;
                let line = |along: f64| along.rem_euclid(apart * diagonal) < thick * diagonal;
                let frame = x.abs() > wide - thick || y.abs() > long - thick;
                frame || line(x + y) || line(x - y)
            }
            Shape::Teeth => {
                // The tip is nearest to the reader.
                let across = ((x + wide).rem_euclid(TOOTH_M) / TOOTH_M - 0.5).abs();
                across < 0.4 * (y / long + 1.0) / 2.0
            }
            Shape::Bars => (x + wide).rem_euclid(2.0 * ZEBRA_M) < ZEBRA_M,
        }
    }
}

/// The strokes of words, one a line, centred; the first lies farthest from the reader.
fn word(text: &str) -> (Vec<Stroke>, [f64; 2]) {
    let lines: Vec<_> = text.split(' ').map(font::line_of).collect();
    let width = lines.iter().map(|(_, width)| *width).fold(1.0, f64::max);
    let pitch = font::LINE_HEIGHT * (1.0 + LINE_GAP);
    let mut strokes = Vec::new();
    for (i, (line, own)) in lines.iter().rev().enumerate() {
        let shift = [(width - own) / 2.0, i as f64 * pitch];
        let moved = |p: [f64; 2]| [p[0] + shift[0], p[1] + shift[1]];
        strokes.extend(line.iter().map(|stroke| stroke.map(moved)));
    }
    let height = pitch * (lines.len() as f64 - 1.0) + font::LINE_HEIGHT;
    (strokes, [width, height])
}

/// The polygons of an arrow, from -1 to 1 along both axes.
pub fn arrow(turn: Turn) -> Vec<Vec<[f64; 2]>> {
    let mirror = |polygons: Vec<Vec<[f64; 2]>>| -> Vec<Vec<[f64; 2]>> {
        polygons.into_iter().map(|p| p.into_iter().map(|[x, y]| [-x, y]).collect()).collect()
    };
    let ahead = || {
        vec![
            vec![[-0.15, -1.0], [0.15, -1.0], [0.15, 0.3], [-0.15, 0.3]],
            vec![[-0.6, 0.25], [0.6, 0.25], [0.0, 1.0]],
        ]
    };
    let arm = |x: f64, y: f64| {
        vec![
            vec![[x - 0.15, y - 0.4], [x + 0.15, y - 0.2], [-0.35, y + 0.22], [-0.35, y - 0.06]],
            vec![[-0.35, y - 0.32], [-0.35, y + 0.48], [-1.0, y + 0.08]],
        ]
    };
    let left = || {
        let mut parts = arm(0.35, 0.4);
        parts.push(vec![[0.2, -1.0], [0.5, -1.0], [0.5, 0.2], [0.2, 0.0]]);
        parts
    };
    match turn {
        Turn::Ahead => ahead(),
        Turn::Left => left(),
        Turn::Right => mirror(left()),
        Turn::AheadLeft => [ahead(), arm(0.0, -0.3)].concat(),
        Turn::AheadRight => [ahead(), mirror(arm(0.0, -0.3))].concat(),
    }
}

/// The strokes of a bicycle seen from its side, and its size in their units.
fn bicycle() -> (Vec<Stroke>, [f64; 2]) {
    let mut strokes = Vec::new();
    for hub in [1.8, 6.2] {
        let rim: Vec<[f64; 2]> = (0..=12)
            .map(|i| {
                let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / 12.0).sin_cos();
                [hub + 1.4 * cos, 1.8 + 1.4 * sin]
            })
            .collect();
        strokes.extend(rim.windows(2).map(|pair| [pair[0], pair[1]]));
    }
    let frame = [
        vec![[1.8, 1.8], [2.9, 4.0], [5.3, 4.0], [3.9, 1.8], [1.8, 1.8]],
        vec![[3.9, 1.8], [2.6, 4.8]],
        vec![[2.0, 4.9], [3.2, 4.9]],
        vec![[6.2, 1.8], [5.1, 5.2], [6.0, 5.4]],
    ];
    for line in frame {
        strokes.extend(line.windows(2).map(|pair| [pair[0], pair[1]]));
    }
    (strokes, [8.0, 6.0])
}
