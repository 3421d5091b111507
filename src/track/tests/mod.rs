//! Made traffic: what is followed against what drove.

#[cfg(feature = "daemon")]
mod brno;
#[cfg(feature = "daemon")]
mod clips;

use super::section::OVERHANG_M;
use super::*;
use crate::units::LaneId;
use std::vec::Vec;

/// Length of road that a car covers, m, as the stage takes it.
const CAR_M: f32 = 4.6;
const LANE_M: f32 = 90.0;
/// Where vehicles begin, m.
const START_M: f32 = -300.0;

/// A lane of vehicles that follow each other by the intelligent driver model (Treiber, Hennecke and
/// Helbing, Physical Review E 62, 2000).
struct Street {
    /// Desired speed, m/s.
    speed: f32,
    /// Time between two arrivals, s.
    headway_s: f32,
    /// For how long of each period a signal at the lane's end is red, s; 0: there is none.
    red: (f32, f32),
}

impl Street {
    /// Places of all vehicles, front first, each `dt`, for `seconds`.
    fn trajectories(&self, seconds: f32, dt: f32) -> Vec<Vec<f32>> {
        let steps = (seconds / dt) as usize;
        let mut all: Vec<Vec<f32>> = Vec::new();
        let mut arrival_s = 0.0;
        while arrival_s < seconds {
            let (mut s, mut v) = (START_M, self.speed);
            let (mut way, mut leader_was) = (Vec::with_capacity(steps), f32::INFINITY);
            for step in 0..steps {
                let t = step as f32 * dt;
                let leader = all.last().map_or(f32::INFINITY, |way| way[step]);
                let leader_v = if leader.is_finite() { (leader - leader_was) / dt } else { 0.0 };
                leader_was = leader;
                if t >= arrival_s {
                    let mut a = self.acceleration(v, leader - CAR_M - s, v - leader_v);
                    let line = LANE_M - 2.0 - s;
                    let (red_s, period_s) = self.red;
                    let can_stop = line > 0.0 && v * v / (2.0 * line) < 3.0;
                    if period_s > 0.0 && t % period_s < red_s && can_stop {
                        a = a.min(self.acceleration(v, line, v));
                    }
                    let next = (v + a * dt).max(0.0);
                    s += (v + next) / 2.0 * dt;
                    v = next;
                }
                way.push(s);
            }
            all.push(way);
            arrival_s += self.headway_s;
        }
        all
    }

    fn acceleration(&self, v: f32, gap_m: f32, closing: f32) -> f32 {
        let (a, b): (f32, f32) = (1.3, 1.8);
        let free = 1.0 - (v / self.speed).powi(4);
        if !gap_m.is_finite() {
            return a * free;
        }
        let wanted = 2.0 + (1.1 * v + v * closing / (2.0 * (a * b).sqrt())).max(0.0);
        (a * (free - (wanted / gap_m.max(0.1)).powi(2))).max(-8.0)
    }
}

/// Differences between the truth and its picture.
#[derive(Clone, Copy)]
struct Eye {
    dt: f32,
    /// Share of vehicles that are not found in a picture.
    misses: f32,
    /// Share of vehicles that have a second box, and of pictures with a box of nothing.
    doubles: f32,
    /// Sway of the camera, px.
    shake_px: f32,
    noise_px: f32,
    /// Every other vehicle is hidden by the one ahead of it, from shortly before it stops behind it
    /// until it has gone.
    hides: bool,
}

/// Speed below which a vehicle behind another is hidden, m/s, and from how near, m.
const HIDDEN_BELOW_M_S: f32 = 2.2;
const HIDDEN_WITHIN_M: f32 = 12.0;

const CLEAR: Eye =
    Eye { dt: 0.2, misses: 0.0, doubles: 0.0, shake_px: 0.0, noise_px: 0.0, hides: false };
const HARD: Eye =
    Eye { dt: 0.2, misses: 0.15, doubles: 0.03, shake_px: 2.0, noise_px: 0.7, hides: false };

struct Random(u32);

impl Random {
    fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as f32 / 16_777_216.0
    }

    /// About normal, of standard deviation 1.
    fn normal(&mut self) -> f32 {
        (0..12).map(|_| self.unit()).sum::<f32>() - 6.0
    }
}

/// Metres a pixel spans: far vehicles are upstream, as on a lane towards the camera.
fn span_m(s_m: f32) -> f32 {
    0.1 + 1.1 * (1.0 - s_m / LANE_M).powi(2)
}

/// Flow (veh/h), speed (km/h), density (veh/km), occupancy and vehicles counted.
#[derive(Debug)]
struct Measured {
    flow: f32,
    speed: f32,
    density: f32,
    occupancy: f32,
    passed: u32,
}

