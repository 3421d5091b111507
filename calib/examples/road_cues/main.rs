//! The accuracy table of the road fit in `docs/measured/calibration.md`: cameras of the street,
//! by cues.
//!
//! `cargo run --release -p mvcalib --example road_cues -- make DIR` records traffic of made
//! cameras over made roads. A detector then writes the boxes of each camera,
//! `verge detect --frames DIR/NAME/frames --detections DIR/NAME/detections.jsonl`, and
//! `... --example road_cues -- measure DIR` prints the table in Markdown: the error of 6 m
//! stretches along the lanes (mean over a camera), its median and 90th percentile over the
//! cameras, and how often the stated 90 % interval holds, near, in the middle, far and whole.

mod made;
mod measure;

use clap::{Parser, Subcommand};
use std::path::PathBuf;

#[derive(Parser)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Record the traffic of made cameras.
    Make {
        /// Where to put them.
        folder: PathBuf,
        /// Cameras of each picture size.
        #[arg(long, default_value_t = 30)]
        count: u64,
        /// First seed.
        #[arg(long, default_value_t = 7000)]
        first: u64,
        /// Pictures of each camera.
        #[arg(long, default_value_t = 60)]
        frames: usize,
        /// Leave out the pictures: the boxes are the true ones.
        #[arg(long)]
        truth_only: bool,
    },
    /// Fit every camera with every set of cues.
    Measure(measure::Wanted),
}

fn main() {
    match Arguments::parse().command {
        Command::Make { folder, count, first, frames, truth_only } => {
            for size in [[320, 240], [720, 480]] {
                for seed in first..first + count {
                    made::record(&folder, size, seed, frames, truth_only);
                }
            }
        }
        Command::Measure(wanted) => measure::table(&wanted),
    }
}
