//! `mvcalib compare`: the paper's table of methods.
//!
//! Owns the table on standard output: Hong Kong-like and Sacramento-like made scenes side
//! by side.

use super::print;
use crate::compare::{Summary, rows, run as run_row};

use indicatif::{ProgressBar, ProgressStyle};

use crate::made_scene::{Fleet, HK_LIKE, Kind, SAC_LIKE};
use mvcalib::error::{Error, Result};
use mvcalib::model::{parse_models, read_models};
use std::path::PathBuf;

/// Arguments of `compare`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Scenes of each kind.
    #[arg(long, default_value_t = 20)]
    scenes: u64,
    /// Standard deviation of the labels, px.
    #[arg(long, default_value_t = 1.0)]
    noise: f64,
    /// The cars: exactly the known models, like them but others, or a foreign fleet.
    #[arg(long, value_enum, default_value = "known")]
    fleet: Fleet,
    /// Seed of the first scene.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Vehicle models; the paper's five where absent.
    #[arg(long)]
    vehicles: Option<PathBuf>,
}

/// Runs `compare`: a Markdown table, one row for each method.
pub fn run(arguments: &Arguments) -> Result<()> {
    let models = match &arguments.vehicles {
        Some(path) => read_models(path)?,
        None => parse_models(include_str!("../../data/vehicles.json"))?,
    };
    if arguments.scenes == 0 || !(arguments.noise >= 0.0 && arguments.noise.is_finite()) {
        return Err(Error::Usage("--scenes must be above 0, --noise 0 or more".into()));
    }
    let kinds = [HK_LIKE, SAC_LIKE].map(|kind| Kind {
        noise_px: arguments.noise,
        fleet: arguments.fleet,
        ..kind
    });
    let rows = rows();
    let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len}")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    let bar = ProgressBar::new((rows.len() * kinds.len()) as u64).with_style(style);
    print(&format!(
        "Median over {} made scenes, labels {} px, fleet {:?}; marks of {} m in {:?} (HK) and \
         {} m in {:?} (Sac). MAE as defined; the paper's MAE seems to be the bias.\n",
        arguments.scenes,
        arguments.noise,
        arguments.fleet,
        kinds[0].segment_m,
        kinds[0].image_size,
        kinds[1].segment_m,
        kinds[1].image_size,
    ));
    print(
        "| method | HK RMSE m | MAE m | MAPE | bias | Sac RMSE m | MAE m | MAPE | bias | failed |",
    );
    print("|---|---|---|---|---|---|---|---|---|---|");
    for row in rows {
        bar.set_message(row.name);
        let [hk, sac] = kinds.map(|kind| {
            let summary = run_row(&row, &kind, &models, arguments.seed, arguments.scenes);
            bar.inc(1);
            summary
        });
        let failed = hk.failures + sac.failures;
        print(&format!("| {} | {} | {} | {failed} |", row.name, cells(&hk), cells(&sac)));
    }
    bar.finish_and_clear();
    Ok(())
}

fn cells(s: &Summary) -> String {
    format!("{:.2} | {:.2} | {:.2} % | {:.2} %", s.rmse_m, s.mae_m, s.mape_pct, s.bias_pct)
}
