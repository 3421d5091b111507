//! The road: a camera from what a road shows, marks of known length, lanes and their table.
//!
//! Owns everything that is measured on the road plane. Does not own the vehicles' key
//! points (`paper`, `joint`) nor the files' formats (`files`, and the core's `lane`).

pub mod cue_files;
pub mod dashes;
pub mod drawn_lane;
pub mod fit;
pub mod judge;
pub mod lane_axis;
pub mod lane_table;
pub mod marks;
pub mod outline;
pub mod scene_reference;
pub mod standards;
