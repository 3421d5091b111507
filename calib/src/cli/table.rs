//! `mvcalib table`: the lane table of a calibrated camera.

use super::CalibrationFile;
use mvcalib::camera::Camera;
use mvcalib::canvas::Canvas;
use mvcalib::error::Result;
use mvcalib::labelme::LabelFile;
use mvcalib::lane_table::{DrawnLane, lanes, table};
use mvcalib::output::write_whole;
use mvcalib::report::{draw_lanes, draw_metres};
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
    /// Also draw the lanes and one-metre dots, as PNG.
    #[arg(long)]
    overlay: Option<PathBuf>,
    /// The frame to draw the overlay on; grey where absent.
    #[arg(long, requires = "overlay")]
    image: Option<PathBuf>,
    /// Make the table although the calibration says it cannot be trusted.
    #[arg(long)]
    force: bool,
}

impl Arguments {
    /// The overlay as PNG, where one is wanted.
    fn drawing(&self, camera: &Camera, lanes: &[DrawnLane]) -> Result<Option<Vec<u8>>> {
        if self.overlay.is_none() {
            return Ok(None);
        }
        let mut canvas = match &self.image {
            Some(path) => Canvas::open(path, camera.image_size)?,
            None => Canvas::blank(camera.image_size),
        };
        draw_metres(&mut canvas, camera);
        draw_lanes(&mut canvas, camera, lanes);
        canvas.png().map(Some)
    }
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
    let overlay = arguments.drawing(&calibration.camera(), &lanes)?;
    let bytes = table(&calibration, &lanes, sha256, &fallback)?;
    write_whole(&arguments.out, &bytes)?;
    if let (Some(path), Some(png)) = (&arguments.overlay, overlay) {
        write_whole(path, &png)?;
    }
    for lane in &lanes {
        eprintln!("lane {}: {:.1} m", lane.id.get(), lane.axis.length_m());
    }
    Ok(())
}
