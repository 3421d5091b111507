//! Camera calibration from what a road shows (MVCalib), and the lane tables made from it.
//!
//! Implements the calibration of Hu et al., "Turning Traffic Monitoring Cameras into
//! Intelligent Sensors for Traffic Density Estimation", its baselines, and a joint method
//! that goes past it. In chapters:
//!
//! ```text
//! files      labels, calibrations, shifts          in and out
//! baselines  EPnP, UPnP, GPnP on single vehicles
//! paper      candidates -> model matching -> fine tuning
//! road       marks, lanes, the lane table
//! joint      one camera, one road, all vehicles at once
//! methods    each of them by its name, and its verdict
//! report     pictures of all of it
//! desk       the page on which all of it is done by hand
//! ```
//!
//! A chapter uses those above it and never one below.
//!
//! The crate owns everything offline, between labels and the lane table file. It does not
//! own the table's format (the core crate's `lane` module does) nor anything that runs
//! beside the camera.

pub mod baselines;
pub mod bodies;
pub mod camera;
pub mod desk;
pub mod error;
pub mod files;
pub mod joint;
pub mod length_error;
pub mod methods;
pub mod model;
pub mod paper;
pub mod plain;
pub mod problem;
pub mod report;
pub mod road;
pub mod trust;
pub mod validation;
pub mod vehicle;

pub use error::{Error, Result};
