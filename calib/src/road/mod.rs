//! The road that a calibrated camera sees: marks of known length, lanes and their table.
//!
//! Owns everything that is measured on the road plane. Does not own the vehicles' key
//! points (`paper`, `joint`) nor the files' formats (`files`, and the core's `lane`).

pub mod lane_axis;
pub mod lane_table;
pub mod marks;
pub mod scene_reference;
