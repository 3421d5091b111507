//! Reading density messages.
//!
//! Fields that are not known are passed over, so that a message of a later version is read as
//! long as its schema is; what is known is checked.

use crate::words::plain;
use crate::{AlarmMessage, Density, Health, SCHEMA, SCHEMA_WITH_PLACE, Schema, Wrong};
use serde::Deserialize;

/// Why bytes are not a density message.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum ReadError {
    /// Not JSON, or not an object with a message's fields.
    #[error("not a density message: {0}; give what the daemon publishes under density/")]
    Json(String),
    /// The same of the state of a sensor, or of an alarm.
    #[error("not a message of {kind}: {reason}; give what the daemon publishes under {kind}")]
    Other {
        /// `health` or `alarm`.
        kind: &'static str,
        /// The fault.
        reason: String,
    },
    /// A schema that this program does not read.
    #[error("schema version {0}, this program reads {SCHEMA} and {SCHEMA_WITH_PLACE}: update it")]
    Schema(u64),
    /// A field with a value that no message has.
    #[error(transparent)]
    Wrong(#[from] Wrong),
}

impl ReadError {
    /// The same of another kind of message.
    fn of(self, kind: &'static str) -> Self {
        match self {
            Self::Json(reason) => Self::Other { kind, reason },
            other => other,
        }
    }
}

/// Reads one message in JSON and checks it.
///
/// # Errors
/// [`ReadError`] says which field is wrong, and what would be right.
pub fn read(json: &[u8]) -> Result<Density, ReadError> {
    let message: Density = parsed(json)?;
    if !message.schema.is_known() {
        return Err(ReadError::Schema(message.schema.0.into()));
    }
    message.check()?;
    Ok(message)
}

/// Reads the state of a sensor in JSON and checks it.
///
/// # Errors
/// As [`read`].
pub fn read_health(json: &[u8]) -> Result<Health, ReadError> {
    let health: Health = parsed(json).map_err(|error| error.of("health"))?;
    if health.schema.0 != SCHEMA {
        return Err(ReadError::Schema(health.schema.0.into()));
    }
    health.check()?;
    Ok(health)
}

/// Reads an alarm in JSON and checks it.
///
/// # Errors
/// As [`read`].
pub fn read_alarm(json: &[u8]) -> Result<AlarmMessage, ReadError> {
    let alarm: AlarmMessage = parsed(json).map_err(|error| error.of("alarm"))?;
    if alarm.schema.0 != SCHEMA {
        return Err(ReadError::Schema(alarm.schema.0.into()));
    }
    alarm.check()?;
    Ok(alarm)
}

/// One object and nothing behind it.
fn parsed<T: serde::de::DeserializeOwned>(json: &[u8]) -> Result<T, ReadError> {
    // serde takes an array for a struct.
    if !json.trim_ascii_start().starts_with(b"{") {
        return Err(ReadError::Json("it does not begin with '{'".into()));
    }
    let mut parser = serde_json::Deserializer::from_slice(json);
    let message =
        serde_path_to_error::deserialize(&mut parser).map_err(|error| reason(json, &error))?;
    parser.end().map_err(|error| ReadError::Json(plain(&error.to_string())))?;
    Ok(message)
}

