//! `mvcalib`: calibrates a traffic camera and makes its lane table.
//!
//! Owns the command line and the exit code. Does not own any work (see the library).

mod cli;
#[path = "../bench/compare.rs"]
mod compare;
#[path = "../bench/made_scene.rs"]
mod made_scene;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    let command = match cli::Cli::try_parse() {
        Ok(cli) => cli.command,
        Err(error) => {
            // Help and version are no errors; clap prints each where it belongs.
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { EX_USAGE } else { 0 });
        }
    };
    match cli::run(command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("mvcalib: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

/// sysexits: the command was used incorrectly.
const EX_USAGE: u8 = 64;
