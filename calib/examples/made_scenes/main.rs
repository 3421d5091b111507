//! The accuracy table of `docs/calibration.md`: made scenes with known truth, all cells.
//!
//! `cargo run --release -p mvcalib --example made_scenes -- 100 kept.tsv` prints Markdown:
//! median MAPE of the road marks for the stages and forms of MVCalib, for `joint` and for an
//! oracle (see `oracle`), the part of the scenes in which joint's 90 % interval holds the
//! true mean length, the median standard error that it states, and how much its focal length
//! moves when the start is half or twice the true one. MVCalib's errors, which take most of
//! the time, are kept in the file named, so that an interrupted table can go on. A third word
//! `mvcalib` only fills the file, `joint` leaves MVCalib out.

mod oracle;
mod stage_errors;

use mvcalib::joint::{self, Joint};
use mvcalib::made_scene::{Fleet, HK_LIKE, Kind, MadeScene, SAC_LIKE, make};
use mvcalib::vehicle::{VehicleModel, parse_models};
use rayon::prelude::*;
use stage_errors::{Kept, NAMES};

/// Standard errors to either side of a 90 % interval.
const NINETY: f64 = 1.645;
/// First seed: scenes that no constant was chosen on (those used seeds below 10,000).
const FIRST_SEED: u64 = 20_000;

fn main() {
    let arg = |k| std::env::args().nth(k);
    let count = arg(1).and_then(|a| a.parse().ok()).unwrap_or(100);
    let kept = arg(2).unwrap_or_else(|| "made_scenes.tsv".into());
    let kept = Kept::open(&kept).expect("the file of kept errors can be opened");
    let models = parse_models(include_str!("../../data/vehicles.json")).expect("shipped models");
    let seeds = FIRST_SEED..FIRST_SEED + count;
    let part = arg(3).unwrap_or_default();
    if part == "mvcalib" {
        // Seed by seed over all cells: an interrupted run has every cell equally far.
        for seed in seeds {
            let compared: Vec<Kind> = cells().filter(|k| k.fleet != Fleet::Foreign).collect();
            compared.par_iter().for_each(|kind| {
                kept.errors(&make(kind, &models, seed), kind, seed);
            });
        }
        return;
    }
    println!("{count} scenes a cell, seeds from {FIRST_SEED}; median MAPE, %\n");
    println!(
        "| picture | label px | cars | {} | joint | mean | oracle | bound | 90 % holds | stated \
         | moved by start % |",
        NAMES.join(" | ")
    );
    println!("|{}", "---|".repeat(NAMES.len() + 10));
    for kind in cells() {
        let row = |seed| {
            let scene = make(&kind, &models, seed);
            let compared = kind.fleet != Fleet::Foreign && part != "joint";
            let others = compared.then(|| kept.errors(&scene, &kind, seed));
            Row { others, ..Row::of(&scene, &kind, &models, seed) }
        };
        let rows: Vec<Row> = seeds.clone().into_par_iter().map(row).collect();
        print_cell(&kind, &rows);
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
        let checked = found.as_ref().and_then(|j| check(scene, kind, j));
        let [joint, stated, z] = checked.unwrap_or([f64::INFINITY; 3]);
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

/// MAPE, stated standard error of the mean length, and its error in these.
fn check(scene: &MadeScene, kind: &Kind, found: &Joint) -> Option<[f64; 3]> {
    let camera = found.camera();
    let stretches: Vec<_> = scene.marks.segments().map(|s| s.ends).collect();
    let lengths = scene.marks.segments().map(|s| s.measure(&camera).ok());
    let mean = lengths.sum::<Option<f64>>()? / stretches.len() as f64;
    let state = &found.estimate.camera;
    let sd = found.covariance.relative_sd(state, kind.image_size, &stretches)?;
    let mape = scene.marks.verify(&camera).ok()?.mape_pct;
    Some([mape, sd, (mean / kind.segment_m).ln() / sd])
}

fn print_cell(kind: &Kind, rows: &[Row]) {
    let median = |of: &dyn Fn(&Row) -> f64| {
        let mut all: Vec<f64> = rows.iter().map(of).collect();
        all.sort_by(f64::total_cmp);
        all[all.len() / 2]
    };
    let others: Vec<String> = (0..NAMES.len())
        .map(|k| match rows[0].others {
            Some(_) => format!("{:.2}", median(&|r| r.others.map_or(f64::INFINITY, |o| o[k]))),
            None => String::new(),
        })
        .collect();
    let count = rows.len() as f64;
    let mean = rows.iter().map(|r| r.joint).sum::<f64>() / count;
    let held = rows.iter().filter(|r| r.z.abs() < NINETY).count() as f64;
    let moved = rows.iter().map(|r| r.moved_by_start).fold(0.0, f64::max);
    let [w, h] = kind.image_size;
    println!(
        "| {w}x{h} | {} | {:?} | {} | {:.2} | {mean:.2} | {:.2} | {:.2} | {:.0} % | {:.1} % | {:.4} |",
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
