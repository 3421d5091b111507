//! Motion of a lane's vehicles between two pictures, and its sums.

use crate::units::VehicleClass;

/// Vehicles that passed the section.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Passages {
    /// By class, in the order of [`VehicleClass::ALL`].
    pub by_class: [u16; VehicleClass::COUNT],
    /// Sum of their speeds there, m/s.
    pub speeds_m_s: f32,
    /// Times from one to the next that are known, their sum in s and that of their squares in s².
    pub headways: u16,
    /// Their sum, s.
    pub headways_s: f32,
    /// The sum of their squares, s².
    pub headways_s2: f32,
}

impl Passages {
    /// All of them.
    pub fn count(&self) -> u32 {
        self.by_class.iter().map(|&n| u32::from(n)).sum()
    }

    pub(super) fn add(&mut self, class: VehicleClass, speed_m_s: f32, headway_s: Option<f32>) {
        if let Some(n) = self.by_class.get_mut(class.index()) {
            *n = n.saturating_add(1);
        }
        self.speeds_m_s += speed_m_s;
        if let Some(headway_s) = headway_s {
            self.headways = self.headways.saturating_add(1);
            self.headways_s += headway_s;
            self.headways_s2 += headway_s * headway_s;
        }
    }
}

/// Motion of a lane's vehicles from one picture to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moves {
    /// Time between the two, s.
    pub observed_s: f32,
    /// Distance covered by all, m.
    pub distance_m: f32,
    /// Time spent on the lane by all, s.
    pub time_s: f32,
    /// Time for which a vehicle covered the section, s.
    pub occupied_s: f32,
    /// Sum of the squares of distances over which a vehicle was not seen, m².
    pub bridged_m2: f32,
    /// Sum of the variances of the places at which vehicles came into being and left, m².
    pub place_m2: f32,
    /// Part of the time spent in which a vehicle was not seen, and time unseen of those that were
    /// given up, which is no part of it, s.
    pub unseen_s: f32,
    /// Who passed the section.
    pub passages: Passages,
    /// Length of the longest queue at the end, m.
    pub queue_m: f32,
    /// Sightings for which there was no room.
    pub lost: u16,
}

impl Moves {
    pub(super) fn add(&mut self, distance_m: f32, time_s: f32, occupied_s: f32) {
        self.distance_m += distance_m;
        self.time_s += time_s;
        self.occupied_s += occupied_s;
    }
}
