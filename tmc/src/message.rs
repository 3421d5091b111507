//! The density message as it arrives: JSON (`docs/schemas/density.schema.json`, schema 1) or
//! the compact form (`verge::wire`).
//!
//! Owns reading and the checks that the archive relies on; fields of JSON that it does not know
//! are passed over. Both forms of a message give the same window.

use serde::de::Error as _;
use serde::{Deserialize, Deserializer};
use verge::density::{LaneReport, SampleZoneStatus};
use verge::wire;

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

impl Lane {
    /// As the box writes it in JSON.
    fn of_wire(report: &LaneReport) -> Result<Self, String> {
        let status = match report.status {
            SampleZoneStatus::Ok => "oK",
            SampleZoneStatus::SensorFailure => "sensorFailure",
            SampleZoneStatus::InputDataIntegrity => "inputDataIntegrity",
            SampleZoneStatus::PoorContrast => "poorContrast",
            SampleZoneStatus::DetectionAutoSuspended => "detectionAutoSuspended",
        };
        let known = |value: Option<f32>| value.map(rounded).transpose();
        let cells = report.cells.as_ref().map(|cells| {
            let densities = cells.density_veh_km.as_ref();
            let densities = densities.map(|all| all.iter().map(|k| known(Some(*k))).collect());
            Ok::<_, String>(Cells {
                length_m: rounded(cells.length_m)?,
                density_veh_km: densities.transpose()?,
            })
        });
        Ok(Self {
            lane: report.lane.get(),
            density_veh_km: known(report.density_veh_km)?,
            density_se: known(report.density_se)?,
            vehicles_mean: known(report.vehicles_mean)?,
            space_occupancy: known(report.space_occupancy)?,
            length_m: rounded(report.length_m)?,
            frames_used: report.frames_used,
            frames_expected: report.frames_expected,
            status: status.to_owned(),
            cells: cells.transpose()?,
        })
    }
}

/// A number with four decimals, as JSON messages have them.
fn rounded(value: f32) -> Result<f32, String> {
    let rounded = (value * 1e4).round() / 1e4;
    let value = if rounded.is_finite() { rounded } else { value };
    value.is_finite().then_some(value).ok_or_else(|| format!("has {value} for a number"))
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
    pub fn parse(bytes: &[u8]) -> Result<Self, String> {
        // The compact form begins with its version.
        let compact = matches!(bytes, [1..=wire::VERSION, ..]);
        let window = if compact { Self::of_wire(bytes)? } else { Self::of_json(bytes)? };
        window.check()?;
        Ok(window)
    }

    fn of_json(json: &[u8]) -> Result<Self, String> {
        let window: Self = serde_json::from_slice(json).map_err(|error| error.to_string())?;
        if window.schema != SCHEMA {
            return Err(format!("has schema {}, this program reads {SCHEMA}", window.schema));
        }
        Ok(window)
    }

    fn of_wire(bytes: &[u8]) -> Result<Self, String> {
        let message = wire::decode(bytes).map_err(|error| error.to_string())?;
        let report = &message.report;
        let length_ms = report.to.0.saturating_sub(report.from.0);
        if length_ms % 1000 != 0 {
            return Err(format!("has a window of {length_ms} ms"));
        }
        Ok(Self {
            schema: SCHEMA,
            site: message.site.as_str().to_owned(),
            seq: message.seq,
            window_s: u32::try_from(length_ms / 1000).map_err(|error| error.to_string())?,
            from: jiff::Timestamp::from_millisecond(report.from.0)
                .map_err(|error| error.to_string())?,
            clock_synced: message.clock_synced,
            lanes: report.lanes.iter().map(Lane::of_wire).collect::<Result<_, _>>()?,
            calibration: Calibration { rel_err: message.calibration.rel_err },
        })
    }

    fn check(&self) -> Result<(), String> {
        let window = self;
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
        Ok(())
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

    #[test]
    fn both_forms_of_a_message_give_the_same_window() {
        use verge::density::{Cells, WindowReport};
        use verge::units::{Direction, LaneId, UtcMs};
        let lane = |number, status, densities: Option<&[f32]>| LaneReport {
            lane: LaneId::new(number).unwrap(),
            direction: Direction::Away,
            density_veh_km: densities.map(|_| 12.500_01),
            density_se: densities.map(|_| 1.0),
            vehicles_mean: densities.map(|_| 1.25),
            by_class: None,
            space_occupancy: densities.map(|_| 0.05),
            length_m: 100.0,
            frames_used: if densities.is_some() { 30 } else { 0 },
            frames_expected: 30,
            status,
            cells: Some(Cells {
                length_m: if densities.is_some() { 50.0 } else { 25.0 },
                density_veh_km: densities.map(|all| all.iter().copied().collect()),
            }),
        };
        let name = |text: &str| text.try_into().unwrap();
        let mut message = wire::DensityMessage {
            site: name("k109f"),
            seq: 7,
            clock_synced: true,
            report: WindowReport {
                from: UtcMs(1_767_600_000_000),
                to: UtcMs(1_767_600_060_000),
                lanes: [
                    lane(1, SampleZoneStatus::Ok, Some(&[20.0, 5.0])),
                    lane(2, SampleZoneStatus::SensorFailure, None),
                ]
                .into_iter()
                .collect(),
            },
            calibration: wire::CalibrationRef {
                id: name("a"),
                sha256: [0; 32],
                rel_err: Some(0.02),
            },
            model: wire::ModelRef { name: name("m"), sha256: [0; 32] },
        };
        let parse = |message: &wire::DensityMessage| {
            let mut buffer = [0; wire::MAX_MESSAGE];
            Window::parse(wire::encode(message, &mut buffer).unwrap())
        };
        let json = self::message("k109f", 7, "2026-01-05T08:00:00.000Z");
        let json = Window::parse(json.as_bytes()).unwrap();
        assert_eq!(format!("{:?}", parse(&message).unwrap()), format!("{json:?}"));
        let mut buffer = [0; wire::MAX_MESSAGE];
        let bytes = wire::encode(&message, &mut buffer).unwrap();
        for cut in 1..bytes.len() {
            assert!(Window::parse(&bytes[..cut]).is_err(), "{cut}");
        }
        message.report.lanes[0].density_se = Some(f32::NAN);
        assert!(parse(&message).unwrap_err().contains("NaN"));
        message.report.lanes[0].density_se = None;
        message.report.from = UtcMs(1_767_600_000_001);
        assert!(parse(&message).unwrap_err().contains("59999 ms"));
    }
}
