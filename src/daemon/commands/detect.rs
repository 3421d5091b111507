//! `verge detect`: boxes of recorded frames, without a lane table.

use super::playback::search;
use super::{ModelArgs, text};
use crate::daemon::assemble::open_detector;
use crate::daemon::exit::Failure;
use crate::daemon::output::WholeFile;
use std::path::PathBuf;

/// Its arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of JPEG or PNG frames
    #[arg(long, value_name = "DIR")]
    frames: PathBuf,
    /// Where each frame's boxes are written, JSON Lines
    #[arg(long, value_name = "FILE")]
    detections: PathBuf,
    #[command(flatten)]
    model: ModelArgs,
}

pub fn run(args: &Args) -> Result<(), Failure> {
    let (recorded, mut detector) =
        open_detector(&args.frames, &args.model.model, args.model.score)?;
    let mut file = WholeFile::create(&args.detections)?;
    search(
        recorded,
        |picture, found| Ok(detector.detect(picture, found)?),
        |frame, found| file.line(&text::boxes(frame, found)),
    )?;
    file.finish()
}
