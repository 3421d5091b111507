//! `site`: the site's name, or a table with its name and where it is.
//!
//! Owns its keys and their values; what a place may hold is `verge_messages`' to say.

use super::foreign::shown;
use crate::lane::MAX_NAME;
use serde::Deserialize;
use serde::de::value::MapAccessDeserializer;
use serde::de::{Deserializer, MapAccess, Visitor};
use std::collections::BTreeSet;
use verge_messages::{LaneName, MOST_LANES, Place, check_lane};

/// A site, and where it is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Site {
    /// Its name, in topics and messages.
    pub id: String,
    /// Its position; `None` where the file has none.
    pub place: Option<Place>,
    /// Names of its lanes.
    pub lanes: Vec<LaneName>,
}

/// `[site]`
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    id: String,
    name: Option<String>,
    road: Option<String>,
    direction: Option<String>,
    latitude: Option<f64>,
    longitude: Option<f64>,
    bearing: Option<f64>,
    #[serde(default)]
    lanes: Vec<LaneTable>,
}

/// `[[site.lanes]]`
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LaneTable {
    lane: u8,
    name: Option<String>,
    order: Option<u8>,
}

impl<'de> Deserialize<'de> for Site {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Either;

        impl<'de> Visitor<'de> for Either {
            type Value = Site;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(
                    "the site's name in quotes, or a section [site] with its id and where it is",
                )
            }

            fn visit_str<E>(self, id: &str) -> Result<Site, E> {
                Ok(Site { id: id.to_owned(), ..Site::default() })
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Site, A::Error> {
                Table::deserialize(MapAccessDeserializer::new(map)).map(Site::from)
            }
        }

        deserializer.deserialize_any(Either)
    }
}

impl From<Table> for Site {
    fn from(table: Table) -> Self {
        let Table { id, name, road, direction, latitude, longitude, bearing, lanes } = table;
        let place = Place { name, road, direction, latitude, longitude, bearing };
        let of_lane = |LaneTable { lane, name, order }| LaneName { lane, name, order };
        let lanes: Vec<_> = lanes.into_iter().map(of_lane).collect();
        let is_known = place != Place::default() || !lanes.is_empty();
        Self { id, place: is_known.then_some(place), lanes }
    }
}

impl Site {
    /// The first key with a wrong value, and what would be right.
    pub(super) fn check(&self) -> Result<(), (&'static str, String)> {
        let id = &self.id;
        if id.is_empty() || id.len() > MAX_NAME || id.contains(['+', '#', '\0', '/']) {
            let id = shown(id);
            return Err(("site", format!("\"{id}\": give 1 to {MAX_NAME} bytes without / + #")));
        }
        if let Some(wrong) = self.place.as_ref().and_then(|place| place.check().err()) {
            return Err((key(&wrong.field), wrong.reason));
        }
        let mut seen = BTreeSet::new();
        for LaneName { lane, name, order } in &self.lanes {
            if !(1..=MOST_LANES).contains(lane) {
                return Err(("site.lanes", format!("lane {lane}: give 1 to {MOST_LANES}")));
            }
            if !seen.insert(lane) {
                return Err(("site.lanes", format!("lane {lane} is there twice")));
            }
            check_lane(name.as_deref(), *order)
                .map_err(|wrong| ("site.lanes", format!("lane {lane}: {wrong}")))?;
        }
        Ok(())
    }
}

fn key(field: &str) -> &'static str {
    match field {
        "name" => "site.name",
        "road" => "site.road",
        "direction" => "site.direction",
        "latitude" => "site.latitude",
        "longitude" => "site.longitude",
        "bearing" => "site.bearing",
        _ => "site",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Deserialize)]
    struct File {
        site: Site,
    }

    fn read(text: &str) -> Result<Site, String> {
        let file: File = crate::daemon::toml_file::parse(text, &[]).map_err(|f| f.to_string())?;
        let site = file.site;
        site.check().map_err(|(key, reason)| format!("{key}: {reason}"))?;
        Ok(site)
    }

    #[test]
    fn a_name_or_a_table_is_a_site() {
        let named = Site { id: "k109f".into(), ..Site::default() };
        assert_eq!(read("site = \"k109f\""), Ok(named.clone()));
        assert_eq!(read("[site]\nid = \"k109f\""), Ok(named), "nothing is said of its place");
        let site = read(
            "[site]\nid = \"k109f\"\nname = \"Siu Lam\"\nlatitude = 22.3625\nlongitude = 114\n\
             [[site.lanes]]\nlane = 2\nname = \"fast lane\"\norder = 3\n",
        )
        .expect("right");
        assert_eq!(site.place.and_then(|place| place.position()), Some([22.3625, 114.0]));
        assert_eq!(site.lanes[0].order, Some(3));
    }

    #[test]
    fn what_is_wrong_is_named_by_its_key() {
        let wrong = |rest: &str| read(&format!("[site]\nid = \"a\"\n{rest}")).expect_err(rest);
        assert_eq!(
            wrong("latitude = 91\nlongitude = 0"),
            "site.latitude: 91: -90 to 90 degrees is right"
        );
        assert_eq!(wrong("latitude = 1"), "site.longitude: is missing beside the latitude");
        assert!(wrong("lattitude = 1").contains("do you mean site.latitude?"));
        assert!(wrong("[[site.lanes]]\nlane = 9").contains("site.lanes: lane 9: give 1 to 8"));
        let twice = wrong("[[site.lanes]]\nlane = 1\n[[site.lanes]]\nlane = 1");
        assert_eq!(twice, "site.lanes: lane 1 is there twice");
        assert!(read("site = 7").expect_err("a number").contains("the site's name in quotes, or"));
        assert!(read("site = \"a/b\"").expect_err("a topic").starts_with("site: \"a/b\": give 1"));
    }
}
