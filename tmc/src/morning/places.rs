//! Where sites are and what people call them: by their own messages, and by a table that the centre
//! keeps, which has the last word.
//!
//! Owns the table's columns and what may stand in them.

use crate::csv::{Column, Row, Table};
use crate::store::events::{self, PlaceRow};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use verge_desk::Failure;
use verge_messages::Place;

/// Sites of the centre's own table, by their names in topics.
pub type Places = BTreeMap<String, Place>;

/// A site's place, and names of its lanes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Known {
    /// Position and names.
    pub place: Place,
    /// Names of some lanes.
    pub lanes: BTreeMap<i32, String>,
}

/// Reads the table: `site`, and of `name`, `road`, `direction`, `latitude`, `longitude` and
/// `bearing` those that there are.
///
/// # Errors
/// [`Failure`] with line and column.
pub fn read(path: &Path) -> Result<Places, Failure> {
    let table = Table::read(path)?;
    let site = table.column("site")?;
    let [name, road, direction] = ["name", "road", "direction"].map(|name| table.find(name));
    let [latitude, longitude, bearing] =
        ["latitude", "longitude", "bearing"].map(|name| table.find(name));
    let mut places = Places::new();
    for row in table.rows() {
        let row = row?;
        let text = |column: &Option<Column>| {
            let text = column.as_ref().map(|column| row.text(column).trim().to_owned());
            text.filter(|text| !text.is_empty())
        };
        let place = Place {
            name: text(&name),
            road: text(&road),
            direction: text(&direction),
            latitude: degrees(&row, latitude.as_ref(), [-90.0, 90.0])?,
            longitude: degrees(&row, longitude.as_ref(), [-180.0, 180.0])?,
            bearing: degrees(&row, bearing.as_ref(), [0.0, 360.0])?,
        };
        if place.latitude.is_some() != place.longitude.is_some() {
            return Err(row.wrong(&site, "has one of latitude and longitude; give both"));
        }
        place.check().map_err(|wrong| row.wrong(&site, &wrong.to_string()))?;
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

/// The places of an archive, as the sites' latest messages have them, under those that are listed.
pub fn of_archive(root: &Path, listed: &Places, told: &mut Vec<String>) -> BTreeMap<String, Known> {
    let rows: Vec<PlaceRow> =
        events::read_table(&events::places_path(root)).unwrap_or_else(|failure| {
            told.push(failure.to_string());
            Vec::new()
        });
    let mut known = BTreeMap::<String, Known>::new();
    // By site and time: the latest stays.
    for PlaceRow { site, place, lanes, .. } in rows {
        let lanes = lane_names(&lanes);
        known.insert(site, Known { place, lanes });
    }
    for (site, listed) in listed {
        let place = &mut known.entry(site.clone()).or_default().place;
        let Place { name, road, direction, latitude, longitude, bearing } = listed.clone();
        place.name = name.or(place.name.take());
        place.road = road.or(place.road.take());
        place.direction = direction.or(place.direction.take());
        place.bearing = bearing.or(place.bearing);
        if latitude.is_some() {
            (place.latitude, place.longitude) = (latitude, longitude);
        }
    }
    known
}

fn lane_names(json: &str) -> BTreeMap<i32, String> {
    let lanes: Vec<Value> = serde_json::from_str(json).unwrap_or_default();
    let name = |lane: &Value| {
        let number = i32::try_from(lane["lane"].as_i64()?).ok()?;
        Some((number, lane["name"].as_str()?.to_owned()))
    };
    lanes.iter().filter_map(name).collect()
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
            name: Some("Bridge, north".into()),
            latitude: Some(22.28),
            longitude: Some(-114.16),
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

    #[test]
    fn the_centres_table_has_the_last_word() {
        let folder = tempfile::tempdir().unwrap();
        let row = PlaceRow {
            site: "a".into(),
            since_ms: 7,
            place: Place {
                name: Some("by the box".into()),
                road: Some("A 1".into()),
                ..Place::default()
            },
            lanes: "[{\"lane\":2,\"name\":\"fast lane\",\"order\":null}]".into(),
        };
        events::write_table(&events::places_path(folder.path()), &[row]).unwrap();
        let listed = of("site,name,latitude,longitude\na,by the centre,1,2\n").unwrap();
        let known = of_archive(folder.path(), &listed, &mut Vec::new());
        assert_eq!(known["a"].place.words(), ["by the centre", "A 1"]);
        assert_eq!(known["a"].place.position(), Some([1.0, 2.0]));
        assert_eq!(known["a"].lanes[&2], "fast lane");
    }
}
