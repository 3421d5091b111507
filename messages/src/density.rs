//! The density of one window of one site, and the check that every reader relies on.

use crate::place::check_lane;
use crate::wrong::{count, interval, known, name, number, sha256};
use crate::{LaneName, Place, SCHEMA, SCHEMA_WITH_PLACE, Schema, Status, Traffic, Utc, Wrong};
use serde::{Deserialize, Serialize};

/// Most lanes of a camera.
pub const MOST_LANES: u8 = 8;
/// Most cells of a lane.
pub const MOST_CELLS: usize = 32;
/// Shortest window, s.
pub const SHORTEST_WINDOW_S: u32 = 10;
/// Longest window, s (15 min, the longest that traffic centres exchange).
pub const LONGEST_WINDOW_S: u32 = 900;
const DAY_S: u32 = 86_400;

// Wider than any road, so that only what cannot be is refused.

/// A vehicle each 10 cm; a jam of cars has some 150.
const MOST_VEH_KM: f32 = 10_000.0;
/// An end of an interval: the most density and three times its error of the same size.
const MOST_CI_VEH_KM: f32 = 1_000_000.0;
/// Vehicles in one lane of one picture.
const MOST_VEHICLES: f32 = 1000.0;
/// Longest lane, m: a lane table holds 655 m.
const LONGEST_LANE_M: f32 = 1000.0;
/// Frames of a window: 900 s at 1,000 a second.
const MOST_FRAMES: u32 = 900_000;
/// Standard error of a length, as a fraction: above it nothing is known of it.
const MOST_REL_ERR: f32 = 10.0;
/// Windows of 10 s in 300,000 years, so that differences of numbers do not overflow.
const MOST_SEQ: u64 = 1 << 40;

/// Published on `<root>/density/<window>` when the window closes, and on
/// `<root>/replay/density/<window>` when it could not be sent then, QoS 1. It may arrive twice,
/// with the same seq. What is not known is null, never 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(title = "verge density window"))]
pub struct Density {
    /// Version of the message: 2 where it has a place, else 1.
    #[cfg_attr(feature = "schema", schemars(schema_with = "either_schema"))]
    pub schema: Schema,
    /// The site that measured.
    #[cfg_attr(feature = "schema", schemars(length(max = crate::LONGEST_NAME)))]
    pub site: String,
    /// Where it is and what people call it; absent where its configuration does not say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(with = "Place"))]
    pub place: Option<Place>,
    /// Number among this site's messages of this window length, from 1. It goes on when the
    /// box restarts; a number that is missing waits on the box or was lost.
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = MOST_SEQ)))]
    pub seq: u64,
    /// Length of the window, s; it divides a day.
    #[cfg_attr(
        feature = "schema",
        schemars(range(min = SHORTEST_WINDOW_S, max = LONGEST_WINDOW_S))
    )]
    pub window_s: u32,
    /// Its beginning, a multiple of its length.
    pub from: Utc,
    /// Its end.
    pub to: Utc,
    /// The box's clock was set from a time source.
    pub clock_synced: bool,
    /// One entry a lane, by rising number.
    #[cfg_attr(feature = "schema", schemars(length(min = 1, max = MOST_LANES)))]
    pub lanes: Vec<Lane>,
    /// Where the metres come from.
    pub calibration: Calibration,
    /// The model that found the vehicles.
    pub model: Model,
    /// In replayed windows alone: whether this is the last of its length that was waiting.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(with = "bool"))]
    pub done: Option<bool>,
}

