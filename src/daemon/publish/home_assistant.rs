//! Home Assistant: the retained messages by which it finds the sensor (MQTT discovery).
//!
//! Owns their topics and payloads; off unless asked for. One `sensor` a lane, with the
//! density of the shortest window, two more for flow and speed where vehicles are followed,
//! and one `binary_sensor` for the connection. Home
//! Assistant reads the daemon's own topics; nothing else is published for it.

use crate::daemon::disk;
use crate::daemon::output::WholeFile;
use crate::daemon::plain;
use crate::daemon::site::Site;
use crate::lane::Lane;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Duration;
use verge_messages::Topic;

/// Its section of the configuration.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Whether discovery messages are published.
    pub discovery: bool,
    /// First level of their topics, as Home Assistant is configured.
    pub prefix: String,
}

impl Default for Settings {
    fn default() -> Self {
        Self { discovery: false, prefix: "homeassistant".into() }
    }
}

/// Windows that may go by without a message until a density is unknown.
const EXPIRE_WINDOWS: u64 = 3;

/// One retained message.
#[derive(Clone, Debug, PartialEq)]
pub struct Announcement {
    /// Its whole topic.
    pub topic: String,
    /// JSON.
    pub payload: Vec<u8>,
}

/// The messages for a site whose topics stand under `root`, with these lanes and windows, and with
/// flow and speed where it `follows` vehicles.
pub fn announcements(
    prefix: &str,
    site: &Site,
    root: &str,
    lanes: &[Lane],
    windows: &[Duration],
    follows: bool,
) -> Vec<Announcement> {
    let id = device_id(&site.id);
    let place = site.place.as_ref();
    let name = place.and_then(|place| place.name.as_deref()).unwrap_or(&site.id);
    let presence = Topic::Presence.under(root);
    let mut common = json!({
        "device": {
            "identifiers": [id],
            "name": name,
            "manufacturer": "verge",
            "model": "traffic density sensor",
            "sw_version": env!("CARGO_PKG_VERSION"),
        },
        "origin": { "name": "verge", "sw_version": env!("CARGO_PKG_VERSION") },
        "qos": 1,
    });
    if let Some(road) = place.and_then(|place| place.road.as_deref()) {
        common["device"]["suggested_area"] = road.into();
    }
    let announce = |component: &str, object: &str, own: Value| {
        let mut payload = common.clone();
        payload["unique_id"] = format!("{id}_{object}").into();
        if let (Some(payload), Value::Object(own)) = (payload.as_object_mut(), own) {
            payload.extend(own);
        }
        Announcement {
            topic: format!("{prefix}/{component}/{id}/{object}/config"),
            payload: payload.to_string().into_bytes(),
        }
    };
    let connectivity = json!({
        "name": "Connectivity",
        "state_topic": presence,
        "value_template": "{{ 'ON' if value == 'online' else 'OFF' }}",
        "payload_on": "ON",
        "payload_off": "OFF",
        "device_class": "connectivity",
        "entity_category": "diagnostic",
    });
    let mut messages = vec![announce("binary_sensor", "connectivity", connectivity)];
    let Some(window) = windows.iter().min() else { return messages };
    for lane in lanes {
        let number = lane.id.get();
        let known = site.lanes.iter().find(|known| known.lane == number);
        let called =
            known.and_then(|known| known.name.clone()).unwrap_or_else(|| format!("Lane {number}"));
        let of_lane = format!("value_json.lanes | selectattr('lane', 'eq', {number})");
        let topic = Topic::Density(*window).under(root);
        let density = json!({
            "name": format!("{called} density"),
            "state_topic": topic,
            "value_template":
                format!("{{{{ {of_lane} | map(attribute='density_veh_km') | first }}}}"),
            "json_attributes_topic": topic,
            "json_attributes_template": format!("{{{{ {of_lane} | first | tojson }}}}"),
            "unit_of_measurement": "veh/km",
            "state_class": "measurement",
            "suggested_display_precision": 1,
            "expire_after": window.as_secs() * EXPIRE_WINDOWS,
            "icon": "mdi:car-multiple",
            "availability": [{
                "topic": presence,
                "value_template": "{{ 'online' if value == 'online' else 'offline' }}",
            }],
        });
        messages.push(announce("sensor", &format!("lane{number}_density"), density.clone()));
        let moving = [
            ("flow", "flow_veh_h", "veh/h", 0, "mdi:counter"),
            ("speed", "speed_kmh", "km/h", 1, "mdi:speedometer"),
        ];
        for (name, field, unit, decimals, icon) in moving.into_iter().filter(|_| follows) {
            let mut sensor = density.clone();
            sensor["name"] = format!("{called} {name}").into();
            sensor["value_template"] =
                format!("{{{{ {of_lane} | map(attribute='{field}') | first }}}}").into();
            sensor["unit_of_measurement"] = unit.into();
            sensor["suggested_display_precision"] = decimals.into();
            sensor["icon"] = icon.into();
            // The lane's fields stand with its density.
            if let Some(fields) = sensor.as_object_mut() {
                fields.retain(|key, _| !key.starts_with("json_attributes"));
            }
            messages.push(announce("sensor", &format!("lane{number}_{name}"), sensor));
        }
    }
    messages
}

