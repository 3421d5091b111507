//! Traffic: no collisions, jam density at a red light, and flow = density x speed.

mod support;

use street::scene::{Signal, Slowdown};
use street::simulation::Simulation;
use street::truth;

fn lanes_of(street: &mut Simulation) -> Vec<truth::LaneTruth> {
    let moved = street.take_moved();
    truth::lanes(street.measured(), &street.snapshot(), &moved)
}

fn smallest_gap_m(street: &Simulation) -> f64 {
    let mut smallest = f64::INFINITY;
    for lane in street.lanes() {
        let mut rear = f64::INFINITY;
        for vehicle in lane.vehicles() {
            smallest = smallest.min(rear - vehicle.front_m);
            rear = vehicle.front_m - vehicle.model().length_m();
        }
    }
    smallest
}

#[test]
fn nobody_collides_in_stop_and_go_and_at_signals() {
    let mut scene =
        support::tiny(&["fleet.bus=0.05", "fleet.truck=0.1", "measure.min_car_height_px=2.0"]);
    scene.lanes[0].inflow_veh_h = 1900.0;
    scene.lanes[0].slowdown = Some(Slowdown {
        from_m: 20.0,
        to_m: 50.0,
        speed_km_h: 6.0,
        period_s: Some(70.0),
        active_s: 35.0,
    });
    scene.lanes[1].inflow_veh_h = 1900.0;
    scene.lanes[1].signal = Some(Signal { at_m: 90.0, green_s: 25.0, red_s: 30.0, offset_s: 3.0 });
    for seed in 0..4 {
        let mut street = Simulation::new(&scene, seed).expect("a street");
        let mut smallest = f64::INFINITY;
        for _ in 0..6000 {
            street.step(0.1);
            smallest = smallest.min(smallest_gap_m(&street));
        }
        assert!(smallest > 0.3, "seed {seed}: gap of {smallest:.2} m");
        assert!(street.lanes().iter().all(|lane| lane.departed() > 50), "seed {seed}");
    }
}

#[test]
fn a_long_red_fills_the_lane_to_jam_density() {
    let mut scene = support::tiny(&["fleet.van=0.0", "fleet.motorcycle=0.0"]);
    scene.lanes[1].signal =
        Some(Signal { at_m: 140.0, green_s: 1.0, red_s: 3000.0, offset_s: -50.0 });
    scene.lanes[1].inflow_veh_h = 1200.0;
    let mut street = Simulation::new(&scene, 9).expect("a street");
    street.step(240.0);
    let state = &lanes_of(&mut street)[1];
    // Cars of 4.73 to 4.89 m with jam gaps about 2 m: 145 veh/km; a stretch of some 50 m
    // quantises that to one vehicle in seven.
    assert!((125.0..=165.0).contains(&state.density_veh_km), "{state:?}");
    assert!(state.speed_km_h.expect("vehicles stand there") < 0.5, "{state:?}");
    // Nobody stands beyond the line.
    let beyond = street.lanes()[1].vehicles().filter(|v| v.front_m > 140.0 && v.speed_m_s < 1.0);
    assert_eq!(beyond.count(), 0);
}

#[test]
fn a_section_before_the_stop_line_is_covered_all_red() {
    let mut scene = support::tiny(&["fleet.van=0.0", "fleet.motorcycle=0.0"]);
    let stretch = Simulation::new(&scene, 9).expect("a street").measured()[0].clone();
    let at_m = stretch.near_m + 10.0;
    scene.lanes[0].signal = Some(Signal { at_m, green_s: 1.0, red_s: 3000.0, offset_s: -60.0 });
    let mut covered_s = |upstream_m: f64| {
        scene.lanes[0].section_m = Some(stretch.far_m - at_m - upstream_m);
        let mut street = Simulation::new(&scene, 9).expect("a street");
        street.step(100.0);
        street.take_moved()[0].occupied_s
    };
    assert!((covered_s(2.0) - 100.0).abs() < 1e-6, "a car stands on it");
    assert!(covered_s(-2.0) < 1e-6, "nobody has passed the line");
}

#[test]
fn in_steady_state_the_flow_counted_is_density_times_speed() {
    for (inflow, seed) in [(500.0, 1), (1100.0, 2)] {
        let mut scene = support::tiny(&["warmup_s=120.0"]);
        for lane in &mut scene.lanes {
            lane.inflow_veh_h = inflow;
        }
        let mut street = Simulation::new(&scene, seed).expect("a street");
        let before: Vec<u64> = street.lanes().iter().map(|lane| lane.departed()).collect();
        let (mut flow, mut by_edie, mut occupied_s) = ([0.0; 2], [0.0; 2], [0.0; 2]);
        let mut passed = [0; 2];
        let seconds = 3600;
        for _ in 0..seconds {
            street.step(1.0);
            for state in lanes_of(&mut street) {
                flow[state.lane - 1] += state.flow_veh_h / f64::from(seconds);
                let edie = state.distance_m / state.length_m * 3600.0;
                by_edie[state.lane - 1] += edie / f64::from(seconds);
                passed[state.lane - 1] += state.passed;
                occupied_s[state.lane - 1] += state.occupied_s;
            }
        }
        for lane in 0..2 {
            let counted = (street.lanes()[lane].departed() - before[lane]) as f64;
            let error = flow[lane] / counted - 1.0;
            assert!(error.abs() < 0.03, "lane {lane}: k v {:.1}, counted {counted}", flow[lane]);
            // Counted and by what was covered; the lane's end and its stretch are seconds apart.
            for flow in [by_edie[lane], f64::from(passed[lane])] {
                assert!((flow / counted - 1.0).abs() < 0.015, "lane {lane}: {flow}, {counted}");
            }
            // Cars and vans of 4.7 to 5.3 m at 50 km/h cover a point for a third of a second.
            let each_s = occupied_s[lane] / f64::from(passed[lane]);
            assert!((0.3..0.45).contains(&each_s), "lane {lane}: {each_s} s");
            // Demand of one hour: shifted-exponential headways spread the count by some 3 %.
            assert!((counted / inflow - 1.0).abs() < 0.12, "counted {counted}, demand {inflow}");
        }
    }
}

#[test]
fn seeds_repeat_and_differ() {
    let scene = support::tiny(&[]);
    let run = |seed| {
        let mut street = Simulation::new(&scene, seed).expect("a street");
        street.step(30.0);
        let places: Vec<_> = street.snapshot().vehicles.iter().map(|v| (v.id, v.centre)).collect();
        places
    };
    assert_eq!(run(3), run(3));
    assert_ne!(run(3), run(4));
}
