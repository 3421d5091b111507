//! `mvcalib calibrate`: labelled vehicles in, a calibration file out.
//!
//! Owns reading the inputs, the progress on a terminal, and the summary.

use super::{dashes, residuals};
use indicatif::{ProgressBar, ProgressStyle};
use mvcalib::error::{Error, Result};
use mvcalib::files::calibration::Calibration;
use mvcalib::files::labelme::{LabelFile, read_vehicles};
use mvcalib::files::picture::picture_size;
use mvcalib::files::registration::FrameShifts;
use mvcalib::joint::cues::RoadCues;
use mvcalib::methods::{Method, Options, calibrate};
use mvcalib::model::read_models;
use mvcalib::paper::loss::Form;
use mvcalib::paper::stages::Step;
use mvcalib::problem::Problem;
use mvcalib::road::cue_files;
use mvcalib::road::fit::{Cues, fit};
use mvcalib::road::marks::Marks;
use mvcalib::trust::Trust;
use std::path::{Path, PathBuf};
use verge_desk::{say, write_whole_beside};

/// Arguments of `calibrate`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Folder of the labelled pictures; only their size is checked.
    #[arg(long)]
    images: Option<PathBuf>,
    /// Folder of labelme files, one for each vehicle (or several by group_id). Only the
    /// method road goes without.
    #[arg(long, requires = "vehicles")]
    labels: Option<PathBuf>,
    /// Vehicle models: an object from name to a list of [x, y, z] in label order, m.
    #[arg(long, requires = "labels")]
    vehicles: Option<PathBuf>,
    /// Size of the pictures, where no labels say it.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = super::image_size)]
    image_size: Option<[u32; 2]>,
    /// The calibration file to write.
    #[arg(long)]
    out: PathBuf,
    /// The method.
    #[arg(long, value_enum, default_value = "joint")]
    method: Method,
    /// Weight of the angle against the length in the fine-tuning loss.
    #[arg(long, default_value_t = 6.0)]
    alpha: f64,
    /// Temperature of the vehicles' weights in the fine-tuning loss, 1/m; below 0 trusts
    /// vehicles near the anchor more.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    tau: f64,
    /// The paper's losses, or those of its authors' program.
    #[arg(long, value_enum, default_value = "paper")]
    form: Form,
    /// Focal length to start from, px. MVCalib stays within 30 % of it in its second
    /// stage: a prior, by default the paper's 350 px of 320.
    #[arg(long)]
    f0: Option<f64>,
    /// Seed of the random numbers.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Lines side by side on the road, by twos: labelme linestrips, or for road the polygons
    /// of a lane file (joint, road).
    #[arg(long)]
    lane_lines: Option<PathBuf>,
    /// Known lengths on the road: a marks file, or labelme linestrips labelled with the metres
    /// of each segment or a standard such as us-lane (joint, road). Polygons of four corners are
    /// right angles on the road, labelled `rectangle` or, where its sides are known, `rectangle
    /// 12 x 3.5 m`.
    #[arg(long, alias = "known-lengths")]
    lengths: Option<PathBuf>,
    /// Boxes of a detector over many pictures, as `verge detect` writes them (road).
    #[arg(long)]
    detections: Option<PathBuf>,
    /// Look for the dashes of the lane lines in --picture: from the start of one to the start of
    /// the next, as a standard such as us-lane or in metres (road).
    #[arg(long, value_name = "STANDARD|M", requires = "picture", requires = "lane_lines")]
    dashes: Option<String>,
    /// A picture without traffic, of the camera's pose in the lane lines (road).
    #[arg(long, requires = "dashes")]
    picture: Option<PathBuf>,
    /// Width of the lanes, m (road).
    #[arg(long, value_name = "M", value_parser = super::metres)]
    lane_width: Option<f64>,
    /// Height of the camera above the road, m (road).
    #[arg(long, value_name = "M", value_parser = super::metres)]
    camera_height: Option<f64>,
    /// Shift of each picture against the reference: brings labels into its frame.
    #[arg(long)]
    frame_shifts: Option<PathBuf>,
    /// Standard deviation of the camera's sway between pictures that are not registered,
    /// px (joint).
    #[arg(long, default_value_t = 0.0)]
    sway_px: f64,
    /// Estimate radial distortion too (joint).
    #[arg(long)]
    distortion: bool,
    /// Name of the camera, kept in the calibration and the lane table.
    #[arg(long)]
    camera_id: Option<String>,
}

