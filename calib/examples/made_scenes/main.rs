//! The accuracy table of `docs/measured/calibration.md`: made scenes with known truth, all cells.
//!
//! `cargo run --release -p mvcalib --example made_scenes -- 100 --kept kept.tsv` prints Markdown:
//! median MAPE of the road marks for the stages and forms of MVCalib, for `joint` and for an
//! oracle (see `oracle`), the ratio of joint's median to the best of MVCalib's four with its
//! 95 % interval (see `ratio`), the part of the scenes in which joint's 90 % interval holds the
//! true mean length, the median standard error that it states, and how much its focal length
//! moves when the start is half or twice the true one. MVCalib's errors, which take most of
//! the time, are kept in the file named, so that an interrupted table can go on. `--help` has
//! the ways to make a part of the table only.

mod judge;
#[path = "../../bench/made_scene.rs"]
mod made_scene;

mod oracle;
mod ratio;
mod stage_errors;

use crate::made_scene::{Fleet, HK_LIKE, Kind, MadeScene, SAC_LIKE, make};
use clap::{Parser, ValueEnum};
use judge::{Judged, NINETY};
use mvcalib::joint::{self, Joint};
use mvcalib::model::{VehicleModel, parse_models};
use rayon::prelude::*;
use stage_errors::{Kept, NAMES};
use std::ops::Range;

