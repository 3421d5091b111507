//! `mvcalib table`: the lane table of a calibrated camera.

use super::CalibrationFile;
use mvcalib::camera::Camera;
use mvcalib::error::{Error, Result};
use mvcalib::files::calibration::Sha256;
use mvcalib::files::labelme::LabelFile;
use mvcalib::report::canvas::Canvas;
use mvcalib::report::{draw_lanes, draw_metres};
use mvcalib::road::drawn_lane::{DrawnLane, lanes};
use mvcalib::road::judge::{judge_lanes, require};
use mvcalib::road::lane_table::table;
use mvcalib::road::outline;
use mvcalib::road::scene_reference::{picture, pictures, reference};
use std::path::PathBuf;
use verge::lane::{DEFAULT_CELL_LENGTH_M, MAX_CELL_LENGTH_M, MIN_CELL_LENGTH_M};
use verge::scene::Reference;
use verge_desk::{say, write_whole_beside};

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
    /// Approximate length of the cells along a lane, each of which has its density, m, from 2 to
    /// 100.
    #[arg(long, value_name = "M", default_value_t = DEFAULT_CELL_LENGTH_M, value_parser = cell_length)]
    cell_length: f32,
    /// Frames of the camera by which it is later noticed when it has moved. The first by name
    /// must show the pose of the calibration; the others, at other times and in other light,
    /// may sway against it. Polygons of the lanes file labelled `ignore` are left out.
    #[arg(long, value_name = "DIR")]
    reference: Option<PathBuf>,
    /// The frame of that folder that shows the pose of the calibration.
    #[arg(long, value_name = "NAME", requires = "reference")]
    pose_frame: Option<String>,
    /// Also draw the lanes and one-metre dots, as PNG.
    #[arg(long)]
    overlay: Option<PathBuf>,
    /// The frame to draw the overlay on; grey where absent.
    #[arg(long, requires = "overlay")]
    image: Option<PathBuf>,
    /// Make the table although the calibration cannot be trusted or a lane cannot be one.
    #[arg(long)]
    force: bool,
}

fn cell_length(text: &str) -> std::result::Result<f32, String> {
    let length_m = text.parse().ok();
    length_m
        .filter(|length_m| (MIN_CELL_LENGTH_M..=MAX_CELL_LENGTH_M).contains(length_m))
        .ok_or_else(|| format!("give {MIN_CELL_LENGTH_M} to {MAX_CELL_LENGTH_M} m"))
}

impl Arguments {
    /// The reference of the scene, where frames are given.
    fn scene(&self, lanes: &LabelFile, expected: [u32; 2]) -> Result<Option<Reference>> {
        let Some(folder) = &self.reference else { return Ok(None) };
        let mut frames = pictures(folder)?;
        if let Some(name) = &self.pose_frame {
            let named = |path: &PathBuf| path.file_name().is_some_and(|n| n == name.as_str());
            let at = frames.iter().position(named).ok_or_else(|| {
                Error::Usage(format!("--pose-frame {name}: no such frame in {}", folder.display()))
            })?;
            frames[..=at].rotate_right(1);
        }
        let (.., width, height) = picture(&frames[0])?;
        if [width, height] != expected {
            let what = frames[0].display().to_string();
            return Err(Error::ImageSize { what, actual: [width, height], expected });
        }
        reference(&frames, &outline::read(lanes)?.ignored).map(|(_, scene)| Some(scene))
    }

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
    let known = calibration.known();
    let judged = judge_lanes(&lanes, &calibration.camera(), known.as_ref(), arguments.cell_length);
    for lane in &judged {
        let problem = lane.problem.as_ref().map_or(String::new(), |p| format!("\n  REFUSED: {p}"));
        say(&format!("{}{problem}", lane.geometry));
    }
    if !arguments.force {
        require(&judged)?;
    }
    let sha256 = Sha256::of(&arguments.calibration.bytes()?);
    let fallback = arguments.out.file_stem().unwrap_or_default().to_string_lossy();
    let overlay = arguments.drawing(&calibration.camera(), &lanes)?;
    let scene = arguments.scene(&file, calibration.camera().image_size)?;
    let bytes =
        table(&calibration, &lanes, sha256, &fallback, scene.as_ref(), arguments.cell_length)?;
    let inputs = [
        Some(arguments.lanes.as_path()),
        Some(arguments.calibration.path()),
        arguments.image.as_deref(),
    ];
    write_whole_beside(&arguments.out, &bytes, &inputs)?;
    if let (Some(path), Some(png)) = (&arguments.overlay, overlay) {
        let made = Some(arguments.out.as_path());
        write_whole_beside(path, &png, &[&inputs[..], &[made]].concat())?;
    }
    match &scene {
        Some(scene) => say(&format!("scene: {} edge points", scene.fine.len())),
        None => say("scene: no --reference, so a moved camera will not be noticed"),
    }
    Ok(())
}