/// Runs `calibrate`.
pub fn run(arguments: &Arguments) -> Result<()> {
    let problem = arguments.problem()?;
    let mut calibration = match &problem {
        Some(problem) => arguments.with_vehicles(problem)?,
        None => arguments.without_vehicles()?,
    };
    calibration.camera_id = arguments.camera_id.clone();
    let Arguments { vehicles, lane_lines, lengths, detections, picture, frame_shifts, .. } =
        arguments;
    let inputs = [vehicles, lane_lines, lengths, detections, picture, frame_shifts];
    let inputs = inputs.map(Option::as_deref);
    write_whole_beside(&arguments.out, calibration.to_json().as_bytes(), &inputs)?;
    say(&summary(&calibration, &arguments.out));
    let unaided = arguments.lane_lines.is_none() && arguments.lengths.is_none();
    if arguments.method == Method::Joint && unaided {
        say(
            "two traced lane lines (--lane-lines) or a known length (--lengths) would make it surer",
        );
    }
    Ok(())
}

impl Arguments {
    /// The labelled vehicles, where there are some.
    fn problem(&self) -> Result<Option<Problem>> {
        let (Some(labels), Some(models)) = (&self.labels, &self.vehicles) else {
            return match self.method {
                Method::Road => Ok(None),
                method => Err(Error::Usage(format!(
                    "--method {} needs --labels and --vehicles; road goes without",
                    method.name()
                ))),
            };
        };
        let (mut vehicles, size) = read_vehicles(labels)?;
        if let Some(path) = &self.frame_shifts {
            FrameShifts::read(path)?.register(&mut vehicles)?;
        }
        if let Some(folder) = &self.images {
            check_pictures(folder, size)?;
        }
        if let Some(expected) = self.image_size.filter(|s| *s != size) {
            let what = labels.display().to_string();
            return Err(Error::ImageSize { what, actual: size, expected });
        }
        Problem::new(size, vehicles, read_models(models)?).map(Some)
    }

    fn with_vehicles(&self, problem: &Problem) -> Result<Calibration> {
        let options = self.options(problem.image_size)?;
        let bar = progress_bar();
        let calibration = calibrate(problem, &options, &|step| show(&bar, step))?;
        bar.finish_and_clear();
        for vehicle in &calibration.vehicles {
            if let Some(px) = vehicle.rms_px {
                say(&format!("{}: its key points miss their fit by {px:.2} px", vehicle.name));
            }
        }
        Ok(calibration)
    }

    fn without_vehicles(&self) -> Result<Calibration> {
        let size = self.image_size.ok_or_else(|| {
            Error::Usage("--image-size WIDTHxHEIGHT is needed where no vehicle is labelled".into())
        })?;
        if let Some(folder) = &self.images {
            check_pictures(folder, size)?;
        }
        let start = std::time::Instant::now();
        let cues = self.road(size)?;
        let found = fit(&cues, size)?;
        if !cues.boxes.is_empty() && found.traffic.is_none() {
            say(&format!(
                "traffic: none of {} boxes is used: none is whole, large enough and inside a lane",
                cues.boxes.len()
            ));
        }
        let mut calibration = found.calibration();
        calibration.wall_time_s = start.elapsed().as_secs_f64();
        say(residuals::text(&found).trim_end());
        Ok(calibration)
    }

    /// What the road shows.
    fn road(&self, size: [u32; 2]) -> Result<Cues> {
        let lanes = self.lane_lines.as_ref().map(|path| cue_files::lanes(path, size));
        let marks = self.lengths.as_ref().map(|path| Marks::read(path)).transpose()?;
        let boxes = self.detections.as_ref().map(|path| cue_files::boxes(path, size));
        let mut cues = Cues {
            marks: marks.as_ref().map_or_else(Vec::new, Marks::cues),
            rectangles: marks.as_ref().map_or_else(Vec::new, Marks::rectangle_cues),
            lanes: lanes.transpose()?.unwrap_or_default(),
            boxes: boxes.transpose()?.unwrap_or_default(),
            lane_width_m: self.lane_width,
            height_m: self.camera_height,
            ..Cues::default()
        };
        if !cues.boxes.is_empty() && cues.lanes.is_empty() {
            return Err(Error::Usage(
                "--detections need --lane-lines: a box tells its vehicle's length only where its \
                 lane runs is known"
                    .into(),
            ));
        }
        if let (Some(pitch), Some(picture)) = (&self.dashes, &self.picture) {
            dashes::add(&mut cues, picture, pitch, size)?;
        }
        Ok(cues)
    }
}

