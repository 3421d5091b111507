//! Traffic: flow, speed and occupancy of a lane over a window, from what its vehicles have covered.
//!
//! Owns the estimators and their intervals. Does not follow vehicles (`track`), and leaves the life
//! of windows to `density`, whose report it completes ([`Windows::complete`]).
//!
//! Flow q, density k and space-mean speed v are Edie's (Discussion of traffic stream measurements
//! and definitions, 1963; Cassidy and Coifman, Transportation Research Record 1591, 1997, has them
//! for cameras): over the rectangle of a lane of length L and an observed time T, in which vehicles
//! cover the distance D and spend the time t, q = D / (L T), k = t / (L T), v = D / t, so that
//! q = k v. At the section, the middle of the lane where nothing else is set, stand the count, the
//! time-mean speed of those that pass, their headways and the time occupancy.

mod sums;

pub use crate::report::{LaneTraffic, Section};
pub use sums::Sums;

use crate::report::{LaneReport, SampleZoneStatus, WindowReport};
use crate::track::LaneMoves;
use crate::units::{LaneId, MAX_LANES, UtcMs};
use core::time::Duration;

/// Standard errors to each side of the mean that hold 90 % of a normal distribution.
const Z90: f32 = 1.645;
/// One standard error of the length that vehicles of one class are taken to have, as a part.
const LENGTH_REL_ERR: f32 = 0.06;
/// One standard error of a speed from where vehicles meet the road, as a part: a bumper that is
/// taken for the road beneath it seems further off, and a lane's ends lie half a vehicle off, which
/// counts where speed changes towards them. With true boxes of the simulated street lanes were 0.5
/// to 1.8 % off (seed 2001).
const PLACE_REL_ERR: f32 = 0.012;
/// One standard error of the time for which vehicles are not seen, as a part of it: where they are
/// hidden in a queue the minutes of seed 2001 in rain held the true speed in nine of ten with it.
const UNSEEN_REL_ERR: f32 = 0.4;
/// One standard error of a window's vehicles from its ends, where their distance is cut: a vehicle
/// counts late, and from where it came in.
const CUT_VEHICLES: f32 = 0.2;
/// The density by Edie's definition and the mean of pictures may differ by this part, and by so
/// many veh/km beside; else neither is trusted to give flow.
const DIFFERENCE: (f32, f32) = (0.3, 3.0);

#[derive(Clone, Debug)]
struct Window {
    length: Duration,
    from: Option<UtcMs>,
    sums: [Sums; MAX_LANES],
}

/// The sums of the windows that run.
#[derive(Clone, Debug)]
pub struct Windows<const W: usize> {
    windows: heapless::Vec<Window, W>,
    longest: Duration,
    min_completeness: f32,
    length_rel_err: Option<f32>,
    count_rel_err: Option<f32>,
    is_corrected: bool,
}

impl<const W: usize> Windows<W> {
    /// Windows of these lengths, as many as there is room for, for pictures at most `longest` apart.
    /// A window that observed less than `min_completeness` (0 to 1) of its time reports nothing.
    pub fn new(lengths: &[Duration], longest: Duration, min_completeness: f32) -> Self {
        let window = |&length| Window { length, from: None, sums: Default::default() };
        let windows = lengths.iter().take(W).map(window).collect();
        Self {
            windows,
            longest,
            min_completeness,
            length_rel_err: None,
            count_rel_err: None,
            is_corrected: false,
        }
    }

    /// From now on reports have an interval from these errors of lengths and of how many of the
    /// vehicles that drive are counted (one standard error, as a part); where the latter is not known,
    /// as the density has it. Where a site's correction multiplies its counts, flow follows density,
    /// else density follows flow.
    pub fn set_errors(
        &mut self,
        length_rel_err: Option<f32>,
        count_rel_err: Option<f32>,
        is_corrected: bool,
    ) {
        (self.length_rel_err, self.count_rel_err) = (length_rel_err, count_rel_err);
        self.is_corrected = is_corrected;
    }

    /// Adds what vehicles have covered up to the picture of that time.
    pub fn add(&mut self, time: UtcMs, moves: &LaneMoves) {
        for window in &mut self.windows {
            let from = time.floor_to(window.length);
            if window.from.replace(from) != Some(from) {
                window.sums = Default::default();
            }
            for (sums, moves) in window.sums.iter_mut().zip(moves) {
                sums.add(moves);
            }
        }
    }

    /// Adds traffic to the report of a window that has closed.
    pub fn complete(&self, report: &mut WindowReport) {
        let length = report.to.saturating_since(report.from);
        let window = self
            .windows
            .iter()
            .find(|window| window.length == length && window.from == Some(report.from));
        for lane in &mut report.lanes {
            let none = Sums::default();
            let sums = window.and_then(|window| window.sums.get(index(lane.lane)));
            let traffic = self.of(sums.unwrap_or(&none), length, lane);
            if let Some((traffic, density)) = traffic {
                if !self.is_corrected {
                    follow(lane, density);
                }
                lane.traffic = Some(traffic);
            } else {
                let status = match lane.status {
                    SampleZoneStatus::Ok => SampleZoneStatus::InputDataIntegrity,
                    fault => fault,
                };
                lane.traffic = Some(LaneTraffic { status, ..LaneTraffic::default() });
            }
        }
    }

