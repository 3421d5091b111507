//! `verge bench`: what each stage of the line takes, as JSON.
//!
//! Times the line that runs, by an observer at its side. Stages in processor time, which a busy
//! machine does not change; the cold start by the wall clock.

#[cfg(feature = "desk")]
use super::compare;
use super::{ModelArgs, print, recording};
use crate::daemon::assemble::open_endless;
use crate::daemon::clock;
use crate::daemon::config::Views;
use crate::daemon::detect::{Detector, Share};
use crate::daemon::exit::Failure;
use crate::daemon::line::{Judging, LineSettings, Stage};
use crate::daemon::presets::{self, WindowSettings};
use crate::daemon::station::Station;
use crate::sensor::{Preset, Windows};
use crate::units::{ImagePoint, ImageSize};
#[cfg(feature = "desk")]
use serde_json::Value;
use serde_json::json;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Most frames: three hours at 100 a second.
const MOST_FRAMES: usize = 1_000_000;
/// Look-ups that are timed together.
const LOOK_UPS: u32 = 1_000_000;

/// Its arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of JPEG or PNG frames, with --table [default: the demo's recording]
    #[arg(long, value_name = "DIR", requires = "table")]
    frames: Option<PathBuf>,
    /// Lane table of these frames
    #[arg(long, value_name = "FILE", requires = "frames")]
    table: Option<PathBuf>,
    #[command(flatten)]
    model: ModelArgs,
    /// Searched parts of a picture
    #[arg(long, value_enum, default_value_t)]
    views: Views,
    /// Frames to measure, after as many again to warm up
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = count)]
    count: usize,
    /// Run ONNX Runtime (python3 with the package onnxruntime) on the same model and picture
    #[cfg(feature = "desk")]
    #[arg(long)]
    compare_onnxruntime: bool,
}

/// Reads a number of frames.
fn count(text: &str) -> Result<usize, &'static str> {
    text.parse().ok().filter(|count| (1..=MOST_FRAMES).contains(count)).ok_or("give 1 to 1000000")
}

pub fn run(args: &Args) -> Result<(), Failure> {
    let started = Instant::now();
    let (frames, table) = match (&args.frames, &args.table) {
        (Some(frames), Some(table)) => (frames.clone(), table.clone()),
        _ => {
            let recording = recording::find(
                "bench without --frames and --table",
                "name a recording of yours and its lane table, or run it in the project's folder",
            )?;
            (recording.frames.into(), recording.table.into())
        }
    };
    let settings = LineSettings {
        score: args.model.score,
        input: args.model.input,
        views: args.views,
        // A recording that is played again shows what it showed.
        judging: Judging::Ignored,
        ..LineSettings::recorded(&table, &args.model.model)
    };
    let windows = WindowSettings::recorded(Duration::from_secs(900));
    let mut bench = Bench::open(&settings, &windows, &frames)?;
    bench.turn()?;
    let cold_start = started.elapsed();
    for _ in 0..args.count {
        bench.turn()?;
    }
    let turns: Vec<Times> = (0..args.count).map(|_| bench.turn()).collect::<Result<_, _>>()?;
    let median = |pick: fn(&Times) -> Duration| median_ms(turns.iter().map(pick));
    let peak_rss = peak_rss_mb();
    let preset = bench.station.line().preset();
    let mut report = json!({
        "frames": turns.len(),
        "picture": preset.table().image_size.to_string(),
        "model": args.model.model.file_name().map(|name| name.to_string_lossy()),
        "capture_ms": median(|t| t.capture),
        "scene_ms": median(|t| t.scene),
        "prepare_ms": median(|t| t.prepare),
        "infer_ms": median(|t| t.infer),
        "read_ms": median(|t| t.read),
        "count_ms": median(|t| t.count),
        "except_inference_ms": median(|t| t.all() - t.infer),
        "frame_ms": median(Times::all),
        "table_look_up_ns": look_up_ns(preset),
        "cold_start_ms": round(cold_start.as_secs_f64() * 1e3),
        "peak_rss_mb": peak_rss,
    });
    let mut detector = Detector::load(&args.model.model, args.model.score)?;
    detector.prepare(&bench.station.frame().picture, 0);
    let share = |share: Share| json!({"by": share.by, "share": round(share.of_time)});
    report["net"] = detector.shares(args.count)?.into_iter().map(share).collect();
    #[cfg(feature = "desk")]
    if args.compare_onnxruntime {
        let picture = bench.station.frame().picture.clone();
        let model = args.model.model.clone();
        let frame = || bench.turn().map(drop);
        let compared = compare::compare(&model, &picture, args.count, frame)?;
        if let (Value::Object(report), Value::Object(compared)) = (&mut report, compared) {
            report.extend(compared);
        }
    }
    print(&format!("{report:#}"))
}

/// A recording that is played in a loop through the line, with a watch at its side.
struct Bench {
    station: Station,
    windows: Windows<Vec<Preset>>,
}

impl Bench {
    fn open(
        settings: &LineSettings,
        windows: &WindowSettings,
        frames: &Path,
    ) -> Result<Self, Failure> {
        let (station, windows) = open_endless(settings, windows, frames)?;
        Ok(Self { station, windows })
    }

    /// Takes and measures a picture, and says what each stage took.
    fn turn(&mut self) -> Result<Times, Failure> {
        let mut times = Times::default();
        let mut last = clock::processor_time();
        let mut lap = |stage: &mut Duration| {
            let now = clock::processor_time();
            *stage += now - std::mem::replace(&mut last, now);
        };
        self.station.capture()?;
        lap(&mut times.capture);
        let time = self.station.frame().time;
        let outcome = self.station.measure(&mut |stage| {
            lap(match stage {
                Stage::Scene => &mut times.scene,
                Stage::Prepare => &mut times.prepare,
                Stage::Infer => &mut times.infer,
                Stage::Read => &mut times.read,
                Stage::Count => &mut times.count,
            });
        })?;
        self.windows.take(time, &outcome, &mut |_| ());
        lap(&mut times.count);
        Ok(times)
    }
}

/// Times of the stages for one frame, of this thread's processor time.
#[derive(Clone, Copy, Debug, Default)]
struct Times {
    /// Reading and decoding the picture.
    capture: Duration,
    scene: Duration,
    prepare: Duration,
    infer: Duration,
    read: Duration,
    /// Boxes into lanes and windows.
    count: Duration,
}

impl Times {
    fn all(&self) -> Duration {
        self.capture + self.scene + self.prepare + self.infer + self.read + self.count
    }
}

fn median_ms(times: impl Iterator<Item = Duration>) -> f64 {
    let mut times: Vec<_> = times.collect();
    times.sort();
    times.get(times.len() / 2).map_or(0.0, |time| round(time.as_secs_f64() * 1e3))
}

/// Three digits behind the point.
fn round(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

/// Mean time of a look-up at points spread over the whole picture.
fn look_up_ns(preset: &presets::Preset) -> f64 {
    let ImageSize { width, height } = preset.table().image_size;
    let (width, height) = (f32::from(width), f32::from(height));
    let mut state = 1u32;
    let begun = clock::processor_time();
    for _ in 0..LOOK_UPS {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let u = (state >> 16) as f32 / 65_536.0 * width;
        let v = (state & 0xffff) as f32 / 65_536.0 * height;
        black_box(preset.place(ImagePoint { u, v }));
    }
    let took = clock::processor_time() - begun;
    round(took.as_secs_f64() * 1e9 / f64::from(LOOK_UPS))
}

/// Largest resident memory so far, MB; `None` where the system does not tell.
fn peak_rss_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kib: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(round(kib * 1024.0 / 1e6))
}
