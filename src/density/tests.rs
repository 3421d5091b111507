//! Tests of windows and of the estimator.

use super::counts::LaneCount;
use super::*;
use crate::units::{Direction, LaneId, VehicleClass};
use std::vec::Vec;

const MINUTE: Duration = Duration::from_secs(60);

fn lane_id(number: u8) -> LaneId {
    LaneId::new(number).expect("in range")
}

fn aggregator(windows: &[Duration], interval: Duration, start: Start) -> Aggregator {
    let lanes = [
        Lane { id: lane_id(1), direction: Direction::Toward, length_m: 50.0 },
        Lane { id: lane_id(2), direction: Direction::Away, length_m: 100.0 },
    ];
    let lanes = heapless::Vec::from_slice(&lanes).expect("two of eight");
    Aggregator::new(&lanes, 10.0, windows, interval, 0.5, start).expect("a right configuration")
}

fn cars(lane: u8, n: usize) -> FrameCounts {
    let mut counts = aggregator(&[MINUTE], MINUTE, Start::AtNextWindow).counts();
    for _ in 0..n {
        counts.add(lane_id(lane), 0.0, VehicleClass::Car);
    }
    counts
}

/// Numbers from 0 to 1, the same each time.
fn random() -> impl FnMut() -> f32 {
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 40) as f32 / (1u64 << 24) as f32
    }
}

fn second(s: i64) -> UtcMs {
    UtcMs(s * 1000)
}

#[test]
fn density_is_mean_count_over_length() {
    let mut line = aggregator(&[MINUTE], Duration::from_secs(20), Start::AtNextWindow);
    for (t, n) in [(0, 2), (20, 3), (40, 4)] {
        assert!(line.observe(second(t), &cars(1, n)).is_empty());
    }
    let closed = line.advance(second(60));
    let report = &closed[0];
    assert_eq!((report.from, report.to), (second(0), second(60)));
    let lane = &report.lanes[0];
    assert_eq!(lane.density_veh_km, Some(60.0), "3 vehicles on 50 m");
    assert_eq!(lane.vehicles_mean, Some(3.0));
    assert_eq!((lane.frames_used, lane.frames_expected), (3, 3));
    assert!((lane.space_occupancy.expect("known") - 3.0 * 4.6 / 50.0).abs() < 1e-6);
    assert_eq!(report.lanes[1].density_veh_km, Some(0.0), "an empty road is known");
    assert_eq!(lane.status, SampleZoneStatus::Ok);
}

#[test]
fn no_frame_is_unknown_and_not_zero() {
    let mut line = aggregator(&[MINUTE], Duration::from_secs(1), Start::AtNextWindow);
    line.advance(second(0));
    let lane = &line.advance(second(60))[0].lanes[0];
    assert_eq!(lane.density_veh_km, None);
    assert_eq!(lane.status, SampleZoneStatus::SensorFailure);
    line.miss(second(70), SampleZoneStatus::DetectionAutoSuspended);
    let lane = &line.advance(second(120))[0].lanes[0];
    assert_eq!(lane.status, SampleZoneStatus::DetectionAutoSuspended);
}

#[test]
fn too_few_frames_are_not_a_window() {
    let mut line = aggregator(&[MINUTE], Duration::from_secs(10), Start::AtNextWindow);
    line.observe(second(0), &cars(1, 5));
    line.observe(second(10), &cars(1, 5));
    let lane = &line.advance(second(60))[0].lanes[0];
    assert_eq!((lane.density_veh_km, lane.frames_used), (None, 2));
    assert_eq!(lane.status, SampleZoneStatus::InputDataIntegrity);
}

