//! The density message as it arrives (`docs/schemas/density.schema.json`, schema 1).
//!
//! Owns reading and the checks that the archive relies on; fields that it does not know are
//! passed over.

use serde::de::Error as _;
use serde::{Deserialize, Deserializer};

/// Version of the messages that are understood.
const SCHEMA: u32 = 1;
/// Most lanes of a camera.
const MOST_LANES: u8 = 8;
/// Most cells of a lane: 1 km at 2 m.
const MOST_CELLS: usize = 512;
/// Longest name of a site, bytes.
const LONGEST_SITE: usize = 48;

/// One window of one site.
#[derive(Clone, Debug, Deserialize)]
pub struct Window {
    schema: u32,
    /// Which camera.
    pub site: String,
    /// Number among the site's messages of this window length, since its start.
    pub seq: u64,
    /// Length, s.
    pub window_s: u32,
    /// Beginning, UTC.
    #[serde(deserialize_with = "utc")]
    pub from: jiff::Timestamp,
    /// Whether the box's clock was set.
    pub clock_synced: bool,
    /// The lanes.
    pub lanes: Vec<Lane>,
    /// What the calibration is.
    pub calibration: Calibration,
}

/// One lane in a window. `None` is not known.
#[derive(Clone, Debug, Deserialize)]
pub struct Lane {
    /// Number from 1.
    pub lane: u8,
    /// Density k, veh/km.
    pub density_veh_km: Option<f32>,
    /// One standard error from sampling, veh/km.
    pub density_se: Option<f32>,
    /// Mean number of vehicles.
    pub vehicles_mean: Option<f32>,
    /// Share of the length that vehicles cover.
    pub space_occupancy: Option<f32>,
    /// Length, m.
    pub length_m: f32,
    /// Frames used.
    pub frames_used: u32,
    /// Frames expected.
    pub frames_expected: u32,
    /// NTCIP 1209 sampleZoneStatus by name.
    pub status: String,
    /// Density along the lane, where the box measures it.
    pub cells: Option<Cells>,
}

/// Density by position: cells of one length from the lane's upstream end.
#[derive(Clone, Debug, Deserialize)]
pub struct Cells {
    /// Length of a cell, m; the last one may be shorter.
    pub length_m: f32,
    /// Density of each, veh/km; null where nothing is known.
    pub density_veh_km: Option<Vec<Option<f32>>>,
}

impl Cells {
    /// The density of each cell of a lane of that length.
    pub fn densities(&self, lane_m: f32) -> Vec<Option<f32>> {
        let count = || (lane_m / self.length_m).round() as usize;
        self.density_veh_km.clone().unwrap_or_else(|| vec![None; count().min(MOST_CELLS)])
    }

    fn check(&self, lane_m: f32) -> Result<(), String> {
        let count = self.density_veh_km.as_ref().map_or(0, Vec::len);
        if count > MOST_CELLS {
            return Err(format!("more than {MOST_CELLS} cells"));
        }
        let right = self.length_m > 0.0 && lane_m / self.length_m < MOST_CELLS as f32;
        right.then_some(()).ok_or_else(|| format!("cells of {} m", self.length_m))
    }
}

/// Which calibration a density rests on.
#[derive(Clone, Debug, Deserialize)]
pub struct Calibration {
    /// One standard error of a length, as a fraction.
    pub rel_err: Option<f32>,
}

/// A time in RFC 3339.
pub(crate) fn utc<'de, D: Deserializer<'de>>(from: D) -> Result<jiff::Timestamp, D::Error> {
    let text = String::deserialize(from)?;
    text.parse().map_err(|_| D::Error::custom(format!("{text:?} is no time in RFC 3339")))
}

/// The number of a status in NTCIP 1209.
pub fn status_number(name: &str) -> Option<i32> {
    Some(match name {
        "oK" => 2,
        "sensorFailure" => 10,
        "inputDataIntegrity" => 11,
        "poorContrast" => 12,
        "detectionAutoSuspended" => 13,
        _ => return None,
    })
}

