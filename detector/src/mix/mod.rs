//! `verge-detector mix`: which pictures to train on, balanced over data sets and scenarios.
//!
//! Owns the command; `lp` owns the program, `sets` finds and sorts the pictures, `table` prints.

mod lp;
mod sample;
mod sets;
mod table;

pub use lp::{Allocation, Balance, allocate};
pub use sample::draw;
pub use sets::{Cell, read_scenarios};
pub use table::print;

use crate::failure::Failure;
use std::path::PathBuf;
use verge_desk::Batch;

/// Arguments of `mix`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// A data set: its name and the folder (or text file of paths) with its pictures.
    #[arg(long = "set", value_name = "NAME=DIR", required = true)]
    sets: Vec<String>,
    /// Scenarios by picture: lines `path-ending<TAB or space>scenario`. Other pictures are
    /// day or night by their own light.
    #[arg(long, value_name = "FILE")]
    scenario: Option<PathBuf>,
    /// How far a data set's share of a scenario may lie from the mean, 0..1.
    #[arg(long, default_value_t = 0.25)]
    beta: f64,
    /// How far a scenario's share may lie from the mean, 0..1.
    #[arg(long, default_value_t = 0.25)]
    gamma: f64,
    /// A data set with fewer pictures of a scenario than this counts as having none.
    #[arg(long, default_value_t = 1)]
    least: usize,
    /// Seed of the sampling.
    #[arg(long)]
    seed: u64,
    /// Folder for the lists: `<set>.<scenario>.txt`, `mix.txt` and `shares.txt`.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Runs `mix`.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let balance = Balance { beta: arguments.beta, gamma: arguments.gamma };
    balance.check()?;
    let scenarios = arguments.scenario.as_deref().map(read_scenarios).transpose()?;
    let (names, cells) = sets::gather(&arguments.sets, scenarios.as_ref(), arguments.least)?;
    let scenario_names = sets::scenario_names(&cells);
    let available = sets::counts(&names, &scenario_names, &cells);
    let allocation = allocate(&available, &names, &scenario_names, balance)?;
    let mut batch = Batch::default();
    let mut all = Vec::new();
    let mut shares = String::new();
    let total: usize = allocation.iter().flatten().sum();
    for (set, row) in names.iter().zip(&allocation) {
        for (scenario, &count) in scenario_names.iter().zip(row) {
            let Some(cell) = cells.iter().find(|c| &c.set == set && &c.scenario == scenario) else {
                continue;
            };
            let chosen = draw(cell, count, arguments.seed);
            let list: String = chosen.iter().map(|path| format!("{}\n", path.display())).collect();
            batch.add(&arguments.out.join(format!("{set}.{scenario}.txt")), list.as_bytes())?;
            if count > 0 {
                shares += &format!("{set} {scenario} {:.6}\n", count as f64 / total as f64);
            }
            all.extend(chosen);
        }
    }
    let list: String = all.iter().map(|path| format!("{}\n", path.display())).collect();
    batch.add(&arguments.out.join("mix.txt"), list.as_bytes())?;
    batch.add(&arguments.out.join("shares.txt"), shares.as_bytes())?;
    batch.commit()?;
    std::print!("{}", print(&names, &scenario_names, &allocation, &available));
    println!("seed {}, beta {}, gamma {}", arguments.seed, arguments.beta, arguments.gamma);
    Ok(())
}
