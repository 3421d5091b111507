//! Recorded tracks against speeds from LIDAR gates: BrnoCompSpeed, session 0 (Sochor et al., IEEE
//! Transactions on Intelligent Transportation Systems 20, 2019). Places of vehicles in pictures, 25 or
//! 50 a second, come from the tracker of 2014 that is part of the data; its identities are thrown away.

use super::super::*;
use crate::units::LaneId;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use std::vec::Vec;

/// The stretch that is measured, m from the camera along the road: nearer, boxes are cut off by the
/// picture, farther, the old tracker loses vehicles.
const STRETCH_M: [f64; 2] = [28.0, 68.0];
/// A vehicle that passed at another time than this many seconds about a gate's is another one.
const SAME_S: f64 = 0.5;

type Point = [f64; 2];
type Vector = [f64; 3];

fn dot(a: Vector, b: Vector) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn scaled(a: Vector, by: f64) -> Vector {
    a.map(|x| x * by)
}

fn unit(a: Vector) -> Vector {
    scaled(a, 1.0 / dot(a, a).sqrt())
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().expect("an array").iter().map(|x| x.as_f64().expect("a number")).collect()
}

/// The road plane by two vanishing points, and distances along it in metres by marks of known length.
struct Road {
    centre: Point,
    focal: f64,
    normal: Vector,
    along: Vector,
    scale: f64,
}

impl Road {
    fn new(calibration: &Value, marks: &Value) -> Self {
        let at = |name: &str| {
            let point = numbers(&calibration[name]);
            [point[0], point[1]]
        };
        let centre = at("pp");
        let [first, second] = ["vp1", "vp2"].map(|name| {
            let [u, v] = at(name);
            [u - centre[0], v - centre[1]]
        });
        let focal = (-(first[0] * second[0] + first[1] * second[1])).sqrt();
        let ([a0, a1], [b0, b1]) = (first, second);
        let (a, b) = ([a0, a1, focal], [b0, b1, focal]);
        let normal =
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
        let mut road = Self { centre, focal, normal: unit(normal), along: unit(a), scale: 1.0 };
        let (mut known, mut seen) = (0.0, 0.0);
        for mark in marks.as_array().expect("marks").iter().filter(|m| m["toVP1"] == true) {
            let [from, to] = ["p1", "p2"].map(|end| numbers(&mark[end]));
            let length = (road.s_m([from[0], from[1]]) - road.s_m([to[0], to[1]])).abs();
            known += mark["distance"].as_f64().expect("metres") * length;
            seen += length * length;
        }
        road.scale = known / seen;
        road
    }

    /// Distance from the camera along the road, m.
    fn s_m(&self, [u, v]: Point) -> f64 {
        let ray = [u - self.centre[0], v - self.centre[1], self.focal];
        (self.scale * dot(ray, self.along) * 10.0 / dot(self.normal, ray)).abs()
    }
}

/// Where lines of the picture are in a row.
fn columns(lines: &[Vec<f64>], row: f64) -> Vec<f64> {
    let mut found: Vec<f64> = lines.iter().map(|l| -(l[1] * row + l[2]) / l[0]).collect();
    found.sort_by(f64::total_cmp);
    found
}

/// A lane, and when vehicles passed its middle (s) and how fast (km/h).
struct Followed {
    tracker: LaneTracker,
    sightings: Sightings,
    passed: Vec<(f64, f64)>,
}

