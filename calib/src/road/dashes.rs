//! Dashes along a drawn lane line: where paint begins and ends in a picture without traffic.
//!
//! Owns the profile of paint along a line, its runs, and which of them repeat at one pitch on the
//! road. A line that does not show dashes is refused with the reason. Does not own what the pitch is
//! in truth (see `standards`) nor the camera: a fit from lane lines alone is good enough, since only
//! neighbouring spacings are compared.

use super::fit::MarkCue;
use crate::camera::Camera;
use nalgebra::{Vector2, Vector3};
use std::fmt;

/// Step along the line, px.
const STEP_PX: f64 = 0.5;
/// How far beside the drawn line its paint is looked for, px.
const REACH_PX: f64 = 3.0;
/// Distances from the paint to the asphalt beside it, px.
const BESIDE_PX: [f64; 4] = [1.0, 1.5, 2.0, 3.0];
/// Paint is brighter than the asphalt beside it by so many levels of 255 at least.
const LEAST_CONTRAST: f64 = 6.0;
/// Where the lower quartile of the profile is above this part of its top, the paint does not break.
const SOLID: f64 = 0.4;
/// Part of the line over which the level of paint and asphalt is taken.
const WINDOW: usize = 4;
/// The same in steps, at least.
const LEAST_WINDOW: usize = 40;
/// Dashes of one line are alike in length within this factor, and gaps too.
const ALIKE: f64 = 1.6;
/// Neighbouring spacings are alike within this factor: a rough camera stretches the far end.
const STEADY: f64 = 1.33;
/// Fewest dashes: two have one spacing, which shows no repetition.
const FEWEST: usize = 3;
/// Two middles closer together than this are not told apart, px.
const LEAST_SPACING_PX: f64 = 4.0;
/// How well the middle of a dash is found, px.
const MIDDLE_PX: f64 = 0.7;

/// Dashes of one line that repeat.
#[derive(Clone, Debug, PartialEq)]
pub struct Dashes {
    /// Their middles, px, in the order of the line.
    pub middles: Vec<Vector2<f64>>,
    /// Median distance from one to the next on the road of the camera by which they were found, m.
    pub pitch_m: f64,
}

impl Dashes {
    /// The cue of the road fit once the pitch is known: `pitch_m` with its tolerance.
    pub fn cue(&self, name: String, pitch_m: f64, rel_sd: f64) -> MarkCue {
        let cue = MarkCue::measured(name, self.middles.clone(), pitch_m);
        MarkCue { rel_sd, px_sd: MIDDLE_PX, ..cue }
    }
}

/// Why a line shows no dashes.
#[derive(Clone, Debug, PartialEq)]
pub enum NoDashes {
    /// The line is too short, or above the horizon.
    Short,
    /// There is no paint along it.
    Unpainted {
        /// Levels by which the brightest tenth is above the asphalt.
        contrast: f64,
    },
    /// Its paint does not break.
    Solid,
    /// There are dashes, but too few in a row at one spacing.
    Irregular {
        /// How many dashes there are.
        found: usize,
        /// How many of them repeat.
        in_a_row: usize,
    },
}

impl fmt::Display for NoDashes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            NoDashes::Short => f.write_str(
                "the line is too short, or lies above the horizon; draw it along the road",
            ),
            NoDashes::Unpainted { contrast } => write!(
                f,
                "no paint is seen along the line ({contrast:.0} of 255 levels brighter than beside \
                 it, {LEAST_CONTRAST:.0} are needed); draw it on the paint, or click the dashes"
            ),
            NoDashes::Solid => f.write_str("the line's paint does not break: it is solid"),
            NoDashes::Irregular { found, in_a_row } => write!(
                f,
                "{found} dashes are seen, {in_a_row} of them in a row at one spacing, {FEWEST} are \
                 needed; click their ends by hand"
            ),
        }
    }
}

