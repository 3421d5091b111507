//! Windows of known motion.

use super::*;
use crate::track::{Moves, Passages};
use crate::units::{Direction, LaneId};

const MINUTE: Duration = Duration::from_secs(60);
const FIFTH: Duration = Duration::from_millis(200);
const LENGTH_M: f32 = 100.0;

fn report(density: Option<f32>) -> WindowReport {
    let lane = LaneReport {
        lane: LaneId::new(1).expect("in range"),
        direction: Direction::Away,
        density_veh_km: density,
        density_se: density.map(|k| k / 10.0),
        vehicles_mean: density.map(|k| k * LENGTH_M / 1000.0),
        by_class: density.map(|k| [0.0, k / 10.0, 0.0, 0.0, 0.0, 0.0]),
        space_occupancy: density.map(|_| 0.1),
        length_m: LENGTH_M,
        frames_used: 300,
        frames_expected: 300,
        status: SampleZoneStatus::Ok,
        cells: None,
        error: density.map(|k| crate::density::DensityError {
            calibration: 0.02 * k,
            counting: 0.1 * k,
            ci90: [k / 2.0, k * 1.5],
        }),
        traffic: None,
    };
    let lanes = [lane].into_iter().collect();
    WindowReport { from: UtcMs(60_000), to: UtcMs(120_000), lanes }
}

/// Two vehicles at 10 m/s on the lane all the while, one of which passes each 5 s.
fn moves(step: u32) -> LaneMoves {
    let mut moves = Moves {
        observed_s: 0.2,
        distance_m: 4.0,
        time_s: 0.4,
        occupied_s: 0.02,
        queue_m: if step < 150 { 30.0 } else { 0.0 },
        ..Moves::default()
    };
    if step.is_multiple_of(25) {
        moves.passages = Passages {
            by_class: [0, 1, 0, 0, 0, 0],
            speeds_m_s: 10.0,
            headways: 1,
            headways_s: 5.0,
            headways_s2: 25.0,
        };
    }
    let mut all = LaneMoves::default();
    all[0] = moves;
    all
}

fn windows(steps: u32, min_completeness: f32) -> Windows<1> {
    let mut windows = Windows::new(&[MINUTE], FIFTH * 2, min_completeness);
    windows.set_errors(Some(0.02), None, false);
    for step in 0..steps {
        windows.add(UtcMs(60_000 + 200 * i64::from(step)), &moves(step));
    }
    windows
}

fn lane(windows: &Windows<1>, density: Option<f32>) -> LaneReport {
    let mut report = report(density);
    windows.complete(&mut report);
    report.lanes[0].clone()
}

#[test]
fn flow_is_density_times_speed() {
    let lane = lane(&windows(300, 0.75), Some(19.0));
    let traffic = lane.traffic.expect("followed");
    let near = |found: Option<f32>, expected: f32| {
        let found = found.expect("known");
        assert!((found - expected).abs() < 1e-3 * expected.max(1.0), "{found} for {expected}");
    };
    near(traffic.flow_veh_h, 720.0);
    near(traffic.speed_kmh, 36.0);
    near(lane.density_veh_km, 20.0);
    near(traffic.time_occupancy, 0.1);
    near(traffic.density_difference, -1.0);
    near(traffic.queue_m, 15.0);
    near(traffic.queue_max_m, 30.0);
    // Everything that follows from the density changes with it.
    near(lane.vehicles_mean, 2.0);
    near(lane.by_class.map(|means| means[1]), 2.0);
    let section = traffic.section.expect("known");
    assert_eq!(section.by_class[1], 12);
    near(Some(section.flow_veh_h), 720.0);
    near(section.speed_time_mean_kmh, 36.0);
    near(section.headway_s, 5.0);
    assert!(section.headway_sd_s.expect("twelve of them") < 0.01);
    // A tenth of counting, which weighs most; two hundredths of length, with those of places.
    let [low, high] = traffic.flow_ci90.expect("all is known");
    assert!((high - low - 2.0 * 1.645 * 73.0).abs() < 2.0, "{low} to {high}");
    let [low, high] = traffic.speed_ci90.expect("all is known");
    assert!((high - low - 2.0 * 1.645 * 0.84).abs() < 0.01, "{low} to {high}");
    let error = lane.error.expect("kept");
    assert!((error.ci90[0] + error.ci90[1] - 40.0).abs() < 1e-3, "about the density");
    assert_eq!(lane.density_se, Some(0.0), "no sampling");
    let half = 1.645 * libm::hypotf(0.1 * 20.0, 0.02 * 20.0);
    assert!((error.ci90[1] - 20.0 - half).abs() < 1e-3, "counting and length");
}