/// Differences of speeds at the middle of the stretch, km/h, and how many vehicles have one by gates.
fn differences(folder: &Path) -> (Vec<f64>, usize) {
    let json = |name: &str| -> Value {
        let text = std::fs::read_to_string(folder.join(name)).expect("it is there");
        serde_json::from_str(&text).expect("JSON")
    };
    let truth = json("gt_data.json");
    let fps = truth["fps"].as_f64().expect("pictures a second");
    let road = Road::new(&json("calib_optimal_vp2.json"), &truth["distanceMeasurement"]);
    let lines = |name: &str| -> Vec<Vec<f64>> {
        truth[name].as_array().expect("lines").iter().map(numbers).collect()
    };
    let (dividers, gates) = (lines("laneDivLines"), lines("measurementLines"));
    let unpacked = std::process::Command::new("gzip")
        .args(["-dc"])
        .arg(folder.join("tracks_dubska.csv.gz"))
        .output()
        .expect("gzip");
    let text = std::string::String::from_utf8(unpacked.stdout).expect("text");
    let mut frames: BTreeMap<u32, Vec<Point>> = BTreeMap::new();
    let (mut first, mut way) = (BTreeMap::new(), 0.0);
    for line in text.lines().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        let number = |index: usize| fields[index].parse::<f64>().expect("a number");
        let point = [number(2), number(3)];
        let s_m = road.s_m(point);
        way += s_m - *first.entry(fields[0]).or_insert(s_m);
        frames.entry(number(1) as u32).or_default().push(point);
    }
    let [near, far] = STRETCH_M;
    let is_away = way > 0.0;
    let along = |s_m: f64| if is_away { s_m - near } else { far - s_m };
    let length_m = far - near;
    let mut lanes: Vec<Followed> = (1..dividers.len() as u8)
        .map(|number| {
            let id = LaneId::new(number).expect("in range");
            let lane = Lane { id, direction: Direction::Unknown, length_m: length_m as f32 };
            let tracker = LaneTracker::new(&lane);
            Followed { tracker, sightings: Sightings::new(), passed: Vec::new() }
        })
        .collect();
    for frame in 0..=*frames.keys().last().expect("some") {
        for &[u, v] in frames.get(&frame).into_iter().flatten() {
            let lane = columns(&dividers, v).iter().filter(|column| **column < u).count();
            let s_m = along(road.s_m([u, v]));
            let span_m = (road.s_m([u, v + 1.0]) - road.s_m([u, v])).abs();
            if (1..=lanes.len()).contains(&lane) && (0.0..length_m).contains(&s_m) {
                let (s_m, span_m) = (s_m as f32, span_m as f32);
                let sighting = Sighting { s_m, span_m, class: VehicleClass::Car };
                let _ = lanes[lane - 1].sightings.push(sighting);
            }
        }
        for Followed { tracker, sightings, passed } in &mut lanes {
            let moves = tracker.observe(1.0 / fps as f32, sightings);
            sightings.clear();
            if moves.passages.count() == 1 {
                let kmh = f64::from(moves.passages.speeds_m_s) * 3.6;
                passed.push((f64::from(frame) / fps, kmh));
            }
        }
    }
    // Where the middle of a lane meets a gate.
    let meets = |gate: &[f64], lane: usize| {
        let row = |half: i32| f64::from(half) / 2.0;
        let apart = |half: &i32| {
            let found = columns(&dividers, row(*half));
            let u = (found[lane] + found[lane + 1]) / 2.0;
            ((gate[0] * u + gate[1] * row(*half) + gate[2]) / gate[1]).abs()
        };
        let half = (300..2158).min_by(|a, b| apart(a).total_cmp(&apart(b))).expect("rows");
        let found = columns(&dividers, row(half));
        along(road.s_m([(found[lane] + found[lane + 1]) / 2.0, row(half)]))
    };
    let (mut found, mut valid) = (Vec::new(), 0);
    for car in truth["cars"].as_array().expect("cars").iter().filter(|car| car["valid"] == true) {
        valid += 1;
        let kmh = car["speed"].as_f64().expect("km/h");
        let lane = car["laneIndex"][0].as_u64().expect("a lane") as usize;
        let crossings = car["intersections"].as_array().expect("gates");
        let at_middle = |crossing: &Value| {
            let gate = crossing["measurementLineId"].as_u64().expect("a gate") as usize;
            let rest_m = length_m / 2.0 - meets(&gates[gate], lane);
            crossing["videoTime"].as_f64().expect("s") + rest_m / (kmh / 3.6)
        };
        let time = crossings.iter().map(at_middle).sum::<f64>() / crossings.len() as f64;
        let apart = |a: &(f64, f64)| (a.0 - time).abs();
        let passed = &mut lanes[lane].passed;
        let nearest =
            (0..passed.len()).min_by(|a, b| apart(&passed[*a]).total_cmp(&apart(&passed[*b])));
        if let Some(index) = nearest.filter(|index| apart(&passed[*index]) < SAME_S) {
            found.push(passed.swap_remove(index).1 - kmh);
        }
    }
    (found, valid)
}

#[test]
fn speeds_are_those_of_the_lidar_gates() {
    for camera in ["left", "center", "right"] {
        let folder = std::format!("data/brnocompspeed/session0_{camera}");
        let Some(folder) = verge_desk::shared(&folder) else { return };
        let (differences, valid) = differences(&folder);
        let mean = |of: fn(f64) -> f64| {
            differences.iter().map(|d| of(*d)).sum::<f64>() / differences.len() as f64
        };
        let (absolute, bias) = (mean(f64::abs), mean(|d| d));
        std::eprintln!(
            "{camera}: {} of {valid} vehicles found, mean absolute error {absolute:.2} km/h, mean \
             {bias:+.2} km/h",
            differences.len()
        );
        assert!(differences.len() * 10 >= valid * 9, "{camera}: nine in ten are found");
        assert!(absolute <= 1.5, "{camera}: {absolute:.2} km/h");
    }
}