/// One lane in a window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "lane"))]
pub struct Lane {
    /// Its number in the lane file.
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = MOST_LANES)))]
    pub lane: u8,
    /// Name for people; absent where the configuration gives none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(
        feature = "schema",
        schemars(with = "String", length(min = 1, max = crate::LONGEST_PLACE))
    )]
    pub lane_name: Option<String>,
    /// Its number on the carriageway as the country counts; absent where the configuration does
    /// not say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(with = "u8", range(min = 1, max = 16)))]
    pub lane_order: Option<u8>,
    /// Direction of its traffic, as the camera sees it.
    pub direction: Direction,
    /// veh/km in this lane
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_VEH_KM)))]
    pub density_veh_km: Option<f32>,
    /// One standard error from sampling, veh/km
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_VEH_KM)))]
    pub density_se: Option<f32>,
    /// Mean number of vehicles in the lane
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_VEHICLES)))]
    pub vehicles_mean: Option<f32>,
    /// Mean vehicles by class
    pub by_class: Option<ByClass>,
    /// Share of the lane's length that vehicles cover (nominal lengths)
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = 1)))]
    pub space_occupancy: Option<f32>,
    /// Length of the lane, m
    #[cfg_attr(
        feature = "schema",
        schemars(extend("exclusiveMinimum" = 0), range(max = LONGEST_LANE_M))
    )]
    pub length_m: f32,
    /// Frames that were used
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_FRAMES)))]
    pub frames_used: u32,
    /// Frames that the window would have at the camera's rate
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = MOST_FRAMES)))]
    pub frames_expected: u32,
    /// How far the reading can be used: NTCIP 1209 sampleZoneStatus 2, 10, 11, 12, 13
    pub status: Status,
    /// Density along the lane, in equal cells from its upstream end: the far one where traffic
    /// comes towards the camera, else the near one. A vehicle counts in the cell where it meets
    /// the road.
    #[cfg_attr(feature = "schema", schemars(extend("x-since" = "0.1")))]
    pub cells: Option<Cells>,
    /// Interval that holds the density with a probability of 90 %, veh/km: sampling, calibration
    /// and counting together. null where one of these is not known.
    #[cfg_attr(
        feature = "schema",
        schemars(extend("x-since" = "0.2"), inner(range(min = 0, max = MOST_CI_VEH_KM)))
    )]
    pub density_ci90: Option<[f32; 2]>,
    /// One standard error from the calibration, veh/km.
    #[cfg_attr(
        feature = "schema",
        schemars(extend("x-since" = "0.2"), range(min = 0, max = MOST_CI_VEH_KM))
    )]
    pub calibration_se: Option<f32>,
    /// One standard error from counting, veh/km: over cameras that the model was not trained on,
    /// or this site's own where it was audited.
    #[cfg_attr(
        feature = "schema",
        schemars(extend("x-since" = "0.2"), range(min = 0, max = MOST_CI_VEH_KM))
    )]
    pub counting_se: Option<f32>,
    /// Flow, speed and occupancy, where vehicles are followed.
    #[serde(
        flatten,
        deserialize_with = "crate::traffic::read",
        skip_serializing_if = "Option::is_none"
    )]
    pub traffic: Option<Traffic>,
}

/// Direction of a lane's traffic, as the camera sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(inline))]
#[serde(rename_all = "lowercase")]
pub enum Direction {
    /// Towards the camera.
    Toward,
    /// Away from it.
    Away,
    /// The lane file does not say.
    Unknown,
}

impl Direction {
    /// The name in messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Toward => "toward",
            Self::Away => "away",
            Self::Unknown => "unknown",
        }
    }
}

/// Mean vehicles by class.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "by_class"))]
#[serde(deny_unknown_fields)]
pub struct ByClass {
    /// Vehicles whose kind the model does not tell
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_VEHICLES)))]
    pub vehicle: f32,
    /// Passenger cars, taxis
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_VEHICLES)))]
    pub car: f32,
    /// Vans, minibuses
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_VEHICLES)))]
    pub van: f32,
    /// Buses, coaches
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_VEHICLES)))]
    pub bus: f32,
    /// Lorries
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_VEHICLES)))]
    pub truck: f32,
    /// Motorcycles, scooters
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_VEHICLES)))]
    pub motorcycle: f32,
}

impl ByClass {
    /// The classes by name, in their order.
    pub const fn named(&self) -> [(&'static str, f32); 6] {
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
}

/// Density along a lane.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "cells"))]
pub struct Cells {
    /// Length of each cell, m: the lane's, divided by a whole number
    #[cfg_attr(
        feature = "schema",
        schemars(extend("exclusiveMinimum" = 0), range(max = LONGEST_LANE_M))
    )]
    pub length_m: f32,
    /// Of each cell, veh/km; their mean is the lane's. null where the lane's is.
    #[cfg_attr(
        feature = "schema",
        schemars(length(min = 1, max = MOST_CELLS), inner(range(min = 0, max = MOST_VEH_KM)))
    )]
    pub density_veh_km: Option<Vec<f32>>,
}

