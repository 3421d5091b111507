//! How many pictures a second following vehicles needs, from the length of a lane.
//!
//! Owns the rule. A vehicle at the highest speed must be in [`PICTURES`] pictures while it is on the
//! lane, and on it for long enough to count; two pictures may not be further apart than the shortest
//! time between two vehicles.

use super::CONFIRM_S;
use crate::lane::Lane;
use core::time::Duration;

/// Pictures in which the fastest vehicle must be: three to know it, one that may miss it.
pub const PICTURES: f32 = 4.0;
/// Longest time between two pictures, s: half of the time in which drivers follow each other, so
/// that no vehicle is where the one before it was.
pub const LONGEST_S: f32 = 0.5;
/// Shortest time between two pictures that is of use, s.
pub const SHORTEST_S: f32 = 0.04;
/// Highest speed that a lane is judged by where no other is given, km/h.
pub const DEFAULT_TOP_KMH: f32 = 130.0;

/// The longest time between two pictures with which vehicles of up to `top_kmh` are followed on
/// every one of these lanes; `None` where a lane is so short that 25 a second are too few.
pub fn longest_interval(lanes: &[Lane], top_kmh: f32) -> Option<Duration> {
    let shortest = lanes.iter().map(|lane| lane.length_m).fold(f32::INFINITY, f32::min);
    let on_lane_s = shortest / (top_kmh / 3.6);
    // The first picture of it may be late, and the one in which it counts.
    let counts = (on_lane_s - CONFIRM_S) / 2.0;
    let seconds = (on_lane_s / PICTURES).min(counts);
    // Written so that what is not a number is too short.
    if seconds >= SHORTEST_S {
        Duration::try_from_secs_f32(if seconds > LONGEST_S { LONGEST_S } else { seconds }).ok()
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::{Direction, LaneId};

    fn needed(lengths: &[f32], top_kmh: f32) -> Option<f32> {
        let lane = |(number, &length_m)| Lane {
            id: LaneId::new(number).expect("in range"),
            direction: Direction::Away,
            length_m,
        };
        let lanes: std::vec::Vec<_> = (1..).zip(lengths).map(lane).collect();
        longest_interval(&lanes, top_kmh).map(|interval| interval.as_secs_f32())
    }

    #[test]
    fn the_shortest_lane_and_the_top_speed_decide() {
        assert_eq!(needed(&[500.0], 130.0), Some(LONGEST_S));
        let s = needed(&[500.0, 36.0], 129.6).expect("long enough");
        assert!((s - 0.25).abs() < 1e-3, "{s}");
        assert_eq!(needed(&[5.0], 130.0), None, "too short to follow anything");
        let s = needed(&[27.0], 129.6).expect("long enough");
        assert!((s - 0.125).abs() < 1e-3, "{s}: half of the 0.25 s in which it may count");
        assert_eq!(needed(&[18.0], 129.6), None, "gone before it counts");
        assert_eq!(needed(&[50.0], f32::NAN), None);
    }
}
