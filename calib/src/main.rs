//! `mvcalib`: calibrates a traffic camera and makes its lane table.
//!
//! Owns the command line. Does not own any work (see the library).

mod cli;
#[path = "../bench/compare.rs"]
mod compare;
#[path = "../bench/made_scene.rs"]
mod made_scene;

use std::process::ExitCode;

fn main() -> ExitCode {
    verge_desk::run_main(|cli: cli::Cli| cli::run(cli.command))
}
