//! `verge-detector`: the commands and their arguments.

mod manual;

use clap::{CommandFactory, Parser, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;
use verge_detector::{check, eval, mix};

/// Choose training pictures, score detections.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Balance training pictures over data sets and scenarios (the paper's linear program).
    Mix(mix::Arguments),
    /// Precision, recall and average precision of a detections file.
    Eval(eval::Arguments),
    /// Describe a model file as verge reads it: head, cost, what runs where; and draft its sidecar.
    Check(check::Arguments),
    /// Write the manual pages into a folder, for packages.
    #[command(hide = true)]
    Man {
        /// The folder.
        folder: PathBuf,
    },
}

fn main() -> ExitCode {
    verge_desk::run_main(|arguments: Arguments| match arguments.command {
        Command::Mix(arguments) => mix::run(&arguments),
        Command::Eval(arguments) => Ok(eval::run(&arguments)?),
        Command::Check(arguments) => Ok(check::run(&arguments)?),
        Command::Man { folder } => Ok(manual::manual(Arguments::command()).write(&folder, &[])?),
    })
}
