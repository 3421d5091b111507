//! The reference of the static scene: a few thousand edge points and which way they run.
//!
//! Owns the choice of points from a field and its bytes in the lane table. Does
//! not own the table (see [`crate::lane`]) nor the search (see `search.rs`).
//!
//! | offset | bytes | field |
//! |---|---|---|
//! | 0 | 1 | version of this section, 1 |
//! | 1 | 1 | reserved, 0 |
//! | 2 | 2 | columns of the working grid |
//! | 4 | 2 | rows of the working grid |
//! | 6 | 2 | number F of fine points |
//! | 8 | 2 | number C of coarse points |
//! | 10 | 6 F | fine points |
//! | 10+6F | 6 C | coarse points |
//!
//! Numbers are little-endian. A point is `x: u16, y: u16` (cells of the grid, or of the
//! grid of half its resolution for coarse points) and `cos: i8, sin: i8` of the doubled
//! angle times its weight, 127 for 1.

use super::field::{Cell, Field, Grid, MAX_SIDE};
use core::fmt;
use heapless::Vec;

/// Columns of the blocks over which points are spread, so that no single tree or sign
/// decides alone.
pub const BLOCK_COLUMNS: usize = 8;
/// Rows of the blocks.
pub const BLOCK_ROWS: usize = 6;
/// Number of blocks.
pub const BLOCKS: usize = BLOCK_COLUMNS * BLOCK_ROWS;
/// Most fine points of a block: more add time and no certainty.
const FINE_IN_BLOCK: usize = 30;
/// Most coarse points of a block.
const COARSE_IN_BLOCK: usize = 10;
/// Most fine points.
pub const FINE_POINTS: usize = BLOCKS * FINE_IN_BLOCK;
/// Most coarse points.
pub const COARSE_POINTS: usize = BLOCKS * COARSE_IN_BLOCK;
/// No point lies this close to the picture's edge, as a part of its longer side: black
/// borders are burnt into many cameras' pictures there, and sway moves the rest out.
const MARGIN: usize = 50;
/// Least length of a cell that becomes a point (127 for 1): an edge twice the noise.
const LEAST_LENGTH: usize = 36;

const VERSION: u8 = 1;
const HEADER: usize = 10;
const POINT: usize = 6;
/// Most bytes of a reference.
pub const MAX_REFERENCE: usize = HEADER + (FINE_POINTS + COARSE_POINTS) * POINT;

/// A point of a static edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Point {
    /// Column, cells.
    pub x: u16,
    /// Row, cells.
    pub y: u16,
    /// Its direction times its weight.
    pub edge: Cell,
}

/// The static scene by its edges.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Reference {
    /// Columns of the working grid.
    pub width: usize,
    /// Rows of the working grid.
    pub height: usize,
    /// Points of the working grid.
    pub fine: Vec<Point, FINE_POINTS>,
    /// Points of the grid of half its resolution.
    pub coarse: Vec<Point, COARSE_POINTS>,
}

/// Why bytes are not a reference, or a scene yields none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReferenceError {
    /// Fewer or more bytes than the header asks for.
    Length {
        /// Bytes that belong to it.
        needed: usize,
        /// Bytes there.
        actual: usize,
    },
    /// A version that this program does not read.
    Version(u8),
    /// A value that no reference has; the text names it.
    Value(&'static str),
    /// Too few edges to know the scene by.
    Bare {
        /// Points found.
        points: usize,
    },
}

/// Least fine points of a reference: a tenth of a full one.
pub const LEAST_POINTS: usize = FINE_POINTS / 10;

impl fmt::Display for ReferenceError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Length { needed, actual } => {
                write!(f, "the scene's reference has {actual} bytes where {needed} belong")
            }
            Self::Version(found) => write!(
                f,
                "the scene's reference has version {found}, this program reads {VERSION}: make \
                 the table again"
            ),
            Self::Value(what) => write!(f, "the scene's reference is wrong: {what}"),
            Self::Bare { points } => write!(
                f,
                "the scene shows {points} edge points, {LEAST_POINTS} are needed: give frames \
                 with a clear view"
            ),
        }
    }
}

impl core::error::Error for ReferenceError {}

impl Reference {
    /// The reference of a scene that gives these fields; `burnt_in` says which cells of the
    /// fine field no camera sees (a clock, a logo).
    ///
    /// # Errors
    /// [`ReferenceError::Bare`].
    pub fn of(
        fine: &Field<'_>,
        coarse: &Field<'_>,
        burnt_in: impl Fn(usize, usize) -> bool,
    ) -> Result<Self, ReferenceError> {
        let mut reference = Self { width: fine.width, height: fine.height, ..Self::default() };
        choose(fine, FINE_IN_BLOCK, &burnt_in, &mut reference.fine);
        let half = |x, y| burnt_in(2 * x, 2 * y);
        choose(coarse, COARSE_IN_BLOCK, &half, &mut reference.coarse);
        let points = reference.fine.len();
        if points < LEAST_POINTS || reference.coarse.is_empty() {
            return Err(ReferenceError::Bare { points });
        }
        Ok(reference)
    }

    /// Whether it was made for pictures of this grid.
    pub fn fits(&self, grid: Grid) -> bool {
        (self.width, self.height) == (grid.width, grid.height)
    }

    /// Bytes that it takes.
    pub fn encoded_len(&self) -> usize {
        HEADER + (self.fine.len() + self.coarse.len()) * POINT
    }

