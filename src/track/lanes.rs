//! All lanes of a table, from one picture to the next.
//!
//! Owns what happens where pictures are too far apart: what was followed is forgotten, and the time
//! between them counts as not observed.

use super::{LaneTracker, Moves, Sighting, Sightings, rate};
use crate::lane::Lane;
use crate::units::{LaneId, MAX_LANES, UtcMs, millis};
use core::time::Duration;

/// Motion of each lane's vehicles, at the index of the lane's number.
pub type LaneMoves = [Moves; MAX_LANES];

/// Longest gap between pictures over which vehicles are followed, as a multiple of the longest
/// interval: one picture may be missing.
const GAP: f64 = 2.1;

/// Follows the vehicles on the lanes of a table.
#[derive(Clone, Debug)]
pub struct Tracker {
    lanes: heapless::Vec<(LaneId, LaneTracker), MAX_LANES>,
    sightings: [Sightings; MAX_LANES],
    longest: Duration,
    latest: Option<UtcMs>,
}

impl Tracker {
    /// Empty lanes; `None` where they are too short to follow vehicles of up to `top_kmh`.
    pub fn new(lanes: &heapless::Vec<Lane, MAX_LANES>, top_kmh: f32) -> Option<Self> {
        let longest = rate::longest_interval(lanes, top_kmh)?;
        let lanes = lanes.iter().map(|lane| (lane.id, LaneTracker::new(lane))).collect();
        Some(Self { lanes, sightings: Default::default(), longest, latest: None })
    }

    /// From now on vehicles of that lane are counted so far from its upstream end, m, as
    /// [`LaneTracker::set_section`] does; false where there is no such lane or place.
    #[must_use]
    pub fn set_section(
        &mut self,
        lane: LaneId,
        section_m: f32,
        foreshortening: Option<f32>,
    ) -> bool {
        let known = self.lanes.iter_mut().find(|(id, _)| *id == lane);
        known.is_some_and(|(_, tracker)| tracker.set_section(section_m, foreshortening))
    }

    /// Where vehicles of that lane are counted, from its upstream end, m.
    pub fn section_m(&self, lane: LaneId) -> Option<f32> {
        let known = self.lanes.iter().find(|(id, _)| *id == lane);
        known.map(|(_, tracker)| tracker.section_m())
    }

    /// How far from its end a vehicle meets the road at the section of that lane, m.
    #[cfg(test)]
    pub fn overhang_m(&self, lane: LaneId) -> Option<f32> {
        let known = self.lanes.iter().find(|(id, _)| *id == lane);
        known.map(|(_, tracker)| tracker.section.overhang_m)
    }

    /// The longest time between two pictures with which it follows vehicles.
    pub const fn longest_interval(&self) -> Duration {
        self.longest
    }

    /// A vehicle of the picture that [`Self::observe`] will take. One for which there is no room is
    /// left out: [`super::MAX_SIGHTINGS`] are more than fit a lane.
    pub fn see(&mut self, lane: LaneId, sighting: Sighting) {
        if let Some(sightings) = self.sightings.get_mut(usize::from(lane.get()) - 1) {
            let _ = sightings.push(sighting);
        }
    }

    /// Takes the picture of that time, with the vehicles seen in it. `None` where it follows none
    /// that was near enough.
    pub fn observe(&mut self, time: UtcMs) -> Option<LaneMoves> {
        let gap_ms = self.latest.replace(time).map(|latest| time.0.saturating_sub(latest.0));
        let most_ms = millis(self.longest.mul_f64(GAP));
        let dt = gap_ms.filter(|ms| (1..=most_ms).contains(ms)).map(|ms| ms as f32 / 1000.0);
        let mut all = LaneMoves::default();
        for (id, tracker) in &mut self.lanes {
            let index = usize::from(id.get()) - 1;
            let (Some(sightings), Some(moves)) =
                (self.sightings.get_mut(index), all.get_mut(index))
            else {
                continue;
            };
            if dt.is_none() {
                tracker.forget();
            }
            *moves = tracker.observe(dt.unwrap_or(0.0), sightings);
            sightings.clear();
        }
        dt.map(|_| all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::{Direction, VehicleClass};

    #[test]
    fn a_gap_and_a_clock_that_is_set_back_are_not_bridged() {
        let id = LaneId::new(2).expect("in range");
        let lane = Lane { id, direction: Direction::Away, length_m: 100.0 };
        let lanes = heapless::Vec::from_slice(&[lane]).expect("room for one");
        let mut tracker = Tracker::new(&lanes, 130.0).expect("long enough");
        let mut at = |ms: i64, s_m: f32| {
            tracker.see(id, Sighting { s_m, span_m: 0.1, class: VehicleClass::Car });
            tracker.observe(UtcMs(ms))
        };
        assert_eq!(at(1000, 10.0), None, "the first picture");
        assert!((1..=4).all(|n| at(1000 + 200 * n, 10.0 + 2.0 * n as f32).is_some()));
        let moved = at(2000, 20.0).expect("followed")[1];
        assert!((moved.distance_m - 2.0).abs() < 0.2, "{moved:?}");
        assert_eq!(at(9000, 90.0), None, "a gap");
        assert_eq!(at(8000, 92.0), None, "the clock was set back");
        assert!(at(8200, 94.0).expect("followed")[1].distance_m == 0.0, "not known yet");
    }
}