/// A picture without traffic: red, green and blue of each pixel, row by row.
#[derive(Clone, Copy, Debug)]
pub struct Picture<'a> {
    /// The pixels.
    pub rgb: &'a [u8],
    /// Width and height, px.
    pub size: [u32; 2],
}

impl Picture<'_> {
    /// Brightness at a place (px), between its pixels' middles; the border's beyond it.
    fn at(&self, p: Vector2<f64>) -> f64 {
        let [width, height] = self.size.map(|n| n as usize);
        let inside = |x: f64, n: usize| (x - 0.5).clamp(0.0, n as f64 - 1.001);
        let (x, y) = (inside(p.x, width), inside(p.y, height));
        let (i, j) = (x as usize, y as usize);
        let (a, b) = (x - i as f64, y - j as f64);
        let grey = |i: usize, j: usize| {
            let at = 3 * (j * width + i);
            let [r, g, b] = [0, 1, 2].map(|k| f64::from(self.rgb[at + k]));
            0.299 * r + 0.587 * g + 0.114 * b
        };
        let upper = grey(i, j) * (1.0 - a) + grey(i + 1, j) * a;
        let lower = grey(i, j + 1) * (1.0 - a) + grey(i + 1, j + 1) * a;
        upper * (1.0 - b) + lower * b
    }
}

/// Finds the dashes along a drawn line (px).
///
/// # Errors
/// Why it shows none.
pub fn find(
    picture: &Picture<'_>,
    line: &[Vector2<f64>],
    camera: &Camera,
) -> Result<Dashes, NoDashes> {
    let (places, paint) = profile(picture, line);
    if places.len() < LEAST_WINDOW {
        return Err(NoDashes::Short);
    }
    let [low, high] = levels(&paint);
    if high < LEAST_CONTRAST {
        return Err(NoDashes::Unpainted { contrast: high });
    }
    if low > SOLID * high {
        return Err(NoDashes::Solid);
    }
    let all: Vec<Dash> =
        runs(&paint).into_iter().filter_map(|run| Dash::of(run, &places, camera)).collect();
    let mut lengths: Vec<f64> = all.iter().map(|d| d.length_m).collect();
    lengths.sort_by(f64::total_cmp);
    let Some(&usual) = lengths.get(lengths.len() / 2) else { return Err(NoDashes::Solid) };
    let alike = |d: &&Dash| (1.0 / ALIKE..ALIKE).contains(&(d.length_m / usual));
    let dashes: Vec<&Dash> = all.iter().filter(alike).collect();
    let spacing: Vec<f64> = dashes.windows(2).map(|w| (w[1].ground - w[0].ground).norm()).collect();
    let px: Vec<f64> = dashes.windows(2).map(|w| (w[1].middle - w[0].middle).norm()).collect();
    // Seen apart, and with a gap between.
    let good = |k: usize| px[k] > LEAST_SPACING_PX && spacing[k] > 1.25 * usual;
    let row = longest(&spacing, good);
    if row.len() + 1 < FEWEST {
        let in_a_row = if row.is_empty() { 0 } else { row.len() + 1 };
        return Err(NoDashes::Irregular { found: dashes.len(), in_a_row });
    }
    let mut steady = spacing[row.clone()].to_vec();
    steady.sort_by(f64::total_cmp);
    let middles = dashes[row.start..=row.end].iter().map(|d| d.middle).collect();
    Ok(Dashes { middles, pitch_m: steady[steady.len() / 2] })
}

/// One run of paint.
struct Dash {
    middle: Vector2<f64>,
    ground: Vector2<f64>,
    length_m: f64,
}

