//! The core's values as the messages of `verge_messages`: a window with who measured it.
//!
//! Owns the step from the core's types to those that leave the box, for the daemon, which
//! writes them, and for the centre, which reads the compact form. Every `match` names all
//! there is and every type is taken apart, so that what is added in the core is not forgotten.

use crate::density::WindowReport;
use crate::density::{Cells, LaneReport, MAX_LANE_CELLS, MAX_WINDOW_S, MIN_WINDOW_S};
use crate::lane::MAX_NAME;
use crate::traffic::{LaneTraffic, Section};
use crate::units::{Direction, MAX_LANES, UtcMs, VehicleClass};
use crate::wire::{CalibrationRef, DensityMessage, ModelRef, hex};
use verge_messages as messages;
use verge_messages::rounded;

// The check of messages and the core have the same limits.
const _: () = assert!(MAX_LANES == messages::MOST_LANES as usize);
const _: () = assert!(MAX_LANE_CELLS == messages::MOST_CELLS);
const _: () = assert!(MIN_WINDOW_S == messages::SHORTEST_WINDOW_S as u64);
const _: () = assert!(MAX_WINDOW_S == messages::LONGEST_WINDOW_S as u64);
const _: () = assert!(MAX_NAME == messages::LONGEST_NAME);

/// One window of one site. `done` is in replayed windows alone: whether this is the last of its
/// length that was waiting.
pub fn density(message: &DensityMessage, done: Option<bool>) -> messages::Density {
    let DensityMessage { site, seq, clock_synced, report, calibration, model } = message;
    let WindowReport { from, to, lanes } = report;
    let CalibrationRef { id, sha256, rel_err } = calibration;
    let ModelRef { name, sha256: model_sha256 } = model;
    messages::Density {
        schema: messages::Schema::default(),
        site: site.as_str().to_owned(),
        // The box's configuration says where it is, not what is measured.
        place: None,
        seq: *seq,
        window_s: u32::try_from(to.saturating_since(*from).as_secs()).unwrap_or(u32::MAX),
        from: (*from).into(),
        to: (*to).into(),
        clock_synced: *clock_synced,
        lanes: lanes.iter().map(lane).collect(),
        calibration: messages::Calibration {
            id: id.as_str().to_owned(),
            sha256: hex(sha256).as_str().to_owned(),
            rel_err: *rel_err,
        },
        model: messages::Model {
            name: name.as_str().to_owned(),
            sha256: hex(model_sha256).as_str().to_owned(),
        },
        done,
    }
}

fn lane(report: &LaneReport) -> messages::Lane {
    let LaneReport { lane, direction, density_veh_km, density_se, vehicles_mean, .. } = report;
    let LaneReport { by_class, space_occupancy, length_m, frames_used, .. } = report;
    let LaneReport { frames_expected, status, cells, error, traffic: moving, .. } = report;
    messages::Lane {
        lane: lane.get(),
        lane_name: None,
        lane_order: None,
        direction: (*direction).into(),
        density_veh_km: density_veh_km.map(rounded),
        density_se: density_se.map(rounded),
        vehicles_mean: vehicles_mean.map(rounded),
        by_class: by_class.as_ref().map(of_classes),
        space_occupancy: space_occupancy.map(rounded),
        length_m: rounded(*length_m),
        frames_used: *frames_used,
        frames_expected: *frames_expected,
        status: *status,
        cells: cells.as_ref().map(|Cells { length_m, density_veh_km }| messages::Cells {
            length_m: rounded(*length_m),
            density_veh_km: density_veh_km
                .as_ref()
                .map(|densities| densities.iter().copied().map(rounded).collect()),
        }),
        density_ci90: error.map(|error| error.ci90.map(rounded)),
        calibration_se: error.map(|error| rounded(error.calibration)),
        counting_se: error.map(|error| rounded(error.counting)),
        traffic: moving.as_ref().map(traffic),
    }
}

fn traffic(traffic: &LaneTraffic) -> messages::Traffic {
    let LaneTraffic { status, flow_veh_h, flow_ci90, speed_kmh, speed_ci90, .. } = traffic;
    let LaneTraffic { time_occupancy, time_occupancy_ci90, section, queue_m, .. } = traffic;
    let LaneTraffic { queue_max_m, density_difference, .. } = traffic;
    let at_section = |of: fn(&Section) -> Option<f32>| section.as_ref().and_then(of).map(rounded);
    messages::Traffic {
        traffic_status: *status,
        flow_veh_h: flow_veh_h.map(rounded),
        flow_ci90: flow_ci90.map(|interval| interval.map(rounded)),
        speed_kmh: speed_kmh.map(rounded),
        speed_ci90: speed_ci90.map(|interval| interval.map(rounded)),
        time_occupancy: time_occupancy.map(rounded),
        time_occupancy_ci90: time_occupancy_ci90.map(|interval| interval.map(rounded)),
        passed: section.as_ref().map(|Section { by_class, .. }| {
            let of = |class: VehicleClass| by_class.get(class.index()).copied().unwrap_or(0);
            messages::Passed {
                vehicle: of(VehicleClass::Vehicle),
                car: of(VehicleClass::Car),
                van: of(VehicleClass::Van),
                bus: of(VehicleClass::Bus),
                truck: of(VehicleClass::Truck),
                motorcycle: of(VehicleClass::Motorcycle),
            }
        }),
        section_flow_veh_h: at_section(|section| Some(section.flow_veh_h)),
        speed_time_mean_kmh: at_section(|section| section.speed_time_mean_kmh),
        headway_s: at_section(|section| section.headway_s),
        headway_sd_s: at_section(|section| section.headway_sd_s),
        queue_m: queue_m.map(rounded),
        queue_max_m: queue_max_m.map(rounded),
        density_difference: density_difference.map(rounded),
    }
}

fn of_classes(means: &[f32; VehicleClass::COUNT]) -> messages::ByClass {
    let mean = |class: VehicleClass| means.get(class.index()).copied().map_or(0.0, rounded);
    messages::ByClass {
        vehicle: mean(VehicleClass::Vehicle),
        car: mean(VehicleClass::Car),
        van: mean(VehicleClass::Van),
        bus: mean(VehicleClass::Bus),
        truck: mean(VehicleClass::Truck),
        motorcycle: mean(VehicleClass::Motorcycle),
    }
}

impl From<UtcMs> for messages::Utc {
    fn from(time: UtcMs) -> Self {
        Self(time.0)
    }
}

impl From<Direction> for messages::Direction {
    fn from(direction: Direction) -> Self {
        match direction {
            Direction::Unknown => Self::Unknown,
            Direction::Toward => Self::Toward,
            Direction::Away => Self::Away,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_have_one_name() {
        let means = std::array::from_fn(|index| index as f32);
        for (class, (name, mean)) in VehicleClass::ALL.into_iter().zip(of_classes(&means).named()) {
            assert_eq!((name, mean), (class.name(), class.index() as f32));
        }
    }
}
