//! `verge audit`: which frames people should count at a site, and what follows from their counts.
//!
//! Owns the order: the recording goes through the line as it would be measured, so that scene and
//! empty road are what they are on the road; then frames are chosen, or counted ones are compared.

use super::playback::walk;
use super::{ModelArgs, print};
use crate::daemon::assemble::{line_settings, open_frames};
use crate::daemon::audit::{
    Answers, Candidate, Counted, FORMAT, LEAST_FRAMES, SHEET, SiteFile, choose, fit, template,
};
use crate::daemon::config::{Config, Views};
use crate::daemon::exit::Failure;
use crate::daemon::frame::Frame;
use crate::daemon::line::{Line, LineSettings};
use crate::daemon::output::WholeFile;
use crate::daemon::overlay;
use crate::picture::Light;
use crate::sensor::Outcome;
use crate::units::LaneId;
use crate::wire::hex;
use std::path::{Path, PathBuf};

/// Its arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of the site's recorded frames, over day and night, light and heavy traffic
    #[arg(long, value_name = "DIR")]
    frames: PathBuf,
    /// Configuration of the site, in place of --table and the model's options
    #[arg(long, value_name = "FILE", required_unless_present = "table", conflicts_with_all = ["table", "model", "score", "input"])]
    config: Option<PathBuf>,
    /// Lane table, where there is no --config
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    #[command(flatten)]
    model: ModelArgs,
    /// How many frames to choose
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u16).range(3..=200))]
    choose: u16,
    /// Draw the chosen frames into this folder, with counts.csv to fill in
    #[arg(long, value_name = "DIR", conflicts_with = "counts")]
    sheet: Option<PathBuf>,
    /// The counts: lines frame,lane,vehicles
    #[arg(long, visible_alias = "answers", value_name = "FILE", requires = "out")]
    counts: Option<PathBuf>,
    /// The site's own file, for replay --audit and lane_table.audit
    #[arg(long, value_name = "FILE", requires = "counts")]
    out: Option<PathBuf>,
    /// Print the correction as JSON, with what people and the line count in each frame
    #[arg(long, requires = "counts")]
    json: bool,
}

/// Least probabilities with which frames are counted, beside the model's own.
const SCORES: [f32; 12] = [0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.8];
/// Probability of a vehicle that is beyond doubt.
const SURE: f32 = 0.95;

pub fn run(args: &Args) -> Result<(), Failure> {
    let settings = match (&args.config, &args.table) {
        (Some(config), _) => LineSettings { audit: None, ..line_settings(&Config::read(config)?) },
        (None, table) => LineSettings {
            score: args.model.score,
            input: args.model.input,
            ..LineSettings::recorded(table.as_deref().unwrap_or(Path::new("")), &args.model.model)
        },
    };
    let line = Line::open(&settings)?;
    match (&args.counts, &args.out) {
        (Some(counts), Some(out)) => learn(args, line, settings.views, counts, out),
        _ => choose_frames(args, line),
    }
}

/// The lanes of the first preset, to which the frames that are counted belong.
fn lanes(line: &Line) -> Vec<LaneId> {
    line.preset().table().lanes.iter().map(|lane| lane.id).collect()
}

/// Prints which frames to count, or draws them.
fn choose_frames(args: &Args, mut line: Line) -> Result<(), Failure> {
    let lanes: Vec<u8> = lanes(&line).iter().map(|lane| lane.get()).collect();
    let mut candidates = Vec::new();
    walk(open_frames(&args.frames)?, |frame| {
        // Frames of other presets show other lanes.
        if !matches!(line.measure(frame, &mut |_| ())?, Outcome::Measured { preset: 0, .. }) {
            return Ok(());
        }
        let light = line.scene().map_or(Light::Day, |scene| scene.light());
        let load = line.latest().1 as u32;
        candidates.push(Candidate { name: frame.name.clone(), time: frame.time, light, load });
        Ok(())
    })?;
    let chosen = choose(&candidates, usize::from(args.choose));
    if chosen.len() < LEAST_FRAMES {
        return Err(Failure::FewToCount { frames: args.frames.clone(), measured: chosen.len() });
    }
    let chosen: Vec<&str> = chosen.iter().map(|&n| candidates[n].name.as_str()).collect();
    let Some(folder) = &args.sheet else {
        return chosen.iter().try_for_each(|name| print(name));
    };
    let failed = |source| Failure::Write { path: folder.clone(), source };
    std::fs::create_dir_all(folder).map_err(failed)?;
    let counts = folder.join(SHEET);
    if counts.exists() {
        let source = std::io::Error::new(
            std::io::ErrorKind::AlreadyExists,
            "it is there already, with what was counted: give another folder",
        );
        return Err(Failure::Write { path: counts, source });
    }
    walk(open_frames(&args.frames)?, |frame| {
        if !chosen.contains(&frame.name.as_str()) {
            return Ok(());
        }
        let name = frame.name.replace(['/', '\\'], "_");
        let path = folder.join(name).with_extension("png");
        // The scene of this very picture: the camera sways.
        line.measure(frame, &mut |_| ())?;
        let drawn = overlay::lanes_png(frame, line.preset());
        let drawn = drawn.map_err(|error| Failure::Internal(format!("{}: {error}", frame.name)))?;
        let mut file = WholeFile::create(&path)?;
        file.bytes(&drawn)?;
        Ok(file.finish()?)
    })?;
    let mut file = WholeFile::create(&counts)?;
    file.line(template(chosen.iter().copied(), &lanes).trim_end())?;
    file.finish()?;
    print(&format!("{}: fill in {} frames", counts.display(), chosen.len()))
}

