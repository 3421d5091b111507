//! The values of NTCIP 1209 (transportation sensor systems), as JSON.
//!
//! Owns the numbers of the standard, not its protocol: names and values are those of a row
//! of `dataCollectionTable`, for an SNMP agent to serve. A lane is a sample zone. Density
//! is not an object of the standard and is added. What is not known is 65535.

use crate::{Density, Lane, Passed, Utc};
use serde::Serialize;

/// "No value": missing, or not measured by this sensor.
pub const MISSING: u16 = 65535;

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Zone<'a> {
    site: &'a str,
    sample_zone: u8,
    sample_end_time: Utc,
    /// s
    sample_period: u32,
    /// Vehicles that passed in the period, where they are followed.
    volume_data: u16,
    /// Tenths of a percent: of the time where vehicles are followed, else of the lane's length.
    percent_occupancy: u16,
    /// Tenths of km/h, space mean, where vehicles are followed.
    speed_data: u16,
    sample_zone_status: u8,
    /// Whole veh/km, an addition, as are the ends of its 90 % interval, the lower one rounded
    /// down and the upper one up.
    density_veh_km: u16,
    density_low90_veh_km: u16,
    density_high90_veh_km: u16,
}

/// The zones of one message, one a line.
pub fn zones(message: &Density) -> String {
    let lanes: Vec<_> = message.lanes.iter().map(|lane| zone(message, lane)).collect();
    lanes.join("\n")
}

fn zone(message: &Density, lane: &Lane) -> String {
    let traffic = lane.traffic.as_ref();
    let passed = traffic.and_then(|traffic| traffic.passed.as_ref()).map(Passed::all);
    let occupancy = traffic.map_or(lane.space_occupancy, |traffic| traffic.time_occupancy);
    let zone = Zone {
        site: &message.site,
        sample_zone: lane.lane,
        sample_end_time: message.to,
        sample_period: message.window_s,
        volume_data: number(passed.map(|count| count as f32)),
        percent_occupancy: number(occupancy.map(|share| share * 1000.0)),
        speed_data: number(traffic.and_then(|traffic| traffic.speed_kmh).map(|v| v * 10.0)),
        sample_zone_status: lane.status.number(),
        density_veh_km: number(lane.density_veh_km),
        density_low90_veh_km: number(lane.density_ci90.map(|[low, _]| low.floor())),
        density_high90_veh_km: number(lane.density_ci90.map(|[_, high]| high.ceil())),
    };
    serde_json::to_string(&zone).expect("these types have string keys and no failing parts")
}

/// A whole number below [`MISSING`].
fn number(value: Option<f32>) -> u16 {
    // `as` saturates.
    value.map_or(MISSING, |value| (value.round() as u16).min(MISSING - 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::tests::{followed, message};

    #[test]
    fn golden_zones() {
        let expected = "\
            {\"site\":\"k109f \\\"<&>\\\", east\",\"sampleZone\":1,\
            \"sampleEndTime\":\"2026-01-05T08:01:00.000Z\",\"samplePeriod\":60,\
            \"volumeData\":65535,\"percentOccupancy\":123,\"speedData\":65535,\
            \"sampleZoneStatus\":2,\"densityVehKm\":24,\
            \"densityLow90VehKm\":16,\"densityHigh90VehKm\":33}\n\
            {\"site\":\"k109f \\\"<&>\\\", east\",\"sampleZone\":2,\
            \"sampleEndTime\":\"2026-01-05T08:01:00.000Z\",\"samplePeriod\":60,\
            \"volumeData\":65535,\"percentOccupancy\":65535,\"speedData\":65535,\
            \"sampleZoneStatus\":12,\"densityVehKm\":65535,\
            \"densityLow90VehKm\":65535,\"densityHigh90VehKm\":65535}";
        assert_eq!(zones(&message()), expected);
    }

    #[test]
    fn volume_occupancy_and_speed_where_vehicles_are_followed() {
        let zones = zones(&followed());
        let (first, second) = zones.split_once('\n').expect("two lanes");
        let has = "\"volumeData\":12,\"percentOccupancy\":100,\"speedData\":361,";
        assert!(first.contains(has), "{first}");
        let none = "\"volumeData\":65535,\"percentOccupancy\":65535,\"speedData\":65535,";
        assert!(second.contains(none), "{second}");
    }

    #[test]
    fn no_value_looks_like_a_missing_one() {
        assert_eq!(number(Some(1e9)), 65534);
        assert_eq!(number(Some(0.0)), 0);
        assert_eq!(number(None), 65535);
    }
}
