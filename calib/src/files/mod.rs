//! The files that calibration reads and writes: labels, calibrations, shifts, pictures.
//!
//! Owns their formats and their first checks. Does not own what they mean to a solver.

pub mod calibration;
pub mod labelme;
pub mod picture;
pub mod registration;
pub mod stated;