/// Compares what people have counted with what the line counts, and writes the site's file.
fn learn(
    args: &Args,
    mut line: Line,
    views: Views,
    counts: &Path,
    out: &Path,
) -> Result<(), Failure> {
    let lanes = lanes(&line);
    let numbers: Vec<u8> = lanes.iter().map(|lane| lane.get()).collect();
    let answers = Answers::read(counts, &numbers)?;
    let cameras = line.counting().ok_or(Failure::NoCounting)?;
    let stated = line.least_score();
    let others = SCORES.into_iter().filter(|score| (score - stated).abs() > 0.02);
    let scores: Vec<f32> = std::iter::once(stated).chain(others).collect();
    let asked: Vec<f32> = scores.iter().copied().chain([SURE]).collect();
    let mut frames: Vec<Counted> = Vec::new();
    walk(open_frames(&args.frames)?, |frame| {
        let Some(people) = answers.of(&frame.name, &numbers) else {
            return line.measure(frame, &mut |_| ()).map(|_| ());
        };
        let compared = compare(&mut line, frame, people, &lanes, &asked)?;
        let unfit = "is not fit to be measured: count another";
        frames.push(compared.ok_or_else(|| answers.wrong(&frame.name, unfit))?);
        Ok(())
    })?;
    if let Some(absent) = answers.frames().find(|name| frames.iter().all(|f| f.frame != *name)) {
        let reason = format!("is not in {}, or cannot be measured", args.frames.display());
        return Err(answers.wrong(absent, &reason).into());
    }
    let correction = fit(&frames, &numbers, &scores, 0, &cameras)?;
    let table = line.preset().table();
    let file = SiteFile {
        format: FORMAT,
        camera: table.camera_id.as_str().to_owned(),
        calibration_sha256: hex(&table.calibration_sha256).as_str().to_owned(),
        model_sha256: hex(&line.model().sha256).as_str().to_owned(),
        input_px: line.input_size(),
        views,
        frames: frames.len(),
        vehicles: frames.iter().flat_map(|frame| &frame.people).sum(),
        correction,
    };
    let inputs = [Some(counts), args.table.as_deref(), args.config.as_deref()];
    file.write(out, &inputs.into_iter().flatten().collect::<Vec<_>>())?;
    if args.json {
        print(&told_json(&file, stated, &frames, &scores))
    } else {
        print(&told(&file, stated, out))
    }
}

/// A frame counted twice; `None` where the line does not measure it.
fn compare(
    line: &mut Line,
    frame: &Frame,
    people: Vec<u32>,
    lanes: &[LaneId],
    scores: &[f32],
) -> Result<Option<Counted>, Failure> {
    let mut counts = line.count_with(frame, scores)?;
    let Some(sure) = counts.pop() else { return Ok(None) };
    let total = |counts: &crate::density::FrameCounts| {
        lanes.iter().map(|&lane| counts.vehicles(lane)).sum()
    };
    Ok(Some(Counted {
        frame: frame.name.clone(),
        people,
        sure: lanes.iter().map(|&lane| sure.vehicles(lane)).collect(),
        line: counts.iter().map(total).collect(),
        is_night: line.scene().is_some_and(|scene| scene.light() == Light::Night),
    }))
}

/// The result, for a program: the line's counts are those with the site's score.
fn told_json(file: &SiteFile, stated: f32, frames: &[Counted], scores: &[f32]) -> String {
    let score = file.correction.score.unwrap_or(stated);
    let at = scores.iter().position(|known| *known == score).unwrap_or(0);
    let frame = |frame: &Counted| {
        serde_json::json!({
            "frame": frame.frame,
            "people": frame.people.iter().sum::<u32>(),
            "line": frame.line.get(at),
        })
    };
    serde_json::json!({
        "frames": frames.iter().map(frame).collect::<Vec<_>>(),
        "vehicles": file.vehicles,
        "stated_score": stated,
        "correction": file.correction,
    })
    .to_string()
}

/// The result, for people.
fn told(file: &SiteFile, stated: f32, out: &Path) -> String {
    let correction = &file.correction;
    let changed = correction.score.filter(|score| *score != stated);
    let score = changed.map_or(format!("score {stated} stays"), |score| {
        format!("score {score} in place of {stated}")
    });
    let load = |load: &crate::density::LoadBias| {
        let (factor, off) = (load.factor, 1.645 * load.factor_se);
        format!(
            "at {:.1} vehicles counts times {factor:.2} ({:.2} to {:.2})",
            load.counted,
            factor - off,
            factor + off
        )
    };
    let loads: Vec<String> = correction.by_load.iter().map(load).collect();
    let loads = if loads.is_empty() { "counts as they are".to_owned() } else { loads.join(", ") };
    format!(
        "{}: {} frames, {} vehicles; {score}; {loads}",
        out.display(),
        file.frames,
        file.vehicles
    )
}
