//! FIWARE `TrafficFlowObserved` (smart data model of Transportation), NGSI-LD key values.
//!
//! `intensity` is the number of vehicles that passed in the period and `averageVehicleSpeed` the
//! space-mean speed, where vehicles are followed. The model has no density: `density` with its unit,
//! its 90 % interval and its errors is added, as NGSI allows. `location` is a GeoJSON point where the
//! site says where it is. What is not known is left out, never 0.

use super::geojson::point;
use crate::{Density, Direction, Lane, Passed, Place, Utc, rounded};
use serde::Serialize;
use serde_json::Value;
use std::fmt::Write;

/// Unit of the added property.
const DENSITY_UNIT: &str = "veh/km/lane";

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct TrafficFlowObserved<'a> {
    id: String,
    r#type: &'static str,
    name: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    location: Option<Value>,
    #[serde(skip_serializing_if = "Option::is_none")]
    address: Option<Address>,
    #[serde(skip_serializing_if = "Option::is_none")]
    description: Option<String>,
    date_observed: String,
    date_observed_from: Utc,
    date_observed_to: Utc,
    lane_id: u8,
    #[serde(skip_serializing_if = "Option::is_none")]
    lane_direction: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ref_road_segment: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    occupancy: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    intensity: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    average_vehicle_speed: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    average_headway_time: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    density: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    density_unit: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    density_standard_error: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    density_low90: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    density_high90: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    density_calibration_error: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    density_counting_error: Option<f32>,
    frames_used: u32,
    frames_expected: u32,
    sample_zone_status: &'static str,
}

/// The part of schema.org's `PostalAddress` that a road has.
#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Address {
    street_address: String,
}

/// The entities of one message, one a lane, as a JSON array for a batch upsert.
pub fn entities(message: &Density, road_segment: Option<&str>) -> String {
    let lanes: Vec<_> =
        message.lanes.iter().map(|lane| entity(message, lane, road_segment)).collect();
    serde_json::to_string(&lanes).expect("these types have string keys and no failing parts")
}

fn entity<'a>(
    message: &Density,
    lane: &Lane,
    ref_road_segment: Option<&'a str>,
) -> TrafficFlowObserved<'a> {
    let (from, to) = (message.from, message.to);
    let (site, window_s, number) = (&message.site, message.window_s, lane.lane);
    let unknown = Place::default();
    let place = message.place.as_ref().unwrap_or(&unknown);
    let traffic = lane.traffic.as_ref();
    let occupancy = traffic.map_or(lane.space_occupancy, |traffic| traffic.time_occupancy);
    TrafficFlowObserved {
        id: format!("urn:ngsi-ld:TrafficFlowObserved:{}:{window_s}s:lane{number}", escaped(site)),
        r#type: "TrafficFlowObserved",
        name: plain(place.name.as_deref().unwrap_or(site)),
        location: place.position().map(point),
        address: place.road.as_deref().map(|road| Address { street_address: plain(road) }),
        description: place.direction.as_deref().map(plain),
        date_observed: format!("{from}/{to}"),
        date_observed_from: from,
        date_observed_to: to,
        lane_id: lane.lane_order.unwrap_or(number),
        lane_direction: match lane.direction {
            Direction::Away => Some("forward"),
            Direction::Toward => Some("backward"),
            Direction::Unknown => None,
        },
        ref_road_segment,
        occupancy: occupancy.map(rounded),
        intensity: traffic.and_then(|traffic| traffic.passed.as_ref()).map(Passed::all),
        average_vehicle_speed: traffic.and_then(|traffic| traffic.speed_kmh).map(rounded),
        average_headway_time: traffic.and_then(|traffic| traffic.headway_s).map(rounded),
        density: lane.density_veh_km.map(rounded),
        density_unit: lane.density_veh_km.map(|_| DENSITY_UNIT),
        density_standard_error: lane.density_se.map(rounded),
        density_low90: lane.density_ci90.map(|[low, _]| rounded(low)),
        density_high90: lane.density_ci90.map(|[_, high]| rounded(high)),
        density_calibration_error: lane.calibration_se.map(rounded),
        density_counting_error: lane.counting_se.map(rounded),
        frames_used: lane.frames_used,
        frames_expected: lane.frames_expected,
        sample_zone_status: lane.status.name(),
    }
}

/// A site's name inside an URN (RFC 8141): all but the unreserved characters in percent
/// form.
fn escaped(site: &str) -> String {
    let mut text = String::new();
    for byte in site.bytes() {
        if byte.is_ascii_alphanumeric() || b"-._~".contains(&byte) {
            text.push(char::from(byte));
        } else {
            // A string takes what is written to it.
            let _ = write!(text, "%{byte:02X}");
        }
    }
    text
}

