//! Reading density messages back: the daemon's JSON, and postcard in hexadecimal.
//!
//! Owns what a reader may rely on. Unknown fields are passed over, so that a message with
//! more in it (`done` of a replay) is read; another schema version is refused.

use crate::daemon::publish::payload::{SCHEMA, status_name};
use crate::density::{self, LaneReport, MAX_LANE_CELLS, SampleZoneStatus, WindowReport};
use crate::lane::Name;
use crate::units::{Direction, LaneId, MAX_LANES, UtcMs, VehicleClass};
use crate::wire::{self, CalibrationRef, DensityMessage, ModelRef, WireError};
use serde::Deserialize;
use std::collections::BTreeMap;

/// How messages stand in the input, one a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum MessageForm {
    /// JSON, as `mosquitto_sub` prints it, with the topic in front (`-v`) or without.
    #[default]
    Json,
    /// Postcard in hexadecimal, as `mosquitto_sub -F %x` prints it.
    Postcard,
}

/// Why a line is no density message.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum ReadError {
    /// It is not JSON, or lacks a field.
    #[error("no density message: {0}; give what the daemon publishes under density/")]
    Json(String),
    /// A schema that this program does not read.
    #[error("schema version {0}, this program reads {SCHEMA}: update it")]
    Schema(u64),
    /// A field with a value that no message has.
    #[error("{field}: {reason}")]
    Value {
        /// Which.
        field: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// It is not hexadecimal.
    #[error("not hexadecimal at character {at}; print messages with `mosquitto_sub -F %x`")]
    Hex {
        /// The first character that is none, from 1.
        at: usize,
    },
    /// It is hexadecimal, but no message.
    #[error(transparent)]
    Wire(#[from] WireError),
}

/// Reads one message.
///
/// # Errors
/// [`ReadError`] says what is wrong with it.
pub fn read(form: MessageForm, line: &[u8]) -> Result<DensityMessage, ReadError> {
    let message = match form {
        MessageForm::Json => json(line)?,
        MessageForm::Postcard => wire::decode(&unhex(line)?)?,
    };
    check(&message)?;
    Ok(message)
}

/// Refuses values that no measurement has: they would look like one in other formats.
fn check(message: &DensityMessage) -> Result<(), ReadError> {
    if message.report.to <= message.report.from {
        return Err(value("to", "is not behind `from`".into()));
    }
    quantity("calibration.rel_err", message.calibration.rel_err)?;
    for lane in &message.report.lanes {
        quantity("density_veh_km", lane.density_veh_km)?;
        quantity("density_se", lane.density_se)?;
        quantity("vehicles_mean", lane.vehicles_mean)?;
        quantity("space_occupancy", lane.space_occupancy)?;
        quantity("length_m", Some(lane.length_m))?;
        for mean in lane.by_class.into_iter().flatten() {
            quantity("by_class", Some(mean))?;
        }
        if lane.space_occupancy.is_some_and(|share| share > 1.0) {
            return Err(value("space_occupancy", "more than 1".into()));
        }
        let Some(cells) = &lane.cells else { continue };
        quantity("cells.length_m", Some(cells.length_m))?;
        for &density in cells.density_veh_km.iter().flatten() {
            quantity("cells.density_veh_km", Some(density))?;
        }
    }
    Ok(())
}

fn quantity(field: &'static str, given: Option<f32>) -> Result<(), ReadError> {
    match given {
        Some(number) if !(number >= 0.0 && number.is_finite()) => {
            Err(value(field, format!("{number}: 0 or more is right")))
        }
        _ => Ok(()),
    }
}

#[derive(Deserialize)]
struct Version {
    schema: u64,
}

#[derive(Deserialize)]
struct Density {
    site: String,
    seq: u64,
    from: String,
    to: String,
    clock_synced: bool,
    lanes: Vec<Lane>,
    calibration: Calibration,
    model: Model,
}

#[derive(Deserialize)]
struct Lane {
    lane: LaneId,
    direction: Direction,
    density_veh_km: Option<f32>,
    density_se: Option<f32>,
    vehicles_mean: Option<f32>,
    by_class: Option<BTreeMap<String, f32>>,
    space_occupancy: Option<f32>,
    length_m: f32,
    frames_used: u32,
    frames_expected: u32,
    status: String,
    cells: Option<Cells>,
}

#[derive(Deserialize)]
struct Cells {
    length_m: f32,
    density_veh_km: Option<Vec<f32>>,
}

#[derive(Deserialize)]
struct Calibration {
    id: String,
    sha256: String,
    rel_err: Option<f32>,
}

#[derive(Deserialize)]
struct Model {
    name: String,
    sha256: String,
}

fn json(line: &[u8]) -> Result<DensityMessage, ReadError> {
    let wrong = |error: serde_json::Error| ReadError::Json(error.to_string());
    // `mosquitto_sub -v` prints the topic first, and no topic of ours has a brace.
    let begin = line.iter().position(|&byte| byte == b'{').unwrap_or(0);
    let text = line.get(begin..).unwrap_or_default();
    let Version { schema } = serde_json::from_slice(text).map_err(wrong)?;
    if schema != u64::from(SCHEMA) {
        return Err(ReadError::Schema(schema));
    }
    let density: Density = serde_json::from_slice(text).map_err(wrong)?;
    let (from, to) = (time("from", &density.from)?, time("to", &density.to)?);
    let lanes: Vec<_> = density.lanes.into_iter().map(lane).collect::<Result<_, _>>()?;
    let count = lanes.len();
    Ok(DensityMessage {
        site: name("site", &density.site)?,
        seq: density.seq,
        clock_synced: density.clock_synced,
        report: WindowReport {
            from,
            to,
            lanes: heapless::Vec::from_slice(&lanes)
                .map_err(|_| value("lanes", format!("{count}, at most {MAX_LANES} can be")))?,
        },
        calibration: CalibrationRef {
            id: name("calibration.id", &density.calibration.id)?,
            sha256: hash("calibration.sha256", &density.calibration.sha256)?,
            rel_err: density.calibration.rel_err,
        },
        model: ModelRef {
            name: name("model.name", &density.model.name)?,
            sha256: hash("model.sha256", &density.model.sha256)?,
        },
    })
}

fn lane(lane: Lane) -> Result<LaneReport, ReadError> {
    let known = [
        SampleZoneStatus::Ok,
        SampleZoneStatus::SensorFailure,
        SampleZoneStatus::InputDataIntegrity,
        SampleZoneStatus::PoorContrast,
        SampleZoneStatus::DetectionAutoSuspended,
    ];
    let status = known.into_iter().find(|&status| status_name(status) == lane.status);
    Ok(LaneReport {
        lane: lane.lane,
        direction: lane.direction,
        density_veh_km: lane.density_veh_km,
        density_se: lane.density_se,
        vehicles_mean: lane.vehicles_mean,
        by_class: lane.by_class.map(by_class).transpose()?,
        space_occupancy: lane.space_occupancy,
        length_m: lane.length_m,
        frames_used: lane.frames_used,
        frames_expected: lane.frames_expected,
        status: status.ok_or_else(|| value("status", format!("unknown: {:?}", lane.status)))?,
        cells: lane.cells.map(cells).transpose()?,
    })
}

fn cells(given: Cells) -> Result<density::Cells, ReadError> {
    let densities = |given: Vec<f32>| {
        let many = |_| format!("{}, at most {MAX_LANE_CELLS} can be", given.len());
        heapless::Vec::from_slice(&given).map_err(many)
    };
    let density_veh_km = given.density_veh_km.map(densities).transpose();
    let density_veh_km = density_veh_km.map_err(|reason| value("cells.density_veh_km", reason))?;
    Ok(density::Cells { length_m: given.length_m, density_veh_km })
}

fn by_class(given: BTreeMap<String, f32>) -> Result<[f32; VehicleClass::COUNT], ReadError> {
    let mut means = [0.0; VehicleClass::COUNT];
    for (name, mean) in given {
        let class = VehicleClass::from_name(&name)
            .ok_or_else(|| value("by_class", format!("unknown class {name:?}")))?;
        means[class.index()] = mean;
    }
    Ok(means)
}

const fn value(field: &'static str, reason: String) -> ReadError {
    ReadError::Value { field, reason }
}

fn name(field: &'static str, text: &str) -> Result<Name, ReadError> {
    let most = crate::lane::MAX_NAME;
    Name::try_from(text).map_err(|_| value(field, format!("longer than {most} bytes")))
}

fn time(field: &'static str, text: &str) -> Result<UtcMs, ReadError> {
    text.parse::<jiff::Timestamp>()
        .map(|time| UtcMs(time.as_millisecond()))
        .map_err(|error| value(field, error.to_string()))
}

fn hash(field: &'static str, text: &str) -> Result<[u8; 32], ReadError> {
    unhex(text.as_bytes())
        .ok()
        .and_then(|bytes| bytes.try_into().ok())
        .ok_or_else(|| value(field, format!("{text:?}: 64 hexadecimal digits are right")))
}

/// Bytes from hexadecimal, spaces around it passed over.
fn unhex(text: &[u8]) -> Result<Vec<u8>, ReadError> {
    let text = text.trim_ascii();
    let digit = |at: usize| {
        let byte = text.get(at).copied().unwrap_or_default();
        char::from(byte).to_digit(16).map(|digit| digit as u8).ok_or(ReadError::Hex { at: at + 1 })
    };
    (0..text.len()).step_by(2).map(|at| Ok(digit(at)? << 4 | digit(at + 1)?)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::export::tests::message;
    use crate::daemon::publish::payload;

    fn changed(from: &str, to: &str) -> Result<DensityMessage, ReadError> {
        let text = String::from_utf8(payload::density(&message(), None)).expect("JSON");
        assert!(text.contains(from), "{from} in {text}");
        read(MessageForm::Json, text.replacen(from, to, 1).as_bytes())
    }

    #[test]
    fn the_topic_in_front_and_unknown_fields_are_passed_over() {
        assert_eq!(changed("{", "verge/k109f/density/60s {").as_ref(), Ok(&message()));
        assert_eq!(changed("\"schema\":1", "\"schema\":1,\"done\":true").as_ref(), Ok(&message()));
        // A message from before cells were measured.
        let without = changed("\"cells\"", "\"other\"").expect("a right message");
        assert_eq!(without.report.lanes[0].cells, None);
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (from, to, expected) in [
            ("\"schema\":1", "\"schema\":2", "schema version 2"),
            ("\"seq\":7", "\"seq\":-7", "no density message"),
            ("\"site\":", "\"sight\":", "missing field `site`"),
            ("\"lane\":1", "\"lane\":9", "lane number"),
            ("24.25", "-24.25", "density_veh_km"),
            ("0.1234", "1.234", "space_occupancy"),
            ("\"oK\"", "\"fine\"", "status"),
            ("\"car\":", "\"tram\":", "by_class"),
            ("08:01:00.000Z", "08:01", "to"),
            ("08:01:00.000Z", "07:01:00.000Z", "to"),
            ("0101", "01", "calibration.sha256"),
            ("\"length_m\":123.7", "\"length_m\":-1", "length_m"),
            ("\"length_m\":61.85", "\"length_m\":-1", "cells.length_m"),
            ("[32.5,", "[-32.5,", "cells.density_veh_km"),
            ("[32.5,", &format!("[{}", "1,".repeat(32)), "33, at most 32"),
            ("{", "[", "no density message"),
        ] {
            let error = changed(from, to).expect_err(to).to_string();
            assert!(error.contains(expected), "{to}: {error}");
        }
    }

    #[test]
    fn postcard_is_read_from_hexadecimal() {
        let mut buffer = [0; wire::MAX_MESSAGE];
        let bytes = wire::encode(&message(), &mut buffer).expect("fits");
        let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        let line = format!("{hex}\r");
        assert_eq!(read(MessageForm::Postcard, line.as_bytes()), Ok(message()));
        let read = |text: &str| read(MessageForm::Postcard, text.as_bytes());
        assert_eq!(read("01zz"), Err(ReadError::Hex { at: 3 }));
        assert_eq!(read("012"), Err(ReadError::Hex { at: 4 }));
        assert_eq!(read("0300000000"), Err(WireError::Version { found: 3 }.into()));
    }
}
