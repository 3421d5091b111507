//! A new configuration takes over in the running sensor.
//!
//! Owns what changes and in which order; what is loaded, and when it is due, is `reload`'s.

use super::Sensor;
use crate::daemon::assemble::Assembly;
use crate::daemon::clock;
use crate::daemon::config::Config;
use crate::daemon::exit::Failure;
use crate::daemon::line::Line;
use crate::daemon::metrics::Metrics;
use crate::daemon::publish::home_assistant::{self, Announcement};
use crate::daemon::reload::{Candidate, Pending};
use crate::health::Health;
use std::time::Duration;

impl Sensor {
    /// From the next instant on at which all running windows end, the candidate is in force.
    pub fn prepare(&mut self, candidate: Box<Candidate>) {
        let pending = Pending::new(candidate, &self.config, clock::now());
        log::info!(
            "the new configuration is right and takes over at {}, when the running windows end",
            clock::rfc3339(pending.at())
        );
        self.pending = Some(pending);
        self.refused = None;
        self.health_sent = None;
    }

    /// A new configuration cannot be used: says so, and goes on.
    pub fn refuse(&mut self, failure: &Failure) {
        log::error!(
            "the new configuration is refused, the one before stays in force: {failure}. Mend \
             it and reload again; `verge check` tries it"
        );
        self.refused = Some(format!("reload refused: {failure}"));
        self.health_sent = None;
    }

    /// Ends the windows of the old line, and begins those of the new one.
    pub(super) fn take_over(&mut self, pending: Pending) {
        let (candidate, at) = pending.begin();
        let closed = self.station.line_mut().advance(at);
        self.publish(&closed);
        let Candidate { config, assembly } = *candidate;
        let Assembly { mut line, camera, broker } = assembly;
        line.advance(at);
        let identity = line.identity(&config.site);
        let is_other_camera = !self.station.asks(&camera);
        if let Err(failure) = self.station.replace(line, camera) {
            return self.refuse(&failure);
        }
        self.outlet.change(broker, config.mqtt.format, identity, config.spool_windows());
        self.outlet.serve_node(config.serial_settings());
        if is_other_camera {
            self.health = Health::new(config.interval(), self.since_start());
        }
        if self.config.metrics.file != config.metrics.file {
            self.metrics = config.metrics.file.as_deref().map(Metrics::new);
        }
        self.announce_anew(&config);
        self.config = config;
        let interval = self.interval();
        self.station.line_mut().set_interval(interval);
        self.say_alarms();
        self.health_sent = None;
        let (model, table) = self.station.line().describe();
        log::info!("the new configuration is in force: {model}; {table}");
    }

    /// Replaces what is said to Home Assistant; what there is no more is taken back by an
    /// empty message.
    fn announce_anew(&mut self, config: &Config) {
        let new = announcements(config, self.station.line());
        let is_gone = |old: &Announcement| new.iter().all(|new| new.topic != old.topic);
        for Announcement { topic, .. } in self.announcements.drain(..).filter(is_gone) {
            self.outlet.publisher().announce(Announcement { topic, payload: Vec::new() });
        }
        self.announcements = new;
        self.announced = None;
    }

    /// Says the alarms that are on: a new broker knows of none.
    fn say_alarms(&self) {
        self.alarms().into_iter().for_each(|alarm| self.tell_alarm(alarm, true));
    }
}

/// The discovery messages that the configuration asks for.
pub(super) fn announcements(config: &Config, line: &Line) -> Vec<Announcement> {
    let settings = &config.home_assistant;
    if !settings.discovery {
        return Vec::new();
    }
    let lengths: Vec<_> =
        config.windows.lengths_s.iter().copied().map(Duration::from_secs).collect();
    let lanes = &line.counting().table().lanes;
    home_assistant::announcements(
        &settings.prefix,
        &config.site,
        &config.root_topic(),
        lanes,
        &lengths,
    )
}
