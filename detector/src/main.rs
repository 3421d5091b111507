//! `verge-detector`: the commands, their arguments and their exit codes.

use clap::{Parser, Subcommand};
use std::process::ExitCode;
use verge_detector::failure::{Failure, USAGE};
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
    /// What verge makes of a model file: head, cost, what runs where; and a sidecar to start from.
    Check(check::Arguments),
}

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            let code = if error.use_stderr() { USAGE } else { 0 };
            // A closed terminal must not change the exit code.
            let _ = error.print();
            return ExitCode::from(code);
        }
    };
    let result: Result<(), Failure> = match arguments.command {
        Command::Mix(arguments) => mix::run(&arguments),
        Command::Eval(arguments) => eval::run(&arguments),
        Command::Check(arguments) => check::run(&arguments),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("verge-detector: {failure}");
            ExitCode::from(failure.code())
        }
    }
}
