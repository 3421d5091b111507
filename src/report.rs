//! The report of a lane in one window: density, flow and speed, their errors, and their status.
//!
//! Owns the types alone. `density` and `traffic` make them and hand them on, `wire` and
//! `messages` write them.

use crate::units::{Direction, LaneId, MAX_LANES, UtcMs, VehicleClass};
use serde::{Deserialize, Serialize};
/// How far a reading can be used.
pub use verge_messages::Status as SampleZoneStatus;

/// Most cells of a lane: 320 m at 10 m, beyond which a camera tells no vehicles apart. A
/// longer lane gets longer cells. Each costs four bytes a window and lane.
pub const MAX_LANE_CELLS: usize = 32;

/// One lane in one window. `None` where it is not known, never 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LaneReport {
    /// The lane.
    pub lane: LaneId,
    /// Direction of its traffic.
    pub direction: Direction,
    /// Density k, veh/km.
    pub density_veh_km: Option<f32>,
    /// One standard error of the density from sampling, veh/km.
    pub density_se: Option<f32>,
    /// Mean number of vehicles in the lane.
    pub vehicles_mean: Option<f32>,
    /// The same by class, in the order of [`VehicleClass::ALL`].
    pub by_class: Option<[f32; VehicleClass::COUNT]>,
    /// Share of the lane's length that vehicles cover (nominal lengths), 0 to 1.
    pub space_occupancy: Option<f32>,
    /// The lane's length, m.
    pub length_m: f32,
    /// Frames that were used.
    pub frames_used: u32,
    /// Frames that the window would have at the camera's rate.
    pub frames_expected: u32,
    /// How far this reading can be used.
    pub status: SampleZoneStatus,
    /// Density along the lane; `None` in messages from before it was measured. Not in the
    /// postcard form of this type: `wire` writes it behind the rest of a message.
    #[serde(skip)]
    pub cells: Option<Cells>,
    /// Errors beside sampling, and the interval of all together; `None` where a part of it
    /// is not known. Written as `cells` are.
    #[serde(skip)]
    pub error: Option<DensityError>,
    /// Flow and speed; `None` where vehicles are not followed. Written as `cells` are.
    #[serde(skip)]
    pub traffic: Option<LaneTraffic>,
}

/// All lanes in one window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WindowReport {
    /// Its beginning, a multiple of its length since 1970.
    pub from: UtcMs,
    /// Its end.
    pub to: UtcMs,
    /// One entry a lane, by rising number.
    pub lanes: heapless::Vec<LaneReport, MAX_LANES>,
}

/// Density along a lane, in equal cells from its upstream end.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cells {
    /// Length of each cell, m.
    pub length_m: f32,
    /// Density of each, veh/km; their mean is the lane's. `None` where the lane's is.
    pub density_veh_km: Option<heapless::Vec<f32, MAX_LANE_CELLS>>,
}

/// Errors of one density that more frames do not make smaller, and its interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DensityError {
    /// One standard error from the calibration, veh/km.
    pub calibration: f32,
    /// One standard error from counting, veh/km.
    pub counting: f32,
    /// Interval that holds the density with a probability of 90 %, veh/km.
    pub ci90: [f32; 2],
}

/// Flow, speed and occupancy of a lane in a window. `None` where it is not known, never 0.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LaneTraffic {
    /// How far these readings can be used.
    pub status: SampleZoneStatus,
    /// Flow q over the whole lane, veh/h.
    pub flow_veh_h: Option<f32>,
    /// Interval that holds it with a probability of 90 %.
    pub flow_ci90: Option<[f32; 2]>,
    /// Space-mean speed v over the whole lane, km/h; `None` too where no vehicle was on it.
    pub speed_kmh: Option<f32>,
    /// Interval that holds it with a probability of 90 %.
    pub speed_ci90: Option<[f32; 2]>,
    /// Share of the time for which a vehicle covered the section, 0 to 1.
    pub time_occupancy: Option<f32>,
    /// Interval that holds it with a probability of 90 %.
    pub time_occupancy_ci90: Option<[f32; 2]>,
    /// Traffic at the section.
    pub section: Option<Section>,
    /// Mean length of the longest queue, m.
    pub queue_m: Option<f32>,
    /// The most of it, m.
    pub queue_max_m: Option<f32>,
    /// Density by the mean of pictures less that by Edie's definition, veh/km: a check on both.
    pub density_difference: Option<f32>,
}

/// Traffic at the section of a lane.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Section {
    /// Vehicles, by class in the order of [`VehicleClass::ALL`].
    pub by_class: [u16; VehicleClass::COUNT],
    /// The same an hour, veh/h.
    pub flow_veh_h: f32,
    /// Time-mean speed, km/h.
    pub speed_time_mean_kmh: Option<f32>,
    /// Mean time from one vehicle to the next, s.
    pub headway_s: Option<f32>,
    /// Standard deviation of that time, s.
    pub headway_sd_s: Option<f32>,
}
