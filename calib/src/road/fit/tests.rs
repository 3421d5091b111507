//! The fit to traffic that is drawn from its own priors: fleets, drawing and outlines that no camera
//! sees, as no made street of one fleet can show.

use super::bodies::ALL as BODIES;
use super::hull::{Footing, log_box, look};
use super::problem::{Problem, Theta, camera_of, shared_of};
use super::traffic::{OUTLINE, SHARED, SHARED_SD, Shared, log_size};
use super::view::{CAMERA, Unknowns, View};
use super::{BoxCue, Cues, LaneCue, MarkCue, advice, fit};
use crate::trust::{Reason, Trust};
use nalgebra::{Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use verge::units::Direction;

const SIZE: [u32; 2] = [320, 240];

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// A camera, and the cues of two lanes with traffic of a fleet drawn from the priors.
fn drawn(seed: u64, boxes: usize) -> (Unknowns, Cues) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let f = 320.0 * (0.1 + 0.25 * normal(&mut rng)).exp();
    let height = 10.0 * (0.2 * normal(&mut rng)).exp();
    // The road 16 m away is at the picture's lower edge.
    let tilt = (height / 16.0).atan() - (120.0 / f).atan();
    let camera = Unknowns::from([f.ln(), tilt, 0.02 * normal(&mut rng), height.ln(), -0.02, 0.0]);
    let view = View::new(&camera, SIZE);
    let lane = |x: f64, rng: &mut ChaCha8Rng| {
        let side = |x: f64, rng: &mut ChaCha8Rng| -> Vec<Vector2<f64>> {
            let beside = 0.5 * normal(rng);
            let along = (0..8).map(|k| 18.0 + 6.0 * f64::from(k));
            let seen: Vec<_> = along.map(|y| view.project(Vector3::new(x, y, 0.0))).collect();
            seen.iter().map(|p| p + Vector2::new(beside + 0.5 * normal(rng), 0.0)).collect()
        };
        let (right, left) = (side(x + 1.7, rng), side(x - 1.7, rng));
        let direction = if x > 0.0 { Direction::Away } else { Direction::Toward };
        LaneCue { name: format!("{x}"), right, left, direction, steady: true }
    };
    let lanes = vec![lane(3.0, &mut rng), lane(-1.5, &mut rng)];
    let shared = Shared::from_fn(|k, _| SHARED_SD[k] * normal(&mut rng));
    let boxes = (0..boxes).map(|frame| vehicle(&view, &shared, frame, &mut rng)).collect();
    (camera, Cues { lanes, boxes, ..Cues::default() })
}

fn vehicle(view: &View, shared: &Shared, frame: usize, rng: &mut ChaCha8Rng) -> BoxCue {
    let toward = rng.random_bool(0.5);
    let x = if toward { -1.5 } else { 3.0 } + 0.2 * normal(rng);
    let ground = Vector2::new(x, rng.random_range(20.0..55.0));
    let mut rest = rng.random_range(0.0..1.0);
    let body = (0..BODIES.len()).find(|&k| {
        rest -= BODIES[k].share;
        rest < 0.0
    });
    let body = body.unwrap_or(0);
    let mut size = log_size(body, shared);
    size[1] += shared[if toward { 9 } else { 10 }];
    (0..3).for_each(|k| size[k] += BODIES[body].scatter[k] * normal(rng));
    let turned = 2.5f64.to_radians() * normal(rng);
    let away = Vector2::new(-turned.sin(), turned.cos());
    let look = look(view.height_m(), ground, Vector2::y(), f64::from(u8::from(toward)));
    let (log, _) = log_box(view, &Footing { ground, away, toward, look }, &BODIES[body], size)
        .expect("below the horizon");
    let outline = |a: usize| -> f64 {
        look.iter().enumerate().map(|(j, l)| l * shared[OUTLINE + a * look.len() + j]).sum()
    };
    // Drawing errors change with the size against the usual one, about 17 px here.
    let excess = log[0] - 17f64.ln();
    let [w, h] =
        [0, 1].map(|a| (log[a] + shared[3 + a] + shared[5 + a] * excess + outline(a)).exp());
    let foot = view.project(ground.push(0.0));
    let edge = |px: f64, rng: &mut ChaCha8Rng| {
        (0.6f64.powi(2) + 0.5 * (0.025 * px).powi(2)).sqrt() * normal(rng)
    };
    let [left, right] = [-0.5, 0.5].map(|side| foot.x + side * w + edge(w, rng));
    let [top, low] = [foot.y - h + edge(h, rng), foot.y + edge(h, rng)];
    BoxCue { frame, corners: [left, top, right, low], class: None }
}

#[test]
fn the_interval_holds_over_fleets_that_no_camera_sees() {
    // `docs/measured/calibration.md` states it for 160 of them.
    let cameras = std::env::var("FLEETS").map_or(24, |n| n.parse().expect("a number"));
    let (mut held, mut squares) = (0, 0.0);
    // Without those whose picture the road leaves at its top.
    let seen = (0..)
        .map(|seed| (seed, drawn(seed, 90)))
        .filter(|(_, (_, cues))| cues.points().all(|p| (0.0..f64::from(SIZE[1])).contains(&p.y)));
    for (seed, (camera, cues)) in seen.take(cameras) {
        let found = fit(&cues, SIZE).expect("a camera");
        let view = View::new(&camera, SIZE);
        let ends = [20.0, 55.0].map(|y| view.project(Vector3::new(0.0, y, 0.0)));
        let whole = found.known.of_stretches(&[ends]).expect("on the road");
        let z = (whole.length_m / 35.0).ln() / whole.rel_sd;
        held += usize::from(z.abs() < 1.645);
        squares += z * z;
        println!(
            "camera {seed}: {:+.1} % stated {:.1} %",
            100.0 * (whole.length_m / 35.0 - 1.0),
            100.0 * whole.rel_sd
        );
    }
    let rms = (squares / cameras as f64).sqrt();
    println!("held in {held} of {cameras}, root mean square {rms:.2} of the stated error");
    assert!(rms < 1.35 && 4 * held >= 3 * cameras as usize, "{held} of {cameras}, {rms:.2}");
}

