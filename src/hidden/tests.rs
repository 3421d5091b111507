//! A straight lane under a camera 10 m up: queues with and without a lorry, and free flow.

use super::*;
use crate::units::{Direction, ImageSize};
use std::vec::Vec;

const HEIGHT_M: f32 = 10.0;
const FOCAL_PX: f32 = 400.0;
const HORIZON: f32 = 60.0;
const BEGINS_M: f32 = 25.0;
const LENGTH_M: f32 = 80.0;

fn lane() -> LaneId {
    LaneId::new(1).expect("in range")
}

/// Row of a point that far from the camera, so high over the road.
fn row(distance_m: f32, height_m: f32) -> f32 {
    HORIZON + FOCAL_PX * (HEIGHT_M - height_m) / distance_m
}

/// The lane's look-up: its traffic comes towards the camera.
fn place(point: ImagePoint) -> Option<Place> {
    let distance = FOCAL_PX * HEIGHT_M / (point.v - HORIZON);
    let half = 1.75 * FOCAL_PX / distance;
    let inside = (BEGINS_M..BEGINS_M + LENGTH_M).contains(&distance);
    (inside && (point.u - 160.0).abs() < half).then(|| Place {
        lane: lane(),
        s_m: BEGINS_M + LENGTH_M - distance,
        span_m: 1.0,
    })
}

fn queues() -> Queues {
    let description = Description {
        camera_id: Default::default(),
        image_size: ImageSize { width: 320, height: 240 },
        lanes: [crate::lane::Lane { id: lane(), direction: Direction::Toward, length_m: LENGTH_M }]
            .into_iter()
            .collect(),
        length_rel_err: None,
        calibration_id: Default::default(),
        calibration_sha256: [0; 32],
        cell_length_m: 10.0,
    };
    let samples = (0..60).map(|i| {
        let distance = BEGINS_M + i as f32;
        (ImagePoint { u: 160.0, v: row(distance, 0.0) }, 1.8 * FOCAL_PX / distance)
    });
    let car = CarSize::fit(samples, 320.0).expect("enough samples");
    Queues::new(&description, place, car)
}

/// A vehicle whose near end is that far from the camera.
fn vehicle(distance_m: f32, class: VehicleClass, height_m: f32) -> Seen {
    let far = distance_m + class.nominal_length_m();
    let half = 0.9 * FOCAL_PX / distance_m;
    let bounds = PixelBox {
        x0: 160.0 - half,
        y0: row(far, height_m),
        x1: 160.0 + half,
        y1: row(distance_m, 0.0),
    };
    let at = place(ImagePoint { u: 160.0, v: bounds.y1 });
    Seen { bounds, class, place: Some(at.expect("on the lane")) }
}

fn cars(distances: &[f32]) -> Vec<Seen> {
    distances.iter().map(|&d| vehicle(d, VehicleClass::Car, 1.4)).collect()
}

fn estimate(seen: &[Seen]) -> Vec<f32> {
    let mut found = Vec::new();
    queues().estimate(seen, |_, s_m| found.push(BEGINS_M + LENGTH_M - s_m));
    found
}

#[test]
fn a_queue_whose_vehicles_are_all_seen_gets_none() {
    assert_eq!(estimate(&cars(&[26.0, 33.0, 40.0, 46.5, 53.5, 60.0])), [0.0; 0]);
}

#[test]
fn a_car_behind_a_lorry_of_a_queue_is_not_forgotten() {
    // The lorry from 40 to 49.1 m; behind it a place at 51 m, then a car that shows.
    let mut seen = cars(&[26.0, 33.0, 58.0, 65.0, 72.0]);
    seen.push(vehicle(40.0, VehicleClass::Truck, 3.6));
    let found = estimate(&seen);
    assert_eq!(found.len(), 1, "{found:?}");
    assert!((found[0] - 51.3).abs() < 1.0, "{found:?}");
}

#[test]
fn a_lorry_in_free_flow_hides_nothing() {
    let mut seen = cars(&[26.0, 70.0, 90.0]);
    seen.push(vehicle(44.0, VehicleClass::Truck, 3.6));
    assert_eq!(estimate(&seen), [0.0; 0]);
    // Two boxes on one vehicle are no queue either.
    seen.extend(cars(&[27.5, 29.0, 71.5, 73.0]));
    assert_eq!(estimate(&seen), [0.0; 0]);
}

#[test]
fn what_stands_outside_the_lanes_hides_but_does_not_count() {
    let mut seen = cars(&[26.0, 33.0, 54.0, 61.0, 68.0]);
    seen.push(vehicle(40.0, VehicleClass::Motorcycle, 1.4));
    assert_eq!(estimate(&seen), [0.0; 0]);
    seen.push(Seen { place: None, ..vehicle(40.5, VehicleClass::Bus, 3.6) });
    assert_eq!(estimate(&seen).len(), 1, "a bus beside the lane hides it");
}
