//! The centre: what a traffic management centre makes of the sensors' densities.
//!
//! Each command is a module with its arguments and a `run`; `main.rs` names them all.
//! `chart` draws, `csv` and `gzip` read, `failure` holds what fails here alone.

pub mod archive;
pub mod chart;
pub mod csv;
pub mod failure;
pub mod fit;
mod gzip;
pub mod message;
pub mod points;
pub mod report;
pub mod score;
pub mod store;