#[test]
fn a_live_line_waits_for_a_whole_window_a_recorded_one_does_not() {
    for (start, first_from) in [(Start::AtNextWindow, 60), (Start::WithFirstFrame, 0)] {
        let mut line = aggregator(&[MINUTE], Duration::from_secs(30), start);
        let mut closed = Vec::new();
        for t in [10, 40, 70, 100] {
            closed.extend(line.observe(second(t), &cars(1, 1)));
        }
        closed.extend(line.finish());
        assert_eq!(closed[0].from, second(first_from), "{start:?}");
        assert_eq!(closed[0].lanes[0].frames_used, 2);
    }
}

#[test]
fn windows_of_several_lengths_close_by_themselves() {
    let mut line = aggregator(&[MINUTE, 5 * MINUTE], Duration::from_secs(60), Start::AtNextWindow);
    let mut lengths = Vec::new();
    for minute in 0..=5 {
        for report in line.observe(second(60 * minute), &cars(2, 1)) {
            lengths.push(report.to.saturating_since(report.from).as_secs());
        }
    }
    assert_eq!(lengths, [60, 60, 60, 60, 60, 300]);
}

#[test]
fn a_leap_reports_one_window_and_a_step_back_none() {
    let mut line = aggregator(&[MINUTE], Duration::from_secs(30), Start::AtNextWindow);
    line.observe(second(0), &cars(1, 1));
    assert_eq!(line.observe(second(3600), &cars(1, 1)).len(), 1);
    assert!(line.observe(second(1800), &cars(1, 9)).is_empty());
    let lane = &line.advance(second(3660))[0].lanes[0];
    assert_eq!((lane.frames_used, lane.vehicles_mean), (1, Some(1.0)));
}

#[test]
fn the_stated_error_covers_the_truth_of_correlated_counts() {
    // A two-state road: a queue of 8 that comes and goes, mean 4, correlation 0.96.
    let mut uniform = random();
    let (mut covered, rounds) = (0, 400);
    for _ in 0..rounds {
        let mut series = Series::default();
        let mut queue = uniform() < 0.5;
        for _ in 0..900 {
            queue ^= uniform() < 0.02;
            let mut count = LaneCount::default();
            count.by_class[1] = if queue { 8 } else { 0 };
            series.push(&count);
        }
        let (mean, error) = series.mean_and_error().expect("900 frames");
        covered += i32::from((mean - 4.0).abs() < 1.645 * error);
    }
    let share = covered as f32 / rounds as f32;
    assert!((0.82..0.97).contains(&share), "90 % interval covers {share}");
}

#[test]
fn a_single_frame_has_an_error_too() {
    let mut series = Series::default();
    series.push(&LaneCount::default());
    let (mean, error) = series.mean_and_error().expect("one frame");
    assert_eq!(mean, 0.0);
    assert!(error > 0.5);
}

#[test]
fn impossible_windows_are_refused() {
    let lanes = heapless::Vec::new();
    let s = Duration::from_secs;
    let new = |lengths: &[Duration], interval| {
        let start = Start::AtNextWindow;
        Aggregator::<MAX_WINDOWS>::new(&lanes, 10.0, lengths, interval, 0.5, start).err()
    };
    assert_eq!(new(&[], s(1)), Some(AggregateError::WindowCount(0)));
    for length in [s(5), s(70), s(1800), Duration::from_millis(10_500), s(0)] {
        assert_eq!(new(&[length], s(1)), Some(AggregateError::WindowLength(length)));
    }
    assert_eq!(new(&[MINUTE, s(20), MINUTE], s(1)), Some(AggregateError::Twice(MINUTE)));
    let slow = AggregateError::Interval { interval: s(120), window: MINUTE };
    assert_eq!(new(&[MINUTE], s(120)), Some(slow));
    assert_eq!(new(&[MINUTE; 7], s(1)), Some(AggregateError::WindowCount(7)));
}

