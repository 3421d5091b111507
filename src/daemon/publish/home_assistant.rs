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
#[path = "home_assistant_tests.rs"]
mod tests;
