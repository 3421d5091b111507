//! The static scene: whether the camera still looks where it was calibrated, to a part of a
//! pixel.
//!
//! Owns the reference in the lane table, the search for it in a picture, and the
//! rules by which the camera counts as moved. Reads no clock, allocates nothing. Both halves
//! use it: `mvcalib table` makes the reference, the sensor compares each picture with it.

mod empty;
mod field;
mod guard;
mod reference;
mod search;
mod watch;

pub use empty::{EmptyRoad, Known, LEARN_SPACING, MEMORY, MeanCell};
pub use field::{Cell, Field, Grid, MAX_SIDE};
pub use guard::Guard;
pub use reference::{
    BLOCKS, FINE_POINTS, LEAST_POINTS, MAX_REFERENCE, Point, Reference, ReferenceError,
};
pub use search::{Pose, SURE, SURE_SUPPORT, Sighting, search, search_wide};
pub use watch::{
    Aim, Evidence, Judgement, RECENT, SPACING, TO_MOVE, TOLERANCE, TURN_TOLERANCE, Watch,
    is_in_place,
};

/// A picture on the working grid, with its fields. `L` and `C` are the buffers: vectors in
/// the daemon, arrays where there is no heap.
#[derive(Debug)]
pub struct Eye<L, C> {
    grid: Grid,
    luma: L,
    cells: C,
    median: u32,
}

impl<L: AsRef<[u8]> + AsMut<[u8]>, C: AsRef<[Cell]> + AsMut<[Cell]>> Eye<L, C> {
    /// An eye for pictures of this grid; `None` where a buffer is shorter than
    /// [`Grid::buffer_len`].
    pub fn new(grid: Grid, luma: L, cells: C) -> Option<Self> {
        let enough =
            luma.as_ref().len() >= grid.buffer_len() && cells.as_ref().len() >= grid.buffer_len();
        enough.then_some(Self { grid, luma, cells, median: 0 })
    }

    /// Takes a picture in RGB, 8 bits a channel, of the size that the grid was made for.
    pub fn look(&mut self, rgb: &[u8]) {
        self.grid.shrink(rgb, self.luma.as_mut());
        let (width, height, cells) = (self.grid.width, self.grid.height, self.grid.cells());
        let Some((fine, half)) = self.luma.as_mut().split_at_mut_checked(cells) else { return };
        let half = half.get_mut(..(width / 2) * (height / 2)).unwrap_or(&mut []);
        field::halve(fine, width, half);
        let Some((fine_out, half_out)) = self.cells.as_mut().split_at_mut_checked(cells) else {
            return;
        };
        self.median = field::orient(fine, width, fine_out);
        let half_out = half_out.get_mut(..half.len()).unwrap_or(&mut []);
        field::orient(half, width / 2, half_out);
    }
}

impl<L: AsRef<[u8]>, C: AsRef<[Cell]>> Eye<L, C> {
    /// Its grid.
    pub const fn grid(&self) -> Grid {
        self.grid
    }

    /// The picture's luma on the grid.
    pub fn luma(&self) -> &[u8] {
        self.luma.as_ref().get(..self.grid.cells()).unwrap_or(&[])
    }

    /// The picture's median gradient, Sobel units (8 times levels per cell).
    pub const fn median_gradient(&self) -> u32 {
        self.median
    }

    /// The field of the grid.
    pub fn fine(&self) -> Field<'_> {
        let Grid { width, height, .. } = self.grid;
        Field { cells: self.cells.as_ref().get(..width * height).unwrap_or(&[]), width, height }
    }

    /// The field of the grid of half the resolution.
    pub fn coarse(&self) -> Field<'_> {
        let (width, height) = (self.grid.width / 2, self.grid.height / 2);
        let from = self.grid.cells();
        let cells = self.cells.as_ref().get(from..from + width * height).unwrap_or(&[]);
        Field { cells, width, height }
    }
}
