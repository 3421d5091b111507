//! Where to look: the parts of the picture that hold the road, from the lane table.
//!
//! Owns how large a vehicle must be for the detector, and which parts of the picture make it
//! so. Computes only, once a table: knows neither the table's file nor who searches.
//!
//! The net's input has a fixed size, so that a part of the picture reaches it enlarged. The
//! first part holds all lanes; where their far ends stay small, a second one holds these alone.
//! How large a vehicle is follows from the width of its lane: lane pixels times the length of
//! road that each spans is an area in pixels times metres, whichever way the lane runs.

use crate::daemon::frame::Region;
use crate::evidence::CarSize;
use crate::lane::{Description, Place};
use crate::units::{ImagePoint, ImageSize, LaneId};
use std::fmt;

/// Most parts of a picture that are searched.
pub const MAX_REGIONS: usize = 2;
/// Shorter side of a vehicle in the net's input from which larger ones are found no more
/// often, px (`models/README.md`, recall by size).
const ENOUGH_PX: f32 = 32.0;
/// A second part must bring so much of the lanes from nothing to [`ENOUGH_PX`], or more of
/// them nearer to it.
const WORTH: f32 = 0.05;
/// Lanes are taken in pieces of this length, m.
const PIECE_M: f32 = 5.0;
/// Width of a car as a share of its lane's: 1.8 of 3.6 m.
const CAR_SHARE: f32 = 0.5;
/// How far vehicles reach beyond the lane pixel where they meet the road, in widths of the
/// lane: half a bus and its mirrors to the sides, a lorry of 3.9 m upwards, and some road below.
const BESIDE: f32 = 0.6;
const ABOVE: f32 = 1.1;
const BELOW: f32 = 0.35;
/// And along the lane: a car and a half, m. A longer vehicle at an end is cut off.
const ALONG_M: f32 = 6.0;

/// The parts of one table's pictures, the widest first; none: the whole picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Parts {
    table: ImageSize,
    regions: heapless::Vec<Region, MAX_REGIONS>,
}

impl Parts {
    /// The whole picture, of whatever size.
    pub const WHOLE: Self =
        Self { table: ImageSize { width: 1, height: 1 }, regions: heapless::Vec::new() };

    /// The parts for a net with an input of that size, where `place` is the look-up in the
    /// table that `description` describes.
    pub fn new(
        description: &Description,
        place: impl Fn(ImagePoint) -> Option<Place>,
        input: [usize; 2],
    ) -> Self {
        let table = description.image_size;
        let pieces = pieces(description, place);
        Self { table, regions: choose(&pieces, table, input) }
    }

    /// How many there are; none stands for the whole picture.
    pub fn count(&self) -> usize {
        self.regions.len()
    }

    /// Leaves out all but the widest.
    pub fn keep_one(&mut self) {
        self.regions.truncate(1);
    }

    /// The parts of a picture of that size, which has the table's shape.
    pub fn of(&self, (width, height): (usize, usize)) -> heapless::Vec<Region, MAX_REGIONS> {
        let scale = |value: usize, table: u16, picture: usize, up: bool| {
            let (product, table) = (value * picture, usize::from(table).max(1));
            if up { product.div_ceil(table) } else { product / table }.min(picture)
        };
        let region = |region: &Region| {
            let (x, y) = (
                scale(region.x, self.table.width, width, false),
                scale(region.y, self.table.height, height, false),
            );
            let (right, lower) = (
                scale(region.x + region.width, self.table.width, width, true),
                scale(region.y + region.height, self.table.height, height, true),
            );
            Region { x, y, width: right - x, height: lower - y }
        };
        self.regions.iter().map(region).collect()
    }
}

impl fmt::Display for Parts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.regions.len() {
            0 => write!(f, "the whole picture"),
            1 => write!(f, "the road"),
            _ => write!(f, "the road and its far part"),
        }
    }
}

/// A piece of a lane in the picture.
#[derive(Clone, Debug, PartialEq)]
struct Piece {
    length_m: f32,
    /// Width of the lane, px.
    width: f32,
    /// Its middle, px.
    middle: [f32; 2],
    /// Pixels that vehicles on it cover: left, upper, right, lower edge, px.
    extent: [f32; 4],
}