impl Dash {
    /// Its middle is that of its paint on the road, not in the picture, where the near half is
    /// larger.
    fn of(run: Run, places: &[Vector2<f64>], camera: &Camera) -> Option<Self> {
        let ground = |p: &Vector2<f64>| Some(camera.back_project(p, 0.0)?.xy());
        let (first, last) = (ground(&places[run.first])?, ground(&places[run.last])?);
        let (mut sum, mut all) = (Vector2::zeros(), 0.0);
        for (p, weight) in places[run.first..=run.last].iter().zip(&run.above) {
            sum += ground(p)? * *weight;
            all += weight;
        }
        let ground = sum / all;
        let middle = camera.project(&Vector3::new(ground.x, ground.y, 0.0))?;
        Some(Dash { middle, ground, length_m: (last - first).norm() })
    }
}

/// Places along the line, and by how much the brightest paint near each is above what is beside it.
fn profile(picture: &Picture<'_>, line: &[Vector2<f64>]) -> (Vec<Vector2<f64>>, Vec<f64>) {
    let (mut places, mut raw) = (Vec::new(), Vec::new());
    let offsets: Vec<f64> =
        (0..).map(|k| STEP_PX * f64::from(k) - REACH_PX).take_while(|o| *o <= REACH_PX).collect();
    for edge in line.windows(2) {
        let length = (edge[1] - edge[0]).norm();
        let Some(along) = (edge[1] - edge[0]).try_normalize(1e-6) else { continue };
        let across = Vector2::new(-along.y, along.x);
        let steps = (length / STEP_PX) as usize;
        for k in 0..steps {
            let p = edge[0] + along * (STEP_PX * k as f64);
            let ridge = |offset: f64, beside: f64| {
                let side = |o: f64| picture.at(p + across * o);
                side(offset) - side(offset - beside).max(side(offset + beside))
            };
            let best = offsets
                .iter()
                .flat_map(|&o| BESIDE_PX.map(|beside| ridge(o, beside)))
                .fold(f64::NEG_INFINITY, f64::max);
            places.push(p);
            raw.push(best);
        }
    }
    let last = raw.len().saturating_sub(1);
    let smooth =
        |k: usize| 0.5 * raw[k] + 0.25 * (raw[k.saturating_sub(1)] + raw[(k + 1).min(last)]);
    (places, (0..raw.len()).map(smooth).collect())
}

/// The lower quartile and the top twentieth.
fn levels(values: &[f64]) -> [f64; 2] {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    [0.25, 0.95].map(|part| sorted[(part * (sorted.len() - 1) as f64) as usize])
}

/// Steps in a row that show paint, with how far each is above the threshold.
struct Run {
    first: usize,
    last: usize,
    above: Vec<f64>,
}

/// The runs that begin and end within the line.
fn runs(paint: &[f64]) -> Vec<Run> {
    let half = (paint.len() / WINDOW).max(LEAST_WINDOW) / 2;
    let above = |k: usize| {
        let window = &paint[k.saturating_sub(half)..(k + half + 1).min(paint.len())];
        let [low, high] = levels(window);
        if high - low > LEAST_CONTRAST { paint[k] - 0.5 * (low + high) } else { -1.0 }
    };
    let above: Vec<f64> = (0..paint.len()).map(above).collect();
    let mut found = Vec::new();
    let mut first = None;
    for (k, &value) in above.iter().enumerate() {
        match (value > 0.0, first) {
            (true, None) => first = Some(k),
            (false, Some(from)) => {
                if from > 0 && k > from + 1 {
                    let above = above[from..k].to_vec();
                    found.push(Run { first: from, last: k - 1, above });
                }
                first = None;
            }
            _ => {}
        }
    }
    found
}

/// The longest row of spacings that are good and like their neighbours.
fn longest(spacing: &[f64], good: impl Fn(usize) -> bool) -> std::ops::Range<usize> {
    let mut best = 0..0;
    let mut start = 0;
    for k in 0..spacing.len() {
        let like_last = k > start
            && (1.0 / STEADY..STEADY).contains(&(spacing[k] / spacing[k - 1]))
            && good(k - 1);
        if !like_last {
            start = k;
        }
        if good(k) && k + 1 - start > best.len() {
            best = start..k + 1;
        }
    }
    best
}