#[derive(Parser)]
struct Arguments {
    /// Scenes a cell.
    #[arg(default_value_t = 100)]
    count: u64,
    /// Where MVCalib's errors are kept.
    #[arg(long, default_value = "made_scenes.tsv")]
    kept: String,
    /// First seed. Nothing was chosen on the scenes from 20,000 and from 100,000.
    #[arg(long, default_value_t = 20_000)]
    first: u64,
    /// What to do.
    #[arg(long, value_enum, default_value_t = Part::Table)]
    part: Part,
    /// Only pictures of this width, px.
    #[arg(long)]
    width: Option<u32>,
    /// Only this label noise, px.
    #[arg(long)]
    noise: Option<f64>,
    /// Only these cars.
    #[arg(long, value_enum)]
    cars: Option<Fleet>,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Part {
    /// Everything.
    Table,
    /// Fill the file of kept errors, print nothing.
    Mvcalib,
    /// Leave MVCalib out.
    Joint,
    /// Only how often joint's interval holds, and how much wider it would have to be to hold
    /// in 85 and in 95 % of the scenes.
    Interval,
}

fn main() {
    let arguments = Arguments::parse();
    let Arguments { count, first, part, .. } = arguments;
    let kept = Kept::open(&arguments.kept).expect("the file of kept errors can be opened");
    let models = parse_models(include_str!("../../data/vehicles.json")).expect("shipped models");
    let cells: Vec<Kind> = cells().filter(|kind| arguments.wants(kind)).collect();
    let seeds = first..first + count;
    if part == Part::Mvcalib {
        // Seed by seed over all cells: an interrupted run has every cell equally far.
        for seed in seeds {
            let compared: Vec<&Kind> = cells.iter().filter(|k| k.fleet != Fleet::Foreign).collect();
            compared.par_iter().for_each(|kind| {
                kept.errors(&make(kind, &models, seed), kind, seed);
            });
        }
        return;
    }
    if part == Part::Interval {
        return intervals(&cells, &models, seeds);
    }
    println!("{count} scenes a cell, seeds from {first}; median MAPE, %\n");
    println!(
        "| picture | label px | cars | {} | joint | mean | oracle | bound | joint : best \
         | 90 % holds | stated | moved by start % |",
        NAMES.join(" | ")
    );
    println!("|{}", "---|".repeat(NAMES.len() + 11));
    for kind in &cells {
        let row = |seed| {
            let scene = make(kind, &models, seed);
            let compared = kind.fleet != Fleet::Foreign && part != Part::Joint;
            let others = compared.then(|| kept.errors(&scene, kind, seed));
            Row { others, ..Row::of(&scene, kind, &models, seed) }
        };
        let rows: Vec<Row> = seeds.clone().into_par_iter().map(row).collect();
        print_cell(kind, &rows);
    }
}

impl Arguments {
    fn wants(&self, kind: &Kind) -> bool {
        self.width.is_none_or(|w| w == kind.image_size[0])
            && self.noise.is_none_or(|n| n == kind.noise_px)
            && self.cars.is_none_or(|c| c == kind.fleet)
    }
}

fn cells() -> impl Iterator<Item = Kind> {
    [HK_LIKE, SAC_LIKE].into_iter().flat_map(|base| {
        [Fleet::Known, Fleet::Unknown, Fleet::Foreign].into_iter().flat_map(move |fleet| {
            [0.5, 1.0, 2.0].into_iter().map(move |noise_px| Kind { noise_px, fleet, ..base })
        })
    })
}

/// One scene; infinite errors where a method found nothing.
struct Row {
    /// MVCalib's; absent for foreign fleets, where only joint's claim is tested.
    others: Option<stage_errors::Errors>,
    joint: f64,
    oracle: f64,
    bound: f64,
    /// Stated standard error of the mean length, and its error in these.
    stated: f64,
    z: f64,
    moved_by_start: f64,
}

impl Row {
    fn of(scene: &MadeScene, kind: &Kind, models: &[VehicleModel], seed: u64) -> Self {
        let [oracle, bound] = oracle::errors(scene, kind, models, seed);
        let f = scene.truth.lens.f;
        let found = started_at(scene, None);
        let Judged { mape: joint, stated, z } = Judged::of(scene, kind, found.as_ref());
        let moved = [0.5, 2.0].map(|part| {
            let other = started_at(scene, Some(part * f));
            let ratio =
                other.zip(found.as_ref()).map(|(a, b)| a.camera().lens.f / b.camera().lens.f);
            ratio.map_or(f64::INFINITY, |r| (r - 1.0).abs())
        });
        Row {
            others: None,
            joint,
            oracle,
            bound,
            stated,
            z,
            moved_by_start: moved[0].max(moved[1]),
        }
    }
}

fn started_at(scene: &MadeScene, f0: Option<f64>) -> Option<Joint> {
    let settings = joint::Settings { f0, ..Default::default() };
    joint::calibrate(&scene.problem, &settings).ok()
}

fn intervals(cells: &[Kind], models: &[VehicleModel], seeds: Range<u64>) {
    println!("| picture | label px | cars | 90 % holds | stated | 85 % at | 95 % at |");
    println!("|{}", "---|".repeat(7));
    for kind in cells {
        let judge = |seed| {
            let scene = make(kind, models, seed);
            Judged::of(&scene, kind, started_at(&scene, None).as_ref())
        };
        let all: Vec<Judged> = seeds.clone().into_par_iter().map(judge).collect();
        let mut widths: Vec<f64> = all.iter().map(|j| j.z.abs() / NINETY).collect();
        widths.sort_by(f64::total_cmp);
        let at = |part: f64| widths[(part * widths.len() as f64) as usize];
        let [w, h] = kind.image_size;
        println!(
            "| {w}x{h} | {} | {:?} | {:.0} % | {:.1} % | {:.2} | {:.2} |",
            kind.noise_px,
            kind.fleet,
            100.0 * judge::held(&all),
            100.0 * ratio::median(all.iter().map(|j| j.stated).collect()),
            at(0.85),
            at(0.95),
        );
    }
}

fn print_cell(kind: &Kind, rows: &[Row]) {
    let median = |of: &dyn Fn(&Row) -> f64| ratio::median(rows.iter().map(of).collect());
    let others: Vec<String> = (0..NAMES.len())
        .map(|k| match rows[0].others {
            Some(_) => format!("{:.2}", median(&|r| r.others.map_or(f64::INFINITY, |o| o[k]))),
            None => String::new(),
        })
        .collect();
    let paired: Vec<(f64, [f64; 4])> =
        rows.iter().filter_map(|r| Some((r.joint, *r.others?.last_chunk()?))).collect();
    let ratio = ratio::of_medians(&paired)
        .map_or(String::new(), |[at, low, high]| format!("{at:.2} ({low:.2} to {high:.2})"));
    let count = rows.len() as f64;
    let mean = rows.iter().map(|r| r.joint).sum::<f64>() / count;
    let held = rows.iter().filter(|r| r.z.abs() < NINETY).count() as f64;
    let moved = rows.iter().map(|r| r.moved_by_start).fold(0.0, f64::max);
    let [w, h] = kind.image_size;
    println!(
        "| {w}x{h} | {} | {:?} | {} | {:.2} | {mean:.2} | {:.2} | {:.2} | {ratio} | {:.0} % \
         | {:.1} % | {:.4} |",
        kind.noise_px,
        kind.fleet,
        others.join(" | "),
        median(&|r| r.joint),
        median(&|r| r.oracle),
        median(&|r| r.bound),
        100.0 * held / count,
        100.0 * median(&|r| r.stated),
        100.0 * moved,
    );
}
