//! Cells: equal pieces of a lane, each with a density of its own.
//!
//! Owns how a lane is divided and what is reported of its pieces. A vehicle belongs to the cell
//! in which it meets the road (its ground contact point): at 10 m it covers half a cell or
//! more, and what it covers of the next cell is not counted there.

use crate::lane::Lane;
use crate::report::MAX_LANE_CELLS;
use crate::units::MAX_LANES;

/// How a lane is divided.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Division {
    count: u8,
    cell_m: f32,
}

impl Division {
    /// Divides a lane into equal cells of about that length.
    pub fn of(lane: &Lane, about_m: f32) -> Self {
        // `as` saturates, and a length that is not a number gives one cell.
        let count = ((lane.length_m / about_m + 0.5) as usize).clamp(1, MAX_LANE_CELLS);
        Self { count: count as u8, cell_m: lane.length_m / count as f32 }
    }

    /// Divides lanes, each at the place of its number.
    pub(super) fn of_each(lanes: &[Lane], cell_m: f32) -> [Self; MAX_LANES] {
        let mut divisions = [Self::default(); MAX_LANES];
        for lane in lanes {
            if let Some(division) = divisions.get_mut(usize::from(lane.id.get()) - 1) {
                *division = Self::of(lane, cell_m);
            }
        }
        divisions
    }

    /// Number of cells.
    pub const fn count(self) -> usize {
        self.count as usize
    }

    /// Length of each, m.
    pub const fn cell_m(self) -> f32 {
        self.cell_m
    }

    /// The cell in which the distance `s_m` along the lane lies; one beyond an end belongs
    /// to the cell at that end.
    pub fn cell(self, s_m: f32) -> usize {
        ((s_m / self.cell_m) as usize).min(self.count().saturating_sub(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::{Direction, LaneId};

    fn divided(length_m: f32, about_m: f32) -> Division {
        let id = LaneId::new(1).expect("in range");
        Division::of(&Lane { id, direction: Direction::Away, length_m }, about_m)
    }

    #[test]
    fn a_lane_has_equal_cells_of_about_the_length() {
        for (length_m, about_m, count) in [
            (50.0, 10.0, 5),
            (54.9, 10.0, 5),
            (55.1, 10.0, 6),
            (3.0, 10.0, 1),
            (0.01, 100.0, 1),
            (320.0, 10.0, 32),
            (655.35, 2.0, MAX_LANE_CELLS),
        ] {
            let division = divided(length_m, about_m);
            assert_eq!(division.count(), count, "{length_m} m in cells of {about_m} m");
            assert_eq!(division.cell_m(), length_m / count as f32);
        }
    }

    #[test]
    fn a_distance_beyond_an_end_belongs_to_the_cell_there() {
        let division = divided(50.0, 10.0);
        for (s_m, cell) in [(0.0, 0), (9.99, 0), (10.0, 1), (49.99, 4), (50.0, 4), (50.01, 4)] {
            assert_eq!(division.cell(s_m), cell, "{s_m} m");
        }
        assert_eq!((division.cell(-1.0), division.cell(f32::NAN)), (0, 0));
        assert_eq!(Division::default().cell(5.0), 0);
    }
}
