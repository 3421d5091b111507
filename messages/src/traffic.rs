//! Flow, speed and occupancy of a lane: the fields that stand beside its density where vehicles are
//! followed.

use crate::wrong::{count, interval, known, number};
use crate::{Status, Wrong};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value};

// Wider than any road, so that only what cannot be is refused.

/// Ten vehicles a second.
const MOST_VEH_H: f32 = 36_000.0;
/// An end of an interval: the most flow and three times its error of the same size.
const MOST_CI_VEH_H: f32 = 1_000_000.0;
const MOST_KMH: f32 = 1000.0;
const MOST_CI_KMH: f32 = 10_000.0;
/// The longest window, s.
const MOST_HEADWAY_S: f32 = 900.0;
/// A lane's length, m.
const MOST_QUEUE_M: f32 = 1000.0;
const MOST_VEH_KM: f32 = 10_000.0;
/// Vehicles of a class in a window.
const MOST_PASSED: u16 = u16::MAX;

/// Flow, speed and occupancy of a lane. The fields are absent where vehicles are not followed: too
/// few pictures, or not asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Traffic {
    /// How far flow, speed and what follows can be used, as `status`; where it is not oK they are
    /// null. This and all that follows is absent where vehicles are not followed.
    pub traffic_status: Status,
    /// Flow over the whole lane (Edie), veh/h. It is density_veh_km times speed_kmh.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_VEH_H)))]
    pub flow_veh_h: Option<f32>,
    /// Interval that holds the flow with a probability of 90 %, veh/h
    #[cfg_attr(feature = "schema", schemars(inner(range(min = 0, max = MOST_CI_VEH_H))))]
    pub flow_ci90: Option<[f32; 2]>,
    /// Space-mean speed over the whole lane (Edie), km/h; null too where no vehicle was on it
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_KMH)))]
    pub speed_kmh: Option<f32>,
    /// Interval that holds the space-mean speed with a probability of 90 %, km/h
    #[cfg_attr(feature = "schema", schemars(inner(range(min = 0, max = MOST_CI_KMH))))]
    pub speed_ci90: Option<[f32; 2]>,
    /// Share of the time for which a vehicle covered the section: the lane's middle, or where
    /// traffic.section_m puts it
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = 1)))]
    pub time_occupancy: Option<f32>,
    /// Interval that holds the time occupancy with a probability of 90 %
    #[cfg_attr(feature = "schema", schemars(inner(range(min = 0, max = 1))))]
    pub time_occupancy_ci90: Option<[f32; 2]>,
    /// Vehicles that passed the section, by class
    pub passed: Option<Passed>,
    /// Flow across the section, veh/h
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_VEH_H)))]
    pub section_flow_veh_h: Option<f32>,
    /// Time-mean speed of the vehicles that passed the section, km/h; null too where none did
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_KMH)))]
    pub speed_time_mean_kmh: Option<f32>,
    /// Mean time from one vehicle to the next at the section, s; null with fewer than two
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_HEADWAY_S)))]
    pub headway_s: Option<f32>,
    /// Standard deviation of that time, s; null with fewer than three
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_HEADWAY_S)))]
    pub headway_sd_s: Option<f32>,
    /// Length of the longest queue, its mean over the window, m: vehicles, at least two, of which
    /// each came down to 5 km/h and has not reached 10 km/h since, at most 20 m behind each other
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_QUEUE_M)))]
    pub queue_m: Option<f32>,
    /// The most of it, m
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_QUEUE_M)))]
    pub queue_max_m: Option<f32>,
    /// Density by the mean of pictures less the one by Edie's definition, veh/km: a check on both
    #[cfg_attr(
        feature = "schema",
        schemars(range(min = -MOST_VEH_KM, max = MOST_VEH_KM))
    )]
    pub density_difference: Option<f32>,
}

/// Vehicles that passed a section, by class.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "passed"))]
#[serde(deny_unknown_fields)]
pub struct Passed {
    /// Vehicles whose kind the model does not tell
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_PASSED)))]
    pub vehicle: u16,
    /// Passenger cars, taxis
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_PASSED)))]
    pub car: u16,
    /// Vans, minibuses
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_PASSED)))]
    pub van: u16,
    /// Buses, coaches
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_PASSED)))]
    pub bus: u16,
    /// Lorries
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_PASSED)))]
    pub truck: u16,
    /// Motorcycles, scooters
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_PASSED)))]
    pub motorcycle: u16,
}

impl Passed {
    /// The classes by name, in their order.
    pub const fn named(&self) -> [(&'static str, u16); 6] {
        let Self { vehicle, car, van, bus, truck, motorcycle } = *self;
        [
            ("vehicle", vehicle),
            ("car", car),
            ("van", van),
            ("bus", bus),
            ("truck", truck),
            ("motorcycle", motorcycle),
        ]
    }

    /// All of them.
    pub fn all(&self) -> u32 {
        self.named().into_iter().map(|(_, n)| u32::from(n)).sum()
    }
}

/// Reads the fields where they are there. serde itself would take a wrong one for none at all.
pub(crate) fn read<'de, D: Deserializer<'de>>(given: D) -> Result<Option<Traffic>, D::Error> {
    let fields = Map::deserialize(given)?;
    if !fields.contains_key("traffic_status") {
        return Ok(None);
    }
    let read = serde_path_to_error::deserialize(Value::Object(fields));
    read.map(Some).map_err(|error| D::Error::custom(format!("{}: {}", error.path(), error.inner())))
}

impl Traffic {
    pub(crate) fn check(&self) -> Result<(), Wrong> {
        let Self { traffic_status: _, flow_veh_h, flow_ci90, speed_kmh, speed_ci90, .. } = self;
        let Self { time_occupancy, time_occupancy_ci90, passed, section_flow_veh_h, .. } = self;
        let Self { speed_time_mean_kmh, headway_s, headway_sd_s, queue_m, queue_max_m, .. } = self;
        let Self { density_difference, .. } = self;
        known("flow_veh_h", *flow_veh_h, MOST_VEH_H)?;
        interval("flow_ci90", *flow_ci90, MOST_CI_VEH_H)?;
        known("speed_kmh", *speed_kmh, MOST_KMH)?;
        interval("speed_ci90", *speed_ci90, MOST_CI_KMH)?;
        known("time_occupancy", *time_occupancy, 1.0)?;
        interval("time_occupancy_ci90", *time_occupancy_ci90, 1.0)?;
        for (class, n) in passed.iter().flat_map(Passed::named) {
            count(class, n.into(), 0, MOST_PASSED.into())?;
        }
        known("section_flow_veh_h", *section_flow_veh_h, MOST_VEH_H)?;
        known("speed_time_mean_kmh", *speed_time_mean_kmh, MOST_KMH)?;
        known("headway_s", *headway_s, MOST_HEADWAY_S)?;
        known("headway_sd_s", *headway_sd_s, MOST_HEADWAY_S)?;
        known("queue_m", *queue_m, MOST_QUEUE_M)?;
        known("queue_max_m", *queue_max_m, MOST_QUEUE_M)?;
        density_difference.map_or(Ok(()), |difference| {
            number("density_difference", difference, -MOST_VEH_KM, MOST_VEH_KM)
        })
    }
}