/// A site as an id: Home Assistant takes letters, digits, `_` and `-` in topics. Where a name has
/// others, a part of its digest keeps it apart from names that look the same without them.
fn device_id(site: &str) -> String {
    let allowed = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    let plain: String = site.chars().map(|c| if allowed(c) { c } else { '_' }).collect();
    // A name with such an ending could be another's id.
    let ends_like_ours = plain.rsplit_once('_').is_some_and(|(_, tail)| is_tail(tail));
    if plain == site && !ends_like_ours {
        return format!("verge_{plain}");
    }
    let digest = Sha256::digest(site);
    let tail: String = digest.iter().take(4).map(|byte| format!("{byte:02x}")).collect();
    format!("verge_{plain}_{tail}")
}

/// Whether a text looks like the part of a digest in an id.
fn is_tail(text: &str) -> bool {
    text.len() == 8 && text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
}

/// Most bytes of the file: 200 times the topics of eight lanes.
const MAX_BYTES: u64 = 1 << 20;

/// The topics on which something may stand for Home Assistant at the broker, over restarts: what is
/// given up later must be taken back.
///
/// A topic is noted before anything is published on it, and forgotten once the broker has taken the
/// empty message on it. So a power cut at any moment leaves none behind, and a topic that another box
/// takes later is left alone.
#[derive(Debug)]
pub struct Announced {
    file: PathBuf,
    topics: BTreeSet<String>,
}

impl Announced {
    /// Reads what an earlier run has announced, beside its windows.
    pub fn open(folder: &Path) -> Self {
        let file = folder.join("announced");
        let text = match plain::read_text(&file, MAX_BYTES) {
            Ok(text) => text,
            Err(error) => {
                if error.kind() != std::io::ErrorKind::NotFound {
                    log::warn!(
                        "{}: {}; Home Assistant keeps what an earlier configuration has announced",
                        file.display(),
                        disk::unread(&error)
                    );
                }
                String::new()
            }
        };
        // What is not ours must not be emptied, whatever has happened to the file.
        let is_ours = |topic: &&str| topic.ends_with("/config") && topic.contains("/verge_");
        Self { file, topics: text.lines().filter(is_ours).map(str::to_owned).collect() }
    }

    /// Messages that withdraw everything but these announcements: empty ones.
    pub fn given_up(&self, now: &[Announcement]) -> Vec<Announcement> {
        let is_gone = |topic: &&String| now.iter().all(|new| new.topic != **topic);
        let empty = |topic: &String| Announcement { topic: topic.clone(), payload: Vec::new() };
        self.topics.iter().filter(is_gone).map(empty).collect()
    }

    /// These are about to be announced.
    pub fn note(&mut self, now: &[Announcement]) {
        let before = self.topics.len();
        self.topics.extend(now.iter().map(|new| new.topic.clone()));
        if self.topics.len() != before {
            self.write();
        }
    }

    /// The broker has taken the empty messages on these topics. Those that are announced again by
    /// now stay.
    pub fn cleared(&mut self, topics: &[String], now: &[Announcement]) {
        let before = self.topics.len();
        for topic in topics {
            if now.iter().all(|new| new.topic != *topic) {
                self.topics.remove(topic);
            }
        }
        if self.topics.len() != before {
            self.write();
        }
    }