impl Cells {
    /// How many of them a lane of that length has.
    pub fn count(&self, lane_m: f32) -> usize {
        // `as` saturates; what is not a number gives none.
        (lane_m / self.length_m).round() as usize
    }
}

/// Where the metres of a density come from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "calibration"))]
pub struct Calibration {
    /// Its name
    #[cfg_attr(feature = "schema", schemars(length(max = crate::LONGEST_NAME)))]
    pub id: String,
    /// SHA-256 of the calibration file
    #[cfg_attr(feature = "schema", schemars(regex(pattern = "^[0-9a-f]{64}$")))]
    pub sha256: String,
    /// One standard error of a length on the road, as a fraction. A density's error from
    /// calibration is density_veh_km times this.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_REL_ERR)))]
    pub rel_err: Option<f32>,
}

/// The model that found the vehicles.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "model"))]
pub struct Model {
    /// Its name
    #[cfg_attr(feature = "schema", schemars(length(max = crate::LONGEST_NAME)))]
    pub name: String,
    /// SHA-256 of the model file
    #[cfg_attr(feature = "schema", schemars(regex(pattern = "^[0-9a-f]{64}$")))]
    pub sha256: String,
}

/// Four decimals: finer than any of these quantities is known. A number that is too large for
/// them stays as it is.
pub fn rounded(value: f32) -> f32 {
    let rounded = (value * 1e4).round() / 1e4;
    if rounded.is_finite() { rounded } else { value }
}

#[cfg(feature = "schema")]
fn either_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
    schemars::json_schema!({ "enum": [SCHEMA, SCHEMA_WITH_PLACE] })
}

impl Density {
    /// The same from a site of which this is known.
    #[must_use]
    pub fn at(mut self, place: &Place, lanes: &[LaneName]) -> Self {
        self.schema = Schema::WITH_PLACE;
        self.place = Some(place.clone());
        for lane in &mut self.lanes {
            let Some(known) = lanes.iter().find(|known| known.lane == lane.lane) else { continue };
            lane.lane_name.clone_from(&known.name);
            lane.lane_order = known.order;
        }
        self
    }

    /// Refuses what no box publishes: it would look like a measurement to whoever reads it.
    ///
    /// # Errors
    /// The first [`Wrong`] field.
    pub fn check(&self) -> Result<(), Wrong> {
        let Self { schema, site, seq, window_s, from, to, clock_synced: _, lanes, .. } = self;
        let Self { calibration, model, place, done: _, .. } = self;
        if !schema.is_known() {
            let reason = format!(
                "{}, this program reads {SCHEMA} and {SCHEMA_WITH_PLACE}: update it",
                schema.0
            );
            return Err(Wrong::new("schema", reason));
        }
        name("site", site)?;
        place.as_ref().map_or(Ok(()), Place::check).map_err(|wrong| wrong.inside("place"))?;
        count("seq", *seq, 1, MOST_SEQ)?;
        let lengths = SHORTEST_WINDOW_S..=LONGEST_WINDOW_S;
        if !lengths.contains(window_s) || !DAY_S.is_multiple_of(*window_s) {
            let reason = "s: 10 to 900 that divide a day are right";
            return Err(Wrong::new("window_s", format!("{window_s} {reason}")));
        }
        let length_ms = i64::from(*window_s) * 1000;
        if !(0..crate::time::YEAR_10000_MS - length_ms).contains(&from.0) || from.0 % length_ms != 0
        {
            let reason = format!("{from} is not the beginning of a window of {window_s} s");
            return Err(Wrong::new("from", reason));
        }
        if to.0 - from.0 != length_ms {
            return Err(Wrong::new("to", format!("{to} is not {window_s} s after {from}")));
        }
        count("lanes", lanes.len() as u64, 1, u64::from(MOST_LANES))?;
        let mut seen = [false; MOST_LANES as usize + 1];
        for (index, lane) in lanes.iter().enumerate() {
            lane.check().map_err(|wrong| wrong.inside(&format!("lanes[{index}]")))?;
            if std::mem::replace(&mut seen[usize::from(lane.lane)], true) {
                let field = format!("lanes[{index}].lane");
                return Err(Wrong::new(field, format!("{} is there twice", lane.lane)));
            }
        }
        calibration.check().map_err(|wrong| wrong.inside("calibration"))?;
        model.check().map_err(|wrong| wrong.inside("model"))
    }
}

