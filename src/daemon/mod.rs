//! The daemon: one straight line from camera to broker.
//!
//! ```text
//! camera -> capture -> scene -> detect -> locate -> aggregate -> publish -> broker
//!            Frame      View   Detection  Located   WindowReport  bytes
//! ```
//!
//! Each stage is a module that knows the values of [`frame`] and no other stage; aggregation is
//! the core's [`crate::density`]. [`mod@line`] joins the stages from a frame to density, [`outlet`]
//! those from a window to the broker, with the [`spool`] between them, [`tableless`] is the line of
//! `verge detect`, and `assemble` builds them: these four alone name two stages. Nothing is declared here, for
//! every module of the daemon would see it.

pub mod address;
mod assemble;
pub mod audit;
mod board;
pub mod capture;
mod certificate;
mod cli;
mod clock;
mod commands;
pub mod config;
pub mod dates;
pub mod detect;
pub mod dial;
mod disk;
pub mod exit;
pub mod foreign;
pub mod frame;
pub mod line;
pub mod locate;
mod manual;
mod memory;
pub mod metrics;
mod notify;
mod offset;
pub mod outlet;
mod output;
mod overlay;
mod places;
mod plain;
pub mod presets;
pub mod publish;
mod reload;
mod road_file;
mod running;
pub mod scene;
pub mod serial;
pub mod site;
pub mod spool;
mod station;
pub mod tableless;
mod toml_file;
pub mod trust;
pub mod vehicles;
mod view;

use crate::hal::{Board, Switch, Thermometer, Watchdog};
use std::process::ExitCode;

/// Runs the program on a board: reads the command line, does what it says.
pub fn main<L, R, W, T>(board: Board<L, R, W, T>) -> ExitCode
where
    L: Switch,
    R: Switch,
    W: Watchdog,
    T: Thermometer,
{
    memory::give_back_large_buffers();
    verge_desk::run_main(|arguments| cli::run(arguments, board))
}
