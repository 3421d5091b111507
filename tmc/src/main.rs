//! `verge-tmc`: the commands, their arguments and their exit codes.

mod manual;

use clap::{CommandFactory, Parser, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;
use verge_tmc::failure::Failure;
use verge_tmc::{archive, exporter, fit, points, report, score, serve};

/// Archive, evaluate and show the sensors' densities, at a traffic management centre.
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
    /// Serve the sites' latest numbers to Prometheus, from the broker.
    Exporter(exporter::Arguments),
    /// Turn detector data into points of density and speed for `fit`.
    Points(points::Arguments),
    /// Fit a fundamental diagram: Greenshields, Daganzo, Newell, Van Aerde.
    Fit(fit::Arguments),
    /// Write the morning page and, for each site, when and where density stands.
    Report(report::Arguments),
    /// Show the morning page, live, on loopback.
    Serve(serve::Arguments),
    /// Score density against ground truth, lane by lane: RMSE, MAE, MAPE.
    Score(score::Arguments),
    /// Write the manual pages.
    #[command(hide = true)]
    Man {
        /// Folder for them.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
}

fn main() -> ExitCode {
    verge_desk::run_main(|Arguments { command }| -> Result<(), Failure> {
        match command {
            Command::Archive(arguments) => archive::run(&arguments),
            Command::Exporter(arguments) => exporter::run(&arguments),
            Command::Points(arguments) => Ok(points::run(&arguments)?),
            Command::Fit(arguments) => Ok(fit::run(&arguments)?),
            Command::Report(arguments) => report::run(&arguments),
            Command::Serve(arguments) => serve::run(&arguments),
            Command::Score(arguments) => Ok(score::run(&arguments)?),
            Command::Man { out } => {
                Ok(manual::write(Arguments::command().name("verge-tmc"), &out)?)
            }
        }
    })
}
