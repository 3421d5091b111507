//! The accuracy table of `docs/calibration.md`: made scenes with known truth, all cells.
//!
//! `cargo run --release -p mvcalib --example made_scenes -- 100` prints Markdown: median
//! MAPE of the road marks for the stages and forms of MVCalib and for `joint`, the part of
//! the scenes in which joint's 90 % interval holds the true mean length, and how much the
//! result moves when the start is half or twice the true focal length. A second number skips
//! so many cells, to go on with a table that was interrupted.

use mvcalib::camera::Camera;
use mvcalib::fine_tuning;
use mvcalib::joint;
use mvcalib::loss::{Form, Weights};
use mvcalib::made_scene::{Fleet, HK_LIKE, Kind, MadeScene, SAC_LIKE, make};
use mvcalib::marks::Segment;
use mvcalib::stages::{self, Settings};
use mvcalib::vehicle::{VehicleModel, parse_models};
use rayon::prelude::*;

/// Standard errors to either side of a 90 % interval.
const NINETY: f64 = 1.645;
/// Columns of other methods; empty for foreign fleets, where only joint's claim is tested.
const OTHERS: usize = 6;
/// First seed: scenes that no constant was chosen on (those used seeds below 2,000).
const FIRST_SEED: u64 = 10_000;

struct OneScene {
    joint_mape: f64,
    covered: bool,
    moved_by_start: f64,
    others: Vec<f64>,
}

fn main() {
    let count = std::env::args().nth(1).and_then(|a| a.parse().ok()).unwrap_or(100);
    let models = parse_models(include_str!("../data/vehicles.json")).expect("shipped models");
    println!("{count} scenes a cell, seeds from {FIRST_SEED}; median MAPE, %\n");
    println!(
        "| picture | label px | cars | CG | VM | paper a1 | paper a6 | authors a1 | authors a6 \
         | joint | 90 % holds | moved by start % |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    let fleets = [Fleet::Known, Fleet::Unknown, Fleet::Foreign];
    let cells = [HK_LIKE, SAC_LIKE].into_iter().flat_map(|base| {
        fleets.into_iter().flat_map(move |fleet| {
            [0.5, 1.0, 2.0].into_iter().map(move |noise_px| Kind { noise_px, fleet, ..base })
        })
    });
    let first = std::env::args().nth(2).and_then(|a| a.parse().ok()).unwrap_or(0);
    for kind in cells.skip(first) {
        print_cell(&kind, &models, count);
    }
}

fn print_cell(kind: &Kind, models: &[VehicleModel], count: u64) {
    let scenes: Vec<OneScene> = (FIRST_SEED..FIRST_SEED + count)
        .into_par_iter()
        .map(|seed| one_scene(&make(kind, models, seed), kind))
        .collect();
    let median = |f: &dyn Fn(&OneScene) -> f64| {
        let mut all: Vec<f64> = scenes.iter().map(f).collect();
        all.sort_by(f64::total_cmp);
        all[all.len() / 2]
    };
    let mut others: Vec<String> =
        (0..scenes[0].others.len()).map(|k| format!("{:.2}", median(&|s| s.others[k]))).collect();
    others.resize(OTHERS, String::new());
    let covered = scenes.iter().filter(|s| s.covered).count();
    let moved = scenes.iter().map(|s| s.moved_by_start).fold(0.0, f64::max);
    let [w, h] = kind.image_size;
    println!(
        "| {w}x{h} | {} | {:?} | {} | {:.2} | {:.0} % | {:.4} |",
        kind.noise_px,
        kind.fleet,
        others.join(" | "),
        median(&|s| s.joint_mape),
        100.0 * covered as f64 / scenes.len() as f64,
        100.0 * moved,
    );
}

/// MAPE of CG and VM, then of MVCalib in both forms with alpha 1 and 6; each form runs its
/// first two stages once.
fn stages_of(scene: &MadeScene) -> Vec<f64> {
    let mape = |camera: Option<Camera>| {
        camera.and_then(|c| scene.marks.verify(&c).ok()).map_or(f64::INFINITY, |a| a.mape_pct)
    };
    let problem = &scene.problem;
    let width = problem.width_px();
    let mut ablation = Vec::new();
    let mut whole = Vec::new();
    for settings in [Settings::paper(width), Settings::authors(width, 6.0)] {
        let Ok(stages) = stages::calibrate(problem, &settings, &|_| ()) else {
            whole.extend([f64::INFINITY; 2]);
            continue;
        };
        if settings.weights.form == Form::Paper {
            ablation.push(mape(stages.best_candidate(problem, settings.weights)));
            ablation.push(mape(stages.best_matched(problem, settings.weights)));
        }
        let at_1 = Settings { weights: Weights { alpha: 1.0, ..settings.weights }, ..settings };
        let tuned = stages::tune(problem, &stages.matched, &at_1, &|_| ());
        let best = fine_tuning::best(&tuned).map(|k| stages::camera_of(problem, &tuned[k]));
        whole.extend([mape(best), mape(Some(stages.camera(problem)))]);
    }
    ablation.resize(2, f64::INFINITY);
    ablation.extend(whole);
    ablation
}

fn one_scene(scene: &MadeScene, kind: &Kind) -> OneScene {
    let others = if kind.fleet == Fleet::Foreign { vec![] } else { stages_of(scene) };
    let failed = |others| OneScene {
        joint_mape: f64::INFINITY,
        covered: false,
        moved_by_start: f64::INFINITY,
        others,
    };
    let started_at = |f0| {
        let settings = joint::Settings { f0, ..Default::default() };
        joint::calibrate(&scene.problem, &settings).ok()
    };
    let Some(found) = started_at(None) else { return failed(others) };
    let camera = found.camera();
    let Ok(accuracy) = scene.marks.verify(&camera) else { return failed(others) };
    let segments: Vec<Segment> = scene.marks.segments().collect();
    let stretches: Vec<_> = segments.iter().map(|s| s.ends).collect();
    let total: f64 = segments.iter().filter_map(|s| s.measure(&camera).ok()).sum();
    let error = (total / (segments.len() as f64 * kind.segment_m)).ln();
    let sd = found.covariance.relative_sd(&found.estimate.camera, kind.image_size, &stretches);
    let f = scene.truth.lens.f;
    let moved = [0.5, 2.0].map(|part| {
        started_at(Some(part * f))
            .map_or(f64::INFINITY, |other| (other.camera().lens.f / camera.lens.f - 1.0).abs())
    });
    OneScene {
        joint_mape: accuracy.mape_pct,
        covered: sd.is_some_and(|sd| error.abs() < NINETY * sd),
        moved_by_start: moved[0].max(moved[1]),
        others,
    }
}
