//! GeoJSON (RFC 7946): one feature a lane and window, one a line, as map programs read it
//! (`GeoJSONSeq`).
//!
//! A site that does not say where it is has no geometry. What is not known is null.

use crate::{Density, Lane, Place};
use serde_json::{Value, json};

/// The features of one message, one a line.
pub fn features(message: &Density) -> String {
    let lanes: Vec<_> =
        message.lanes.iter().map(|lane| feature(message, lane).to_string()).collect();
    lanes.join("\n")
}

/// A position as a GeoJSON point.
pub fn point([latitude, longitude]: [f64; 2]) -> Value {
    json!({ "type": "Point", "coordinates": [longitude, latitude] })
}

fn feature(message: &Density, lane: &Lane) -> Value {
    let unknown = Place::default();
    let place = message.place.as_ref().unwrap_or(&unknown);
    let traffic = lane.traffic.as_ref();
    // As text, so that 24.3 does not become 24.299999237060547.
    let number = |value: Option<f32>| {
        value.and_then(|value| serde_json::from_str(&value.to_string()).ok()).unwrap_or(Value::Null)
    };
    json!({
        "type": "Feature",
        "geometry": place.position().map(point),
        "properties": {
            "site": message.site,
            "name": place.name,
            "road": place.road,
            "direction": place.direction,
            "bearing": place.bearing,
            "from": message.from,
            "to": message.to,
            "window_s": message.window_s,
            "lane": lane.lane,
            "lane_name": lane.lane_name,
            "lane_order": lane.lane_order,
            "status": lane.status.name(),
            "density_veh_km": number(lane.density_veh_km),
            "density_low90": number(lane.density_ci90.map(|[low, _]| low)),
            "density_high90": number(lane.density_ci90.map(|[_, high]| high)),
            "flow_veh_h": number(traffic.and_then(|traffic| traffic.flow_veh_h)),
            "speed_kmh": number(traffic.and_then(|traffic| traffic.speed_kmh)),
            "time_occupancy": number(traffic.and_then(|traffic| traffic.time_occupancy)),
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::tests::{followed, message, placed};

    #[test]
    fn a_lane_is_a_feature_where_its_site_is() {
        let features = features(&placed(followed()));
        let lanes: Vec<Value> =
            features.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
        assert_eq!(lanes.len(), 2);
        assert_eq!(lanes[0]["geometry"]["coordinates"], json!([114.0125, 22.36251]));
        assert_eq!(lanes[0]["properties"]["speed_kmh"], json!(36.1));
        assert_eq!(lanes[0]["properties"]["density_veh_km"], json!(24.25));
        assert_eq!(lanes[1]["properties"]["lane_name"], "fast lane");
        assert_eq!(lanes[1]["properties"]["density_veh_km"], Value::Null);
        let nowhere: Value =
            serde_json::from_str(super::features(&message()).lines().next().expect("a lane"))
                .expect("JSON");
        assert_eq!(nowhere["geometry"], Value::Null);
    }
}