impl Arguments {
    fn options(&self, size: [u32; 2]) -> Result<Options> {
        let of_joint = [("--distortion", self.distortion), ("--sway-px", self.sway_px != 0.0)];
        if let Some((name, _)) = of_joint.iter().find(|(_, given)| *given)
            && self.method != Method::Joint
        {
            return Err(Error::Usage(format!("{name} is an option of --method joint alone")));
        }
        let positive = |name: &str, value: f64| {
            if value > 0.0 && value.is_finite() {
                Ok(value)
            } else {
                Err(Error::Usage(format!("--{name} {value}: must be above 0")))
            }
        };
        if !(self.sway_px >= 0.0 && self.sway_px.is_finite()) {
            return Err(Error::Usage(format!("--sway-px {}: must be 0 or more", self.sway_px)));
        }
        if !(self.alpha >= 0.0 && self.alpha.is_finite() && self.tau.is_finite()) {
            return Err(Error::Usage("--alpha must be 0 or more, --tau a number".into()));
        }
        Ok(Options {
            method: self.method,
            form: self.form,
            alpha: self.alpha,
            tau: self.tau,
            f0: self.f0.map(|f0| positive("f0", f0)).transpose()?,
            seed: self.seed,
            distortion: self.distortion,
            sway_px: self.sway_px,
            cues: if self.method == Method::Road { RoadCues::default() } else { self.cues(size)? },
            road: if self.method == Method::Road { self.road(size)? } else { Cues::default() },
        })
    }
}

impl Arguments {
    fn cues(&self, expected: [u32; 2]) -> Result<RoadCues> {
        let mut cues = RoadCues::default();
        let of_road = [
            ("--dashes", self.dashes.is_some()),
            ("--detections", self.detections.is_some()),
            ("--lane-width", self.lane_width.is_some()),
            ("--camera-height", self.camera_height.is_some()),
        ];
        if let Some((name, _)) = of_road.iter().find(|(_, given)| *given) {
            return Err(Error::Usage(format!("{name} is an observation of --method road")));
        }
        if let Some(path) = &self.lane_lines {
            let file = LabelFile::read(path)?;
            let actual = file.image_size();
            if actual != expected {
                let what = path.display().to_string();
                return Err(Error::ImageSize { what, actual, expected });
            }
            cues.line_pairs = file.line_pairs()?;
        }
        if let Some(path) = &self.lengths {
            let marks = Marks::read(path)?;
            if marks.rectangles.iter().any(|r| r.sides_m.is_none()) {
                return Err(Error::Usage(
                    "a rectangle without its sides is an observation of --method road alone".into(),
                ));
            }
            cues.segments = marks.segments().collect();
        }
        if !cues.is_empty() && self.method != Method::Joint {
            return Err(Error::Usage(
                "--lane-lines and --lengths are observations of --method joint and road".into(),
            ));
        }
        Ok(cues)
    }
}

/// Every picture of the folder must have the labels' size.
fn check_pictures(folder: &Path, expected: [u32; 2]) -> Result<()> {
    let read = |source| verge_desk::Failure::reading(folder, source);
    let mut any = false;
    for entry in std::fs::read_dir(folder).map_err(read)? {
        let path = entry.map_err(read)?.path();
        let kind = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
        if !matches!(kind.as_deref(), Some("jpg" | "jpeg" | "png")) {
            continue;
        }
        any = true;
        let actual = picture_size(&path)?;
        if actual != expected {
            let what = path.display().to_string();
            return Err(Error::ImageSize { what, actual, expected });
        }
    }
    if any {
        Ok(())
    } else {
        Err(Error::EmptyFolder { path: folder.to_owned(), wanted: "picture (jpg, png)" })
    }
}

/// A bar on a terminal; hidden when standard error is none.
fn progress_bar() -> ProgressBar {
    let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len}")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(0).with_style(style)
}

fn show(bar: &ProgressBar, step: Step) {
    let (name, total) = match step {
        Step::Joint => return bar.set_message("joint"),
        Step::Candidates => return bar.set_message("candidates"),
        Step::Matching(total) => ("model matching", total),
        Step::Tuning(total) => ("fine tuning", total),
    };
    if bar.message() != name {
        bar.set_message(name);
        bar.set_position(0);
        bar.set_length(total as u64);
    }
    bar.inc(1);
}

fn summary(c: &Calibration, out: &Path) -> String {
    let camera = c.camera();
    let error = c.rel_err.map_or(String::new(), |e| format!(", lengths +- {:.1} %", 100.0 * e));
    let trust = match &c.trust {
        Trust::Ok => String::new(),
        Trust::Refused(reason) => format!("\nNOT TRUSTED: {reason}"),
    };
    let warnings: String = c.warnings.iter().map(|w| format!("\nWARNING: {w}")).collect();
    format!(
        "{}: {} f {:.1} px, {:.1} m above the road, {:.1} degrees down{error} ({:.2} s){trust}\
         {warnings}",
        out.display(),
        c.method,
        c.f,
        camera.height_m(),
        camera.tilt_rad().to_degrees(),
        c.wall_time_s,
    )
}