fn lane() -> Lane {
    let id = LaneId::new(1).expect("in range");
    Lane { id, direction: Direction::Toward, length_m: LANE_M }
}

/// The true traffic, the followed one, and the mean queue, m.
fn compare(street: &Street, eye: Eye, seconds: f32) -> (Measured, Measured, f32) {
    const FINE_S: f32 = 0.04;
    const WARM_S: f32 = 60.0;
    let ways = street.trajectories(seconds + WARM_S, FINE_S);
    let (first, steps) = ((WARM_S / FINE_S) as usize, (seconds / FINE_S) as usize);
    let (mut distance, mut time, mut occupied, mut passed) = (0.0_f64, 0.0_f64, 0.0, 0);
    for way in &ways {
        for pair in way[first..first + steps].windows(2) {
            let (a, b) = (pair[0], pair[1]);
            if (0.0..LANE_M).contains(&b) {
                distance += f64::from(b - a);
                time += f64::from(FINE_S);
            }
            let section = LANE_M / 2.0;
            if (section - OVERHANG_M..section + CAR_M - OVERHANG_M).contains(&b) {
                occupied += FINE_S;
            }
            passed += u32::from(a < section && b >= section);
        }
    }
    let area = f64::from(LANE_M * seconds);
    let truth = Measured {
        flow: (distance / area * 3600.0) as f32,
        speed: (distance / time * 3.6) as f32,
        density: (time / area * 1000.0) as f32,
        occupancy: occupied / seconds,
        passed,
    };

    let mut tracker = LaneTracker::new(&lane());
    let mut random = Random(7);
    let every = (eye.dt / FINE_S).round() as usize;
    let mut sum = Moves::default();
    let (mut passed, mut queue) = (0, 0.0);
    for step in (first..first + steps).step_by(every) {
        let mut sightings = Sightings::new();
        let shake = eye.shake_px * (2.0 * random.unit() - 1.0);
        let mut see = |s: f32, random: &mut Random| {
            let s_m = s + span_m(s) * (shake + eye.noise_px * random.normal());
            if (0.0..LANE_M).contains(&s_m) {
                let class = VehicleClass::Car;
                let _ = sightings.push(Sighting { s_m, span_m: span_m(s_m), class });
            }
        };
        for (number, way) in ways.iter().enumerate() {
            let s = way[step];
            let speed = (s - way[step - 1]) / FINE_S;
            let behind = number > 0 && ways[number - 1][step] - s < HIDDEN_WITHIN_M;
            if eye.hides && number % 2 == 1 && behind && speed < HIDDEN_BELOW_M_S {
                continue;
            }
            if (0.0..LANE_M).contains(&s) && random.unit() >= eye.misses {
                see(s, &mut random);
                if random.unit() < eye.doubles {
                    see(s - 1.5, &mut random);
                }
            }
        }
        if random.unit() < eye.doubles {
            see(random.unit() * LANE_M, &mut random);
        }
        let moves = tracker.observe(eye.dt, &mut sightings);
        assert_eq!(moves.lost, 0);
        passed += moves.passages.count();
        queue += moves.queue_m * eye.dt / seconds;
        sum.add(moves.distance_m, moves.time_s, moves.occupied_s);
    }
    let area = LANE_M * seconds;
    let measured = Measured {
        flow: sum.distance_m / area * 3600.0,
        speed: sum.distance_m / sum.time_s * 3.6,
        density: sum.time_s / area * 1000.0,
        occupancy: sum.occupied_s / seconds,
        passed,
    };
    (truth, measured, queue)
}

const STREETS: [(&str, Street); 4] = [
    ("free", Street { speed: 14.0, headway_s: 3.7, red: (0.0, 0.0) }),
    ("fast", Street { speed: 33.0, headway_s: 2.6, red: (0.0, 0.0) }),
    ("signal", Street { speed: 13.0, headway_s: 5.0, red: (40.0, 70.0) }),
    ("crowded", Street { speed: 13.0, headway_s: 2.8, red: (30.0, 60.0) }),
];

/// Compares and prints; returns the errors of flow and of speed as parts, and of the occupancy.
fn errors(name: &str, street: &Street, eye: Eye) -> [f32; 3] {
    let (truth, found, queue_m) = compare(street, eye, 300.0);
    std::eprintln!("{name}, {} s: {truth:?}\n   {found:?}", eye.dt);
    assert!((found.flow - found.density * found.speed).abs() <= 0.001 * found.flow);
    assert!(found.passed.abs_diff(truth.passed) <= 1 + truth.passed / 20, "vehicles that passed");
    let has_queue = street.red.0 > 0.0;
    assert!(if has_queue { queue_m > 10.0 } else { queue_m < 0.5 }, "{queue_m} m");
    [
        found.flow / truth.flow - 1.0,
        found.speed / truth.speed - 1.0,
        found.occupancy - truth.occupancy,
    ]
}