/// Sums over the pixels of a piece.
#[derive(Clone, Copy)]
struct Sum {
    area: f32,
    count: f32,
    middle: [f32; 2],
    extent: [f32; 4],
}

/// Side of a car's box (the root of its area) as a share of its lane's width, from whichever
/// angle: the medians over pieces of lanes are 0.63 on `freeway`, 0.68 on `curve` and 0.72 on K109F.
const SIDE_SHARE: f32 = 0.67;

/// How large cars are along the lanes of a table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cars {
    /// By place; `None` where the lanes are too short to tell.
    pub size: Option<CarSize>,
    /// The median over the lanes' length, px of the table's picture.
    pub median_px: Option<f32>,
}

impl Cars {
    /// From the table that `description` describes; `place` is its look-up.
    pub fn along(description: &Description, place: impl Fn(ImagePoint) -> Option<Place>) -> Self {
        let pieces = pieces(description, place);
        let samples = pieces.iter().map(|piece| {
            let [u, v] = piece.middle;
            (ImagePoint { u, v }, piece.width * SIDE_SHARE)
        });
        let width = f32::from(description.image_size.width);
        let size = CarSize::fit(samples.clone(), width);
        let mut sides: Vec<f32> =
            samples.map(|(point, side)| size.map_or(side, |size| size.at(point, width))).collect();
        sides.sort_by(f32::total_cmp);
        Self { size, median_px: sides.get(sides.len() / 2).copied() }
    }
}

const NOTHING: [f32; 4] = [f32::INFINITY, f32::INFINITY, f32::NEG_INFINITY, f32::NEG_INFINITY];
const EMPTY: Sum = Sum { area: 0.0, count: 0.0, middle: [0.0; 2], extent: NOTHING };

fn union(a: [f32; 4], b: [f32; 4]) -> [f32; 4] {
    [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])]
}

fn pieces(description: &Description, place: impl Fn(ImagePoint) -> Option<Place>) -> Vec<Piece> {
    let ImageSize { width, height } = description.image_size;
    let count = |length_m: f32| (length_m / PIECE_M).ceil().max(1.0) as usize;
    let mut sums: Vec<(LaneId, f32, Vec<Sum>)> = description
        .lanes
        .iter()
        .map(|lane| (lane.id, lane.length_m, vec![EMPTY; count(lane.length_m)]))
        .collect();
    for v in 0..height {
        for u in 0..width {
            let (u, v) = (f32::from(u), f32::from(v));
            let Some(at) = place(ImagePoint { u: u + 0.5, v: v + 0.5 }) else { continue };
            let Some((_, _, sums)) = sums.iter_mut().find(|lane| lane.0 == at.lane) else {
                continue;
            };
            let piece = ((at.s_m / PIECE_M) as usize).min(sums.len() - 1);
            let sum = &mut sums[piece];
            sum.area += at.span_m;
            sum.count += 1.0;
            sum.middle = [sum.middle[0] + u + 0.5, sum.middle[1] + v + 0.5];
            sum.extent = union(sum.extent, [u, v, u + 1.0, v + 1.0]);
        }
    }
    sums.iter().flat_map(|(_, length_m, sums)| lane_pieces(*length_m, sums)).collect()
}

fn lane_pieces(length_m: f32, sums: &[Sum]) -> Vec<Piece> {
    let last = sums.len() - 1;
    let length = |i: usize| (length_m - i as f32 * PIECE_M).clamp(PIECE_M / 10.0, PIECE_M);
    // The picture or a slanting end may cut the outermost ones.
    let whole = |i: usize| if last < 2 { i } else { i.clamp(1, last - 1) };
    let middle = |i: usize| sums[i].middle.map(|sum| sum / sums[i].count);
    let is_there = |i: &usize| sums[*i].count > 0.0;
    (0..=last)
        .filter(is_there)
        .map(|i| {
            let width = sums[whole(i)].area / length(whole(i));
            let beside = [i.saturating_sub(1), (i + 1).min(last)];
            let [from, to] = beside.map(|j| if is_there(&j) { j } else { i });
            let metres = ((to - from) as f32 * PIECE_M).max(1.0);
            let [a, b] = [middle(from), middle(to)];
            let [along_u, along_v] = [0, 1].map(|axis| (b[axis] - a[axis]).abs() / metres);
            let [x0, y0, x1, y1] = sums[i].extent;
            let sideways = BESIDE * width + ALONG_M * along_u;
            let upwards = ABOVE * width + ALONG_M * along_v;
            let extent = [x0 - sideways, y0 - upwards, x1 + sideways, y1 + BELOW * width];
            Piece { length_m: length(i), width, middle: middle(i), extent }
        })
        .collect()
}