    /// The report of a lane's traffic, and its density by Edie's definition.
    fn of(&self, sums: &Sums, length: Duration, lane: &LaneReport) -> Option<(LaneTraffic, f32)> {
        let by_pictures = lane.density_veh_km?;
        let (observed_s, length_m) = (sums.observed_s, lane.length_m);
        let enough = observed_s > 0.0
            && observed_s >= self.min_completeness * length.as_secs_f32()
            && sums.interval_s() <= 1.1 * self.longest.as_secs_f32();
        if !enough || sums.lost > 0 {
            return None;
        }
        let area = length_m * observed_s;
        let by_edie = sums.time_s.max(0.0) / area * 1000.0;
        // A site's factor applies to one and not to the other; it is not a difference between them.
        let difference = if self.is_corrected { 0.0 } else { by_pictures - by_edie };
        let (part, beside) = DIFFERENCE;
        if difference.abs() > part * by_pictures.max(by_edie) + beside {
            return None;
        }
        let factor = if self.is_corrected && by_edie > 0.0 { by_pictures / by_edie } else { 1.0 };
        let flow = sums.distance_m.max(0.0) / area * 3600.0 * factor;
        let speed = (sums.time_s > 0.0).then(|| sums.distance_m.max(0.0) / sums.time_s * 3.6);
        let occupancy = (sums.occupied_s / observed_s * factor).clamp(0.0, 1.0);
        // Vehicles not found and found twice, as a part, as for the density.
        let counting = lane
            .error
            .map(|error| if by_pictures > 0.0 { error.counting / by_pictures } else { 0.0 });
        let interval = |value: f32, se: f32| [(value - Z90 * se).max(0.0), value + Z90 * se];
        let bridged = libm::sqrtf(sums.bridged_m2) / area * 3600.0;
        let cut = CUT_VEHICLES * 3600.0 / observed_s;
        let flow_se = |counting: f32| {
            let counting = self.count_rel_err.unwrap_or(counting);
            libm::hypotf(libm::hypotf(flow * counting, bridged), cut)
        };
        let place = libm::sqrtf(sums.bridged_m2 + sums.place_m2) / sums.distance_m.max(length_m);
        // Who is seen again has covered a known distance; for how long one that is not was on the
        // lane is known less well.
        let unseen = UNSEEN_REL_ERR * sums.unseen_s / sums.time_s.max(f32::EPSILON);
        let places = libm::hypotf(libm::hypotf(place, PLACE_REL_ERR), unseen);
        let speed_se = |calibration: f32, speed: f32| speed * libm::hypotf(calibration, places);
        let occupancy_se = |counting: f32| {
            libm::hypotf(occupancy * libm::hypotf(counting, LENGTH_REL_ERR), 0.5 / observed_s)
        };
        let traffic = LaneTraffic {
            status: SampleZoneStatus::Ok,
            flow_veh_h: Some(flow),
            flow_ci90: counting.map(|counting| interval(flow, flow_se(counting))),
            speed_kmh: speed,
            speed_ci90: speed
                .zip(self.length_rel_err)
                .map(|(speed, calibration)| interval(speed, speed_se(calibration, speed))),
            time_occupancy: Some(occupancy),
            time_occupancy_ci90: counting.map(|counting| {
                interval(occupancy, occupancy_se(counting)).map(|end| end.min(1.0))
            }),
            section: Some(sums.section()),
            queue_m: Some(sums.queue_m_s / observed_s),
            queue_max_m: Some(sums.queue_max_m),
            density_difference: Some(difference),
        };
        Some((traffic, by_edie))
    }
}

fn index(lane: LaneId) -> usize {
    usize::from(lane.get()) - 1
}

/// Sets a lane's density, in place of the mean of pictures, and all values that follow from it.
fn follow(lane: &mut LaneReport, density: f32) {
    let Some(before) = lane.density_veh_km.filter(|&before| before > 0.0) else { return };
    let factor = density / before;
    let scale = |value: &mut f32| *value *= factor;
    for value in [&mut lane.density_veh_km, &mut lane.vehicles_mean] {
        value.iter_mut().for_each(scale);
    }
    // What was followed is not sampled: the rest of the window is (correction for a finite population,
    // Cochran, Sampling Techniques, 1977, section 2.6).
    let seen = lane.frames_used as f32 / lane.frames_expected.max(1) as f32;
    let sampling = factor * libm::sqrtf((1.0 - seen).max(0.0));
    lane.density_se.iter_mut().for_each(|error| *error *= sampling);
    lane.by_class.iter_mut().flatten().for_each(scale);
    if let Some(occupancy) = &mut lane.space_occupancy {
        *occupancy = (*occupancy * factor).min(1.0);
    }
    if let Some(densities) = lane.cells.as_mut().and_then(|cells| cells.density_veh_km.as_mut()) {
        densities.iter_mut().for_each(scale);
    }
    if let Some(error) = &mut lane.error {
        error.calibration *= factor;
        error.counting *= factor;
        let parts = [error.calibration, error.counting, lane.density_se.unwrap_or(0.0)];
        let half = Z90 * libm::sqrtf(parts.iter().map(|part| part * part).sum());
        error.ci90 = [(density - half).max(0.0), density + half];
    }
}

#[cfg(test)]
mod tests;
