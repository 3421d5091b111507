//! How soon a move of the camera is noticed.

use super::{INTERVAL_S, eye_of, next, reference_of, scene};
use std::time::Duration;
use street::random::Stream;
use street::recording::Recorder;
use street::scene::{Ptz, Scene};
use verge::scene::{Aim, Guard, Reference};

/// Frames before a move and after it: two minutes.
const BEFORE: usize = 6;
const AFTER: usize = 12;

/// Moves of random direction: of three kinds, 2 % of the width or 2 degrees; in every light or
/// in the named one.
pub fn moves(name: &str, cases: usize, only: Option<&str>) {
    println!("| scene | light | move | cases | flagged within 2 min | slowest, s |");
    println!("|---|---|---|---|---|---|");
    let lights = [
        ("day", vec![]),
        ("night", vec!["light.daylight=night"]),
        ("rain", vec!["light.rain=0.8"]),
        ("rain at night", vec!["light.daylight=night", "light.rain=0.8"]),
    ];
    let kinds = ["2 % of the width", "2 degrees of pan or tilt", "2 degrees of roll"];
    let (mut total, mut flagged) = (0, 0);
    let known: Vec<Reference> = (0..4).map(|seed| reference_of(name, 500 + seed)).collect();
    for (light, changes) in lights.iter().filter(|(light, _)| only.is_none_or(|o| o == *light)) {
        for (kind, said) in kinds.iter().enumerate() {
            let share = cases / kinds.len();
            let (mut hits, mut slowest) = (0, 0.0_f64);
            for case in 0..share {
                let seed = 500 + case as u64 % 4;
                let mut scene = scene(name, changes);
                let after = one_move(&mut scene, &known[case % 4], seed, kind, case as u64);
                if let Some(after) = after {
                    hits += 1;
                    slowest = slowest.max(after);
                }
            }
            (total, flagged) = (total + share, flagged + hits);
            println!("| {name} | {light} | {said} | {share} | {hits} | {slowest:.0} |");
        }
    }
    println!("all: {flagged} of {total}");
}

/// Seconds from a move until it is flagged.
fn one_move(
    scene: &mut Scene,
    known: &Reference,
    seed: u64,
    kind: usize,
    case: u64,
) -> Option<f64> {
    let mut random = Stream::new(case, "moves");
    let (sin, cos) = random.range(0.0, std::f64::consts::TAU).sin_cos();
    let two_percent = 0.02 * f64::from(scene.camera.width) / scene.camera.focal_px;
    let (pan_deg, tilt_deg, roll_deg) = match kind {
        0 => (two_percent.to_degrees() * cos, two_percent.to_degrees() * sin, 0.0),
        1 => (2.0 * cos, 2.0 * sin, 0.0),
        _ => (0.0, 0.0, 2.0 * cos.signum()),
    };
    scene.interval_s = INTERVAL_S;
    // Another stretch of traffic for every case, on the street of the seed.
    scene.warmup_s += 30.0 * case as f64;
    scene.faults.shake_px = 2.0 * f64::from(scene.camera.width) / 320.0;
    let at_s = BEFORE as f64 * INTERVAL_S - 1.0;
    scene.faults.ptz = Some(Ptz { at_s, pan_deg, tilt_deg, roll_deg, until_s: None, zoom: 1.0 });
    let mut recorder = Recorder::new(scene, seed).expect("a street");
    let (mut guard, mut eye) = (Guard::new(1), eye_of(scene));
    for number in 0..BEFORE + AFTER {
        eye.look(&next(&mut recorder));
        let now = Duration::from_secs_f64(number as f64 * INTERVAL_S);
        let aim = guard.judge(std::slice::from_ref(known), &eye, now).aim;
        if number < BEFORE {
            assert_eq!(aim, Aim::Preset(0), "before the move, frame {number}");
        } else if aim == Aim::Moved {
            return Some((number - BEFORE) as f64 * INTERVAL_S + 1.0);
        }
    }
    None
}
