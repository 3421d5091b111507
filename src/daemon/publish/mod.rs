//! Publish: the last stage, from a window to messages at the broker.
//!
//! Owns which message goes when, and the rate of replay. The spool keeps windows until they have
//! arrived, `mqtt` has the connection, `verge_messages` topics and JSON.

pub mod home_assistant;
#[cfg(feature = "demo")]
pub mod loopback;
mod mqtt;
pub mod payload;

pub use mqtt::{MqttSettings, MqttVersion, Tls, TlsError, TlsFiles, probe};
pub use verge_messages::window_name;

use crate::lane::Name;
use crate::sensor::ClosedWindow;
use crate::units::UtcMs;
use crate::wire::{self, DensityMessage, MAX_MESSAGE, ModelRef};
use mqtt::{Connection, Message, Report};
use serde::Deserialize;
use std::collections::BTreeSet;
use std::time::{Duration, Instant};
use verge_messages::Topic;

/// How long a stop waits for the broker to take what is left.
const DRAIN: Duration = Duration::from_secs(3);
/// Most live windows that wait for their acknowledgement; what comes on top of them goes
/// the way of an outage.
const MAX_LIVE: usize = 64;
/// Of a message that is not a window of the spool.
const NO_KEY: u64 = u64::MAX;
/// Most windows of an outage that wait for theirs.
const MAX_ARREARS: usize = 32;

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

/// Who measures, and with which model.
#[derive(Clone, Debug)]
pub struct Identity {
    site: Name,
    model: ModelRef,
    located: Option<payload::Located>,
}

impl Identity {
    /// The identity of a site that measures with this model.
    pub fn new(site: &str, model: &ModelRef) -> Self {
        Self { site: Name::truncated(site), model: model.clone(), located: None }
    }

    /// The same of a site that says where it is, or does not.
    #[must_use]
    pub fn at(mut self, located: Option<payload::Located>) -> Self {
        self.located = located;
        self
    }

    /// Position and names of the site.
    pub const fn located(&self) -> Option<&payload::Located> {
        self.located.as_ref()
    }

    /// The message of a window with its number.
    pub fn message(
        &self,
        window: ClosedWindow<'_>,
        clock_synced: bool,
        seq: u64,
    ) -> DensityMessage {
        DensityMessage {
            site: self.site.clone(),
            seq,
            clock_synced,
            report: window.report.clone(),
            calibration: window.calibration.clone(),
            model: self.model.clone(),
        }
    }
}

/// An event of the connection, or of a window given to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delivery {
    /// A session is open: it knows nothing of what was given before.
    Opened,
    /// The session has ended.
    Closed,
    /// The broker has taken the window with this key.
    Taken {
        /// Its key.
        key: u64,
        /// It was one of an outage.
        replayed: bool,
    },
    /// The broker does not take the window with this key now.
    PutOff(u64),
}

/// Sends what the line measures.
#[derive(Debug)]
pub struct Publisher {
    root: String,
    format: Format,
    /// Position and names of the site; JSON messages carry them.
    located: Option<payload::Located>,
    /// Whether the broker keeps the latest live window of each length.
    keeps_latest: bool,
    connection: Connection,
    /// The open session, as far as its reports were read.
    session: Option<u64>,
    live: BTreeSet<u64>,
    arrears: BTreeSet<u64>,
    replay_per_s: f64,
    tls: Option<Tls>,
    /// Windows of an outage that may be sent now, and since when it is so.
    allowance: (f64, Instant),
}

impl Publisher {
    /// Starts the connection, in a thread of its own; an absent broker is not an error.
    pub fn start(settings: MqttSettings, format: Format) -> Self {
        Self {
            root: settings.root.clone(),
            format,
            located: None,
            keeps_latest: settings.keeps_latest,
            replay_per_s: settings.replay_per_s,
            tls: settings.tls.clone(),
            connection: Connection::start(settings),
            session: None,
            live: BTreeSet::new(),
            arrears: BTreeSet::new(),
            allowance: (0.0, Instant::now()),
        }
    }

    /// From here on publishes to this broker, in this format. A connection to another one, or
    /// with other words, begins when the old one has said goodbye.
    pub fn change(&mut self, settings: MqttSettings, format: Format) {
        self.root = settings.root.clone();
        self.format = format;
        self.replay_per_s = settings.replay_per_s;
        self.keeps_latest = settings.keeps_latest;
        if self.tls != settings.tls {
            self.tls = settings.tls.clone();
        }
        self.connection.change(settings, DRAIN);
    }

    /// From here on messages say that the site is there.
    pub fn locate(&mut self, located: Option<payload::Located>) {
        self.located = located;
    }

    /// Whether a session is open.
    pub fn is_open(&self) -> bool {
        self.session.is_some()
    }

    /// Sends a window that has just closed; false where no session can take it now.
    pub fn live(&mut self, key: u64, message: &DensityMessage) -> bool {
        let Some(session) = self.session.filter(|_| self.live.len() < MAX_LIVE) else {
            return false;
        };
        self.live.insert(key);
        let topic = Topic::Density(length(message)).under(&self.root);
        let payload = self.payload(message, None);
        if self.keeps_latest {
            self.state(Topic::Latest(length(message)), payload.clone());
        }
        self.connection.window(session, key, true, Message { topic, payload, retain: false });
        true
    }

