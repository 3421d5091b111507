//! Where the static scene lies in a picture: shift, turn and zoom against the reference.
//!
//! Owns the search and how sure it is. Does not own what follows from it (see `watch.rs`).
//!
//! The score of a pose is the sum over the reference's points of the inner product of the
//! point's edge and the picture's field where the pose puts the point. Coarse: every shift
//! within a tenth of the picture, at half resolution. Fine: shift, turn and zoom together by
//! pattern search (Hooke and Jeeves 1961), the shift then to a part of a cell by a parabola.
//! How sure: each block's score against its own scores at shifts around, in standard
//! deviations, held between -3 and 5 so that no block decides alone (a burnt-in clock never
//! moves); their sum over the root of their number is near normal where nothing matches.

use super::Eye;
use super::field::Field;
use super::reference::{BLOCK_COLUMNS, BLOCK_ROWS, BLOCKS, Point, Reference};

/// Shifts that are searched at half resolution, cells of it: a tenth of the longer side.
const REACH: i32 = 16;
/// The same where a camera is being turned back: half of the longer side.
const WIDE: i32 = 80;
/// Turns (rad) and zooms at which the coarse search is made once more where the plain one
/// finds nothing.
const TURNS: [f32; 3] = [-0.052, 0.0, 0.052];
const ZOOMS: [f32; 3] = [0.93, 1.0, 1.07];
/// Steps of the pattern search at its beginning and its end: cells, rad, parts.
const FIRST_STEP: [f32; 4] = [1.0, 1.0, 0.018, 0.018];
const HALVINGS: usize = 3;
/// Moves of the pattern search at each step length.
const MOVES: usize = 12;
/// Shifts around a pose at which it must not match as well: three rings of 8, cells.
const RINGS: [f32; 4] = [5.0, 8.0, 11.0, 14.0];
/// A block with fewer points has no say.
const LEAST_IN_BLOCK: u32 = 6;
/// A block supports a pose when it scores so many standard deviations over its surroundings.
const SUPPORT: f32 = 2.0;

/// How the picture lies against the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// To the right, cells.
    pub dx: f32,
    /// Down, cells.
    pub dy: f32,
    /// Clockwise about the picture's middle, rad.
    pub turn: f32,
    /// Factor about the picture's middle.
    pub zoom: f32,
}

impl Pose {
    /// As the reference.
    pub const SAME: Self = Self { dx: 0.0, dy: 0.0, turn: 0.0, zoom: 1.0 };

    /// Root mean square displacement over a picture of so many cells.
    pub fn displacement(&self, width: usize, height: usize) -> f32 {
        let spread = (width * width + height * height) as f32 / 12.0;
        let (turn, zoom) = (self.turn, self.zoom - 1.0);
        libm::sqrtf(self.dx * self.dx + self.dy * self.dy + (turn * turn + zoom * zoom) * spread)
    }
}

/// Result of a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// The best pose.
    pub pose: Pose,
    /// How far it stands out, standard deviations of a pose that matches by chance.
    pub significance: f32,
    /// Share of the blocks that support it.
    pub support: f32,
    /// Its score as a share of the score of the reference's own picture.
    pub agreement: f32,
}

impl Sighting {
    /// Whether the scene was found, and not a chance likeness.
    pub fn is_sure(&self) -> bool {
        self.significance >= SURE && self.support >= SURE_SUPPORT
    }
}

/// Least significance of a sighting that is believed. Measured (docs/measured/health.md):
/// pictures of other cameras reach 6.8, the same camera by day and night 11 to 34.
pub const SURE: f32 = 8.5;
/// Least support of a sighting that is believed; other cameras reach 0.25.
pub const SURE_SUPPORT: f32 = 0.3;

/// Searches a picture for the reference, within a tenth of its longer side.
pub fn search(
    reference: &Reference,
    eye: &Eye<impl AsRef<[u8]>, impl AsRef<[super::Cell]>>,
) -> Sighting {
    search_within(reference, eye, REACH)
}

/// The same within half of the picture's longer side: 25 times the work, for a camera that
/// someone is turning.
pub fn search_wide(
    reference: &Reference,
    eye: &Eye<impl AsRef<[u8]>, impl AsRef<[super::Cell]>>,
) -> Sighting {
    search_within(reference, eye, WIDE)
}

