//! The speed figures of `docs/measured/calibration.md`, on camera K109F and one core.
//!
//! `cargo run --release -p mvcalib --example speed`: the paper's full budgets (35 searches
//! of 4,000 and 7 of 20,000 evaluations, none stopped early) in both forms, and `joint`
//! with its uncertainty. Medians of several runs; on Linux the time this thread had a core, so
//! that other work on the machine does not count, elsewhere the wall clock.

use mvcalib::files::labelme::read_vehicles;
use mvcalib::joint;
use mvcalib::model::read_models;
use mvcalib::paper::stages::{Settings, calibrate};
use mvcalib::problem::Problem;
use std::path::Path;
use std::time::Instant;

const RUNS: usize = 7;

fn main() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("data");
    let (vehicles, size) = read_vehicles(&data.join("k109f/labels")).expect("shipped labels");
    let models = read_models(&data.join("vehicles.json")).expect("shipped models");
    let problem = Problem::new(size, vehicles, models).expect("shipped labels are valid");
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("one thread");
    pool.install(|| {
        for (name, settings) in [
            ("authors' form, alpha 6", Settings::authors(320.0, 6.0)),
            ("paper's form, alpha 6", Settings::paper(320.0)),
        ] {
            let settings = Settings { stop_early: false, ..settings };
            let mut evaluations = 0;
            let seconds = median(|| {
                let stages = calibrate(&problem, &settings, &|_| ()).expect("seven vehicles");
                evaluations = stages.evaluations();
            });
            let each_us = 1e6 * seconds / evaluations as f64;
            println!("{name}: {evaluations} evaluations in {seconds:.3} s ({each_us:.2} us each)");
        }
        let seconds = median(|| {
            let found = joint::calibrate(&problem, &joint::Settings::default());
            assert!(found.expect("seven vehicles").rel_err().is_some());
        });
        println!("joint, 7 vehicles, with its uncertainty: {seconds:.4} s");
    });
}

fn median(mut run: impl FnMut()) -> f64 {
    let mut all: Vec<f64> = (0..RUNS)
        .map(|_| {
            let (wall, core) = (Instant::now(), core_seconds());
            run();
            match (core, core_seconds()) {
                (Some(before), Some(after)) => after - before,
                _ => wall.elapsed().as_secs_f64(),
            }
        })
        .collect();
    all.sort_by(f64::total_cmp);
    all[RUNS / 2]
}

/// How long this thread has run on a core, s (Linux: first field of schedstat, ns).
fn core_seconds() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(1e-9 * text.split_whitespace().next()?.parse::<f64>().ok()?)
}