    /// How many windows of an outage may be sent now.
    pub fn arrears_wanted(&mut self) -> usize {
        let now = Instant::now();
        let (allowed, since) = self.allowance;
        // The unused allowance of a second is not saved up for a burst.
        let most = self.replay_per_s.max(1.0);
        let earned = now.duration_since(since).as_secs_f64() * self.replay_per_s;
        self.allowance = ((allowed + earned).min(most), now);
        match self.session {
            Some(_) => (self.allowance.0 as usize).min(MAX_ARREARS - self.arrears.len()),
            None => 0,
        }
    }

    /// Sends a window of an outage; `done` with the last one of its length.
    pub fn arrear(&mut self, key: u64, message: &DensityMessage, done: bool) {
        let Some(session) = self.session else { return };
        self.allowance.0 -= 1.0;
        self.arrears.insert(key);
        let topic = Topic::Replay(length(message)).under(&self.root);
        let payload = self.payload(message, Some(done));
        let send = |key, topic, payload| {
            let message = Message { topic, payload, retain: false };
            self.connection.window(session, key, false, message);
        };
        send(key, topic.clone(), payload);
        if done && self.format == Format::Postcard {
            // The binary form has no place for `done`: an empty message says it.
            send(NO_KEY, topic, Vec::new());
        }
    }

    /// The next event since the last call, in order.
    pub fn delivery(&mut self) -> Option<Delivery> {
        let report = self.connection.report()?;
        Some(self.heard(report))
    }

    fn heard(&mut self, report: Report) -> Delivery {
        match report {
            Report::Taken { key } => {
                self.live.remove(&key);
                return Delivery::Taken { key, replayed: self.arrears.remove(&key) };
            }
            Report::PutOff { key } => {
                self.live.remove(&key);
                self.arrears.remove(&key);
                return Delivery::PutOff(key);
            }
            Report::Opened { session } => self.session = Some(session),
            Report::Closed => self.session = None,
        }
        self.live.clear();
        self.arrears.clear();
        if self.is_open() { Delivery::Opened } else { Delivery::Closed }
    }

    /// Sends the state of the sensor, kept by the broker for those who come later.
    pub fn health(&self, health: &payload::Health) {
        self.state(Topic::Health, verge_messages::json(health));
    }

    /// Raises or clears an alarm, kept by the broker.
    pub fn alarm(&self, alarm: &payload::AlarmMessage) {
        self.state(Topic::Alarm(alarm.name), verge_messages::json(alarm));
    }

    /// Takes back the latest window of this length, of which there are no more.
    pub fn forget_latest(&self, length: Duration) {
        self.state(Topic::Latest(length), Vec::new());
    }

    /// Announces the sensor's values to Home Assistant; the broker keeps it.
    pub fn announce(&self, announcement: home_assistant::Announcement) {
        let home_assistant::Announcement { topic, payload } = announcement;
        self.connection.state(Message { topic, payload, retain: true });
    }

    /// The topics of announcements whose empty message the broker has taken since it was asked last.
    pub fn cleared(&self) -> Vec<String> {
        self.connection.cleared()
    }

    /// The open session; each has a number of its own.
    pub fn session(&self) -> Option<u64> {
        self.session
    }

    /// End of the first certificate of the connection, where it is known.
    pub fn certificate_end(&self) -> Option<UtcMs> {
        self.tls.as_ref()?.first_end()
    }

    /// How long the connection's thread has not turned; `None` where it has ended.
    pub fn stalled(&self) -> Option<Duration> {
        self.connection.stalled()
    }

    /// Messages that the broker has taken, and refused, since start.
    pub fn counts(&self) -> (u64, u64) {
        (self.connection.delivered(), self.connection.refused())
    }

    /// Says goodbye: waits a moment for what is on its way, then publishes `shutdown`.
    /// Returns what was delivered meanwhile.
    pub fn stop(self) -> impl Iterator<Item = u64> {
        self.connection.stop(DRAIN).into_iter().filter_map(|report| match report {
            Report::Taken { key } => Some(key),
            Report::Opened { .. } | Report::Closed | Report::PutOff { .. } => None,
        })
    }

    fn state(&self, topic: Topic, payload: Vec<u8>) {
        let retain = topic.is_retained();
        self.connection.state(Message { topic: topic.under(&self.root), payload, retain });
    }

    fn payload(&self, message: &DensityMessage, done: Option<bool>) -> Vec<u8> {
        match self.format {
            Format::Json => match &self.located {
                Some(located) => payload::density_at(message, done, located),
                None => payload::density(message, done),
            },
            Format::Postcard => {
                let mut buffer = [0; MAX_MESSAGE];
                let bytes = wire::encode(message, &mut buffer);
                bytes.expect("MAX_MESSAGE holds every message").to_vec()
            }
        }
    }
}

/// The length of a message's window.
const fn length(message: &DensityMessage) -> Duration {
    message.report.to.saturating_since(message.report.from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_names_are_cut_between_characters() {
        let name = Name::truncated(&"ä".repeat(40));
        assert_eq!(name.len(), crate::lane::MAX_NAME);
    }
}
