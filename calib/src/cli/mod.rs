//! The commands of `mvcalib`.
//!
//! Owns their arguments and the order in which files are read and written. Does not own
//! the work.

mod calibrate;
mod compare;
mod dashes;
mod desk;
mod manual;
mod report;
mod residuals;
mod table;
mod verify;

use clap::{CommandFactory, Parser, Subcommand};
use mvcalib::error::Result;
use mvcalib::files::calibration::Calibration;
use std::path::{Path, PathBuf};

/// Calibrates a traffic camera and makes its lane table.
#[derive(Debug, Parser)]
#[command(name = "mvcalib", version)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Estimate focal length and pose from what the road shows, or from labelled vehicles.
    Calibrate(calibrate::Arguments),
    /// Measure a calibration against marks of known length.
    Verify(verify::Arguments),
    /// Print the paper's table of methods over made scenes.
    Compare(compare::Arguments),
    /// Draw a calibration: one-metre dots, lanes, key points, residuals, losses.
    Report(report::Arguments),
    /// Make the lane table from a calibration and lane polygons.
    Table(table::Arguments),
    /// Do all of it by hand on a page in the browser, on this machine alone.
    Desk(desk::Arguments),
    /// Write the manual pages into a folder, for packages.
    #[command(hide = true)]
    Man {
        /// The folder.
        folder: PathBuf,
    },
}

/// Runs one command.
pub fn run(command: Command) -> Result<()> {
    match command {
        Command::Calibrate(arguments) => calibrate::run(&arguments),
        Command::Verify(arguments) => verify::run(&arguments),
        Command::Compare(arguments) => compare::run(&arguments),
        Command::Report(arguments) => report::run(&arguments),
        Command::Table(arguments) => table::run(&arguments),
        Command::Desk(arguments) => desk::run(&arguments),
        Command::Man { folder } => Ok(manual::manual(Cli::command()).write(&folder, &[])?),
    }
}

/// The calibration file that a command reads.
#[derive(Debug, clap::Args)]
pub struct CalibrationFile {
    /// Calibration file written by `mvcalib calibrate`.
    #[arg(long)]
    calibration: PathBuf,
    /// Picture size, where the file has none.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = image_size)]
    image_size: Option<[u32; 2]>,
}

impl CalibrationFile {
    fn read(&self) -> Result<Calibration> {
        Calibration::read(&self.calibration, self.image_size)
    }

    fn path(&self) -> &Path {
        &self.calibration
    }

    /// The file's bytes, for its hash.
    fn bytes(&self) -> Result<Vec<u8>> {
        Ok(verge_desk::read_bytes(&self.calibration)?)
    }
}

fn image_size(text: &str) -> std::result::Result<[u32; 2], String> {
    let sides = text.split_once('x').and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    sides.filter(|s: &[u32; 2]| !s.contains(&0)).ok_or_else(|| "give it as 320x240".into())
}

fn metres(text: &str) -> std::result::Result<f64, String> {
    let metres = text.trim_end_matches('m').trim_end().parse().ok();
    metres.filter(|m: &f64| *m > 0.0 && m.is_finite()).ok_or_else(|| "give metres above 0".into())
}

/// Writes a line to standard output; a reader that has gone is not an error.
fn print(text: &str) {
    use std::io::Write;
    let _ = writeln!(std::io::stdout(), "{text}");
}