impl Lane {
    fn check(&self) -> Result<(), Wrong> {
        let Self { lane, lane_name, lane_order, direction: _, density_veh_km, .. } = self;
        let Self { density_se, vehicles_mean, .. } = self;
        let Self { by_class, space_occupancy, length_m, frames_used, frames_expected, .. } = self;
        let Self { status: _, cells, density_ci90, calibration_se, counting_se, traffic, .. } =
            self;
        count("lane", (*lane).into(), 1, MOST_LANES.into())?;
        check_lane(lane_name.as_deref(), *lane_order)?;
        known("density_veh_km", *density_veh_km, MOST_VEH_KM)?;
        known("density_se", *density_se, MOST_VEH_KM)?;
        known("vehicles_mean", *vehicles_mean, MOST_VEHICLES)?;
        for (class, mean) in by_class.iter().flat_map(ByClass::named) {
            number(class, mean, 0.0, MOST_VEHICLES).map_err(|wrong| wrong.inside("by_class"))?;
        }
        known("space_occupancy", *space_occupancy, 1.0)?;
        length("length_m", *length_m)?;
        count("frames_used", (*frames_used).into(), 0, MOST_FRAMES.into())?;
        count("frames_expected", (*frames_expected).into(), 1, MOST_FRAMES.into())?;
        known("calibration_se", *calibration_se, MOST_CI_VEH_KM)?;
        known("counting_se", *counting_se, MOST_CI_VEH_KM)?;
        interval("density_ci90", *density_ci90, MOST_CI_VEH_KM)?;
        traffic.as_ref().map_or(Ok(()), Traffic::check)?;
        let Some(cells) = cells else { return Ok(()) };
        cells.check(*length_m).map_err(|wrong| wrong.inside("cells"))
    }
}

impl Cells {
    fn check(&self, lane_m: f32) -> Result<(), Wrong> {
        let Self { length_m, density_veh_km } = self;
        length("length_m", *length_m)?;
        let most = self.count(lane_m);
        if !(1..=MOST_CELLS).contains(&most) {
            let reason = format!("{length_m}: {lane_m} m in 1 to {MOST_CELLS} cells is right");
            return Err(Wrong::new("length_m", reason));
        }
        let Some(densities) = density_veh_km else { return Ok(()) };
        if densities.len() != most {
            let reason = format!(
                "{} of them, {most} of {length_m} m make the lane's {lane_m} m",
                densities.len()
            );
            return Err(Wrong::new("density_veh_km", reason));
        }
        for (cell, &density) in densities.iter().enumerate() {
            number(&format!("density_veh_km[{cell}]"), density, 0.0, MOST_VEH_KM)?;
        }
        Ok(())
    }
}

impl Calibration {
    fn check(&self) -> Result<(), Wrong> {
        let Self { id, sha256: hash, rel_err } = self;
        name("id", id)?;
        sha256("sha256", hash)?;
        known("rel_err", *rel_err, MOST_REL_ERR)
    }
}

impl Model {
    fn check(&self) -> Result<(), Wrong> {
        let Self { name: id, sha256: hash } = self;
        name("name", id)?;
        sha256("sha256", hash)
    }
}

/// A length above 0.
fn length(field: &str, given: f32) -> Result<(), Wrong> {
    number(field, given, f32::MIN_POSITIVE, LONGEST_LANE_M)
        .map_err(|_| Wrong::new(field, format!("{given}: above 0 to {LONGEST_LANE_M} is right")))
}