#[test]
fn a_slower_pace_is_expected_in_its_window_and_a_faster_one_in_the_next() {
    let mut line = aggregator(&[MINUTE], Duration::from_secs(10), Start::AtNextWindow);
    let frames = |line: &mut Aggregator, from: i64, step: usize| {
        let mut closed: Closed = Closed::new();
        for t in (from..from + 60).step_by(step) {
            let now = line.observe(second(t), &cars(1, 2));
            closed.extend(now);
        }
        closed
    };
    frames(&mut line, 0, 10);
    line.set_interval(Duration::from_secs(20));
    let full = frames(&mut line, 60, 20);
    line.set_interval(Duration::from_secs(10));
    let half = frames(&mut line, 120, 10);
    let again = line.advance(second(180));
    for (report, frames) in [(&full[0], (6, 3)), (&half[0], (3, 3)), (&again[0], (6, 6))] {
        let lane = &report.lanes[0];
        assert_eq!((lane.frames_used, lane.frames_expected), frames);
        assert_eq!(lane.density_veh_km, Some(40.0));
    }
}

#[test]
fn a_vehicle_counts_in_the_cell_of_its_place() {
    let mut line = aggregator(&[MINUTE], Duration::from_secs(20), Start::AtNextWindow);
    for (t, places) in [(0, &[5.0, 15.0][..]), (20, &[15.0]), (40, &[49.9, 50.0])] {
        let mut counts = line.counts();
        places.iter().for_each(|&s_m| counts.add(lane_id(1), s_m, VehicleClass::Car));
        assert!(line.observe(second(t), &counts).is_empty());
    }
    let report = &line.advance(second(60))[0];
    let cells = |lane: usize| report.lanes[lane].cells.clone().expect("measured");
    let by_density = |cells: &Cells, per_frame: &[f32]| {
        let densities = cells.density_veh_km.as_ref().expect("known");
        assert_eq!(densities.len(), per_frame.len());
        for (density, n) in densities.iter().zip(per_frame) {
            assert!((density - n / 3.0 * 100.0).abs() < 1e-3, "{densities:?}");
        }
    };
    assert_eq!(cells(0).length_m, 10.0);
    by_density(&cells(0), &[1.0, 2.0, 0.0, 0.0, 2.0]);
    by_density(&cells(1), &[0.0; 10]);
    line.miss(second(70), SampleZoneStatus::PoorContrast);
    let report = &line.advance(second(120))[0];
    let unknown = Cells { length_m: 10.0, density_veh_km: None };
    assert_eq!(report.lanes[0].cells, Some(unknown), "no density, no cells of it");
}

#[test]
fn the_mean_of_the_cells_is_the_density_of_the_lane() {
    let mut uniform = random();
    for round in 0..200 {
        let lane = Lane {
            id: lane_id(1 + round % 8),
            direction: Direction::Away,
            length_m: 1.0 + 654.0 * uniform(),
        };
        let lanes = heapless::Vec::from_slice(&[lane]).expect("one of eight");
        let about_m = 2.0 + 98.0 * uniform();
        let (windows, start) = ([MINUTE, 5 * MINUTE], Start::AtNextWindow);
        let mut line: Aggregator =
            Aggregator::new(&lanes, about_m, &windows, MINUTE / 12, 0.5, start).expect("right");
        let busy = 20.0 * uniform();
        for t in (0..300).step_by(5) {
            let mut counts = line.counts();
            for _ in 0..(busy * uniform()) as usize {
                counts.add(lane.id, lane.length_m * uniform(), VehicleClass::Car);
            }
            line.observe(second(t), &counts);
        }
        for report in line.advance(second(300)) {
            let report = &report.lanes[0];
            let cells = report.cells.as_ref().expect("measured");
            let densities = cells.density_veh_km.as_ref().expect("known");
            let whole = cells.length_m * densities.len() as f32;
            assert!((whole - lane.length_m).abs() < 1e-3 * lane.length_m, "{cells:?}");
            let mean = densities.iter().sum::<f32>() / densities.len() as f32;
            let density = report.density_veh_km.expect("known");
            assert!((mean - density).abs() <= 1e-5 * density, "{mean} {density}");
        }
    }
}
