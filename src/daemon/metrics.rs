//! Metrics: a text file for Prometheus, written whole at each health message.
//!
//! Owns names, units and the text format of the `textfile` collector of node_exporter. Off
//! unless `metrics.file` is given; no socket is opened for it. What is not known is left
//! out, never 0.

use super::output::{WholeFile, WriteError, real_place};
use super::publish::payload::Health;
use super::publish::window_name;
use crate::alarm::Alarm;
use crate::density::{LaneReport, WindowReport};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::{Display, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::Duration;
use verge_messages::{Direction, Status};

/// Its section of the configuration.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// The file; nothing is written where it is not given.
    pub file: Option<PathBuf>,
}

/// Why node_exporter would not find the file, in words.
pub fn unseen(file: &Path) -> Option<String> {
    if file.extension().is_none_or(|extension| extension != "prom") {
        return Some(
            "node_exporter reads files alone whose names end in .prom: name it so".to_owned(),
        );
    }
    let closed = file.ancestors().skip(1).find(|folder| {
        std::fs::metadata(folder).is_ok_and(|there| there.permissions().mode() & 0o001 == 0)
    })?;
    Some(format!(
        "{} is closed to other users, as whom node_exporter runs: name a file in an open folder, \
         /run/verge/verge.prom under systemd",
        closed.display()
    ))
}

/// The file and what goes into it besides the health message.
#[derive(Debug)]
pub struct Metrics {
    file: PathBuf,
    latest: BTreeMap<Duration, WindowReport>,
    turn: Option<Duration>,
    failed: bool,
}

impl Metrics {
    /// Metrics to that file.
    pub fn new(file: &Path) -> Self {
        if let Some(why) = unseen(&real_place(file)) {
            log::warn!("metrics {}: {why}", file.display());
        }
        Self { file: file.to_owned(), latest: BTreeMap::new(), turn: None, failed: false }
    }

    /// Keeps a window until the next one of its length.
    pub fn note(&mut self, report: &WindowReport) {
        let length = report.to.saturating_since(report.from);
        self.latest.insert(length, report.clone());
    }

    /// From here on there are windows of these lengths alone.
    pub fn keep(&mut self, lengths: &[Duration]) {
        self.latest.retain(|length, _| lengths.contains(length));
    }

    /// Keeps what the latest picture took from camera to lanes.
    pub fn note_turn(&mut self, took: Duration) {
        self.turn = Some(took);
    }

    /// Writes the file. A failure is logged once and stops nothing.
    pub fn write(&mut self, health: &Health, alarms: &[Alarm], connected: bool) {
        match self.try_write(health, alarms, connected) {
            Ok(()) => self.failed = false,
            Err(error) => {
                if !std::mem::replace(&mut self.failed, true) {
                    log::warn!("no metrics: {error}");
                }
            }
        }
    }

    fn try_write(
        &self,
        health: &Health,
        alarms: &[Alarm],
        connected: bool,
    ) -> Result<(), WriteError> {
        let mut file = WholeFile::create(&self.file)?.for_everybody()?;
        file.line(self.text(health, alarms, connected).trim_end())?;
        file.finish()
    }

    fn text(&self, health: &Health, alarms: &[Alarm], connected: bool) -> String {
        let mut text = Text { site: health.site.clone(), ..Text::default() };
        text.family("verge_build_info", "gauge", "Version and site of the sensor.");
        text.sample(&[("version", &health.version)], 1);
        text.family("verge_uptime_seconds", "gauge", "Time since the daemon's start.");
        text.sample(&[], health.uptime_s);
        text.family("verge_clock_synchronized", "gauge", "1: a time source has set the clock.");
        text.sample(&[], u8::from(health.clock_synced));
        text.family("verge_broker_connected", "gauge", "1: the connection to the broker stands.");
        text.sample(&[], u8::from(connected));
        text.family("verge_status", "gauge", "1 for the sensor's NTCIP 1209 status, 0 for others.");
        for status in Status::ALL {
            text.sample(&[("status", status.name())], u8::from(status == health.status));
        }
        text.family("verge_alarm_active", "gauge", "1 while the alarm is on.");
        for alarm in Alarm::ALL {
            text.sample(&[("alarm", alarm.name())], u8::from(alarms.contains(&alarm)));
        }
        let (frames, messages) = (health.frames, health.messages);
        text.family("verge_frames_total", "counter", "Pictures, by what became of them.");
        for (outcome, count) in [
            ("measured", frames.measured),
            ("unchanged", frames.unchanged),
            ("damaged", frames.damaged),
            ("missing", frames.missing),
            ("withheld", frames.withheld),
        ] {
            text.sample(&[("outcome", outcome)], count);
        }
        text.family("verge_messages_delivered_total", "counter", "Messages the broker took.");
        text.sample(&[], messages.delivered);
        if let Some(days) = health.certificate_days {
            let help = "Days until the first certificate in use ends.";
            text.family("verge_certificate_days", "gauge", help);
            text.sample(&[], days);
        }
        if let Some(lost) = health.node_windows_lost {
            let help = "Windows that did not leave for the I/O node.";
            text.family("verge_node_windows_lost_total", "counter", help);
            text.sample(&[], lost);
        }
        text.family("verge_messages_dropped_total", "counter", "Windows lost for want of room.");
        text.sample(&[], messages.dropped);
        text.family("verge_messages_refused_total", "counter", "Messages the broker refused.");
        text.sample(&[], messages.refused);
        text.family("verge_messages_waiting", "gauge", "Windows that wait for the broker.");
        text.sample(&[], messages.waiting);
        text.family("verge_messages_in_memory", "gauge", "Waiting windows not on the disk.");
        text.sample(&[], messages.in_memory);
        text.family("verge_spool_damaged_total", "counter", "Spool records not readable.");
        text.sample(&[], messages.damaged);
        if let Some(turn) = self.turn {
            let help = "Time of the latest picture from camera to lanes.";
            text.family("verge_turn_duration_seconds", "gauge", help);
            text.sample(&[], turn.as_secs_f64());
        }
        self.windows(&mut text);
        text.text
    }

