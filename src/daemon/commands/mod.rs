//! The commands, one file each. A command builds its line through `assemble` and names no more
//! than one stage itself.

pub mod audit;
pub mod bench;
pub mod check;
pub mod collect;
#[cfg(feature = "desk")]
mod compare;
#[cfg(feature = "desk")]
pub mod convert;
#[cfg(feature = "demo")]
pub mod demo;
pub mod detect;
pub mod node;
mod playback;
mod recording;
pub mod replay;
pub mod run;
mod text;
pub mod view;

use super::config::{DEFAULT_MODEL, NetInput};
use super::exit::Failure;
use super::places;
use std::convert::Infallible;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

/// The model to use.
#[derive(Debug, clap::Args)]
pub struct ModelArgs {
    /// Model (.onnx) or its sidecar (.toml)
    #[arg(long, value_name = "FILE", default_value = DEFAULT_MODEL, value_parser = file)]
    model: PathBuf,
    /// Least score that counts, 0 to 1 [default: the sidecar's]
    #[arg(long, value_name = "SCORE", value_parser = score, allow_hyphen_values = true)]
    score: Option<f32>,
    /// The net's input: auto, as the size of the cars asks for, or columns and rows such as 800x608
    #[arg(long, value_name = "auto|WxH", default_value = "auto")]
    input: NetInput,
}

/// Prints a line. A reader that has gone away (`| head`) ends the program in silence.
fn print(line: &str) -> Result<(), Failure> {
    match writeln!(std::io::stdout(), "{line}") {
        Ok(()) => Ok(()),
        Err(error) if error.kind() == ErrorKind::BrokenPipe => std::process::exit(0),
        Err(source) => Err(Failure::Write { path: Path::new("standard output").into(), source }),
    }
}

/// Reads a score.
fn score(text: &str) -> Result<f32, &'static str> {
    text.parse().ok().filter(|score| (0.0..=1.0).contains(score)).ok_or("give 0 to 1")
}

/// Place of a model or a lane table.
fn file(text: &str) -> Result<PathBuf, Infallible> {
    Ok(places::find(Path::new(""), Path::new(text)))
}
