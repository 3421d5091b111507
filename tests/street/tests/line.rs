//! The line behind the detector against exact truth: boxes of the simulated street in place
//! of detections, 15-minute density per lane against the street's own.

use std::path::Path;
use std::time::Duration;
use street::recording::Recorder;
use street::scene::Scene;
use street::truth::FrameTruth;
use street::vehicle::Class;
use verge::daemon::frame::{Detection, PixelBox};
use verge::daemon::locate::Anchor;
use verge::daemon::presets::{Presets, TableSettings, WindowSettings};
use verge::density::{Errors, WindowReport};
use verge::picture::Light;
use verge::sensor::{Outcome, Preset, Windows};
use verge::units::{ImagePoint, UtcMs, VehicleClass};
use verge_street_tests::{Extras, scene, write_table};

const QUARTER: Duration = Duration::from_secs(900);
/// 08:00 on the scene's day, the beginning of a window.
const START: UtcMs = UtcMs(1_767_600_000_000);

/// About how long cells are, m.
const CELL_M: f32 = 10.0;

fn detections(truth: &FrameTruth) -> Vec<Detection> {
    let detection = |vehicle: &street::truth::VehicleTruth| {
        let [x0, y0, x1, y1] = vehicle.bounds.map(|side| side as f32);
        let bounds = PixelBox { x0, y0, x1, y1 };
        let class = match vehicle.class {
            Class::Car => VehicleClass::Car,
            Class::Van => VehicleClass::Van,
            Class::Bus => VehicleClass::Bus,
            Class::Truck => VehicleClass::Truck,
            Class::Motorcycle => VehicleClass::Motorcycle,
        };
        Detection { bounds, score: 1.0, class }
    };
    truth.vehicles.iter().map(detection).collect()
}

/// The line behind the detector: tables and windows.
struct Counting {
    tables: Presets,
    windows: Windows<Vec<Preset>>,
}

impl Counting {
    fn open(table: &Path, anchor: Anchor, scene: &Scene) -> Self {
        let settings = TableSettings { anchor, ..TableSettings::of(table) };
        let mut tables = Presets::load(&settings).expect("a right table");
        let interval = Duration::from_secs_f64(scene.interval_s);
        tables.follow(130.0, interval);
        let windows =
            tables.windows(&WindowSettings::recorded(QUARTER), interval, &Errors::default());
        Self { tables, windows: Windows::new(windows.expect("right windows")) }
    }

    fn count(&mut self, detections: &[Detection], scene: &Scene, time: UtcMs) {
        let size = (scene.camera.width as usize, scene.camera.height as usize);
        let unmoved = ImagePoint { u: 0.0, v: 0.0 };
        let (counts, moves) = self
            .tables
            .count(0, detections, (time, size), unmoved, Light::Day)
            .expect("the table's camera");
        let outcome = Outcome::Measured { preset: 0, counts, moves };
        self.windows.take(time, &outcome, &mut |window| panic!("too early: {window:?}"));
    }

    /// The one window.
    fn finish(mut self) -> WindowReport {
        let mut reports = Vec::new();
        self.windows.finish(&mut |window| reports.push(window.report.clone()));
        assert_eq!(reports.len(), 1);
        reports.remove(0)
    }
}

/// Density per lane, veh/km: the street's own, ours by ground contact points, and ours by
/// box centres.
fn quarter_of_an_hour(scene: &Scene, seed: u64) -> Vec<[f64; 3]> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut recorder = Recorder::new(scene, seed).expect("a street");
    let table = write_table(scene, folder.path(), "street.lut", Extras::default());
    let interval = Duration::from_secs_f64(scene.interval_s);
    let mut lines =
        [Anchor::GroundContact, Anchor::BoxCentre].map(|by| Counting::open(&table, by, scene));
    let frames = (QUARTER.as_secs_f64() / scene.interval_s) as u32;
    let mut truth = vec![0.0; scene.lanes.len()];
    for frame in 0..frames {
        let seen = recorder.next_truth();
        for (sum, lane) in truth.iter_mut().zip(&seen.lanes) {
            *sum += lane.density_veh_km / f64::from(frames);
        }
        let time = START.saturating_add(interval * frame);
        lines.iter_mut().for_each(|line| line.count(&detections(&seen), scene, time));
    }
    let [contact, centre] = lines.map(Counting::finish);
    let density = |report: &WindowReport, lane: usize| {
        f64::from(report.lanes[lane].density_veh_km.expect("all frames were used"))
    };
    let row = |(lane, truth)| [truth, density(&contact, lane), density(&centre, lane)];
    truth.into_iter().enumerate().map(row).collect()
}

