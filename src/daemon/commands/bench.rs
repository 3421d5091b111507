//! `verge bench`: what each stage takes, as JSON.

#[cfg(feature = "desk")]
use super::compare;
use super::{ModelArgs, recording};
use crate::daemon::assemble::open_endless;
use crate::daemon::config::Views;
use crate::daemon::counting::Counting;
use crate::daemon::detect::{Detector, Share};
use crate::daemon::exit::Failure;
use crate::daemon::line::{LineSettings, StageTimes};
use crate::units::{ImagePoint, ImageSize};
#[cfg(feature = "desk")]
use serde_json::Value;
use serde_json::json;
use std::hint::black_box;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Look-ups that are timed together.
const LOOK_UPS: u32 = 1_000_000;

/// Its arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of JPEG or PNG frames [default: the demo's recording]
    #[arg(long, value_name = "DIR", requires = "table")]
    frames: Option<PathBuf>,
    /// Lane table of these frames
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    #[command(flatten)]
    model: ModelArgs,
    /// Which parts of a picture are searched
    #[arg(long, value_enum, default_value_t)]
    views: Views,
    /// Frames to measure, after as many again to warm up
    #[arg(long, value_name = "N", default_value_t = 50)]
    count: usize,
    /// Run ONNX Runtime (python3 with the package onnxruntime) on the same model and picture
    #[cfg(feature = "desk")]
    #[arg(long)]
    compare_onnxruntime: bool,
}

pub fn run(args: &Args) -> Result<(), Failure> {
    let started = Instant::now();
    let (frames, table) = match (&args.frames, &args.table) {
        (Some(frames), Some(table)) => (frames.clone(), table.clone()),
        _ => {
            let recording = recording::find()?;
            (recording.frames.into(), recording.table.into())
        }
    };
    let settings = LineSettings {
        score: args.model.score,
        views: args.views,
        ..LineSettings::recorded(&table, &args.model.model, Duration::from_secs(900))
    };
    let mut station = open_endless(&settings, &frames)?;
    station.turn_timed()?;
    let cold_start = started.elapsed();
    for _ in 0..args.count {
        station.turn_timed()?;
    }
    let stages: Vec<StageTimes> =
        (0..args.count.max(1)).map(|_| station.turn_timed()).collect::<Result<_, _>>()?;
    let stage = |pick: fn(&StageTimes) -> Duration| median_ms(stages.iter().map(pick));
    let peak_rss = peak_rss_mb();
    #[cfg_attr(not(feature = "desk"), expect(unused_mut, reason = "the comparison adds to it"))]
    let mut report = json!({
        "frames": stages.len(),
        "picture": station.line().counting().table().image_size.to_string(),
        "model": args.model.model.file_name().map(|name| name.to_string_lossy()),
        "capture_ms": stage(|s| s.capture),
        "scene_ms": stage(|s| s.scene),
        "prepare_ms": stage(|s| s.prepare),
        "infer_ms": stage(|s| s.infer),
        "read_ms": stage(|s| s.read),
        "count_ms": stage(|s| s.count),
        "except_inference_ms": stage(|s| s.capture + s.scene + s.prepare + s.read + s.count),
        "frame_ms": stage(|s| s.capture + s.scene + s.prepare + s.infer + s.read + s.count),
        "table_look_up_ns": look_up_ns(station.line().counting()),
        "cold_start_ms": round(cold_start.as_secs_f64() * 1e3),
        "peak_rss_mb": peak_rss,
    });
    let mut detector = Detector::load(&args.model.model, args.model.score)?;
    detector.prepare(&station.frame().picture, 0);
    let share = |share: Share| json!({"by": share.by, "share": round(share.of_time)});
    report["net"] = detector.shares(args.count.max(1))?.into_iter().map(share).collect();
    #[cfg(feature = "desk")]
    if args.compare_onnxruntime {
        let picture = station.frame().picture.clone();
        let model = args.model.model.clone();
        let frame = || station.turn_timed().map(drop);
        let compared = compare::compare(&model, &picture, args.count.max(1), frame)?;
        if let (Value::Object(report), Value::Object(compared)) = (&mut report, compared) {
            report.extend(compared);
        }
    }
    println!("{report:#}");
    Ok(())
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
fn look_up_ns(counting: &Counting) -> f64 {
    let ImageSize { width, height } = counting.table().image_size;
    let (width, height) = (f32::from(width), f32::from(height));
    let mut state = 1u32;
    let begun = Instant::now();
    for _ in 0..LOOK_UPS {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let u = (state >> 16) as f32 / 65_536.0 * width;
        let v = (state & 0xffff) as f32 / 65_536.0 * height;
        black_box(counting.place(ImagePoint { u, v }));
    }
    round(begun.elapsed().as_secs_f64() * 1e9 / f64::from(LOOK_UPS))
}

/// Largest resident memory so far, MB; `None` where the system does not tell.
fn peak_rss_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kib: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(round(kib * 1024.0 / 1e6))
}
