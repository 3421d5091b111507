//! Publish: the last stage, from a [`WindowReport`] to messages at the broker.
//!
//! Owns topics, formats and numbering. The door of the crate `rumqttc` is `mqtt`; what
//! the messages look like in JSON stands in [`payload`].

pub mod home_assistant;
#[cfg(feature = "demo")]
pub mod loopback;
mod mqtt;
pub mod payload;

pub use mqtt::{MqttSettings, Statistics, probe};

use crate::density::WindowReport;
use crate::lane::{Description, Name};
use crate::wire::{self, CalibrationRef, DensityMessage, MAX_MESSAGE, ModelRef};
use mqtt::{Connection, Message};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// How long a stop waits for the broker to take what is left.
const DRAIN: Duration = Duration::from_secs(3);

/// How density messages are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// JSON with a published schema.
    #[default]
    Json,
    /// The compact binary form of [`crate::wire`].
    Postcard,
}

/// Who measures, and with what.
#[derive(Clone, Debug)]
pub struct Identity {
    site: Name,
    calibration: CalibrationRef,
    model: ModelRef,
    seq: BTreeMap<u64, u64>,
}

impl Identity {
    /// The identity of a site that measures with this table and model.
    pub fn new(site: &str, table: &Description, model: &ModelRef) -> Self {
        Self {
            site: short_name(site),
            calibration: CalibrationRef {
                id: table.calibration_id.clone(),
                sha256: table.calibration_sha256,
                rel_err: table.length_rel_err,
            },
            model: model.clone(),
            seq: BTreeMap::new(),
        }
    }

    /// The next message of the report's window length.
    pub fn message(&mut self, report: &WindowReport, clock_synced: bool) -> DensityMessage {
        let seq = self.seq.entry(window_s(report)).or_default();
        *seq += 1;
        DensityMessage {
            site: self.site.clone(),
            seq: *seq,
            clock_synced,
            report: report.clone(),
            calibration: self.calibration.clone(),
            model: self.model.clone(),
        }
    }
}

/// The first [`crate::lane::MAX_NAME`] bytes of a name, at a character's end.
fn short_name(text: &str) -> Name {
    let mut name = Name::new();
    for character in text.chars() {
        if name.push(character).is_err() {
            break;
        }
    }
    name
}

fn window_s(report: &WindowReport) -> u64 {
    report.to.saturating_since(report.from).as_secs()
}

/// The window's name in topics: `60s`, `5min`.
pub fn window_name(length: Duration) -> String {
    match length.as_secs() {
        seconds if seconds >= 300 && seconds % 60 == 0 => format!("{}min", seconds / 60),
        seconds => format!("{seconds}s"),
    }
}

/// Sends what the line measures.
#[derive(Debug)]
pub struct Publisher {
    identity: Identity,
    root: String,
    format: Format,
    connection: Connection,
}

impl Publisher {
    /// Starts the connection, in a thread of its own; a broker that is away is no error.
    pub fn start(settings: MqttSettings, format: Format, identity: Identity) -> Self {
        let root = settings.root.clone();
        Self { identity, root, format, connection: Connection::start(settings) }
    }

    /// Sends one window.
    pub fn density(&mut self, report: &WindowReport, clock_synced: bool) {
        let message = self.identity.message(report, clock_synced);
        let payload = match self.format {
            Format::Json => payload::density(&message),
            Format::Postcard => {
                let mut buffer = [0; MAX_MESSAGE];
                match wire::encode(&message, &mut buffer) {
                    Ok(bytes) => bytes.to_vec(),
                    Err(error) => {
                        log::error!("a window is lost: {error}");
                        return;
                    }
                }
            }
        };
        let window = window_name(Duration::from_secs(window_s(report)));
        self.send(&format!("density/{window}"), payload, false);
    }

    /// Sends the state of the sensor, kept by the broker for those who come later.
    pub fn health(&self, health: &payload::Health<'_>) {
        self.send("health", payload::health(health), true);
    }

    /// Raises or clears an alarm, kept by the broker.
    pub fn alarm(&self, name: &str, alarm: &payload::Alarm<'_>) {
        self.send(&format!("alarm/{name}"), payload::alarm(alarm), true);
    }

    /// Says to Home Assistant what there is to read; kept by the broker.
    pub fn announce(&self, announcement: home_assistant::Announcement) {
        let home_assistant::Announcement { topic, payload } = announcement;
        self.connection.send(Message { topic, payload, retain: true });
    }

    /// What has become of the messages so far.
    pub fn statistics(&self) -> Arc<Statistics> {
        self.connection.statistics()
    }

    /// Says goodbye: waits a moment for what is left, then publishes `shutdown`.
    pub fn stop(self) {
        self.connection.stop(DRAIN);
    }

    fn send(&self, topic: &str, payload: Vec<u8>, retain: bool) {
        let topic = format!("{}/{topic}", self.root);
        self.connection.send(Message { topic, payload, retain });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_have_the_names_of_the_design() {
        for (seconds, name) in
            [(10, "10s"), (60, "60s"), (120, "120s"), (300, "5min"), (900, "15min")]
        {
            assert_eq!(window_name(Duration::from_secs(seconds)), name);
        }
    }

    #[test]
    fn long_names_are_cut_between_characters() {
        let name = short_name(&"ä".repeat(40));
        assert_eq!(name.len(), crate::lane::MAX_NAME);
    }
}
