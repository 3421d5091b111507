//! Which image point of a box is the vehicle's place on the road? Four rules against the truth.
//!
//! For each scene and traffic state, 15 minutes of truth boxes are mapped to the road through
//! the true camera by four rules, counted in the measured stretch of the lane they fall into,
//! and compared with the true density. Prints a Markdown table. Owns no part of verge's line.
//!
//! `cargo run --release -p street --example ground_point`

use street::camera::Camera;
use street::measured::MeasuredLane;
use street::recording::Recorder;
use street::road::Direction;
use street::scene::{Scene, Signal, Slowdown};
use street::simulation::Simulation;
use street::truth::VehicleTruth;
use street::vehicle::Class;

/// The rule that also knows the class's length.
const MOVED: &str = "bottom moved by half the class's length";

const SEED: u64 = 5;
const WINDOW_S: f64 = 900.0;
const INTERVAL_S: f64 = 2.0;

/// The image point that a rule takes for a vehicle, px.
type Rule = fn(&VehicleTruth) -> [f64; 2];

/// The middle of a box's bottom lies so far behind the near end of the footprint, m: measured
/// by this program (the difference of its second and third row, over both scenes).
const BOTTOM_FROM_NEAR_END_M: f64 = 0.8;

/// Half the length of a vehicle, by class alone as a detector knows it, m.
fn half_length_m(class: Class) -> f64 {
    match class {
        Class::Car => 2.4,
        Class::Van => 2.65,
        Class::Bus => 6.0,
        Class::Truck => 4.0,
        Class::Motorcycle => 1.0,
    }
}

const RULES: [(&str, Rule); 5] = [
    ("true footprint centre", |v| v.contact),
    ("true near end", |v| v.near_contact),
    ("middle of the box's bottom", |v| [(v.bounds[0] + v.bounds[2]) / 2.0, v.bounds[3]]),
    (MOVED, |v| [(v.bounds[0] + v.bounds[2]) / 2.0, v.bounds[3]]),
    ("centre of the box", |v| {
        [(v.bounds[0] + v.bounds[2]) / 2.0, (v.bounds[1] + v.bounds[3]) / 2.0]
    }),
];

/// The lane and the distance along it (m from the road's start) of an image point.
fn locate(street: &Simulation, camera: &Camera, image: [f64; 2]) -> Option<(usize, f64)> {
    let point = camera.ground(image)?;
    // The near half of the road is enough, and the walk starts there.
    let (s, d) = street.road().locate(point, &mut 100);
    let lanes = &street.scene().lanes;
    let lane = lanes.iter().position(|lane| (d - lane.offset_m).abs() <= lane.width_m / 2.0)?;
    // The lane's own arc length that belongs to s, by bisection of the inverse map.
    let line = &street.lane_lines()[lane];
    let (mut low, mut high) = (0.0, line.length_m());
    for _ in 0..40 {
        let middle = (low + high) / 2.0;
        if line.reference_s(middle) < s { low = middle } else { high = middle }
    }
    Some((lane, low))
}

fn states(text: &str) -> Vec<(&'static str, Scene)> {
    let scene = |inflow: f64| {
        let mut scene = Scene::parse(text, "shipped scene", &[]).expect("a shipped scene");
        scene.interval_s = INTERVAL_S;
        for lane in &mut scene.lanes {
            lane.inflow_veh_h = inflow;
            lane.signal = None;
            lane.slowdown = None;
        }
        scene
    };
    let mut go = scene(1500.0);
    let mut queue = scene(1500.0);
    for (slow, held) in go.lanes.iter_mut().zip(&mut queue.lanes) {
        // Just downstream of the measured stretch for either direction.
        let away = slow.direction == Direction::Away;
        let (from_m, to_m) = if away { (125.0, 160.0) } else { (0.0, 20.0) };
        let period_s = Some(120.0);
        slow.slowdown = Some(Slowdown { from_m, to_m, speed_km_h: 8.0, period_s, active_s: 60.0 });
        let at_m = if away { 125.0 } else { 15.0 };
        held.signal = Some(Signal { at_m, green_s: 8.0, red_s: 82.0, offset_s: 0.0 });
    }
    vec![("free flow", scene(700.0)), ("stop-and-go", go), ("queue", queue)]
}

fn main() {
    println!(
        "| scene | traffic | true density, veh/km | rule | mean error of s, m | error of the 15-minute density, % per lane |"
    );
    println!("|---|---|---|---|---|---|");
    for text in [include_str!("../scenes/curve.toml"), include_str!("../scenes/freeway.toml")] {
        for (traffic, scene) in states(text) {
            let mut recorder = Recorder::new(&scene, SEED).expect("a shipped scene");
            let camera = scene.camera();
            let lanes: Vec<MeasuredLane> = recorder.street().measured().to_vec();
            let frames = (WINDOW_S / INTERVAL_S) as usize;
            let mut truth = vec![0.0; lanes.len()];
            let mut counted = vec![vec![0.0; lanes.len()]; RULES.len()];
            let mut shift = vec![(0.0, 0usize); RULES.len()];
            for _ in 0..frames {
                let frame = recorder.next_truth();
                for lane in &frame.lanes {
                    truth[lane.lane - 1] += lane.vehicles as f64;
                }
                for vehicle in &frame.vehicles {
                    for (rule, (name, image)) in RULES.iter().enumerate() {
                        let place = locate(recorder.street(), &camera, image(vehicle));
                        let Some((lane, s)) = place else { continue };
                        let moved = half_length_m(vehicle.class) - BOTTOM_FROM_NEAR_END_M;
                        let s = if *name == MOVED { s + moved } else { s };
                        if lanes[lane].contains(s) {
                            counted[rule][lane] += 1.0;
                            if lane + 1 == vehicle.lane {
                                shift[rule].0 += s - lanes[lane].near_m - vehicle.s_m;
                                shift[rule].1 += 1;
                            }
                        }
                    }
                }
            }
            let density: Vec<String> = truth
                .iter()
                .zip(&lanes)
                .map(|(sum, lane)| format!("{:.1}", sum / frames as f64 / lane.length_m() * 1000.0))
                .collect();
            for (rule, (name, _)) in RULES.iter().enumerate() {
                let errors: Vec<String> = counted[rule]
                    .iter()
                    .zip(&truth)
                    .map(|(count, sum)| format!("{:+.1}", (count / sum - 1.0) * 100.0))
                    .collect();
                println!(
                    "| {} | {traffic} | {} | {name} | {:+.2} | {} |",
                    scene.name,
                    density.join(", "),
                    shift[rule].0 / shift[rule].1.max(1) as f64,
                    errors.join(", ")
                );
            }
        }
    }
}
