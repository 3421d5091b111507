//! The command `street`: record a scene, or measure how fast it is drawn.
//!
//! Owns the command line; all work is in the library.

mod manual;

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use clap::{CommandFactory, Parser, Subcommand};
use street::error::Result;
use street::recording::{self, Recorder};
use street::scene::Scene;
use street::score;

/// Simulated street recordings with exact truth.
#[derive(Parser)]
#[command(version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Write a recording: frames, truth, calibration, lanes.
    Record {
        /// Scene file.
        #[arg(long)]
        scene: PathBuf,
        /// Number of frames.
        #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
        frames: u32,
        /// Seed of traffic and picture.
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// Change a key of the scene, such as light.daylight=night; may be repeated.
        #[arg(long, value_name = "KEY=VALUE")]
        set: Vec<String>,
        /// New or empty folder.
        #[arg(long)]
        out: PathBuf,
    },
    /// Compare what `verge replay --json` measured in a recording with its truth: flow, speed, occupancy.
    Score {
        /// The recording's `truth.jsonl`.
        #[arg(long)]
        truth: PathBuf,
        /// The windows, one JSON object a line.
        #[arg(long)]
        windows: PathBuf,
    },
    /// Time frames in memory (traffic, truth, drawing, JPEG) and print JSON.
    Bench {
        /// Scene file.
        #[arg(long)]
        scene: PathBuf,
        /// Number of timed frames, after the first, which lays the background.
        #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=100_000))]
        frames: u32,
        /// Seed of traffic and picture.
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// Change a key of the scene, such as light.daylight=night; may be repeated.
        #[arg(long, value_name = "KEY=VALUE")]
        set: Vec<String>,
    },
    /// Write the manual pages into a folder, for packages.
    #[command(hide = true)]
    Man {
        /// The folder.
        folder: PathBuf,
    },
}

fn main() -> ExitCode {
    verge_desk::run_main(|cli: Cli| match cli.command {
        Command::Record { scene, frames, seed, set, out } => Scene::read(&scene, &set)
            .and_then(|scene| recording::write(&scene, frames as usize, seed, &out)),
        Command::Score { truth, windows } => {
            score::table(&truth, &windows).and_then(|table: String| Ok(verge_desk::print(&table)?))
        }
        Command::Bench { scene, frames, seed, set } => {
            Scene::read(&scene, &set).and_then(|scene| bench(&scene, frames, seed))
        }
        Command::Man { folder } => Ok(manual::manual(Cli::command()).write(&folder, &[])?),
    })
}

fn bench(scene: &Scene, frames: u32, seed: u64) -> Result<()> {
    let started = Instant::now();
    let mut recorder = Recorder::new(scene, seed)?;
    recorder.next_frame();
    let setup_ms = started.elapsed().as_secs_f64() * 1000.0;
    let mut bytes = 0;
    let mut vehicles = 0;
    let started = Instant::now();
    for _ in 0..frames {
        let frame = recorder.next_frame();
        vehicles += frame.truth.vehicles.len();
        bytes += frame.picture.jpeg(scene.imaging.jpeg_quality, &frame.truth.frame)?.len();
    }
    let per_frame = started.elapsed().as_secs_f64() / f64::from(frames);
    let report = serde_json::json!({
        "scene": scene.name,
        "frames": frames,
        "setup_ms": setup_ms.round(),
        "frame_ms": (per_frame * 1e5).round() / 100.0,
        "frames_per_s": (1.0 / per_frame).round(),
        "mean_vehicles": (vehicles as f64 / f64::from(frames)).round(),
        "mean_jpeg_bytes": (bytes as f64 / f64::from(frames)).round(),
    });
    Ok(verge_desk::print(&format!("{report}\n"))?)
}