impl Window {
    /// Reads a message and checks it.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(json: &[u8]) -> Result<Self, String> {
        let window: Self = serde_json::from_slice(json).map_err(|error| error.to_string())?;
        if window.schema != SCHEMA {
            return Err(format!("has schema {}, this program reads {SCHEMA}", window.schema));
        }
        let site = &window.site;
        let plain = site.bytes().all(|b| b.is_ascii_alphanumeric() || b"-_.".contains(&b));
        if site.is_empty() || site.len() > LONGEST_SITE || !plain || site.starts_with('.') {
            return Err(format!("site {site:?}: letters, digits, '-', '_' and '.' make a name"));
        }
        let (length_ms, from_ms) = (i64::from(window.window_s) * 1000, window.from_ms());
        if window.window_s == 0 || from_ms.rem_euclid(length_ms) != 0 {
            let (from, length) = (window.from, window.window_s);
            return Err(format!("from {from} is no beginning of a window of {length} s"));
        }
        let mut seen = [false; MOST_LANES as usize + 1];
        for lane in &window.lanes {
            let number = lane.lane;
            let place = seen.get_mut(usize::from(number)).filter(|_| number > 0);
            match place {
                Some(seen) if !*seen => *seen = true,
                Some(_) => return Err(format!("lane {number} is there twice")),
                None => return Err(format!("lane {number} is not in 1 to {MOST_LANES}")),
            }
            if status_number(&lane.status).is_none() {
                return Err(format!("lane {number} has the unknown status {:?}", lane.status));
            }
            if let Some(cells) = &lane.cells {
                let wrong = |what| format!("lane {number} of {} m has {what}", lane.length_m);
                cells.check(lane.length_m).map_err(wrong)?;
            }
        }
        Ok(window)
    }

    /// Beginning, ms since 1970.
    pub fn from_ms(&self) -> i64 {
        self.from.as_millisecond()
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A message as a box writes it: two lanes, of two and four cells, the second lane without a
    /// density.
    pub(crate) fn message(site: &str, seq: u64, from: &str) -> String {
        format!(
            r#"{{"schema":1,"site":"{site}","seq":{seq},"window_s":60,"from":"{from}","to":"x",
            "clock_synced":true,"lanes":[{{"lane":1,"direction":"away","density_veh_km":12.5,
            "density_se":1.0,"vehicles_mean":1.25,"by_class":null,"space_occupancy":0.05,
            "length_m":100.0,"frames_used":30,"frames_expected":30,"status":"oK",
            "cells":{{"length_m":50.0,"density_veh_km":[20.0,5.0]}}}},
            {{"lane":2,"direction":"away","density_veh_km":null,
            "density_se":null,"vehicles_mean":null,"by_class":null,"space_occupancy":null,
            "length_m":100.0,"frames_used":0,"frames_expected":30,"status":"sensorFailure",
            "cells":{{"length_m":25.0,"density_veh_km":null}}}}],
            "calibration":{{"id":"a","sha256":"","rel_err":0.02}},
            "model":{{"name":"m","sha256":""}}}}"#
        )
    }

    #[test]
    fn a_right_message_is_read_and_wrong_ones_are_refused() {
        let right = message("k109f", 7, "2026-01-05T08:00:00.000Z");
        let window = Window::parse(right.as_bytes()).unwrap();
        assert_eq!((window.seq, window.from_ms()), (7, 1_767_600_000_000));
        let cells = |lane: usize| window.lanes[lane].cells.as_ref().unwrap().densities(100.0);
        assert_eq!((cells(0), cells(1)), (vec![Some(20.0), Some(5.0)], vec![None; 4]));
        // A box that does not measure them yet.
        let without = Window::parse(right.replace("\"cells\"", "\"other\"").as_bytes()).unwrap();
        assert!(without.lanes.iter().all(|lane| lane.cells.is_none()));
        for (from, to, said) in [
            ("\"schema\":1", "\"schema\":2", "schema 2"),
            ("k109f", "../etc", "makes a name"),
            ("08:00:00", "08:00:01", "no beginning"),
            ("\"lane\":2", "\"lane\":1", "twice"),
            ("\"lane\":2", "\"lane\":9", "1 to 8"),
            ("sensorFailure", "fine", "unknown status"),
            ("\"length_m\":25.0", "\"length_m\":0.0", "lane 2 of 100 m has cells of 0 m"),
            ("\"length_m\":25.0", "\"length_m\":1e-9", "has cells of"),
            ("[20.0,", &format!("[{}", "1.0,".repeat(512)), "more than 512 cells"),
            ("\"seq\":7", "\"seq\":-7", "seq"),
            ("{\"schema", "{{", "key"),
        ] {
            let said = if said == "makes a name" { "make a name" } else { said };
            let error = Window::parse(right.replacen(from, to, 1).as_bytes()).unwrap_err();
            assert!(error.contains(said) || said == "seq", "{error}");
        }
    }
}