    fn write(&self) {
        let text: String = self.topics.iter().map(|topic| format!("{topic}\n")).collect();
        let written = WholeFile::create(&self.file).and_then(|mut file| {
            file.bytes(text.as_bytes())?;
            file.finish()
        });
        if let Err(error) = written {
            log::warn!("{error}; Home Assistant may keep what a later configuration gives up");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::{Direction, LaneId};

    fn made() -> Vec<Announcement> {
        of_site(false)
    }

    fn of_site(follows: bool) -> Vec<Announcement> {
        let lane = |number| Lane {
            id: LaneId::new(number).expect("in range"),
            direction: Direction::Away,
            length_m: 100.0,
        };
        let windows = [900, 60].map(Duration::from_secs);
        let lanes = [lane(1), lane(2)];
        let site = Site { id: "k 109/f".into(), ..Site::default() };
        announcements("homeassistant", &site, "verge/k109f", &lanes, &windows, follows)
    }

    #[test]
    fn topics_are_those_of_discovery() {
        let topics: Vec<_> = made().into_iter().map(|message| message.topic).collect();
        let expected = [
            "homeassistant/binary_sensor/verge_k_109_f_ID/connectivity/config",
            "homeassistant/sensor/verge_k_109_f_ID/lane1_density/config",
            "homeassistant/sensor/verge_k_109_f_ID/lane2_density/config",
        ];
        assert_eq!(topics, expected.map(|topic| topic.replace("verge_k_109_f_ID", &id())));
    }

    fn id() -> String {
        device_id("k 109/f")
    }

    #[test]
    fn ids_are_unique_for_any_site() {
        assert_eq!(device_id("k109-F_2"), "verge_k109-F_2", "a plain name stays as it is");
        let long = |end: &str| "a".repeat(47) + end;
        let plain =
            ["k1", "K1", "k_1", "k-1", "_", "__", "-", "k1_lane1_density", &long("a"), &long("b")];
        let odd = [
            "k 1",
            "k/1",
            "k.1",
            "k\u{e4}1",
            "k\u{f6}1",
            "ka\u{308}1",
            "\u{4e2d}",
            "\u{6587}",
            "...",
            "..,",
            "!",
            "?",
            "k1 ",
            &long("."),
            &long(","),
            &"\u{e4}".repeat(24),
        ];
        let mut names: Vec<_> = plain.iter().chain(&odd).map(|name| (*name).to_owned()).collect();
        // Names that are the ids of others, without what stands before each.
        names.extend(odd.map(|name| device_id(name).split_off("verge_".len())));
        let ids: BTreeSet<_> = names.iter().map(|name| device_id(name)).collect();
        assert_eq!(ids.len(), names.len());
        assert!(ids.iter().all(|id| id.is_ascii() && !id.contains(['/', '.', ' '])));
    }

    #[test]
    fn what_was_given_up_is_known_until_the_broker_has_emptied_it() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let all = made();
        let open = || Announced::open(folder.path());
        let topics = |given_up: Vec<Announcement>| -> Vec<String> {
            given_up.into_iter().map(|one| one.topic).collect()
        };
        assert!(open().given_up(&all).is_empty());
        open().note(&all);
        // A lane is gone. A power cut before the broker has taken that forgets nothing.
        let mut announced = open();
        let gone = announced.given_up(&all[..2]);
        assert_eq!(gone, [Announcement { topic: all[2].topic.clone(), payload: Vec::new() }]);
        announced.note(&all[..2]);
        assert_eq!(topics(open().given_up(&all[..2])), [all[2].topic.clone()]);
        let mut announced = open();
        announced.cleared(&topics(gone), &all[..2]);
        assert!(open().given_up(&all[..2]).is_empty(), "another box may have the topic now");
        // Turned off: all of it goes.
        let gone = topics(open().given_up(&[]));
        assert_eq!(gone.len(), 2);
        // Turned on again before that came back: it stays.
        let mut announced = open();
        announced.cleared(&gone, &all[..1]);
        assert_eq!(topics(open().given_up(&[])), [all[0].topic.clone()]);
        announced.cleared(&gone, &[]);
        assert!(open().given_up(&[]).is_empty());
    }

    #[test]
    fn a_file_that_came_to_harm_empties_no_others_topics() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("announced");
        for text in [&b"home/light/config\nverge/k1/health\n#\n\n"[..], b"\xff\0", b""] {
            std::fs::write(&file, text).expect("written");
            assert!(Announced::open(folder.path()).given_up(&[]).is_empty());
        }
        // As the versions before have written it.
        std::fs::write(&file, "ha/sensor/verge_a/lane1_density/config\n").expect("written");
        assert_eq!(Announced::open(folder.path()).given_up(&[]).len(), 1);
    }

