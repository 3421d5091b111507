//! `verge replay`: density in recorded frames, the same bytes each time.

use super::playback::{Played, play};
use super::{ModelArgs, print, text};
use crate::daemon::assemble::open_recording;
use crate::daemon::audit::SHEET;
use crate::daemon::config::{ConfigError, Views};
use crate::daemon::dates::Dates;
use crate::daemon::exit::Failure;
use crate::daemon::frame::Frame;
use crate::daemon::line::{Line, LineSettings};
use crate::daemon::locate::Anchor;
use crate::daemon::output::WholeFile;
use crate::daemon::presets::{Following, TableSettings, WindowSettings};
use crate::density::{LaneReport, check_lengths};
use crate::track::rate::DEFAULT_TOP_KMH;
use crate::units::LaneId;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Its arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Lane table; given several times, one for each preset of the camera
    #[arg(long, value_name = "FILE", required = true, value_parser = super::file)]
    table: Vec<PathBuf>,
    /// Folder of JPEG or PNG frames, or of folders by day, played in the order of their times
    #[arg(long, value_name = "DIR")]
    frames: PathBuf,
    #[command(flatten)]
    model: ModelArgs,
    /// Measure every frame: blurred, unchanged, displaced or of another scene
    #[arg(long)]
    unwatched: bool,
    /// One JSON object per window instead of one line per lane
    #[arg(long)]
    json: bool,
    /// Window length, s
    #[arg(long, value_name = "S", default_value = "900", value_parser = window)]
    window: Duration,
    /// Time between frames, s [default: from names, file times, else 120]
    #[arg(long, value_name = "S", value_parser = interval, allow_hyphen_values = true)]
    interval: Option<Duration>,
    /// Highest speed that is driven there, km/h: it decides how many pictures flow and speed need
    #[arg(long, value_name = "KMH", default_value_t = DEFAULT_TOP_KMH, value_parser = top_speed)]
    top_speed: f32,
    /// Section of a lane at which vehicles are counted, m from its upstream end; may be repeated
    /// [default: the lane's middle]
    #[arg(long, value_name = "LANE=M", value_parser = section)]
    section: Vec<(LaneId, f32)>,
    /// Offset from UTC of times in names that state none, as +01:00
    #[arg(long, value_name = "OFFSET", value_parser = utc_offset, default_value = "Z", allow_hyphen_values = true)]
    utc_offset: i32,
    /// Order of ambiguous dates in names [default: as the folder's names tell together]
    #[arg(long, value_enum)]
    dates: Option<Dates>,
    /// Searched parts of a picture
    #[arg(long, value_enum, default_value_t)]
    views: Views,
    /// Also write each frame's boxes here, JSON Lines
    #[arg(long, value_name = "FILE")]
    detections: Option<PathBuf>,
    /// Also draw each frame with lanes, boxes, contact points and counts: PNGs in this folder
    #[arg(long, value_name = "DIR")]
    overlay: Option<PathBuf>,
    /// The site's own file, made by `verge audit`
    #[arg(long, value_name = "FILE")]
    audit: Option<PathBuf>,
    /// Point of a box that is the vehicle's place; an audit holds for the default alone
    #[arg(long, value_enum, default_value_t, conflicts_with = "audit")]
    anchor: Anchor,
}

pub fn run(args: &Args) -> Result<(), Failure> {
    let settings = LineSettings {
        tables: TableSettings { files: args.table.clone(), camera: None, anchor: args.anchor },
        judging: (!args.unwatched).into(),
        model: args.model.model.clone(),
        score: args.model.score,
        input: args.model.input,
        audit: args.audit.clone(),
        views: args.views,
    };
    let windows = WindowSettings::recorded(args.window);
    let (recorded, mut line, windows) = open_recording(
        &settings,
        &windows,
        &args.frames,
        args.interval,
        (args.utc_offset, args.dates),
        args.top_speed,
    )
    .map_err(of_the_command_line)?;
    line.set_sections(args.section.iter().copied())
        .map_err(|error| of_the_command_line(error.into()))?;
    if let Following::TooSeldom { .. } | Following::TooShort { .. } = line.following() {
        // A recording of snapshots is not meant for more, one of a stream may be.
        let is_stream = recorded.interval() <= Duration::from_secs(2);
        let level = if is_stream { log::Level::Warn } else { log::Level::Info };
        log::log!(level, "{}", line.following());
    }
    let mut messages =
        text::Messages::new(&line.preset().table().camera_id, line.model(), recorded.tells_time());
    let inputs = args.table.iter().chain(&args.audit).map(PathBuf::as_path);
    let inputs: Vec<&Path> = inputs.chain([args.model.model.as_path()]).collect();
    let detections = args.detections.as_deref().map(|file| WholeFile::beside(file, &inputs));
    let mut detections = detections.transpose()?;
    let mut short = false;
    let is_moving = matches!(line.following(), Following::On { .. });
    let mut heading = (!args.json).then(|| text::heading(is_moving));
    let overlays = args.overlay.as_deref().map(|folder| Overlays::into(folder, &args.frames));
    let overlays = overlays.transpose()?;
    play(recorded, &mut line, windows, |played| match played {
        Played::Frame(frame, line, withheld) => {
            if let Some(file) = &mut detections {
                file.line(&text::boxes(frame, line.found()))?;
            }
            overlays.as_ref().map_or(Ok(()), |overlays| overlays.write(frame, line, withheld))
        }
        Played::Window(window) => {
            let used = |lane: &LaneReport| lane.frames_used * 4 < lane.frames_expected * 3;
            if !short && window.report.lanes.iter().any(used) {
                short = true;
                log::warn!(
                    "a window has fewer than three quarters of its frames: replay gives its density \
                     all the same, run gives null (windows.min_completeness)"
                );
            }
            if args.json {
                return print(&messages.next(window));
            }
            heading.take().map_or(Ok(()), |heading| print(&heading))?;
            window.report.lanes.iter().try_for_each(|lane| {
                let line = text::lane(window.report, lane);
                print(&format!("{line}{}", text::moving(lane)))
            })
        }
    })?;
    detections.map_or(Ok(()), |file| Ok(file.finish()?))
}

