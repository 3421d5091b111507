//! `verge detect`: boxes of recorded frames, without a lane table.

use super::playback::search;
use super::{ModelArgs, text};
use crate::daemon::assemble::open_frames;
use crate::daemon::exit::Failure;
use crate::daemon::output::WholeFile;
use crate::daemon::tableless::Tableless;
use std::io::{self, Write};
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
    /// Print each frame's name once it is searched
    #[arg(long)]
    names: bool,
    #[command(flatten)]
    model: ModelArgs,
}

/// Endings of pictures' names.
const PICTURES: [&str; 3] = ["jpg", "jpeg", "png"];
/// Frames of the first look, spread over the recording.
const FIRST_LOOK: usize = 48;

pub fn run(args: &Args) -> Result<(), Failure> {
    let suffix = args.detections.extension().and_then(|suffix| suffix.to_str());
    if suffix.is_some_and(|suffix| PICTURES.iter().any(|p| p.eq_ignore_ascii_case(suffix))) {
        let source = io::Error::other("it is JSON Lines and has a picture's name: name it .jsonl");
        return Err(Failure::Write { path: args.detections.clone(), source });
    }
    let ModelArgs { model, score, input } = &args.model;
    let mut recorded = open_frames(&args.frames)?;
    let mut line = Tableless::open(model, *score, *input)?;
    if line.looks_first() {
        let stride = recorded.frames().div_ceil(FIRST_LOOK).max(1);
        let mut number = 0;
        search(
            recorded,
            |picture, found| {
                number += 1;
                found.clear();
                if (number - 1) % stride == 0 { line.look(picture, found) } else { Ok(()) }
            },
            |_, _| Ok(()),
        )?;
        line.settle()?;
        recorded = open_frames(&args.frames)?;
    }
    let mut file = WholeFile::create(&args.detections)?;
    search(
        recorded,
        |picture, found| line.detect(picture, found),
        |frame, found| {
            file.line(&text::boxes(frame, found))?;
            // The reader's going away changes nothing: the file is what was asked for.
            let _ = args.names.then(|| writeln!(std::io::stdout(), "{}", frame.name));
            Ok(())
        },
    )?;
    Ok(file.finish()?)
}
