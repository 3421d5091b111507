//! A new configuration takes over in the running sensor.
//!
//! Owns the changes and their order; `reload` loads, and [`crate::sensor`] decides when the new one
//! takes over.

use super::Running;
use crate::daemon::assemble::Assembly;
use crate::daemon::clock;
use crate::daemon::exit::Failure;
use crate::daemon::reload::Candidate;
use crate::units::UtcMs;

impl Running {
    /// From the next instant on at which all running windows end, the candidate is in force.
    pub fn prepare(&mut self, candidate: Box<Candidate>) {
        let at = self.sensor.prepare(clock::now());
        log::info!(
            "the new configuration is right and takes over at {}, when the running windows end",
            clock::rfc3339(at)
        );
        self.pending = Some(candidate);
        self.hands.refuse(None);
    }

    /// A new configuration cannot be used: says so, and goes on.
    pub fn refuse(&mut self, failure: &Failure) {
        log::error!(
            "the new configuration is refused, the one before stays in force: {failure}. Fix it \
             and reload again; `verge check` tries it"
        );
        self.hands.refuse(Some(failure));
        self.sensor.publish_health();
    }

    /// The windows of the old line have ended; those of the new one begin.
    pub(super) fn take_over(&mut self, at: UtcMs) {
        let Some(candidate) = self.pending.take() else { return };
        let Candidate { config, assembly } = *candidate;
        let Assembly { mut line, presets, camera, broker, identity } = assembly;
        self.road.finish(self.station.line());
        line.recall_road(&config.road_file());
        let camera_since = (!self.station.asks(&camera)).then(|| self.since_start());
        if let Err(failure) = self.station.replace(line, camera) {
            return self.refuse(&failure);
        }
        self.hands.outlet.change(broker, config.mqtt.format, identity, config.spool_windows());
        self.hands.outlet.serve_node(config.serial_settings());
        let interval = config.interval();
        self.tell(|sensor, act| sensor.replace(at, presets, interval, camera_since, act));
        self.hands.change(&self.config, &config, self.station.line());
        self.config = config;
        let (model, table) = self.station.line().describe();
        log::info!("the new configuration is in force: {model}; {table}");
    }
}