#[test]
fn what_is_seen_well_is_measured_well() {
    for (name, street) in STREETS {
        for dt in [0.04, 0.2, 0.4] {
            let [flow, speed, occupancy] = errors(name, &street, Eye { dt, ..CLEAR });
            assert!(flow.abs() < 0.02, "{name} {dt}: flow {flow:+.3}");
            assert!(speed.abs() < 0.02, "{name} {dt}: speed {speed:+.3}");
            assert!(occupancy.abs() < 0.01, "{name} {dt}: occupancy {occupancy:+.3}");
        }
    }
}

#[test]
fn misses_second_boxes_and_sway_are_borne() {
    for (name, street) in STREETS {
        for dt in [0.08, 0.2] {
            let [flow, speed, occupancy] = errors(name, &street, Eye { dt, ..HARD });
            assert!(flow.abs() < 0.05, "{name} {dt}: flow {flow:+.3}");
            assert!(speed.abs() < 0.03, "{name} {dt}: speed {speed:+.3}");
            assert!(occupancy.abs() < 0.01, "{name} {dt}: occupancy {occupancy:+.3}");
        }
    }
}

#[test]
fn who_is_hidden_in_a_queue_is_still_there() {
    for (name, street) in &STREETS[2..] {
        for dt in [0.08, 0.2] {
            let eye = Eye { dt, hides: true, ..CLEAR };
            let (truth, found, _) = compare(street, eye, 300.0);
            std::eprintln!("{name} hidden, {dt} s: {truth:?}\n   {found:?}");
            let flow = found.flow / truth.flow - 1.0;
            assert!(flow.abs() < 0.05, "{name} {dt}: flow {flow:+.3}");
            let speed = found.speed - truth.speed;
            assert!(speed.abs() < 2.0, "{name} {dt}: speed {speed:+.2} km/h");
            let occupancy = found.occupancy - truth.occupancy;
            assert!(occupancy.abs() < 0.01, "{name} {dt}: occupancy {occupancy:+.3}");
        }
    }
}

#[test]
fn time_unseen_is_told() {
    // 10 m/s, not seen for a second; or not seen again before the lane's end is near.
    let unseen_s = |hidden: core::ops::Range<u8>| {
        let mut tracker = LaneTracker::new(&lane());
        let mut unseen_s = 0.0;
        for step in 0..40_u8 {
            let mut seen = Sightings::new();
            if !hidden.contains(&step) {
                let (s_m, class) = (f32::from(step) * 2.0, VehicleClass::Car);
                let _ = seen.push(Sighting { s_m, span_m: 0.1, class });
            }
            unseen_s += tracker.observe(0.2, &mut seen).unseen_s;
        }
        unseen_s
    };
    assert_eq!(unseen_s(0..0), 0.0);
    assert!((unseen_s(10..14) - 1.0).abs() < 1e-3, "from the last sighting to the next");
    let given_up = unseen_s(10..40);
    assert!((BRIDGE_S..BRIDGE_S + 0.5).contains(&given_up), "{given_up}");
}

#[test]
fn what_lasts_for_less_than_half_a_second_is_no_vehicle() {
    // 20 m/s, with a box of its trailer for a while before the section.
    for dt in [0.04_f32, 0.08, 0.16] {
        let mut tracker = LaneTracker::new(&lane());
        let mut passed = 0;
        for step in 0..(5.0 / dt) as u16 {
            let time_s = f32::from(step) * dt;
            let mut seen = Sightings::new();
            let mut push = |s_m: f32| {
                let _ = seen.push(Sighting { s_m, span_m: 0.1, class: VehicleClass::Truck });
            };
            push(20.0 * time_s);
            if (2.7..3.15).contains(&time_s) {
                push(20.0 * time_s - 8.0);
            }
            passed += tracker.observe(dt, &mut seen).passages.count();
        }
        assert_eq!(passed, 1, "{dt} s");
    }
}

#[test]
fn the_section_is_where_it_was_set() {
    let mut tracker = LaneTracker::new(&lane());
    assert!(!tracker.set_section(0.0, None) && !tracker.set_section(LANE_M, None));
    assert!(!tracker.set_section(f32::NAN, None));
    assert!(tracker.set_section(70.0, None));
    let mut passed = [0; 2];
    for step in 0..40_u8 {
        let s_m = f32::from(step) * 2.0;
        let class = VehicleClass::Car;
        let mut seen =
            Sightings::from_slice(&[Sighting { s_m, span_m: 0.1, class }]).expect("room");
        passed[usize::from(s_m > 69.0)] += tracker.observe(0.2, &mut seen).passages.count();
    }
    assert_eq!(passed, [0, 1]);
}
