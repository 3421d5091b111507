//! Counts of one frame, and their sums over the frames of a window.

use super::cells::Division;
use crate::lane::Lane;
use crate::picture::Light;
use crate::report::{Cells, MAX_LANE_CELLS};
use crate::units::{LaneId, MAX_LANES, VehicleClass};

/// Vehicles of one lane in one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct LaneCount {
    pub(super) by_class: [u16; VehicleClass::COUNT],
    /// A cell of 100 m has no room for 255 vehicles.
    by_cell: [u8; MAX_LANE_CELLS],
    occupied_m: f32,
    /// How many of them nobody saw.
    hidden: u16,
}

/// The vehicles of one frame, counted by lane, class and cell. [`super::Aggregator::counts`] makes
/// one that knows the lanes' cells.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameCounts {
    divisions: [Division; MAX_LANES],
    lanes: [LaneCount; MAX_LANES],
    light: Light,
}

impl FrameCounts {
    /// No vehicle yet, in these lanes, in cells of about `cell_m`.
    pub fn new(lanes: &[Lane], cell_m: f32) -> Self {
        Self::of(Division::of_each(lanes, cell_m))
    }

    /// No vehicle yet, in lanes that are divided like this.
    pub(super) fn of(divisions: [Division; MAX_LANES]) -> Self {
        Self { divisions, lanes: Default::default(), light: Light::default() }
    }

    /// The frame was taken in this light.
    pub fn set_light(&mut self, light: Light) {
        self.light = light;
    }

    pub(super) const fn light(&self) -> Light {
        self.light
    }

    pub(super) const fn lanes(&self) -> &[LaneCount; MAX_LANES] {
        &self.lanes
    }

    /// Counts one vehicle that stands `s_m` from the upstream end of its lane.
    pub fn add(&mut self, lane: LaneId, s_m: f32, class: VehicleClass) {
        let index = usize::from(lane.get()) - 1;
        let (lane, division) = (self.lanes.get_mut(index), self.divisions.get(index));
        let (Some(count), Some(division)) = (lane, division) else { return };
        if let Some(n) = count.by_cell.get_mut(division.cell(s_m)) {
            *n = n.saturating_add(1);
        }
        count.occupied_m += class.nominal_length_m();
        if let Some(n) = count.by_class.get_mut(class.index()) {
            *n = n.saturating_add(1);
        }
    }

    /// Counts a vehicle that others hide, of unknown kind ([`crate::hidden`]).
    pub fn add_hidden(&mut self, lane: LaneId, s_m: f32) {
        self.add(lane, s_m, VehicleClass::Vehicle);
        if let Some(count) = self.lanes.get_mut(usize::from(lane.get()) - 1) {
            count.hidden = count.hidden.saturating_add(1);
        }
    }

    /// Vehicles in that lane.
    pub fn vehicles(&self, lane: LaneId) -> u32 {
        let count = self.lanes.get(usize::from(lane.get()) - 1);
        count.map_or(0, |c| c.by_class.iter().map(|&n| u32::from(n)).sum())
    }
}

/// Sums over a window's frames, enough for mean, variance and lag-one correlation.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Series {
    pub(super) n: u32,
    sum: f32,
    sum_squares: f32,
    sum_lag_one: f32,
    first: f32,
    last: f32,
    pub(super) by_class: [f32; VehicleClass::COUNT],
    /// Whole numbers: 16 bits would not hold 15 minutes of a stream's frames.
    by_cell: [u32; MAX_LANE_CELLS],
    pub(super) occupied_m: f32,
    hidden: f32,
}

impl Series {
    pub(super) fn push(&mut self, count: &LaneCount) {
        let x: f32 = count.by_class.iter().map(|&n| f32::from(n)).sum();
        if self.n == 0 {
            self.first = x;
        } else {
            self.sum_lag_one += self.last * x;
        }
        self.n = self.n.saturating_add(1);
        self.sum += x;
        self.sum_squares += x * x;
        self.last = x;
        self.occupied_m += count.occupied_m;
        self.hidden += f32::from(count.hidden);
        for (sum, &n) in self.by_class.iter_mut().zip(&count.by_class) {
            *sum += f32::from(n);
        }
        for (sum, &n) in self.by_cell.iter_mut().zip(&count.by_cell) {
            *sum = sum.saturating_add(u32::from(n));
        }
    }

    /// Mean vehicles per frame; `None` without a frame.
    pub(super) fn mean(&self) -> Option<f32> {
        (self.n > 0).then(|| self.sum / self.n as f32)
    }

    /// The part of the vehicles that nobody saw, 0 to 1.
    pub(super) fn hidden_part(&self) -> f32 {
        if self.sum > 0.0 { self.hidden / self.sum } else { 0.0 }
    }

    /// The density of each cell, its counts times `factor`; `None` where that of the lane is not
    /// known.
    pub(super) fn cells(&self, division: Division, factor: Option<f32>) -> Cells {
        let per_km = 1000.0 / (self.n as f32 * division.cell_m());
        let by_cell = || self.by_cell.iter().take(division.count());
        let density_veh_km =
            factor.map(|factor| by_cell().map(|&sum| sum as f32 * per_km * factor).collect());
        Cells { length_m: division.cell_m(), density_veh_km }
    }

    /// Mean vehicles per frame and its standard error; `None` without a frame.
    ///
    /// The spread is the frames' own plus one pseudo-observation of a Poisson count
    /// (mean + 1/2), so that two equal frames do not claim certainty. Frames close in
    /// time repeat each other: the number of independent ones is n (1-r)/(1+r) for a
    /// lag-one correlation r (Bayley and Hammersley 1946), with r corrected for its small
    /// sample bias of -(1+3r)/n (Kendall 1954). Sampling error only: detection and
    /// calibration have their own.
    pub(super) fn mean_and_error(&self) -> Option<(f32, f32)> {
        if self.n == 0 {
            return None;
        }
        let n = self.n as f32;
        let mean = self.sum / n;
        let squares = (self.sum_squares - n * mean * mean).max(0.0);
        let lagged = self.sum_lag_one - mean * (2.0 * self.sum - self.first - self.last)
            + (n - 1.0) * mean * mean;
        let raw = if squares > 0.0 { lagged / squares } else { 0.0 };
        let most = (n - 1.0) / (n + 1.0);
        let correlation = (raw + (1.0 + 3.0 * raw) / n).max(0.0).min(most);
        let independent = n * (1.0 - correlation) / (1.0 + correlation);
        let variance = (squares + mean + 0.5) / n;
        Some((mean, libm::sqrtf(variance / independent)))
    }
}
