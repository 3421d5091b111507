//! The section of a lane: where vehicles are counted, and for how long one of them covers it.
//!
//! Owns where a vehicle begins and ends about the point at which it meets the road in the picture.
//! Towards the camera that point is of its front, away from it of its rear: of the bumper's lower edge,
//! which is seen on the road behind it, and at most of the wheels.

use super::vehicle::STANDING_M_S;
use crate::lane::Lane;
use crate::units::{Direction, VehicleClass};

/// Height of a bumper's lower edge over the road, m: cars have 0.15 to 0.2.
const CLEARANCE_M: f32 = 0.18;
/// From a vehicle's end to its wheels, m: 0.7 to 1.0 for cars.
const AXLE_M: f32 = 0.85;
/// The same of a motorcycle, whose wheels are its ends, m.
const WHEEL_M: f32 = 0.1;
/// The same as it is seen, m, where nothing tells how steeply.
pub(super) const OVERHANG_M: f32 = 0.6;

/// The section of one lane.
#[derive(Clone, Copy, Debug)]
pub(super) struct Section {
    /// Place along the lane from its upstream end, m.
    pub(super) at_m: f32,
    length_m: f32,
    direction: Direction,
    pub(super) overhang_m: f32,
}

impl Section {
    /// In the middle of a lane, seen at an unknown angle.
    pub(super) const fn of(lane: &Lane) -> Self {
        let &Lane { length_m, direction, .. } = lane;
        Self { at_m: length_m / 2.0, length_m, direction, overhang_m: OVERHANG_M }
    }

    /// Puts it elsewhere, where a pixel's road is `foreshortening` times as long as wide; false where
    /// that is not on the lane.
    pub(super) fn set(&mut self, at_m: f32, foreshortening: Option<f32>) -> bool {
        let is_inside = at_m > 0.0 && at_m < self.length_m;
        if is_inside {
            self.at_m = at_m;
            self.overhang_m = foreshortening.map_or(OVERHANG_M, |ratio| {
                // The ratio is 1 / sin of the angle at which the road is seen; a point over the road
                // hides the road for its height times the cotangent.
                let cotangent = libm::sqrtf((ratio * ratio - 1.0).max(0.0));
                (CLEARANCE_M * cotangent).min(AXLE_M)
            });
        }
        is_inside
    }

    /// Where a vehicle meets the road while it covers the section, from and to, m.
    fn covers(&self, class: VehicleClass) -> [f32; 2] {
        let length_m = class.nominal_length_m();
        let overhang_m = match class {
            VehicleClass::Motorcycle => WHEEL_M,
            _ => self.overhang_m,
        };
        let [low, high] = match self.direction {
            Direction::Away => [overhang_m - length_m, overhang_m],
            Direction::Toward => [-overhang_m, length_m - overhang_m],
            Direction::Unknown => [-length_m / 2.0, length_m / 2.0],
        };
        [self.at_m + low, self.at_m + high]
    }

    /// Time for which a vehicle covers it that goes that way, m, in `time_s`, s.
    pub(super) fn covered(
        &self,
        [from_m, to_m]: [f32; 2],
        time_s: f32,
        class: VehicleClass,
    ) -> f32 {
        let [low, high] = self.covers(class);
        let way_m = (to_m - from_m).abs();
        if way_m < 0.01 {
            return if (low..high).contains(&to_m) { time_s } else { 0.0 };
        }
        let inside = to_m.max(from_m).min(high) - to_m.min(from_m).max(low);
        time_s * inside.max(0.0) / way_m
    }

    /// Time for which a vehicle of that speed, m/s, covers it before it meets the road on the lane.
    pub(super) fn covered_before(&self, speed: f32, class: VehicleClass) -> f32 {
        let [low, high] = self.covers(class);
        (high.min(0.0) - low).max(0.0) / speed.max(STANDING_M_S)
    }

    /// The same after it has left the lane.
    pub(super) fn covered_after(&self, speed: f32, class: VehicleClass) -> f32 {
        let [low, high] = self.covers(class);
        (high - low.max(self.length_m)).max(0.0) / speed.max(STANDING_M_S)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::LaneId;

    fn section(direction: Direction) -> Section {
        let id = LaneId::new(1).expect("in range");
        Section::of(&Lane { id, direction, length_m: 80.0 })
    }

    const CAR: VehicleClass = VehicleClass::Car;

    #[test]
    fn steeply_seen_a_vehicle_meets_the_road_at_its_end() {
        let overhang = |ratio| {
            let mut section = section(Direction::Toward);
            assert!(section.set(40.0, ratio));
            section.overhang_m
        };
        assert!(overhang(Some(1.0)) == 0.0 && overhang(Some(0.7)) == 0.0);
        assert!((overhang(Some(3.0)) - 0.51).abs() < 0.01, "{}", overhang(Some(3.0)));
        assert_eq!([overhang(Some(20.0)), overhang(None)], [AXLE_M, OVERHANG_M]);
    }

    #[test]
    fn a_passing_vehicle_covers_it_for_its_length() {
        for direction in [Direction::Toward, Direction::Away, Direction::Unknown] {
            let section = section(direction);
            let covered = section.covered([0.0, 80.0], 8.0, CAR);
            assert!((covered - 0.46).abs() < 1e-3, "{direction:?}: {covered}");
            assert_eq!(section.covered_before(10.0, CAR) + section.covered_after(10.0, CAR), 0.0);
        }
    }

    #[test]
    fn near_the_lanes_ends_what_is_covered_beyond_them_counts() {
        for (direction, at_m) in [
            (Direction::Toward, 78.0),
            (Direction::Away, 2.0),
            (Direction::Unknown, 1.0),
            (Direction::Unknown, 79.0),
        ] {
            let mut section = section(direction);
            assert!(section.set(at_m, None));
            let inside = section.covered([0.0, 80.0], 8.0, CAR);
            let beyond = section.covered_before(10.0, CAR) + section.covered_after(10.0, CAR);
            assert!(beyond > 0.1, "{direction:?}: {beyond}");
            assert!((inside + beyond - 0.46).abs() < 1e-3, "{direction:?}: {inside} and {beyond}");
        }
    }

    #[test]
    fn it_is_on_the_lane() {
        let mut section = section(Direction::Away);
        assert!(![0.0, 80.0, -1.0, f32::NAN].into_iter().any(|m| section.set(m, None)));
        assert_eq!(section.at_m, 40.0);
    }
}