fn search_within(
    reference: &Reference,
    eye: &Eye<impl AsRef<[u8]>, impl AsRef<[super::Cell]>>,
    reach: i32,
) -> Sighting {
    let (fine, coarse) = (eye.fine(), eye.coarse());
    let (start, _) = coarse_search(&reference.coarse, &coarse, 0.0, 1.0, reach);
    let first = sighting(reference, &fine, start);
    if first.is_sure() {
        return first;
    }
    // Nothing at this turn and zoom: the others cost eight times as much and are tried
    // only now.
    let mut best = (start, i32::MIN);
    for turn in TURNS {
        for zoom in ZOOMS {
            if turn == 0.0 && zoom == 1.0 {
                continue;
            }
            let found = coarse_search(&reference.coarse, &coarse, turn, zoom, reach);
            if found.1 > best.1 {
                best = found;
            }
        }
    }
    let other = sighting(reference, &fine, best.0);
    if other.significance > first.significance { other } else { first }
}

/// The best shift at half resolution, as a pose of the full one, and its score.
fn coarse_search(
    points: &[Point],
    field: &Field<'_>,
    turn: f32,
    zoom: f32,
    reach: i32,
) -> (Pose, i32) {
    let mut best = (Pose { turn, zoom, ..Pose::SAME }, i32::MIN);
    let map = Map::of(Pose { turn, zoom, ..Pose::SAME }, field);
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            let mut score = 0;
            for point in points {
                let (x, y) = map.nearest(point);
                score += inner(point, field.at(x + dx, y + dy));
            }
            // Of equal scores the one with less shift.
            if score > best.1 {
                let (dx, dy) = (2.0 * dx as f32, 2.0 * dy as f32);
                best = (Pose { dx, dy, turn, zoom }, score);
            }
        }
    }
    best
}

#[inline]
fn inner(point: &Point, cell: [i8; 2]) -> i32 {
    let ([pc, ps], [c, s]) = (point.edge, cell);
    i32::from(pc) * i32::from(c) + i32::from(ps) * i32::from(s)
}

/// A pose as the affine map of cell indices.
struct Map {
    cos: f32,
    sin: f32,
    middle: [f32; 2],
    to: [f32; 2],
}

impl Map {
    fn of(pose: Pose, field: &Field<'_>) -> Self {
        let (sin, cos) = libm::sincosf(pose.turn);
        let middle = [(field.width as f32 - 1.0) / 2.0, (field.height as f32 - 1.0) / 2.0];
        let [x, y] = middle;
        let to = [x + pose.dx, y + pose.dy];
        Self { cos: cos * pose.zoom, sin: sin * pose.zoom, middle, to }
    }

    #[inline]
    fn apply(&self, point: &Point) -> (f32, f32) {
        let x = f32::from(point.x) - self.middle[0];
        let y = f32::from(point.y) - self.middle[1];
        (self.to[0] + self.cos * x - self.sin * y, self.to[1] + self.sin * x + self.cos * y)
    }

    #[inline]
    fn nearest(&self, point: &Point) -> (i32, i32) {
        let (x, y) = self.apply(point);
        // Shifted so that the conversion, which cuts towards zero, rounds.
        ((x + 1000.5) as i32 - 1000, (y + 1000.5) as i32 - 1000)
    }
}

/// The score of a pose with the field between its cells.
fn score(points: &[Point], field: &Field<'_>, pose: Pose) -> f32 {
    let map = Map::of(pose, field);
    let mut sum = 0.0;
    for point in points {
        sum += between(point, field, map.apply(point));
    }
    sum
}

/// Inner product of a point and the field at a place between four cells.
#[inline]
fn between(point: &Point, field: &Field<'_>, (x, y): (f32, f32)) -> f32 {
    let (x0, y0) = ((x + 1000.0) as i32 - 1000, (y + 1000.0) as i32 - 1000);
    let (fx, fy) = (x - x0 as f32, y - y0 as f32);
    let at = |i: i32, j: i32| inner(point, field.at(x0 + i, y0 + j)) as f32;
    let above = at(0, 0) * (1.0 - fx) + at(1, 0) * fx;
    let below = at(0, 1) * (1.0 - fx) + at(1, 1) * fx;
    above * (1.0 - fy) + below * fy
}