/// The curve with its first three lanes, those towards the camera, under the same traffic.
fn curve(traffic: &str) -> Scene {
    let mut scene = scene("curve", &[]);
    let stop_and_go = scene.lanes[1].slowdown;
    let queue = scene.lanes[2].signal;
    for lane in &mut scene.lanes[..3] {
        (lane.slowdown, lane.signal) = match traffic {
            "free flow" => (None, None),
            "stop-and-go" => (stop_and_go, None),
            "queue" => (None, queue),
            other => panic!("no traffic {other}"),
        };
    }
    scene
}

/// Errors of both anchors, per cent, and prints a row.
fn errors(name: &str, seed: u64, lane: usize, [truth, contact, centre]: [f64; 3]) -> [f64; 2] {
    let errors = [contact, centre].map(|density| (density / truth - 1.0) * 100.0);
    let [by_contact, by_centre] = errors;
    eprintln!(
        "| {name} | {seed} | {lane} | {truth:.1} | {contact:.1} ({by_contact:+.1} %) | \
         {centre:.1} ({by_centre:+.1} %) |"
    );
    errors
}

/// From a vehicle's middle to the end of it that the camera sees, m: half a car.
const HALF_A_CAR_M: f64 = 2.3;

/// Mean vehicles in each cell of the lanes from their upstream ends, by the line and in truth.
fn cells_of_a_quarter(scene: &Scene, seed: u64) -> Vec<[Vec<f64>; 2]> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut recorder = Recorder::new(scene, seed).expect("a street");
    let table = write_table(scene, folder.path(), "street.lut", Extras::default());
    let interval = Duration::from_secs_f64(scene.interval_s);
    let mut line = Counting::open(&table, Anchor::GroundContact, scene);
    let frames = (QUARTER.as_secs_f64() / scene.interval_s) as u32;
    let lanes: Vec<(f64, bool)> = recorder
        .street()
        .measured()
        .iter()
        .map(|lane| (lane.length_m(), lane.direction == street::road::Direction::Toward))
        .collect();
    let count = |length_m: f64| (length_m / f64::from(CELL_M)).round() as usize;
    let mut truth: Vec<Vec<f64>> = lanes.iter().map(|&(m, _)| vec![0.0; count(m)]).collect();
    for frame in 0..frames {
        let seen = recorder.next_truth();
        for vehicle in &seen.vehicles {
            let (length_m, toward) = lanes[vehicle.lane - 1];
            let near_m = vehicle.s_m - HALF_A_CAR_M;
            let s_m = if toward { length_m - near_m } else { near_m };
            let cells = &mut truth[vehicle.lane - 1];
            let cell = s_m / length_m * cells.len() as f64;
            if (0.0..cells.len() as f64).contains(&cell) {
                cells[cell as usize] += 1.0 / f64::from(frames);
            }
        }
        let time = START.saturating_add(interval * frame);
        line.count(&detections(&seen), scene, time);
    }
    let report = line.finish();
    let ours = report.lanes.iter().map(|lane| {
        let cells = lane.cells.as_ref().expect("measured");
        let densities = cells.density_veh_km.as_ref().expect("all frames were used");
        let vehicles = |density: &f32| f64::from(density * cells.length_m / 1000.0);
        densities.iter().map(vehicles).collect()
    });
    ours.zip(truth).map(|(ours, truth)| [ours, truth]).collect()
}

#[test]
fn density_by_position_is_the_streets_own_from_the_upstream_end() {
    let mut worst: f64 = 0.0;
    for (lane, [ours, truth]) in cells_of_a_quarter(&curve("queue"), 1).iter().enumerate() {
        assert_eq!(ours.len(), truth.len(), "lane {}", lane + 1);
        // The differences of the cells as a share of the vehicles.
        let all: f64 = truth.iter().sum();
        let apart = |truth: &mut dyn Iterator<Item = &f64>| {
            ours.iter().zip(truth).map(|(ours, truth)| (ours - truth).abs()).sum::<f64>() / all
        };
        let share = apart(&mut truth.iter());
        let turned = apart(&mut truth.iter().rev());
        eprintln!("lane {}: {share:.3}, from the other end {turned:.3}", lane + 1);
        eprintln!("  {ours:.3?}\n  {truth:.3?}");
        worst = worst.max(share);
        // The queue tells one end of the first three lanes from the other.
        assert!(lane >= 3 || share < 0.7 * turned, "lane {}", lane + 1);
    }
    assert!(worst < 0.08, "{worst}");
}

