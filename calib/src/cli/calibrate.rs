//! `mvcalib calibrate`: labelled vehicles in, a calibration file out.
//!
//! Owns reading the inputs, the progress on a terminal, and the summary.

use indicatif::{ProgressBar, ProgressStyle};
use mvcalib::error::{Error, Result};
use mvcalib::files::calibration::Calibration;
use mvcalib::files::labelme::{LabelFile, read_vehicles};
use mvcalib::files::output::write_whole;
use mvcalib::files::registration::FrameShifts;
use mvcalib::joint::cues::RoadCues;
use mvcalib::methods::{Method, Options, calibrate};
use mvcalib::model::read_models;
use mvcalib::paper::loss::Form;
use mvcalib::paper::stages::Step;
use mvcalib::problem::Problem;
use mvcalib::report::canvas::picture_size;
use mvcalib::road::marks::Marks;
use mvcalib::trust::Trust;
use std::path::{Path, PathBuf};

/// Arguments of `calibrate`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Folder of the labelled pictures; only their size is checked.
    #[arg(long)]
    images: Option<PathBuf>,
    /// Folder of labelme files, one for each vehicle (or several by group_id).
    #[arg(long)]
    labels: PathBuf,
    /// Vehicle models: an object from name to a list of [x, y, z] in label order, m.
    #[arg(long)]
    vehicles: PathBuf,
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
    /// Lines side by side on the road, by twos: labelme linestrips (joint).
    #[arg(long)]
    lane_lines: Option<PathBuf>,
    /// Marks of known length as observations: a marks file (joint).
    #[arg(long)]
    known_lengths: Option<PathBuf>,
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
    let (mut vehicles, size) = read_vehicles(&arguments.labels)?;
    if let Some(path) = &arguments.frame_shifts {
        FrameShifts::read(path)?.register(&mut vehicles)?;
    }
    if let Some(folder) = &arguments.images {
        check_pictures(folder, size)?;
    }
    let problem = Problem::new(size, vehicles, read_models(&arguments.vehicles)?)?;
    let options = arguments.options(size)?;
    let bar = progress_bar();
    let mut calibration = calibrate(&problem, &options, &|step| show(&bar, step))?;
    bar.finish_and_clear();
    calibration.camera_id = arguments.camera_id.clone();
    write_whole(&arguments.out, calibration.to_json().as_bytes())?;
    eprintln!("{}", summary(&calibration, &arguments.out));
    Ok(())
}

impl Arguments {
    fn options(&self, size: [u32; 2]) -> Result<Options> {
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
            cues: self.cues(size)?,
        })
    }
}

impl Arguments {
    fn cues(&self, expected: [u32; 2]) -> Result<RoadCues> {
        let mut cues = RoadCues::default();
        if let Some(path) = &self.lane_lines {
            let file = LabelFile::read(path)?;
            let actual = file.image_size();
            if actual != expected {
                let what = path.display().to_string();
                return Err(Error::ImageSize { what, actual, expected });
            }
            cues.line_pairs = file.line_pairs()?;
        }
        if let Some(path) = &self.known_lengths {
            cues.segments = Marks::read(path)?.segments().collect();
        }
        if !cues.is_empty() && self.method != Method::Joint {
            return Err(Error::Usage(
                "--lane-lines and --known-lengths are observations of --method joint".into(),
            ));
        }
        Ok(cues)
    }
}

/// Every picture of the folder must have the labels' size.
fn check_pictures(folder: &Path, expected: [u32; 2]) -> Result<()> {
    let read = |source| Error::Read { path: folder.to_owned(), source };
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
    format!(
        "{}: {} f {:.1} px, {:.1} m above the road, {:.1} degrees down{error} ({:.2} s){trust}",
        out.display(),
        c.method,
        c.f,
        camera.height_m(),
        camera.tilt_rad().to_degrees(),
        c.wall_time_s,
    )
}