#[test]
fn boxes_tell_less_for_their_bodies_are_unknown() {
    let (camera, cues) = drawn(3, 60);
    let mut problem = Problem::new(&cues, SIZE).expect("a prior");
    let optimum = problem.solve().expect("a camera");
    let mixture = optimum.mixture.as_ref().expect("traffic");
    let mut r = Vec::new();
    problem.residuals(&optimum.theta, Some(mixture), &mut r).expect("on the road");
    let all = [true; CAMERA];
    let (complete, _) = problem.normal(&optimum.theta, Some(mixture), &r, &all).expect("slopes");
    let sd = |information: super::problem::Information| {
        information.cholesky().expect("positive").inverse()[(0, 0)].sqrt()
    };
    let (as_if_known, stated) = (sd(complete), sd(optimum.information));
    assert!(stated > 1.02 * as_if_known && stated < 2.0 * as_if_known, "{as_if_known} {stated}");
    assert!((optimum.theta[0] - camera[0]).abs() < 3.0 * stated);
}

#[test]
fn what_boxes_share_has_the_slopes_that_the_residuals_have() {
    let (camera, cues) = drawn(5, 40);
    let mut problem = Problem::new(&cues, SIZE).expect("a prior");
    let mut theta = Theta::zeros();
    theta.fixed_rows_mut::<CAMERA>(0).copy_from(&camera);
    problem.hold(&camera_of(&theta)).expect("on the road");
    let view = View::new(&camera, SIZE);
    let middles = problem.middles(&view);
    let mut mixture =
        super::mixture::Mixture::new(problem.traffic(), &view, &middles, &shared_of(&theta));
    mixture.expect(problem.traffic(), &view, &middles, &shared_of(&theta), 1.0, true);
    let of = |problem: &mut Problem<'_>, theta: &Theta| {
        let mut r = Vec::new();
        problem.residuals(theta, Some(&mixture), &mut r).expect("on the road");
        r
    };
    let base = of(&mut problem, &theta);
    let first = base.len() - 2 * mixture.pairs();
    let rows: Vec<_> = mixture.shared_rows().flatten().collect();
    for k in 0..SHARED {
        let mut at = theta;
        at[CAMERA + k] += 1e-4;
        let moved = of(&mut problem, &at);
        for (j, row) in rows.iter().enumerate() {
            let slope = (moved[first + j] - base[first + j]) / 1e-4;
            assert!(
                (slope - row[k]).abs() < 0.05 * (1.0 + row[k].abs()),
                "{k} {j} {slope} {}",
                row[k]
            );
        }
    }
}

#[test]
fn where_the_width_of_the_lanes_is_asked_for_it_helps_across() {
    let mut asked = 0;
    for seed in 0..12 {
        let (camera, mut cues) = drawn(seed, 0);
        let view = View::new(&camera, SIZE);
        let ends = [20.0, 55.0].map(|y| view.project(Vector3::new(0.0, y, 0.0))).to_vec();
        cues.marks = vec![MarkCue::measured("along", ends, 35.0)];
        let advised = |cues: &Cues| {
            let found = fit(cues, SIZE).expect("a camera");
            let advice = advice::best_across(&found.known, cues, found.errors());
            (advice.expect("an advice"), found.errors().worst_across().error.rel_sd)
        };
        let (advice, before) = advised(&cues);
        if advice != "the width of the lanes (--lane-width)" {
            continue;
        }
        asked += 1;
        cues.lane_width_m = Some(3.4);
        let (advice, after) = advised(&cues);
        assert!(after < 0.8 * before, "camera {seed}: {before} {after}");
        assert!(advice.contains("length"), "camera {seed}: {advice}");
    }
    assert!(asked > 0);
}

#[test]
fn two_lanes_drawn_as_one_do_not_bend_the_camera() {
    let (camera, mut cues) = drawn(3, 0);
    let view = View::new(&camera, SIZE);
    let mark = |name: &str, [a, b]: [[f64; 2]; 2]| {
        let ends = [a, b].map(|[x, y]| view.project(Vector3::new(x, y, 0.0)));
        let metres = (Vector2::from(b) - Vector2::from(a)).norm();
        MarkCue::measured(name, ends.to_vec(), metres)
    };
    cues.marks = vec![
        mark("near", [[0.0, 20.0], [0.0, 32.0]]),
        mark("far", [[0.0, 40.0], [0.0, 58.0]]),
        mark("across", [[-3.0, 22.0], [4.5, 22.0]]),
    ];
    let right = fit(&cues, SIZE).expect("a camera");
    assert_eq!(right.trust, Trust::Ok);
    let left = cues.lanes[1].left.clone();
    cues.lanes = vec![LaneCue { left, ..cues.lanes[0].clone() }];
    let found = fit(&cues, SIZE).expect("a camera");
    let Trust::Refused(Reason::LaneWidth { width_m, .. }) = found.trust else {
        panic!("{}", found.trust)
    };
    assert!((width_m / 7.9 - 1.0).abs() < 0.1, "{width_m}");
    // Lanes as wide as that may be stated.
    cues.lane_width_m = Some(7.9);
    assert_eq!(fit(&cues, SIZE).expect("a camera").trust, Trust::Ok);
}