/// Flow, speed and occupancy by the line from true boxes, against the street's own, for two minutes.
fn two_minutes(name: &str, scene: &Scene, seed: u64) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut recorder = Recorder::new(scene, seed).expect("a street");
    let table = write_table(scene, folder.path(), "street.lut", Extras::default());
    let mut line = Counting::open(&table, Anchor::GroundContact, scene);
    let interval = Duration::from_secs_f64(scene.interval_s);
    let frames = (120.0 / scene.interval_s) as u32;
    let mut truth = vec![[0.0; 4]; scene.lanes.len()];
    for frame in 0..frames {
        let seen = recorder.next_truth();
        for (sums, lane) in truth.iter_mut().zip(&seen.lanes) {
            let covered = [lane.distance_m, lane.time_s, lane.occupied_s, lane.passed.into()];
            sums.iter_mut().zip(covered).for_each(|(sum, value)| *sum += value);
        }
        line.count(&detections(&seen), scene, START.saturating_add(interval * frame));
    }
    let seconds = f64::from(frames - 1) * scene.interval_s;
    for (report, [distance_m, time_s, occupied_s, passed]) in line.finish().lanes.iter().zip(truth)
    {
        let lane = report.lane.get();
        let traffic = report.traffic.as_ref().expect("followed");
        let flow = distance_m / f64::from(report.length_m) / seconds * 3600.0;
        let (speed, occupancy) = (distance_m / time_s * 3.6, occupied_s / seconds);
        let known = |value: Option<f32>| f64::from(value.expect("known"));
        let found = (
            known(traffic.flow_veh_h),
            known(traffic.speed_kmh),
            known(traffic.time_occupancy),
            traffic.section.as_ref().expect("known").by_class.iter().sum::<u16>(),
        );
        eprintln!(
            "{name}, {} s, lane {lane}: flow {flow:.0}, speed {speed:.1}, occupancy {occupancy:.3}, \
             {passed} passed; found {found:.3?}",
            scene.interval_s
        );
        assert!((found.0 / flow - 1.0).abs() < 0.05, "flow");
        assert!((found.1 - speed).abs() < (0.03 * speed).max(if speed < 30.0 { 2.0 } else { 0.0 }));
        let density = known(report.density_veh_km);
        assert!(
            (found.0 - density * found.1).abs() < 0.02 * found.0,
            "flow is density times speed"
        );
        assert!((f64::from(found.3) - passed).abs() <= 1.0, "vehicles that passed");
        assert!((found.2 - occupancy).abs() < 0.01, "occupancy");
    }
}

#[test]
fn flow_and_speed_are_the_streets_own() {
    for (traffic, interval_s) in [("queue", 0.2), ("stop-and-go", 0.08)] {
        let scene = Scene { interval_s, ..curve(traffic) };
        two_minutes(traffic, &scene, 4);
    }
    two_minutes("freeway", &Scene { interval_s: 0.2, ..scene("freeway", &[]) }, 5);
}

const HEADING: &str = "| traffic | seed | lane | truth veh/km | ground contact | box centre |\n\
                       |---|---|---|---|---|---|";

#[test]
fn density_is_the_streets_own_within_three_per_cent() {
    eprintln!("{HEADING}");
    let mut worst: f64 = 0.0;
    for traffic in ["free flow", "stop-and-go", "queue"] {
        for seed in 1..=3 {
            for (lane, row) in quarter_of_an_hour(&curve(traffic), seed).into_iter().enumerate() {
                let [by_contact, _] = errors(traffic, seed, lane + 1, row);
                worst = worst.max(by_contact.abs());
            }
        }
    }
    assert!(worst <= 3.0, "{worst:.1} %");
}

#[test]
fn the_contact_point_beats_the_box_centre_on_every_scene() {
    eprintln!("{HEADING}");
    for name in ["curve", "freeway"] {
        let mut sums = [0.0; 2];
        for seed in 1..=3 {
            for (lane, row) in quarter_of_an_hour(&scene(name, &[]), seed).into_iter().enumerate() {
                for (sum, error) in sums.iter_mut().zip(errors(name, seed, lane + 1, row)) {
                    *sum += error.abs() / 12.0;
                }
            }
        }
        let [by_contact, by_centre] = sums;
        eprintln!("{name}: mean error {by_contact:.1} % against {by_centre:.1} %");
        assert!(by_contact < by_centre);
    }
}