    /// Writes it into `buffer` and returns its length.
    ///
    /// # Errors
    /// [`ReferenceError`]: what [`Self::parse`] would refuse is never written.
    pub fn encode(&self, buffer: &mut [u8]) -> Result<usize, ReferenceError> {
        let (needed, actual) = (self.encoded_len(), buffer.len());
        let full = ReferenceError::Length { needed, actual };
        let mut at = 0;
        let mut put = |bytes: &[u8]| {
            let place = buffer.get_mut(at..at + bytes.len()).ok_or(full)?;
            place.copy_from_slice(bytes);
            at += bytes.len();
            Ok(())
        };
        put(&[VERSION, 0])?;
        for number in [self.width, self.height, self.fine.len(), self.coarse.len()] {
            put(&(number as u16).to_le_bytes())?;
        }
        for point in self.fine.iter().chain(&self.coarse) {
            let ([x0, x1], [y0, y1]) = (point.x.to_le_bytes(), point.y.to_le_bytes());
            let [c, s] = point.edge.map(|v| v.cast_unsigned());
            put(&[x0, x1, y0, y1, c, s])?;
        }
        Self::parse(buffer.get(..needed).unwrap_or(&[]))?;
        Ok(needed)
    }

    /// Reads a reference that trusts nothing of the bytes.
    ///
    /// # Errors
    /// [`ReferenceError`] names the first thing that is wrong.
    pub fn parse(bytes: &[u8]) -> Result<Self, ReferenceError> {
        let actual = bytes.len();
        let (header, points) = bytes
            .split_first_chunk::<HEADER>()
            .ok_or(ReferenceError::Length { needed: HEADER, actual })?;
        let &[version, reserved, w0, w1, h0, h1, f0, f1, c0, c1] = header;
        if version != VERSION {
            return Err(ReferenceError::Version(version));
        }
        if reserved != 0 {
            return Err(ReferenceError::Value("the reserved byte is not 0"));
        }
        let (width, height) = (u16::from_le_bytes([w0, w1]), u16::from_le_bytes([h0, h1]));
        if usize::from(width).max(usize::from(height)) > MAX_SIDE {
            return Err(ReferenceError::Value("its grid is larger than any"));
        }
        let fine = usize::from(u16::from_le_bytes([f0, f1]));
        let coarse = usize::from(u16::from_le_bytes([c0, c1]));
        let needed = HEADER + (fine + coarse) * POINT;
        if actual != needed {
            return Err(ReferenceError::Length { needed, actual });
        }
        if fine < LEAST_POINTS || coarse == 0 {
            return Err(ReferenceError::Bare { points: fine });
        }
        let mut reference =
            Self { width: usize::from(width), height: usize::from(height), ..Self::default() };
        let (fine, coarse) = points.split_at_checked(fine * POINT).unwrap_or((points, &[]));
        read_points(fine, (width, height), &mut reference.fine)?;
        read_points(coarse, (width / 2, height / 2), &mut reference.coarse)?;
        Ok(reference)
    }
}

fn length(cell: Cell) -> usize {
    let [c, s] = cell.map(f32::from);
    libm::sqrtf(c * c + s * s) as usize
}

/// The strongest cells of each block, at most `most` of it.
fn choose<const N: usize>(
    field: &Field<'_>,
    most: usize,
    burnt_in: &impl Fn(usize, usize) -> bool,
    points: &mut Vec<Point, N>,
) {
    let margin = field.width.max(field.height) / MARGIN;
    let inside = |x: usize, y: usize| {
        let far = |at: usize, side: usize| at >= margin && at + margin < side;
        far(x, field.width) && far(y, field.height) && !burnt_in(x, y)
    };
    for block in 0..BLOCKS {
        let (column, row) = (block % BLOCK_COLUMNS, block / BLOCK_COLUMNS);
        let columns =
            column * field.width / BLOCK_COLUMNS..(column + 1) * field.width / BLOCK_COLUMNS;
        let rows = row * field.height / BLOCK_ROWS..(row + 1) * field.height / BLOCK_ROWS;
        let cells = || {
            rows.clone().flat_map(|y| columns.clone().map(move |x| (x, y))).filter_map(|(x, y)| {
                let edge = field.at(x as i32, y as i32);
                inside(x, y).then(|| (x, y, edge, length(edge)))
            })
        };
        // The length that `most` cells reach: a histogram, for want of a heap to sort in.
        let mut histogram = [0usize; 256];
        for (.., long) in cells() {
            if let Some(count) = histogram.get_mut(long) {
                *count += 1;
            }
        }
        let (mut above, mut threshold) = (0, 255);
        for (long, count) in histogram.iter().enumerate().skip(LEAST_LENGTH).rev() {
            if above + count > most {
                break;
            }
            above += count;
            threshold = long;
        }
        for (x, y, edge, long) in cells() {
            if long >= threshold {
                // Full only where more than its share came: then the block has enough.
                let _ = points.push(Point { x: x as u16, y: y as u16, edge });
            }
        }
    }
}

fn read_points<const N: usize>(
    bytes: &[u8],
    (width, height): (u16, u16),
    points: &mut Vec<Point, N>,
) -> Result<(), ReferenceError> {
    for &[x0, x1, y0, y1, c, s] in bytes.as_chunks::<POINT>().0 {
        let (x, y) = (u16::from_le_bytes([x0, x1]), u16::from_le_bytes([y0, y1]));
        if x >= width || y >= height {
            return Err(ReferenceError::Value("a point lies outside the grid"));
        }
        let edge = [c.cast_signed(), s.cast_signed()];
        if points.push(Point { x, y, edge }).is_err() {
            return Err(ReferenceError::Value("it has too many points"));
        }
    }
    Ok(())
}
