//! The centre's archive, pages and diagrams of the sensors' densities.
//!
//! Each command is a module with its arguments and a `run`; `main.rs` names them all.
//! `chart` draws, `csv` and `gzip` read, `failure` holds what fails here alone.

pub mod archive;
pub mod broker;
pub mod chart;
pub mod csv;
pub mod exporter;
pub mod failure;
pub mod fit;
mod gzip;
mod html;
pub mod message;
pub mod morning;
pub mod points;
pub mod report;
pub mod score;
pub mod serve;
pub mod store;
