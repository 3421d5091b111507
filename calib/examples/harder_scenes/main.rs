//! What joint loses where its assumptions do not hold, for `docs/measured/calibration.md`.
//!
//! `cargo run --release -p mvcalib --example harder_scenes -- 300` prints three tables in
//! Markdown, from made scenes of unknown cars with labels of 1 px: vans, minibuses and taxis
//! among the cars, told as what they are, taken for cars or left out; which of them are named
//! when nobody told them (`-- 300 untold`: this one alone); and roads with a curved
//! profile and off-centre principal points.

#[path = "../made_scenes/judge.rs"]
mod judge;
#[path = "../../bench/made_scene.rs"]
mod made_scene;

use crate::made_scene::{Fleet, HK_LIKE, Kind, MadeScene, SAC_LIKE, make};
use judge::{Judged, held};
use mvcalib::bodies::Body;
use mvcalib::joint::untold::{NAMED, untold_above};
use mvcalib::joint::{self, Settings};
use mvcalib::model::{VehicleModel, parse_models};
use mvcalib::problem::Problem;
use rayon::prelude::*;

/// First seed: scenes that nothing was chosen on.
const FIRST_SEED: u64 = 300_000;

fn main() {
    let count = std::env::args().nth(1).and_then(|a| a.parse().ok()).unwrap_or(100);
    let models = parse_models(include_str!("../../data/vehicles.json")).expect("shipped models");
    if std::env::args().nth(2).is_some_and(|part| part == "untold") {
        return untold_bodies(&models, count);
    }
    println!("{count} scenes a cell, seeds from {FIRST_SEED}; median MAPE, 90 % holds, stated\n");
    println!("| picture | of seven | told | taken for cars | left out |\n|---|---|---|---|---|");
    for base in [HK_LIKE, SAC_LIKE] {
        for (n, body) in [(1, Body::Van), (2, Body::Van), (2, Body::Minibus), (2, Body::Taxi)] {
            let kind = Kind { fleet: Fleet::Unknown, others: (n, body), ..base };
            let ways = [told, as_cars, left_out].map(|way| cell(&kind, &models, count, way));
            let [w, h] = kind.image_size;
            println!("| {w}x{h} | {n} {} | {} |", body.name(), ways.join(" | "));
        }
    }
    untold_bodies(&models, count);
    println!("\n| picture | road and principal point | joint |\n|---|---|---|");
    for base in [HK_LIKE, SAC_LIKE] {
        let kind = Kind { fleet: Fleet::Unknown, ..base };
        let [w, h] = kind.image_size;
        println!("| {w}x{h} | level, centred | {} |", cell(&kind, &models, count, told));
        for radius_m in [2000.0, 1000.0, 500.0] {
            for (what, sign) in [("sag", 1.0), ("crest", -1.0)] {
                let kind = Kind { profile_per_m: sign / radius_m, ..kind };
                let cell = cell(&kind, &models, count, told);
                println!("| {w}x{h} | {what} {radius_m} m | {cell} |");
            }
        }
        for (u, v) in [(0.02, 0.0), (0.05, 0.0), (0.0, 0.02), (0.0, 0.05), (0.0, -0.05)] {
            let kind = Kind { off_centre: [u, v], ..kind };
            let cell = cell(&kind, &models, count, told);
            println!("| {w}x{h} | {:+} % right, {:+} % down | {cell} |", 100.0 * u, 100.0 * v);
        }
    }
}

/// How often vehicles that nobody told are named, and cars for something else.
fn untold_bodies(models: &[VehicleModel], count: u64) {
    // Each scene with its odds, also where they are too small to name a vehicle.
    let each = std::env::var_os("UNTOLD_EACH").is_some();
    println!("\n| picture | of seven, taken for cars | one named | all named | a car named |");
    println!("|---|---|---|---|---|");
    for base in [HK_LIKE, SAC_LIKE] {
        let others = [(0, Body::Car), (1, Body::Van), (2, Body::Van), (2, Body::Minibus)];
        for (n, body) in others.into_iter().chain([(2, Body::Taxi)]) {
            let kind = Kind { fleet: Fleet::Unknown, others: (n, body), ..base };
            let judge = |seed| {
                let scene = make(&kind, models, seed);
                let problem = as_cars(&scene);
                let joint = joint::calibrate(&problem, &Settings::default()).ok();
                let least = if each { 0.0 } else { NAMED };
                let settings = Settings::default();
                let named = |j: joint::Joint| untold_above(least, &problem, &settings, &j.estimate);
                let named = joint.map(named).unwrap_or_default();
                let is_other = |k: usize| scene.problem.vehicles[k].body != Body::Car;
                let right = named.iter().filter(|u| is_other(u.vehicle)).count();
                let line: Vec<String> =
                    named.iter().map(|u| format!("{:.1}", u.log_odds)).collect();
                if each {
                    eprintln!("{n} {} {right}/{} {}", body.name(), named.len(), line.join(" "));
                }
                [right > 0, right == n && n > 0, right < named.len()]
            };
            let seeds = FIRST_SEED..FIRST_SEED + count;
            let all: Vec<[bool; 3]> = seeds.into_par_iter().map(judge).collect();
            let share = |k: usize| 100 * all.iter().filter(|j| j[k]).count() / all.len();
            let [w, h] = kind.image_size;
            let what = format!("{n} {}", body.name());
            println!("| {w}x{h} | {what} | {} % | {} % | {} % |", share(0), share(1), share(2));
        }
    }
}

fn told(scene: &MadeScene) -> Problem {
    scene.problem.clone()
}

fn as_cars(scene: &MadeScene) -> Problem {
    let mut problem = told(scene);
    problem.vehicles.iter_mut().for_each(|v| v.body = Body::Car);
    problem
}

fn left_out(scene: &MadeScene) -> Problem {
    let mut problem = told(scene);
    problem.vehicles.retain(|v| v.body == Body::Car);
    problem
}

/// Median MAPE, how often the interval holds, the median of what is stated.
fn cell(
    kind: &Kind,
    models: &[VehicleModel],
    count: u64,
    way: fn(&MadeScene) -> Problem,
) -> String {
    let judge = |seed| {
        let scene = make(kind, models, seed);
        let found = joint::calibrate(&way(&scene), &Settings::default()).ok();
        Judged::of(&scene, kind, found.as_ref())
    };
    let seeds = FIRST_SEED..FIRST_SEED + count;
    let all: Vec<Judged> = seeds.into_par_iter().map(judge).collect();
    let median = |of: fn(&Judged) -> f64| {
        let mut values: Vec<f64> = all.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let (mape, stated) = (median(|j| j.mape), 100.0 * median(|j| j.stated));
    format!("{mape:.2}, {:.0} %, {stated:.1} %", 100.0 * held(&all))
}
