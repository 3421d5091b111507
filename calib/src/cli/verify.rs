//! `mvcalib verify`: how far a calibration is from marks of known length.

use super::{CalibrationFile, print};
use mvcalib::error::Result;
use mvcalib::road::marks::Marks;
use std::path::PathBuf;

/// Arguments of `verify`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    calibration: CalibrationFile,
    /// Marks of known length: {"marks":[{"points":[[u,v],...],"segment_length_m":6.0}]}.
    #[arg(long)]
    marks: PathBuf,
}

/// Runs `verify`: one JSON object on standard output.
pub fn run(arguments: &Arguments) -> Result<()> {
    let camera = arguments.calibration.read()?.camera();
    let accuracy = Marks::read(&arguments.marks)?.verify(&camera)?;
    let json = serde_json::to_string(&accuracy).expect("five finite numbers are always JSON");
    print(&json);
    Ok(())
}
