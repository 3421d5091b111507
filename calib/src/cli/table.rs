//! `mvcalib table`: the lane table of a calibrated camera.

use super::CalibrationFile;
use mvcalib::error::Result;
use mvcalib::labelme::LabelFile;
use mvcalib::lane_table::{lanes, table};
use mvcalib::output::write_whole;
use sha2::{Digest, Sha256};
use std::path::PathBuf;

/// Arguments of `table`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    calibration: CalibrationFile,
    /// Lanes: labelme polygons, labelled 1 to 8, flag `toward` or `away`.
    #[arg(long)]
    lanes: PathBuf,
    /// The lane table to write.
    #[arg(long)]
    out: PathBuf,
    /// Make the table although the calibration says it cannot be trusted.
    #[arg(long)]
    force: bool,
}

/// Runs `table`.
pub fn run(arguments: &Arguments) -> Result<()> {
    let calibration = arguments.calibration.read()?;
    if !arguments.force {
        calibration.require_trust()?;
    }
    let file = LabelFile::read(&arguments.lanes)?;
    let what = arguments.lanes.display().to_string();
    let lanes = lanes(&file, &what, &calibration.camera())?;
    let sha256 = Sha256::digest(arguments.calibration.bytes()?).into();
    let fallback = arguments.out.file_stem().unwrap_or_default().to_string_lossy();
    let bytes = table(&calibration, &lanes, sha256, &fallback)?;
    write_whole(&arguments.out, &bytes)?;
    for lane in &lanes {
        eprintln!("lane {}: {:.1} m", lane.id.get(), lane.axis.length_m());
    }
    Ok(())
}