/// Text without the characters that NGSI-v2 forbids in values.
fn plain(text: &str) -> String {
    text.replace(['<', '>', '"', '\'', '=', ';', '(', ')'], " ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::tests::{followed, message, placed};
    use serde_json::{Value, json};

    #[test]
    fn golden_entities() {
        let text = entities(&message(), Some("urn:ngsi-ld:RoadSegment:7"));
        let id = "urn:ngsi-ld:TrafficFlowObserved:k109f%20%22%3C%26%3E%22%2C%20east:60s:lane";
        let expected = json!([
            {
                "id": format!("{id}1"),
                "type": "TrafficFlowObserved",
                "name": "k109f   &  , east",
                "dateObserved": "2026-01-05T08:00:00.000Z/2026-01-05T08:01:00.000Z",
                "dateObservedFrom": "2026-01-05T08:00:00.000Z",
                "dateObservedTo": "2026-01-05T08:01:00.000Z",
                "laneId": 1,
                "laneDirection": "forward",
                "refRoadSegment": "urn:ngsi-ld:RoadSegment:7",
                "occupancy": 0.1234,
                "density": 24.25,
                "densityUnit": "veh/km/lane",
                "densityStandardError": 3.5,
                "densityLow90": 16.0,
                "densityHigh90": 32.5,
                "densityCalibrationError": 0.5,
                "densityCountingError": 3.5,
                "framesUsed": 57,
                "framesExpected": 60,
                "sampleZoneStatus": "oK",
            },
            {
                "id": format!("{id}2"),
                "type": "TrafficFlowObserved",
                "name": "k109f   &  , east",
                "dateObserved": "2026-01-05T08:00:00.000Z/2026-01-05T08:01:00.000Z",
                "dateObservedFrom": "2026-01-05T08:00:00.000Z",
                "dateObservedTo": "2026-01-05T08:01:00.000Z",
                "laneId": 2,
                "refRoadSegment": "urn:ngsi-ld:RoadSegment:7",
                "framesUsed": 3,
                "framesExpected": 60,
                "sampleZoneStatus": "poorContrast",
            },
        ]);
        let found: Value = serde_json::from_str(&text).expect("JSON");
        assert_eq!(found.to_string(), expected.to_string());
    }

    #[test]
    fn intensity_and_speed_where_vehicles_are_followed() {
        let found: Value = serde_json::from_str(&entities(&followed(), None)).expect("JSON");
        let [known, unknown] = [&found[0], &found[1]];
        assert_eq!(known["intensity"], 12);
        assert_eq!(known["averageHeadwayTime"], 5.0);
        assert!((known["averageVehicleSpeed"].as_f64().expect("a number") - 36.1).abs() < 1e-4);
        assert!((known["occupancy"].as_f64().expect("a number") - 0.1).abs() < 1e-4);
        for absent in ["intensity", "averageVehicleSpeed", "averageHeadwayTime", "occupancy"] {
            assert_eq!(unknown[absent], Value::Null, "{absent}");
        }
    }

    #[test]
    fn a_place_is_a_location_and_an_address() {
        let text = entities(&placed(message()), None);
        let found: Value = serde_json::from_str(&text).expect("JSON");
        assert_eq!(found[1]["location"]["type"], "Point");
        assert_eq!(found[1]["location"]["coordinates"], json!([114.0125, 22.36251]));
        assert_eq!(found[1]["address"]["streetAddress"], "Tuen Mun Road");
        assert_eq!(found[1]["name"], "Siu Lam");
        assert_eq!((&found[0]["laneId"], &found[1]["laneId"]), (&json!(1), &json!(2)));
    }

    /// Attributes of the model that are used, with what its schema says of each.
    #[test]
    fn used_attributes_are_as_the_model_has_them() {
        let schema = json!({
            "type": "array",
            "items": {
                "type": "object",
                "required": ["id", "type", "dateObserved"],
                "properties": {
                    "id": { "type": "string", "maxLength": 256,
                            "pattern": "^[\\w\\-\\.\\{\\}\\$\\+\\*\\[\\]`|~^@!,:\\\\%]+$" },
                    "type": { "enum": ["TrafficFlowObserved"] },
                    "laneId": { "type": "integer", "minimum": 1 },
                    "laneDirection": { "enum": ["forward", "backward"] },
                    "refRoadSegment": { "type": "string" },
                    "location": { "type": "object", "required": ["type", "coordinates"],
                        "properties": { "type": { "enum": ["Point"] },
                            "coordinates": { "type": "array", "minItems": 2,
                                "items": { "type": "number" } } } },
                    "address": { "type": "object",
                        "properties": { "streetAddress": { "type": "string" } } },
                    "description": { "type": "string" },
                    "dateObserved": { "type": "string" },
                    "dateObservedFrom": { "type": "string", "pattern": "^[-0-9]{10}T[:.0-9]{12}Z$" },
                    "dateObservedTo": { "type": "string", "pattern": "^[-0-9]{10}T[:.0-9]{12}Z$" },
                    "occupancy": { "type": "number", "minimum": 0, "maximum": 1 },
                    "intensity": { "type": "number", "minimum": 0 },
                    "averageVehicleSpeed": { "type": "number", "minimum": 0 },
                    "averageHeadwayTime": { "type": "number", "minimum": 0 },
                    "name": { "type": "string", "pattern": "^[^<>\"'=;()]*$" }
                }
            }
        });
        let validator = jsonschema::validator_for(&schema).expect("a right schema");
        let found: Value =
            serde_json::from_str(&entities(&placed(followed()), None)).expect("JSON");
        let errors: Vec<_> = validator.iter_errors(&found).map(|e| e.to_string()).collect();
        assert!(errors.is_empty(), "{errors:#?}");
    }
}
