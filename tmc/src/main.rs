//! `verge-tmc`: the commands, their arguments and their exit codes.

use clap::{Parser, Subcommand};
use std::process::ExitCode;
use verge_tmc::failure::Failure;
use verge_tmc::{archive, fit, points, report, score};

/// What a traffic management centre makes of the sensors' densities.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Keep what the sensors publish: from the broker into Parquet, each window once.
    Archive(archive::Arguments),
    /// Turn detector data into points of density and speed for `fit`.
    Points(points::Arguments),
    /// Fit a fundamental diagram: Greenshields or Newell.
    Fit(fit::Arguments),
    /// Say when, on which weekday and where density stands: pages, pictures, tables.
    Report(report::Arguments),
    /// Score density against ground truth, lane by lane: RMSE, MAE, MAPE.
    Score(score::Arguments),
}

fn main() -> ExitCode {
    verge_desk::run_main(|Arguments { command }| -> Result<(), Failure> {
        match command {
            Command::Archive(arguments) => archive::run(&arguments),
            Command::Points(arguments) => Ok(points::run(&arguments)?),
            Command::Fit(arguments) => Ok(fit::run(&arguments)?),
            Command::Report(arguments) => report::run(&arguments),
            Command::Score(arguments) => Ok(score::run(&arguments)?),
        }
    })
}
