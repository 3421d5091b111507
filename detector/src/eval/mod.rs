//! `verge-detector eval`: how good a detections file is against labels.
//!
//! Owns the command and its grouping; `truth` and `detections` read, `matching` and `average`
//! compute as pycocotools does, `report` prints, `curve` draws.

mod average;
mod curve;
mod detections;
mod matching;
mod report;
mod truth;

pub use average::{Score, Slice, score};
pub use matching::{Found, Frame, Labelled, SIZES, Size};

use std::path::PathBuf;
use verge_desk::{Failure, make_parent, print, write_whole};

/// Arguments of `eval`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Pictures with YOLO labels beside them (or in `labels` next to `images`), or a recording
    /// with `truth.jsonl`.
    #[arg(long, value_name = "DIR")]
    truth: PathBuf,
    /// Boxes: a JSON line per frame.
    #[arg(long, value_name = "FILE")]
    detections: PathBuf,
    /// Score only these frames: a file name or path per line.
    #[arg(long, value_name = "FILE")]
    frames: Option<PathBuf>,
    /// Regions without labels, a JSON line per frame (`{"frame":..,"boxes":[[x0,y0,x1,y1],..]}`):
    /// an unmatched detection whose centre lies in one is not counted.
    #[arg(long, value_name = "FILE")]
    ignore: Option<PathBuf>,
    /// Score at which `precision` and `recall` are taken.
    #[arg(long, default_value_t = 0.35)]
    score: f64,
    /// Also state the recall where precision is at least this.
    #[arg(long, default_value_t = 0.60)]
    at_precision: f64,
    /// Detections a frame that count, the surest first.
    #[arg(long, default_value_t = 100)]
    max_detections: usize,
    /// Also by camera: the file name up to this character.
    #[arg(long, value_name = "CHAR")]
    camera_until: Option<char>,
    /// Precision-recall curves as PNG.
    #[arg(long, value_name = "FILE")]
    curves: Option<PathBuf>,
    /// One JSON object instead of the table.
    #[arg(long)]
    json: bool,
}

/// Runs `eval`.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    for (name, value) in [("score", arguments.score), ("at-precision", arguments.at_precision)] {
        if !(0.0..=1.0).contains(&value) {
            return Err(Failure::Usage(format!("--{name} is {value}; give 0 to 1")));
        }
    }
    let wanted = arguments.frames.as_deref().map(truth::read_names).transpose()?;
    let mut frames = truth::read(&arguments.truth, wanted.as_ref())?;
    if let Some(path) = &arguments.ignore {
        detections::read_ignored(path, &mut frames)?;
    }
    detections::read(&arguments.detections, &mut frames)?;
    let frames: Vec<Frame> = frames.into_values().collect();
    let rules = average::Rules {
        score: arguments.score,
        at_precision: arguments.at_precision,
        max_detections: arguments.max_detections,
    };
    let slices = slices(&frames, arguments.camera_until);
    let scores: Vec<(Slice, Score)> = slices
        .into_iter()
        .map(|(slice, chosen)| {
            let score = score(&chosen, &slice, rules);
            (slice, score)
        })
        .collect();
    if let Some(path) = &arguments.curves {
        make_parent(path)?;
        write_whole(path, &curve::png(&scores, path)?)?;
    }
    let text = if arguments.json { report::json(&scores) } else { report::table(&scores) };
    print(&text)
}

/// Everything, by light, by size, by camera: which frames, which sizes.
fn slices(frames: &[Frame], camera_until: Option<char>) -> Vec<(Slice, Vec<&Frame>)> {
    let all: Vec<&Frame> = frames.iter().collect();
    let mut found = vec![(Slice { name: "all".to_owned(), size: Size::ALL }, all.clone())];
    for light in ["day", "night"] {
        let chosen: Vec<&Frame> =
            all.iter().copied().filter(|frame| frame.light.name() == light).collect();
        if !chosen.is_empty() {
            found.push((Slice { name: light.to_owned(), size: Size::ALL }, chosen));
        }
    }
    for size in SIZES {
        found.push((Slice { name: size.name.to_owned(), size }, all.clone()));
    }
    if let Some(end) = camera_until {
        let camera = |frame: &Frame| frame.name.split(end).next().unwrap_or_default().to_owned();
        let mut cameras: Vec<String> = frames.iter().map(camera).collect();
        cameras.sort();
        cameras.dedup();
        for name in cameras {
            let chosen = all.iter().copied().filter(|frame| camera(frame) == name).collect();
            found.push((Slice { name: format!("camera {name}"), size: Size::ALL }, chosen));
        }
    }
    found
}