/// The folder of drawn frames.
struct Overlays<'a>(&'a Path);

impl<'a> Overlays<'a> {
    /// Makes the folder, which is not that of the frames: their names are the drawings' names.
    fn into(folder: &'a Path, frames: &Path) -> Result<Self, Failure> {
        let failed = |source| Failure::Write { path: folder.to_owned(), source };
        std::fs::create_dir_all(folder).map_err(failed)?;
        let same = folder.canonicalize().ok().zip(frames.canonicalize().ok());
        if same.is_some_and(|(folder, frames)| folder == frames) {
            return Err(failed(std::io::Error::new(
                ErrorKind::AlreadyExists,
                "the frames lie there; give another folder",
            )));
        }
        if folder.join(SHEET).exists() {
            return Err(failed(std::io::Error::new(
                ErrorKind::AlreadyExists,
                "the sheet of an audit lies there, whose pictures have the same names; give another \
                 folder",
            )));
        }
        Ok(Self(folder))
    }

    /// `a/b.jpg` becomes `a_b.png`.
    fn write(&self, frame: &Frame, line: &Line, withheld: Option<&str>) -> Result<(), Failure> {
        let drawn = line.overlay(frame, withheld.unwrap_or_default())?;
        let name = Path::new(&frame.name).with_extension("png");
        let name = name.to_string_lossy().replace(['/', '\\'], "_");
        let mut file = WholeFile::create(&self.0.join(name))?;
        file.bytes(&drawn)?;
        Ok(file.finish()?)
    }
}

/// What a configuration would have wrong is here the command line's.
fn of_the_command_line(failure: Failure) -> Failure {
    match failure {
        Failure::Config(ConfigError::Camera { key, reason }) => {
            let argument = match key {
                "traffic.section_m" => "--section",
                "model.input" => "--input",
                other => other,
            };
            Failure::Usage(format!("{argument}: {reason}"))
        }
        Failure::Aggregate(reason) => Failure::Usage(format!("--window: {reason}")),
        other => other,
    }
}

/// Reads a window's length, s.
fn window(text: &str) -> Result<Duration, String> {
    let seconds = text.parse().map_err(|_| "give whole seconds".to_owned())?;
    let window = Duration::from_secs(seconds);
    check_lengths(&[window], Duration::ZERO).map_err(|reason| reason.to_string())?;
    Ok(window)
}

/// Longest time between two frames, s: a day.
const LONGEST_INTERVAL_S: f64 = 86_400.0;

/// Reads a time between frames, s.
fn interval(text: &str) -> Result<Duration, String> {
    let seconds = text.parse().ok().filter(|s| (0.001..=LONGEST_INTERVAL_S).contains(s));
    seconds
        .map(Duration::from_secs_f64)
        .ok_or_else(|| format!("give 0.001 to {LONGEST_INTERVAL_S} s"))
}

/// Reads a speed, km/h.
fn top_speed(text: &str) -> Result<f32, String> {
    let speed = text.parse().ok().filter(|kmh| (10.0..=300.0).contains(kmh));
    speed.ok_or_else(|| "give 10 to 300".to_owned())
}

/// Reads a lane and a place on it, m.
fn section(text: &str) -> Result<(LaneId, f32), String> {
    let read = |(lane, m): (&str, &str)| Some((LaneId::new(lane.parse().ok()?)?, m.parse().ok()?));
    text.split_once('=').and_then(read).ok_or_else(|| "give lane and metres, as 3=40".to_owned())
}

/// Reads an offset from UTC, s.
fn utc_offset(text: &str) -> Result<i32, String> {
    crate::daemon::assemble::utc_offset_s(text)
        .ok_or_else(|| "give it as +01:00, -0530 or Z".to_owned())
}
