//! The orientation field of a picture: which way its edges run, whatever their contrast.
//!
//! Owns the working grid, the shrinking of a picture to it, and the field. A cell holds the
//! gradient's doubled angle, `(cos 2a, sin 2a)`, so that an edge that turns from bright-dark
//! to dark-bright at dusk stays the same edge; its length is m² / (m² + c²), which is near 1
//! for an edge that stands out of the picture's own noise and near 0 for one that does not,
//! so that a lane line counts as much under a street lamp as in the sun.

use crate::units::ImageSize;

/// Longer side of the working grid, cells: the paper's cameras have 320 columns, and the
/// shift of a larger picture is known to a part of a cell all the same.
pub const MAX_SIDE: usize = 320;
/// A gradient counts half when it is so many times the picture's median gradient.
const NOISE_FACTOR: u32 = 3;
/// Least gradient that counts half, as the sum of a Sobel kernel (8 times levels per cell):
/// an edge of 6 levels over two cells, above the steps of a JPEG at quality 60.
const LEAST_GRADIENT: u32 = 24;
/// Bins of the histogram from which the median gradient is read, 4 Sobel units each.
const BINS: usize = 128;

/// One cell of a field: cosine and sine of the doubled angle, 127 for 1.
pub type Cell = [i8; 2];

/// The working grid of a picture: the same shape, the longer side at most [`MAX_SIDE`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    /// Columns, cells.
    pub width: usize,
    /// Rows, cells.
    pub height: usize,
    /// Columns of the picture, px.
    picture_width: usize,
    picture_height: usize,
}

impl Grid {
    /// The grid of pictures of this size; pictures smaller than the grid keep their pixels.
    pub fn of(width: usize, height: usize) -> Self {
        let longer = if width > height { width } else { height };
        let scaled = |side: usize| {
            if longer <= MAX_SIDE {
                return side;
            }
            let half = longer / 2;
            let cells = (side * MAX_SIDE + half).checked_div(longer).unwrap_or(0);
            if cells == 0 { 1 } else { cells }
        };
        Self {
            width: scaled(width),
            height: scaled(height),
            picture_width: width,
            picture_height: height,
        }
    }

    /// Pixels of the picture that one cell is wide.
    pub fn cell_px(&self) -> f32 {
        if self.width == 0 { 1.0 } else { self.picture_width as f32 / self.width as f32 }
    }

    /// Its columns and rows.
    pub const fn size(&self) -> ImageSize {
        ImageSize { width: self.width as u16, height: self.height as u16 }
    }

    /// Number of cells.
    pub const fn cells(&self) -> usize {
        self.width * self.height
    }

    /// Cells of the grid and of the one of half its resolution together: the length of an
    /// [`super::Eye`]'s buffers.
    pub const fn buffer_len(&self) -> usize {
        self.cells() + (self.width / 2) * (self.height / 2)
    }

    /// Shrinks a picture in RGB (8 bits a channel) to this grid's luma.
    pub fn shrink(&self, rgb: &[u8], luma: &mut [u8]) {
        if self.width == 0 || self.height == 0 {
            return;
        }
        let stride = self.picture_width * 3;
        let sx = self.picture_width as f32 / self.width as f32;
        let sy = self.picture_height as f32 / self.height as f32;
        let whole = self.picture_width == self.width && self.picture_height == self.height;
        for (y, row) in luma.chunks_exact_mut(self.width).take(self.height).enumerate() {
            if whole {
                let line = rgb.get(y * stride..).unwrap_or(&[]);
                for (out, px) in row.iter_mut().zip(line.as_chunks::<3>().0) {
                    *out = level(px);
                }
                continue;
            }
            // The mean over the cell, in sixteenths of it: a fixed pattern of samples, so
            // that the same picture always gives the same cells.
            for (x, out) in row.iter_mut().enumerate() {
                let mut sum = 0u32;
                for j in 0..4 {
                    let v = ((y as f32 + (j as f32 + 0.5) * 0.25) * sy) as usize;
                    for i in 0..4 {
                        let u = ((x as f32 + (i as f32 + 0.5) * 0.25) * sx) as usize;
                        let px = rgb.get(v * stride + u * 3..).and_then(|p| p.first_chunk::<3>());
                        sum += px.map_or(0, |px| u32::from(level(px)));
                    }
                }
                *out = (sum / 16) as u8;
            }
        }
    }
}

