//! `mvcalib report`: a calibration as a picture or a page.

use super::CalibrationFile;
use mvcalib::error::{Error, Result};
use mvcalib::files::labelme::{LabelFile, read_vehicles};
use mvcalib::files::registration::FrameShifts;
use mvcalib::model::read_models;
use mvcalib::report::canvas::Canvas;
use mvcalib::report::{draw_lanes, draw_metres, draw_vehicles, html, place};
use mvcalib::road::drawn_lane::lanes;
use std::path::PathBuf;
use verge_desk::write_whole;

/// Arguments of `report`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    calibration: CalibrationFile,
    /// The frame to draw on; grey where absent.
    #[arg(long)]
    image: Option<PathBuf>,
    /// Folder of labelled vehicles, drawn with their residuals.
    #[arg(long, requires = "vehicles")]
    labels: Option<PathBuf>,
    /// Vehicle models.
    #[arg(long)]
    vehicles: Option<PathBuf>,
    /// Shift of each labelled picture against the reference.
    #[arg(long)]
    frame_shifts: Option<PathBuf>,
    /// Lane polygons.
    #[arg(long)]
    lanes: Option<PathBuf>,
    /// The report to write: .html for the page, .png for the picture alone.
    #[arg(long)]
    out: PathBuf,
}

/// Runs `report`.
pub fn run(arguments: &Arguments) -> Result<()> {
    let kind = arguments.out.extension().and_then(|e| e.to_str()).unwrap_or_default();
    if !matches!(kind, "html" | "png") {
        let out = arguments.out.display();
        return Err(Error::Usage(format!("{out}: a report is .html or .png")));
    }
    let calibration = arguments.calibration.read()?;
    let camera = calibration.camera();
    let mut canvas = match &arguments.image {
        Some(path) => Canvas::open(path, camera.image_size)?,
        None => Canvas::blank(camera.image_size),
    };
    draw_metres(&mut canvas, &camera);
    if let Some(path) = &arguments.lanes {
        let lanes = lanes(&LabelFile::read(path)?, &path.display().to_string(), &camera)?;
        draw_lanes(&mut canvas, &camera, &lanes);
    }
    let mut placed = Vec::new();
    if let (Some(labels), Some(models)) = (&arguments.labels, &arguments.vehicles) {
        let (mut vehicles, _) = read_vehicles(labels)?;
        if let Some(path) = &arguments.frame_shifts {
            FrameShifts::read(path)?.register(&mut vehicles)?;
        }
        placed = place(&camera, &vehicles, &read_models(models)?);
        draw_vehicles(&mut canvas, &placed);
    }
    let png = canvas.png()?;
    match kind {
        "png" => write_whole(&arguments.out, &png)?,
        _ => write_whole(&arguments.out, html(&calibration, &png, &placed).as_bytes())?,
    }
    Ok(())
}
