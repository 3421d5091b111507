//! The files that calibration reads and writes: labels, calibrations, shifts.
//!
//! Owns their formats and their first checks. Does not own what they mean to a solver.

pub mod calibration;
pub mod labelme;
pub mod registration;
pub mod road_cues;
pub mod stated;
