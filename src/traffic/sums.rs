//! The sums of a window over what vehicles have covered, and what follows at the section.

use super::Section;
use crate::track::{Moves, Passages};
use crate::units::VehicleClass;

/// Sums over the pictures of a window, of one lane.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sums {
    pictures: u32,
    /// Time between pictures near enough, s.
    pub(super) observed_s: f32,
    /// Distance covered, m.
    pub(super) distance_m: f32,
    /// Time spent, s.
    pub(super) time_s: f32,
    /// Time for which the section was covered, s.
    pub(super) occupied_s: f32,
    /// As [`Moves`] has them.
    pub(super) bridged_m2: f32,
    pub(super) place_m2: f32,
    pub(super) unseen_s: f32,
    /// The longest queue's length over time, m s, and the most of it, m.
    pub(super) queue_m_s: f32,
    pub(super) queue_max_m: f32,
    pub(super) lost: u32,
    by_class: [u16; VehicleClass::COUNT],
    speeds_m_s: f32,
    headways: u32,
    headways_s: f32,
    headways_s2: f32,
}

impl Sums {
    pub(super) fn add(&mut self, moves: &Moves) {
        let Moves { observed_s, distance_m, time_s, occupied_s, bridged_m2, place_m2, .. } = moves;
        let Moves { unseen_s, passages, queue_m, lost, .. } = moves;
        self.pictures = self.pictures.saturating_add(1);
        self.observed_s += observed_s;
        self.distance_m += distance_m;
        self.time_s += time_s;
        self.occupied_s += occupied_s;
        self.bridged_m2 += bridged_m2;
        self.place_m2 += place_m2;
        self.unseen_s += unseen_s;
        self.queue_m_s += queue_m * observed_s;
        self.queue_max_m = self.queue_max_m.max(*queue_m);
        self.lost = self.lost.saturating_add(u32::from(*lost));
        let Passages { by_class, speeds_m_s, headways, headways_s, headways_s2 } = passages;
        for (sum, n) in self.by_class.iter_mut().zip(by_class) {
            *sum = sum.saturating_add(*n);
        }
        self.speeds_m_s += speeds_m_s;
        self.headways = self.headways.saturating_add(u32::from(*headways));
        self.headways_s += headways_s;
        self.headways_s2 += headways_s2;
    }

    /// Mean time between pictures, s.
    pub(super) fn interval_s(&self) -> f32 {
        self.observed_s / self.pictures.max(1) as f32
    }

    /// Traffic at the section.
    pub(super) fn section(&self) -> Section {
        let vehicles: u32 = self.by_class.iter().map(|&n| u32::from(n)).sum();
        let mean = |sum: f32, n: u32| (n > 0).then(|| sum / n as f32);
        let headway_s = mean(self.headways_s, self.headways);
        let variance = |mean_s: f32| {
            let n = self.headways as f32;
            (self.headways > 1).then(|| (self.headways_s2 - n * mean_s * mean_s) / (n - 1.0))
        };
        Section {
            by_class: self.by_class,
            flow_veh_h: vehicles as f32 / self.observed_s * 3600.0,
            speed_time_mean_kmh: mean(self.speeds_m_s * 3.6, vehicles),
            headway_s,
            headway_sd_s: headway_s.and_then(variance).map(|v| libm::sqrtf(v.max(0.0))),
        }
    }
}