/// Luma of a pixel, ITU-R BT.601 in 8-bit integers.
fn level(&[r, g, b]: &[u8; 3]) -> u8 {
    ((u32::from(r) * 77 + u32::from(g) * 150 + u32::from(b) * 29) >> 8) as u8
}

/// Half the resolution: the mean of two by two cells.
pub(super) fn halve(luma: &[u8], width: usize, half: &mut [u8]) {
    let half_width = width / 2;
    if half_width == 0 {
        return;
    }
    for (y, row) in half.chunks_exact_mut(half_width).enumerate() {
        let line = |y: usize| luma.get(y * width..(y + 1) * width).unwrap_or(&[]);
        let pairs = line(2 * y).as_chunks::<2>().0.iter().zip(line(2 * y + 1).as_chunks::<2>().0);
        for (out, (&[a, b], &[c, d])) in row.iter_mut().zip(pairs) {
            *out = ((u32::from(a) + u32::from(b) + u32::from(c) + u32::from(d) + 2) >> 2) as u8;
        }
    }
}

/// A field over cells that it borrows.
#[derive(Clone, Copy, Debug)]
pub struct Field<'a> {
    /// Its cells, row by row.
    pub cells: &'a [Cell],
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Field<'_> {
    /// The cell at column x, row y; no direction outside.
    #[inline]
    pub fn at(&self, x: i32, y: i32) -> Cell {
        let inside = (x as u32) < self.width as u32 && (y as u32) < self.height as u32;
        if !inside {
            return [0, 0];
        }
        self.cells.get(y as usize * self.width + x as usize).copied().unwrap_or([0, 0])
    }
}

/// Writes the field of a luma picture and returns its median gradient (Sobel units).
pub(super) fn orient(luma: &[u8], width: usize, out: &mut [Cell]) -> u32 {
    let mut histogram = [0u32; BINS];
    let mut counted = 0u32;
    sobel(luma, width, |_, gx, gy| {
        let bin = libm::sqrtf((gx * gx + gy * gy) as f32) as usize / 4;
        if let Some(count) = histogram.get_mut(if bin < BINS { bin } else { BINS - 1 }) {
            *count += 1;
        }
        counted += 1;
    });
    let mut below = 0;
    let middle = histogram.iter().position(|count| {
        below += count;
        below * 2 >= counted
    });
    let median = middle.unwrap_or(0) as u32 * 4 + 2;
    let knee = median * NOISE_FACTOR;
    let knee = if knee < LEAST_GRADIENT { LEAST_GRADIENT } else { knee };
    let knee = (knee * knee) as f32;
    out.fill([0, 0]);
    sobel(luma, width, |at, gx, gy| {
        let scale = 127.0 / ((gx * gx + gy * gy) as f32 + knee);
        if let Some(cell) = out.get_mut(at) {
            *cell =
                [((gx * gx - gy * gy) as f32 * scale) as i8, ((2 * gx * gy) as f32 * scale) as i8];
        }
    });
    median
}

/// Calls `each` with index and gradient of every cell that has eight neighbours.
fn sobel(luma: &[u8], width: usize, mut each: impl FnMut(usize, i32, i32)) {
    if width < 3 {
        return;
    }
    // Not zipped chunks, whose length the compiler divides for: that is a panic path to it.
    let row = |y: usize| luma.get(y * width..(y + 1) * width);
    for y in 0.. {
        let (Some(above), Some(here), Some(below)) = (row(y), row(y + 1), row(y + 2)) else {
            return;
        };
        let columns = above.windows(3).zip(here.windows(3)).zip(below.windows(3));
        for (x, ((a, b), c)) in columns.enumerate() {
            let (&[a0, a1, a2], &[b0, _, b2], &[c0, c1, c2]) = (a, b, c) else { continue };
            let [a0, a1, a2, b0, b2, c0, c1, c2] = [a0, a1, a2, b0, b2, c0, c1, c2].map(i32::from);
            let gx = (a2 + 2 * b2 + c2) - (a0 + 2 * b0 + c0);
            let gy = (c0 + 2 * c1 + c2) - (a0 + 2 * a1 + a2);
            each((y + 1) * width + x + 1, gx, gy);
        }
    }
}