#[test]
fn what_was_not_seen_of_a_window_is_sampled() {
    let mut lane = report(Some(20.0)).lanes[0].clone();
    lane.frames_used = 75;
    follow(&mut lane, 20.0);
    // Three quarters were not seen.
    let sampling = 2.0 * libm::sqrtf(0.75);
    assert!((lane.density_se.expect("known") - sampling).abs() < 1e-4);
    let half = 1.645 * libm::sqrtf(0.4 * 0.4 + 2.0 * 2.0 + sampling * sampling);
    assert!((lane.error.expect("kept").ci90[1] - 20.0 - half).abs() < 1e-3);
}

#[test]
fn what_stands_in_an_empty_road_is_no_error_of_a_flow() {
    let mut windows = windows(300, 0.75);
    windows.set_errors(Some(0.02), Some(0.05), false);
    let traffic = lane(&windows, Some(20.0)).traffic.expect("followed");
    let [low, high] = traffic.flow_ci90.expect("all is known");
    // A twentieth of the vehicles, where the density has a tenth; a fifth of one in a minute.
    let expected = libm::hypotf(36.0, 12.0);
    assert!((high - low - 2.0 * 1.645 * expected).abs() < 1.0, "{low} to {high}");
}

#[test]
fn time_unseen_makes_a_speed_less_sure() {
    let half = |unseen_s: f32| {
        let mut windows = windows(299, 0.75);
        let mut last = moves(299);
        last[0].unseen_s = unseen_s;
        windows.add(UtcMs(60_000 + 200 * 299), &last);
        let [low, high] = lane(&windows, Some(20.0)).traffic.expect("followed").speed_ci90?;
        Some((high - low) / 2.0)
    };
    let (none, some) = (half(0.0).expect("known"), half(24.0).expect("known"));
    // A fifth of the time that both spent.
    let expected = libm::hypotf(none, 36.0 * 1.645 * UNSEEN_REL_ERR / 5.0);
    assert!((some - expected).abs() < 0.02, "{none}, {some} for {expected}");
}

#[test]
fn too_little_is_not_guessed_from() {
    let status = |lane: LaneReport| {
        let traffic = lane.traffic.expect("followed");
        let LaneTraffic { status, ref flow_veh_h, ref speed_kmh, .. } = traffic;
        assert_eq!((*flow_veh_h, *speed_kmh), (None, None));
        assert_ne!(status, SampleZoneStatus::Ok);
        status
    };
    let integrity = SampleZoneStatus::InputDataIntegrity;
    assert_eq!(status(lane(&windows(200, 0.75), Some(20.0))), integrity, "two thirds observed");
    assert_eq!(status(lane(&windows(300, 0.75), None)), integrity, "no density");
    assert_eq!(status(lane(&windows(0, 0.0), Some(20.0))), integrity, "no picture");
    // The two densities say different things.
    let two = lane(&windows(300, 0.75), Some(40.0));
    assert_eq!(two.density_veh_km, Some(40.0), "the mean of pictures stays");
    assert_eq!(status(two), integrity);
}

#[test]
fn another_window_begins_at_nothing() {
    let mut windows = windows(300, 0.75);
    windows.add(UtcMs(120_000), &moves(0));
    assert!(lane(&windows, Some(20.0)).traffic.expect("followed").flow_veh_h.is_none());
}

#[test]
fn an_empty_road_has_a_flow_and_no_speed() {
    let mut windows = Windows::<1>::new(&[MINUTE], FIFTH, 0.75);
    windows.set_errors(Some(0.02), None, false);
    for step in 0..300 {
        let mut all = LaneMoves::default();
        all.iter_mut().for_each(|moves| moves.observed_s = 0.2);
        windows.add(UtcMs(60_000 + 200 * step), &all);
    }
    let traffic = lane(&windows, Some(0.0)).traffic.expect("followed");
    assert_eq!((traffic.flow_veh_h, traffic.speed_kmh), (Some(0.0), None));
    assert_eq!(traffic.time_occupancy, Some(0.0));
    assert!(traffic.flow_ci90.is_some_and(|[low, high]| low == 0.0 && high > 10.0));
}

#[test]
fn where_a_site_corrects_its_counts_flow_follows_density() {
    let mut windows = windows(300, 0.75);
    windows.set_errors(Some(0.02), None, true);
    let lane = lane(&windows, Some(24.0));
    let traffic = lane.traffic.expect("followed");
    assert_eq!(lane.density_veh_km, Some(24.0));
    let (flow, speed) = (traffic.flow_veh_h.expect("known"), traffic.speed_kmh.expect("known"));
    assert!((flow - 24.0 * speed).abs() < 0.1, "{flow} {speed}");
}
