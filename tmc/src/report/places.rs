//! Where sites are and what people call them: a table that the centre keeps.
//!
//! Owns its columns and what may stand in them, and GeoJSON (RFC 7946) of all sites; messages carry
//! no place.

use super::summary::Summary;
use crate::csv::{Column, Row, Table};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use verge_desk::Failure;

/// A site as people know it; what the table leaves out is empty or none.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Place {
    /// What people call it.
    pub(super) name: String,
    /// The road.
    pub(super) road: String,
    /// Where its traffic goes.
    pub(super) direction: String,
    /// Latitude and longitude, degrees (WGS 84).
    pub(super) position: Option<[f64; 2]>,
    /// Where its traffic goes, degrees from north over east.
    pub(super) bearing: Option<f64>,
}

impl Place {
    /// Its name, road and direction, those that are known.
    pub(super) fn words(&self) -> Vec<&str> {
        let all = [&self.name, &self.road, &self.direction];
        all.into_iter().map(String::as_str).filter(|text| !text.is_empty()).collect()
    }
}

/// Sites by their names in topics.
pub(super) type Places = BTreeMap<String, Place>;

/// Reads the table: `site`, and of `name`, `road`, `direction`, `latitude`, `longitude` and
/// `bearing` those that there are.
///
/// # Errors
/// [`Failure`] with line and column.
pub(super) fn read(path: &Path) -> Result<Places, Failure> {
    let table = Table::read(path)?;
    let site = table.column("site")?;
    let [name, road, direction] = ["name", "road", "direction"].map(|name| table.find(name));
    let [latitude, longitude, bearing] =
        ["latitude", "longitude", "bearing"].map(|name| table.find(name));
    let mut places = Places::new();
    for row in table.rows() {
        let row = row?;
        let text = |column: &Option<Column>| {
            column.as_ref().map_or_else(String::new, |column| row.text(column).to_owned())
        };
        let position = [
            degrees(&row, latitude.as_ref(), [-90.0, 90.0])?,
            degrees(&row, longitude.as_ref(), [-180.0, 180.0])?,
        ];
        let position = match position {
            [Some(latitude), Some(longitude)] => Some([latitude, longitude]),
            [None, None] => None,
            _ => return Err(row.wrong(&site, "has one of latitude and longitude; give both")),
        };
        let place = Place {
            name: text(&name),
            road: text(&road),
            direction: text(&direction),
            position,
            bearing: degrees(&row, bearing.as_ref(), [0.0, 360.0])?,
        };
        if places.insert(row.text(&site).to_owned(), place).is_some() {
            return Err(row.wrong(&site, "is there twice"));
        }
    }
    Ok(places)
}

fn degrees(
    row: &Row<'_>,
    column: Option<&Column>,
    [least, most]: [f64; 2],
) -> Result<Option<f64>, Failure> {
    let Some(column) = column.filter(|column| !row.text(column).is_empty()) else {
        return Ok(None);
    };
    let number: Option<f64> = row.text(column).parse().ok();
    let right = number.filter(|number| (least..=most).contains(number));
    let wrong = || row.wrong(column, &format!("is not a number of degrees from {least} to {most}"));
    right.map(Some).ok_or_else(wrong)
}

/// All sites as GeoJSON, each with its figures; one without a position has no geometry.
pub(super) fn geojson(summaries: &[Summary], places: &Places) -> Vec<u8> {
    let unknown = Place::default();
    let feature = |summary: &Summary| {
        let place = places.get(&summary.site).unwrap_or(&unknown);
        let text = |text: &str| if text.is_empty() { Value::Null } else { text.into() };
        let (mean, [archived, known]) = (summary.mean(), summary.completeness_pct());
        let rounded = |value: f64| (value * 100.0).round() / 100.0;
        json!({
            "type": "Feature",
            "id": summary.site,
            "geometry": place.position.map(|[latitude, longitude]| {
                json!({ "type": "Point", "coordinates": [longitude, latitude] })
            }),
            "properties": {
                "site": summary.site,
                "name": text(&place.name),
                "road": text(&place.road),
                "direction": text(&place.direction),
                "bearing": place.bearing,
                "mean_density_veh_km": mean.value().map(rounded),
                "low90_veh_km": mean.interval().map(|[low, _]| rounded(low)),
                "high90_veh_km": mean.interval().map(|[_, high]| rounded(high)),
                "archived_pct": rounded(archived),
                "known_pct": rounded(known),
            },
        })
    };
    let features: Vec<_> = summaries.iter().map(feature).collect();
    let all = json!({ "type": "FeatureCollection", "features": features });
    format!("{all}\n").into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Result<Places, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sites.csv");
        std::fs::write(&path, text).unwrap();
        read(&path).map_err(|failure| failure.to_string())
    }

    #[test]
    fn columns_that_are_not_there_are_not_known() {
        let places = of("site,name,latitude,longitude,bearing\n\
             a,\"Bridge, north\",22.28,-114.16,270\nb,,,,\n")
        .unwrap();
        let expected = Place {
            name: "Bridge, north".into(),
            position: Some([22.28, -114.16]),
            bearing: Some(270.0),
            ..Place::default()
        };
        assert_eq!(places["a"], expected);
        assert_eq!(places["b"], Place::default());
    }

    #[test]
    fn what_is_wrong_is_told_by_line() {
        for (text, said) in [
            ("name\nx\n", "has no column site"),
            (
                "site,latitude,longitude\na,91,0\n",
                "line 2: column latitude: \"91\" is not a number",
            ),
            ("site,latitude,longitude\na,1,east\n", "column longitude: \"east\" is not"),
            ("site,latitude,longitude\na,1,\n", "has one of latitude and longitude"),
            ("site\na\na\n", "line 3: column site: \"a\" is there twice"),
        ] {
            let error = of(text).unwrap_err();
            assert!(error.contains(said), "{error}");
        }
    }
}