    fn windows(&self, text: &mut Text) {
        let help = "End of the latest window, UTC since 1970.";
        text.family("verge_window_end_timestamp_seconds", "gauge", help);
        for (length, report) in &self.latest {
            text.sample(&[("window", &window_name(*length))], report.to.0 as f64 / 1000.0);
        }
        type Quantity = (&'static str, &'static str, fn(&LaneReport) -> Option<f32>);
        let quantities: [Quantity; 9] = [
            (
                "verge_lane_density_vehicles_per_kilometre",
                "Density of the latest window in one lane.",
                |lane| lane.density_veh_km,
            ),
            (
                "verge_lane_density_error_vehicles_per_kilometre",
                "One standard error of the density from sampling.",
                |lane| lane.density_se,
            ),
            (
                "verge_lane_space_occupancy_ratio",
                "Share of the lane's length that vehicles cover.",
                |lane| lane.space_occupancy,
            ),
            (
                "verge_lane_completeness_ratio",
                "Frames that were used, of those expected in the window.",
                |lane| Some(lane.frames_used as f32 / lane.frames_expected.max(1) as f32),
            ),
            ("verge_lane_length_metres", "Length of the lane.", |lane| Some(lane.length_m)),
            (
                "verge_lane_flow_vehicles_per_hour",
                "Flow of the latest window in one lane.",
                |lane| lane.traffic.as_ref()?.flow_veh_h,
            ),
            (
                "verge_lane_speed_kilometres_per_hour",
                "Space-mean speed of the latest window in one lane.",
                |lane| lane.traffic.as_ref()?.speed_kmh,
            ),
            (
                "verge_lane_time_occupancy_ratio",
                "Share of the time for which a vehicle covered the lane's section.",
                |lane| lane.traffic.as_ref()?.time_occupancy,
            ),
            ("verge_lane_queue_metres", "Mean length of the longest queue.", |lane| {
                lane.traffic.as_ref()?.queue_m
            }),
        ];
        for (name, help, value) in quantities {
            text.family(name, "gauge", help);
            for (length, report) in &self.latest {
                let window = window_name(*length);
                for lane in &report.lanes {
                    let Some(value) = value(lane) else { continue };
                    let direction = Direction::from(lane.direction).name();
                    let number = lane.lane.get().to_string();
                    let labels = [
                        ("window", window.as_str()),
                        ("lane", number.as_str()),
                        ("direction", direction),
                    ];
                    text.sample(&labels, value);
                }
            }
        }
    }
}

/// Text in the exposition format: every sample says which site it is of.
#[derive(Default)]
struct Text {
    text: String,
    site: String,
    /// The family that samples belong to.
    family: &'static str,
}

impl Text {
    fn family(&mut self, name: &'static str, kind: &str, help: &str) {
        self.family = name;
        // A string takes what is written to it.
        let _ = write!(self.text, "# HELP {name} {help}\n# TYPE {name} {kind}\n");
    }

    fn sample(&mut self, labels: &[(&str, &str)], value: impl Display) {
        let labels: Vec<_> = std::iter::once(&("site", self.site.as_str()))
            .chain(labels)
            .map(|(key, text)| format!("{key}=\"{}\"", escaped(text)))
            .collect();
        let _ = writeln!(self.text, "{}{{{}}} {value}", self.family, labels.join(","));
    }
}

/// A label's value: backslash, quote and line end are escaped.
fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

#[cfg(test)]
#[path = "metrics_tests.rs"]
mod tests;