    /// Keys that the documentation of the MQTT `sensor` and `binary_sensor` has.
    const DOCUMENTED: [&str; 19] = [
        "availability",
        "device",
        "device_class",
        "entity_category",
        "expire_after",
        "icon",
        "json_attributes_template",
        "json_attributes_topic",
        "name",
        "origin",
        "payload_off",
        "payload_on",
        "qos",
        "state_class",
        "state_topic",
        "suggested_display_precision",
        "unique_id",
        "unit_of_measurement",
        "value_template",
    ];

    #[test]
    fn keys_are_documented_and_ids_unique() {
        let mut ids = BTreeSet::new();
        for message in of_site(true) {
            let payload: Value = serde_json::from_slice(&message.payload).expect("JSON");
            for key in payload.as_object().expect("an object").keys() {
                assert!(DOCUMENTED.contains(&key.as_str()), "{key}");
            }
            // Required, and required for a device to be made.
            assert!(payload["state_topic"].is_string() && payload["origin"]["name"].is_string());
            assert_eq!(payload["device"]["identifiers"][0], id());
            assert!(ids.insert(payload["unique_id"].to_string()), "{payload:#}");
        }
    }

    #[test]
    fn a_place_names_device_and_lanes() {
        let lane = Lane {
            id: LaneId::new(2).expect("in range"),
            direction: Direction::Away,
            length_m: 1.0,
        };
        let place = verge_messages::Place {
            name: Some("Siu Lam".into()),
            road: Some("Tuen Mun Road".into()),
            ..Default::default()
        };
        let fast =
            verge_messages::LaneName { lane: 2, name: Some("Fast lane".into()), order: None };
        let site = Site { id: "k".into(), place: Some(place), lanes: vec![fast] };
        let windows = [Duration::from_secs(60)];
        let all = announcements("homeassistant", &site, "verge/k", &[lane], &windows, false);
        let payload: Value = serde_json::from_slice(&all[1].payload).expect("JSON");
        assert_eq!(payload["device"]["name"], "Siu Lam");
        assert_eq!(payload["device"]["suggested_area"], "Tuen Mun Road");
        assert_eq!(payload["device"]["identifiers"][0], "verge_k", "an id stays");
        assert_eq!(payload["name"], "Fast lane density");
    }

    #[test]
    fn flow_and_speed_are_announced_where_vehicles_are_followed() {
        let all = of_site(true);
        assert_eq!(all.len(), made().len() + 4);
        let speed = all.iter().find(|m| m.topic.contains("lane2_speed")).expect("announced");
        let payload: Value = serde_json::from_slice(&speed.payload).expect("JSON");
        assert_eq!(
            payload["value_template"],
            "{{ value_json.lanes | selectattr('lane', 'eq', 2) | map(attribute='speed_kmh') | first }}"
        );
        assert_eq!(payload["unit_of_measurement"], "km/h");
        assert_eq!(payload["json_attributes_topic"], Value::Null);
    }

    #[test]
    fn a_lane_reads_its_density_from_the_shortest_window() {
        let payload: Value = serde_json::from_slice(&made()[2].payload).expect("JSON");
        assert_eq!(payload["state_topic"], "verge/k109f/density/60s");
        assert_eq!(
            payload["value_template"],
            "{{ value_json.lanes | selectattr('lane', 'eq', 2) | \
             map(attribute='density_veh_km') | first }}"
        );
        assert_eq!(payload["unit_of_measurement"], "veh/km");
        assert_eq!(payload["expire_after"], 180);
        assert_eq!(payload["unique_id"], format!("{}_lane2_density", id()));
    }
}
