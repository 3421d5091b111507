//! Where a site is and what people call it: what its configuration says of the place.
//!
//! Owns the bounds of each field. A message carries a place from schema 2 on; the name in topics
//! stays [`crate::Density::site`].

use crate::Wrong;
use crate::wrong::count;
use serde::{Deserialize, Serialize};

/// Longest name of a site's place, road, direction or lane, bytes.
pub const LONGEST_PLACE: usize = 96;
/// Most lanes of a carriageway.
const MOST_ORDER: u8 = 16;

/// Where a site is and what people call it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "place"))]
#[serde(default)]
pub struct Place {
    /// Name of the site, for people.
    #[cfg_attr(feature = "schema", schemars(length(max = LONGEST_PLACE)))]
    pub name: Option<String>,
    /// The road.
    #[cfg_attr(feature = "schema", schemars(length(max = LONGEST_PLACE)))]
    pub road: Option<String>,
    /// Where the road's traffic goes, in words.
    #[cfg_attr(feature = "schema", schemars(length(max = LONGEST_PLACE)))]
    pub direction: Option<String>,
    /// Latitude of the measured stretch, degrees (WGS 84); with the longitude or not at all.
    #[cfg_attr(feature = "schema", schemars(range(min = -90, max = 90)))]
    pub latitude: Option<f64>,
    /// Longitude of the measured stretch, degrees (WGS 84).
    #[cfg_attr(feature = "schema", schemars(range(min = -180, max = 180)))]
    pub longitude: Option<f64>,
    /// Where its traffic goes, degrees from north over east.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = 360)))]
    pub bearing: Option<f64>,
}

/// A road authority's names for a lane.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LaneName {
    /// Its number in the lane table.
    pub lane: u8,
    /// Name for people.
    pub name: Option<String>,
    /// Its number on the carriageway as the country counts.
    pub order: Option<u8>,
}

impl Place {
    /// Latitude and longitude.
    pub fn position(&self) -> Option<[f64; 2]> {
        self.latitude.zip(self.longitude).map(|(latitude, longitude)| [latitude, longitude])
    }

    /// Name, road and direction, those that are known.
    pub fn words(&self) -> Vec<&str> {
        [&self.name, &self.road, &self.direction]
            .into_iter()
            .flatten()
            .map(String::as_str)
            .collect()
    }

    /// Refuses what no place on Earth has.
    ///
    /// # Errors
    /// The first [`Wrong`] field.
    pub fn check(&self) -> Result<(), Wrong> {
        let Self { name, road, direction, latitude, longitude, bearing } = self;
        words("name", name.as_deref())?;
        words("road", road.as_deref())?;
        words("direction", direction.as_deref())?;
        degrees("latitude", *latitude, [-90.0, 90.0])?;
        degrees("longitude", *longitude, [-180.0, 180.0])?;
        degrees("bearing", *bearing, [0.0, 360.0])?;
        match (latitude, longitude) {
            (Some(_), None) => Err(Wrong::new("longitude", "is missing beside the latitude")),
            (None, Some(_)) => Err(Wrong::new("latitude", "is missing beside the longitude")),
            _ => Ok(()),
        }
    }
}

/// Refuses a lane's name or order that no lane has.
///
/// # Errors
/// The [`Wrong`] field.
pub fn check_lane(name: Option<&str>, order: Option<u8>) -> Result<(), Wrong> {
    words("lane_name", name)?;
    order.map_or(Ok(()), |order| count("lane_order", order.into(), 1, MOST_ORDER.into()))
}

fn words(field: &str, given: Option<&str>) -> Result<(), Wrong> {
    let Some(text) = given else { return Ok(()) };
    if text.len() > LONGEST_PLACE {
        return Err(Wrong::new(field, format!("longer than {LONGEST_PLACE} bytes")));
    }
    if text.trim().is_empty() || text.chars().any(char::is_control) {
        let reason = format!("{text:?}: give words without control characters, or leave it out");
        return Err(Wrong::new(field, reason));
    }
    Ok(())
}

fn degrees(field: &str, given: Option<f64>, [least, most]: [f64; 2]) -> Result<(), Wrong> {
    match given {
        Some(given) if !(least..=most).contains(&given) => {
            Err(Wrong::new(field, format!("{given}: {least} to {most} degrees is right")))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_place_has_is_refused_by_its_field() {
        let right = Place {
            name: Some("Siu Lam".into()),
            latitude: Some(22.36),
            longitude: Some(114.01),
            bearing: Some(120.0),
            ..Place::default()
        };
        assert_eq!(right.check(), Ok(()));
        assert_eq!(Place::default().check(), Ok(()));
        let with = |change: fn(&mut Place)| {
            let mut place = right.clone();
            change(&mut place);
            place.check().expect_err("wrong").to_string()
        };
        assert_eq!(with(|p| p.latitude = Some(91.0)), "latitude: 91: -90 to 90 degrees is right");
        assert_eq!(with(|p| p.longitude = None), "longitude: is missing beside the latitude");
        assert_eq!(with(|p| p.latitude = None), "latitude: is missing beside the longitude");
        assert!(with(|p| p.bearing = Some(f64::NAN)).starts_with("bearing: NaN: 0 to 360"));
        assert!(with(|p| p.road = Some(" ".into())).starts_with("road: \" \": give words"));
        assert!(with(|p| p.name = Some("x".repeat(97))).starts_with("name: longer than 96"));
        assert!(check_lane(Some("\n"), None).is_err() && check_lane(None, Some(0)).is_err());
        assert_eq!(check_lane(Some("fast lane"), Some(3)), Ok(()));
    }
}