/// Another schema explains everything else.
fn reason(json: &[u8], error: &serde_path_to_error::Error<serde_json::Error>) -> ReadError {
    #[derive(Deserialize)]
    struct Version {
        schema: u64,
    }
    match serde_json::from_slice(json) {
        Ok(Version { schema })
            if !u32::try_from(schema).is_ok_and(|schema| Schema(schema).is_known()) =>
        {
            ReadError::Schema(schema)
        }
        _ => {
            let (path, inner) = (error.path().to_string(), error.inner());
            match inner.classify() {
                serde_json::error::Category::Data if path != "." => {
                    Wrong::new(path, plain(&inner.to_string())).into()
                }
                _ => ReadError::Json(plain(&inner.to_string())),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(crate) fn golden() -> String {
        let sha256 = "01".repeat(32);
        format!(
            "{{\"schema\":1,\"site\":\"k109f\",\"seq\":7,\"window_s\":60,\
            \"from\":\"2026-01-05T08:00:00.000Z\",\"to\":\"2026-01-05T08:01:00.000Z\",\
            \"clock_synced\":true,\"lanes\":[{{\"lane\":1,\"direction\":\"away\",\
            \"density_veh_km\":24.25,\"density_se\":3.5,\"vehicles_mean\":3.0,\
            \"by_class\":{{\"vehicle\":0.0,\"car\":1.0,\"van\":2.0,\"bus\":3.0,\"truck\":4.0,\
            \"motorcycle\":5.0}},\"space_occupancy\":0.1234,\"length_m\":123.7,\
            \"frames_used\":57,\"frames_expected\":60,\"status\":\"oK\",\
            \"cells\":{{\"length_m\":61.85,\"density_veh_km\":[32.5,16.0]}},\"density_ci90\":[16.0,32.5],\
            \"calibration_se\":0.5,\"counting_se\":3.5}},\
            {{\"lane\":2,\"direction\":\"unknown\",\"density_veh_km\":null,\"density_se\":null,\
            \"vehicles_mean\":null,\"by_class\":null,\"space_occupancy\":null,\
            \"length_m\":123.7,\"frames_used\":3,\"frames_expected\":60,\
            \"status\":\"poorContrast\",\"cells\":{{\"length_m\":61.85,\
            \"density_veh_km\":null}},\"density_ci90\":null,\"calibration_se\":null,\
            \"counting_se\":null}}],\
            \"calibration\":{{\"id\":\"c\",\"sha256\":\"{sha256}\",\"rel_err\":0.02}},\
            \"model\":{{\"name\":\"m\",\"sha256\":\"{sha256}\"}}}}"
        )
    }

    fn changed(from: &str, to: &str) -> Result<Density, ReadError> {
        let text = golden();
        assert!(text.contains(from), "{from} in {text}");
        read(text.replacen(from, to, 1).as_bytes())
    }

    #[test]
    fn what_is_read_is_written_in_the_same_bytes() {
        let message = read(golden().as_bytes()).expect("right");
        assert_eq!(String::from_utf8(crate::json(&message)).expect("JSON"), golden());
        let replayed = golden().replacen("\"seq\":7", "\"done\":true,\"seq\":7", 1);
        assert_eq!(read(replayed.as_bytes()).map(|message| message.done), Ok(Some(true)));
    }

    #[test]
    fn a_place_is_carried_and_a_message_without_one_is_as_before() {
        let place = crate::Place {
            name: Some("Siu Lam".into()),
            road: Some("Tuen Mun Road".into()),
            latitude: Some(22.362_51),
            longitude: Some(114.012_5),
            bearing: Some(120.0),
            ..crate::Place::default()
        };
        let fast = crate::LaneName { lane: 2, name: Some("fast lane".into()), order: Some(3) };
        let message = read(golden().as_bytes()).expect("right").at(&place, &[fast]);
        let golden = golden()
            .replacen(
                "\"schema\":1,\"site\":\"k109f\"",
                "\"schema\":2,\"site\":\"k109f\",\"place\":{\
                \"name\":\"Siu Lam\",\"road\":\"Tuen Mun Road\",\"direction\":null,\
                \"latitude\":22.36251,\"longitude\":114.0125,\"bearing\":120.0}",
                1,
            )
            .replacen("\"lane\":2", "\"lane\":2,\"lane_name\":\"fast lane\",\"lane_order\":3", 1);
        assert_eq!(String::from_utf8(crate::json(&message)).expect("JSON"), golden);
        assert_eq!(read(golden.as_bytes()), Ok(message));
    }

    #[test]
    fn unknown_fields_are_passed_over_and_optional_ones_may_be_absent() {
        let message = read(golden().as_bytes());
        assert_eq!(changed("\"schema\":1", "\"schema\":1,\"colour\":[1]"), message);
        // A message from before cells were measured.
        let without = changed("\"cells\"", "\"other\"").expect("a right message");
        assert_eq!(without.lanes[0].cells, None);
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (from, to, expected) in [
            ("\"schema\":1", "\"schema\":3", "schema version 3, this program reads 1 and 2"),
            ("\"schema\":1,\"site\"", "\"schema\":9,\"place\"", "schema version 9"),
            (
                "\"seq\":7",
                "\"seq\":7,\"place\":{\"latitude\":91,\"longitude\":0}",
                "place.latitude: 91: -90 to 90",
            ),
            (
                "\"seq\":7",
                "\"seq\":7,\"place\":{\"bearing\":\"north\"}",
                "place.bearing: must be a number, not the text",
            ),
            ("\"lane\":1", "\"lane\":1,\"lane_order\":0", "lanes[0].lane_order: 0: 1 to 16"),
            ("\"seq\":7", "\"seq\":-7", "seq: must be a whole number, 0 or more, not -7"),
            ("\"seq\":7", "\"seq\":0", "seq: 0: 1 to"),
            ("\"seq\":7", "\"seq\":9223372036854775807", "seq: 9223372036854775807: 1 to"),
            ("\"site\":", "\"sight\":", "not a density message: site is missing"),
            ("k109f", &"x".repeat(49), "site: longer than 48 bytes"),
            ("\"window_s\":60", "\"window_s\":1", "window_s: 1 s: 10 to 900"),
            ("\"window_s\":60", "\"window_s\":70", "window_s: 70 s: 10 to 900"),
            ("08:00:00.000Z", "08:00:01.000Z", "from: 2026-01-05T08:00:01.000Z is not the beginn"),
            ("2026-01-05T08:00", "-000001-01-01T08:00", "from: "),
            ("08:01:00.000Z", "08:01", "to: \"2026-01-05T08:01\" is not a time in RFC 3339"),
            ("08:01:00.000Z", "08:02:00.000Z", "to: 2026-01-05T08:02:00.000Z is not 60 s after"),
            ("\"lane\":1", "\"lane\":9", "lanes[0].lane: 9: 1 to 8"),
            ("\"lane\":2", "\"lane\":1", "lanes[1].lane: 1 is there twice"),
            ("24.25", "-24.25", "lanes[0].density_veh_km: -24.25: 0 to 10000 is right"),
            ("0.1234", "1.234", "lanes[0].space_occupancy: 1.234: 0 to 1"),
            ("\"oK\"", "\"fine\"", "lanes[0].status: \"fine\" is not known, only"),
            ("\"car\":", "\"tram\":", "lanes[0].by_class"),
            ("\"car\":1.0", "\"car\":-1.0", "lanes[0].by_class.car: -1"),
            ("\"length_m\":123.7", "\"length_m\":-1", "lanes[0].length_m: -1: above 0"),
            ("\"length_m\":61.85", "\"length_m\":0.0", "lanes[0].cells.length_m: 0: above 0"),
            ("\"length_m\":61.85", "\"length_m\":1e-9", "lanes[0].cells.length_m: 0.000000001"),
            (
                "\"length_m\":61.85",
                "\"length_m\":0.196",
                "lanes[0].cells.length_m: 0.196: 123.7 m in",
            ),
            ("[32.5,", "[-32.5,", "lanes[0].cells.density_veh_km[0]: -32.5"),
            ("[32.5,", &format!("[{}", "1,".repeat(32)), "33 of them, 2 of 61.85 m make"),
            ("\"frames_expected\":60", "\"frames_expected\":0", "lanes[0].frames_expected: 0"),
            ("0101", "01", "calibration.sha256: \"0101"),
            ("\"rel_err\":0.02", "\"rel_err\":-1", "calibration.rel_err: -1"),
            ("{", "[", "not a density message"),
            ("{\"schema", "{{", "not a density message: a name needs quotes"),
        ] {
            let error = changed(from, to).expect_err(to).to_string();
            assert!(error.contains(expected), "{to}: {error}");
        }
        // With serde_json's feature float_roundtrip, which some builds of the workspace turn on,
        // the parser refuses what is not an f32 before the check can.
        let error = changed("24.25", "1e39").expect_err("beyond f32").to_string();
        let by_check = error.contains("lanes[0].density_veh_km: inf: 0 to 10000 is right");
        assert!(by_check || error.contains("the number is too large (character"), "{error}");
    }
}