/// Refines a pose and says how sure it is.
fn sighting(reference: &Reference, field: &Field<'_>, start: Pose) -> Sighting {
    let (pose, best) = refine(&reference.fine, field, start);
    let [at, around] = blocks(&reference.fine, field, pose);
    let (mut sum, mut count, mut supporting) = (0.0, 0u32, 0u32);
    for (block, surroundings) in at.iter().zip(&around) {
        if block.points < LEAST_IN_BLOCK {
            continue;
        }
        let n = (RINGS.len() * 8) as f32;
        let mean = surroundings.sum / n;
        // One level of every point is the least spread that means anything.
        let least = block.points as f32 * 127.0;
        let variance = (surroundings.squares / n - mean * mean).max(least * least * 0.01);
        let z = (block.sum - mean) / libm::sqrtf(variance);
        sum += z.clamp(-3.0, 5.0);
        count += 1;
        supporting += u32::from(z >= SUPPORT);
    }
    let own: f32 =
        reference.fine.iter().map(|p| libm::sqrtf(inner(p, p.edge) as f32) * 127.0).sum();
    let blocks = if count == 0 { 1.0 } else { count as f32 };
    Sighting {
        pose,
        significance: sum / libm::sqrtf(blocks),
        support: supporting as f32 / blocks,
        agreement: if own > 0.0 { best / own } else { 0.0 },
    }
}

fn refine(points: &[Point], field: &Field<'_>, start: Pose) -> (Pose, f32) {
    let mut pose = [start.dx, start.dy, start.turn, start.zoom];
    let of = |[dx, dy, turn, zoom]: [f32; 4]| Pose { dx, dy, turn, zoom };
    let mut best = score(points, field, of(pose));
    let mut step = FIRST_STEP;
    for _ in 0..=HALVINGS {
        for _ in 0..MOVES {
            let mut moved = false;
            for axis in 0..4 {
                for sign in [-1.0, 1.0] {
                    let mut tried = pose;
                    if let (Some(value), Some(step)) = (tried.get_mut(axis), step.get(axis)) {
                        *value += sign * step;
                    }
                    let score = score(points, field, of(tried));
                    if score > best {
                        (best, pose, moved) = (score, tried, true);
                    }
                }
            }
            if !moved {
                break;
            }
        }
        let [dx, dy, turn, zoom] = step;
        step = [dx, dy, turn * 0.5, zoom * 0.5];
    }
    let mut pose = of(pose);
    let peak = |minus: f32, plus: f32| {
        let curve = minus + plus - 2.0 * best;
        if curve < 0.0 { (0.5 * (minus - plus) / curve).clamp(-0.5, 0.5) } else { 0.0 }
    };
    let at = |dx: f32, dy: f32| {
        score(points, field, Pose { dx: pose.dx + dx, dy: pose.dy + dy, ..pose })
    };
    let (dx, dy) = (peak(at(-1.0, 0.0), at(1.0, 0.0)), peak(at(0.0, -1.0), at(0.0, 1.0)));
    pose.dx += dx;
    pose.dy += dy;
    (pose, best)
}

#[derive(Clone, Copy, Default)]
struct Block {
    points: u32,
    sum: f32,
    squares: f32,
}

/// Scores by block at a pose, and their sums over the shifts around it.
fn blocks(points: &[Point], field: &Field<'_>, pose: Pose) -> [[Block; BLOCKS]; 2] {
    let mut at = [Block::default(); BLOCKS];
    let mut around = [Block::default(); BLOCKS];
    let block_of = |p: &Point| {
        let column = usize::from(p.x) * BLOCK_COLUMNS;
        let row = usize::from(p.y) * BLOCK_ROWS;
        let column = column.checked_div(field.width).unwrap_or(0);
        row.checked_div(field.height).unwrap_or(0) * BLOCK_COLUMNS + column
    };
    let mut sums = |pose: Pose, mut each: Option<&mut [Block; BLOCKS]>| {
        let map = Map::of(pose, field);
        let mut here = [Block::default(); BLOCKS];
        for point in points {
            if let Some(block) = here.get_mut(block_of(point)) {
                block.points += 1;
                block.sum += between(point, field, map.apply(point));
            }
        }
        if let Some(each) = &mut each {
            **each = here;
            return;
        }
        for (total, block) in around.iter_mut().zip(&here) {
            total.sum += block.sum;
            total.squares += block.sum * block.sum;
        }
    };
    sums(pose, Some(&mut at));
    for (ring, radius) in RINGS.into_iter().enumerate() {
        for spoke in 0..8 {
            // Each ring turned by a quarter of a spoke, so that no direction is left out.
            let angle = (spoke as f32 + ring as f32 * 0.25) * core::f32::consts::FRAC_PI_4;
            let (sin, cos) = libm::sincosf(angle);
            let (dx, dy) = (pose.dx + radius * cos, pose.dy + radius * sin);
            sums(Pose { dx, dy, ..pose }, None);
        }
    }
    [at, around]
}
