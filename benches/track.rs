//! Cost of following vehicles, per picture: `cargo bench --bench track`. Prints the least of twenty
//! rounds, in microseconds, for a street with four lanes of moving traffic and one of four in a
//! jam.

use std::hint::black_box;
use std::time::Instant;
use verge::lane::Lane;
use verge::track::{LaneTracker, Sighting, Sightings};
use verge::units::{Direction, LaneId, VehicleClass};

const ROUNDS: usize = 20;
const PICTURES: u32 = 500;
const LENGTH_M: f32 = 120.0;
/// Time between two pictures, s.
const DT_S: f32 = 0.08;

/// Microseconds a picture of four lanes, with vehicles so far apart that go so fast.
fn picture_us(spacing_m: f32, v_m_s: f32) -> f64 {
    let lane = Lane {
        id: LaneId::new(1).expect("in range"),
        direction: Direction::Away,
        length_m: LENGTH_M,
    };
    let mut least = f64::INFINITY;
    for _ in 0..ROUNDS {
        let mut lanes = [(); 4].map(|()| LaneTracker::new(&lane));
        let begun = Instant::now();
        for picture in 0..PICTURES {
            let first = (picture as f32 * DT_S * v_m_s) % spacing_m;
            for tracker in &mut lanes {
                let mut sightings = Sightings::new();
                let mut s_m = first;
                while s_m < LENGTH_M {
                    let class = VehicleClass::Car;
                    let _ = sightings.push(Sighting { s_m, span_m: 0.3, class });
                    s_m += spacing_m;
                }
                black_box(tracker.observe(DT_S, &mut sightings));
            }
        }
        least = least.min(begun.elapsed().as_secs_f64() * 1e6 / f64::from(PICTURES));
    }
    least
}

fn main() {
    println!("moving, 4 lanes of 4 vehicles: {:.1} us a picture", picture_us(30.0, 15.0));
    println!("jammed, 4 lanes of 17 vehicles: {:.1} us a picture", picture_us(7.0, 1.0));
}