/// The part of a picture of that shape that holds `extent`, in the shape of the input where
/// the picture has room for it.
fn fit(extent: [f32; 4], picture: ImageSize, input: [usize; 2]) -> Region {
    let [width, height] = [f32::from(picture.width), f32::from(picture.height)];
    let (x0, x1) = (extent[0].max(0.0), extent[2].min(width));
    let (y0, y1) = (extent[1].max(0.0), extent[3].min(height));
    let aspect = input[0] as f32 / input[1] as f32;
    let wanted = [(x1 - x0).max((y1 - y0) * aspect), (y1 - y0).max((x1 - x0) / aspect)];
    let span = |low: f32, high: f32, wanted: f32, whole: f32| {
        let wanted = wanted.min(whole);
        let from = ((low + high - wanted) / 2.0).clamp(0.0, whole - wanted);
        // A hair's breadth of rounding takes no further row.
        let (first, last) = ((from + 1e-2).floor(), (from + wanted - 1e-2).ceil().min(whole));
        (first as usize, (last - first).max(1.0) as usize)
    };
    let ((x, width), (y, height)) =
        (span(x0, x1, wanted[0], width), span(y0, y1, wanted[1], height));
    Region { x, y, width, height }
}

/// Pixels of the input a pixel of the picture.
fn scale(region: &Region, input: [usize; 2]) -> f32 {
    (input[0] as f32 / region.width as f32).min(input[1] as f32 / region.height as f32)
}

/// How far a vehicle is from being large enough: 1 where it is.
fn worth(piece: &Piece, scale: f32) -> f32 {
    (piece.width * CAR_SHARE * scale / ENOUGH_PX).min(1.0)
}

fn choose(
    pieces: &[Piece],
    picture: ImageSize,
    input: [usize; 2],
) -> heapless::Vec<Region, MAX_REGIONS> {
    let mut regions = heapless::Vec::new();
    let road = pieces.iter().fold(NOTHING, |extent, piece| union(extent, piece.extent));
    if pieces.is_empty() {
        return regions;
    }
    let near = fit(road, picture, input);
    let near_scale = scale(&near, input);
    let metres: f32 = pieces.iter().map(|piece| piece.length_m).sum();
    let mut by_width: Vec<&Piece> = pieces.iter().collect();
    by_width.sort_by(|a, b| a.width.total_cmp(&b.width));
    let mean = |far: usize, far_scale: f32| {
        let worth = |(i, piece): (usize, &&Piece)| {
            let scale = if i < far { far_scale.max(near_scale) } else { near_scale };
            piece.length_m * worth(piece, scale)
        };
        by_width.iter().enumerate().map(worth).sum::<f32>() / metres
    };
    let alone = mean(0, near_scale);
    let mut extent = NOTHING;
    let mut best: Option<(f32, Region)> = None;
    for (far, piece) in by_width.iter().enumerate() {
        extent = union(extent, piece.extent);
        let region = fit(extent, picture, input);
        let gain = mean(far + 1, scale(&region, input)) - alone;
        // Of equals the largest: it shows more of what surrounds a vehicle.
        if best.is_none_or(|(most, _)| gain > most - 1e-3) {
            best = Some((best.map_or(gain, |(most, _)| most.max(gain)), region));
        }
    }
    let far = best.filter(|(gain, _)| *gain >= WORTH).map(|(_, region)| region);
    regions.extend([near].into_iter().chain(far));
    regions
}

#[cfg(test)]
mod tests;
