//! Metrics: a text file for Prometheus, written whole at each health message.
//!
//! Owns names, units and the text format of the `textfile` collector of node_exporter. Off
//! unless `metrics.file` is given; no socket is opened for it. What is not known is left
//! out, never 0.

use super::output::{WholeFile, WriteError};
use super::publish::payload::Health;
use super::publish::window_name;
use crate::alarm::Alarm;
use crate::density::{LaneReport, WindowReport};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::{Display, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;
use verge_messages::{Direction, Status};

/// What the configuration says of it.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// The file; nothing is written where it is not given.
    pub file: Option<PathBuf>,
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
        Self { file: file.to_owned(), latest: BTreeMap::new(), turn: None, failed: false }
    }

    /// Keeps a window until the next one of its length.
    pub fn note(&mut self, report: &WindowReport) {
        let length = report.to.saturating_since(report.from);
        self.latest.insert(length, report.clone());
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
mod tests {
    use super::*;
    use crate::daemon::publish::payload::{Board, BoardFaults, Frames, Messages, Schema, Stream};
    use crate::density::SampleZoneStatus;
    use crate::units::{Direction, LaneId, UtcMs};
    use std::collections::{BTreeSet, HashMap};

    fn report() -> WindowReport {
        let lane = |number, density| LaneReport {
            lane: LaneId::new(number).expect("in range"),
            direction: Direction::Away,
            density_veh_km: density,
            density_se: density,
            vehicles_mean: density,
            by_class: None,
            space_occupancy: None,
            length_m: 100.5,
            frames_used: 45,
            frames_expected: 60,
            status: SampleZoneStatus::Ok,
            cells: None,
            error: None,
            traffic: None,
        };
        WindowReport {
            from: UtcMs(1_767_600_000_000),
            to: UtcMs(1_767_600_060_000),
            lanes: [lane(1, Some(20.25)), lane(2, None)].into_iter().collect(),
        }
    }

    fn health() -> Health {
        Health {
            schema: Schema::default(),
            site: "a \"b\" \\".into(),
            time: verge_messages::Utc(1_767_600_000_000),
            version: "0.1.0".into(),
            status: Status::PoorContrast,
            alarm: Some(verge_messages::Alarm::NoPicture),
            uptime_s: 75,
            clock_synced: true,
            frames: Frames { measured: 7, unchanged: 1, damaged: 2, missing: 3, withheld: 8 },
            stream: Stream::default(),
            camera: None,
            traffic: None,
            board: Board {
                enclosure_c: None,
                pace: crate::daemon::publish::payload::Pace::Half,
                faults: BoardFaults::default(),
                last_fault: None,
            },
            stage_faults: 0,
            messages: Messages { delivered: 4, waiting: 5, dropped: 6, ..Messages::default() },
            certificate_days: Some(300),
            node_windows_lost: Some(2),
            last_fault: None,
        }
    }

    /// The samples by name with labels. Panics on what Prometheus would refuse.
    fn parsed(text: &str) -> HashMap<String, f64> {
        let mut samples = HashMap::new();
        let (mut family, mut families) = (String::new(), BTreeSet::new());
        let mut lines = text.lines();
        while let Some(line) = lines.next() {
            if let Some(help) = line.strip_prefix("# HELP ") {
                let (name, help) = help.split_once(' ').expect("a name and its help");
                assert!(!help.is_empty() && families.insert(name.to_owned()), "{name} twice");
                let kind = lines.next().and_then(|line| line.strip_prefix("# TYPE "));
                let (typed, kind) = kind.and_then(|line| line.split_once(' ')).expect("a type");
                assert_eq!(typed, name);
                let total = name.ends_with("_total");
                assert_eq!(kind, if total { "counter" } else { "gauge" }, "{name}");
                family = name.to_owned();
                continue;
            }
            let (series, value) = line.rsplit_once(' ').expect("a series and its value");
            let name = series.split('{').next().expect("a name");
            assert_eq!(name, family, "samples stand under their family");
            assert!(name.chars().all(|c| c.is_ascii_lowercase() || c == '_'), "{name}");
            if let Some(labels) = series.strip_prefix(name).filter(|labels| !labels.is_empty()) {
                assert!(labels.starts_with('{') && labels.ends_with("\"}"), "{labels}");
            }
            let value = value.parse().expect("a number");
            assert!(samples.insert(series.to_owned(), value).is_none(), "{series} twice");
        }
        samples
    }

    #[test]
    fn the_file_parses_and_says_what_is_known() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("verge.prom");
        let mut metrics = Metrics::new(&path);
        metrics.note(&report());
        metrics.note_turn(Duration::from_millis(125));
        metrics.write(&health(), &[Alarm::NoPicture, Alarm::Overheated], true);
        let text = std::fs::read_to_string(&path).expect("written");
        assert!(text.ends_with('\n') && !text.contains("\n\n"));
        let mode = std::os::unix::fs::MetadataExt::mode(&path.metadata().expect("written"));
        assert_eq!(mode & 0o777, 0o644, "node_exporter runs as another user");
        let samples = parsed(&text);
        let density = "verge_lane_density_vehicles_per_kilometre";
        for (series, value) in [
            ("verge_build_info{version=\"0.1.0\"}", 1.0),
            ("verge_uptime_seconds", 75.0),
            ("verge_clock_synchronized", 1.0),
            ("verge_broker_connected", 1.0),
            ("verge_status{status=\"oK\"}", 0.0),
            ("verge_status{status=\"poorContrast\"}", 1.0),
            ("verge_alarm_active{alarm=\"no_picture\"}", 1.0),
            ("verge_alarm_active{alarm=\"overheated\"}", 1.0),
            ("verge_alarm_active{alarm=\"board_fault\"}", 0.0),
            ("verge_alarm_active{alarm=\"frozen_picture\"}", 0.0),
            ("verge_alarm_active{alarm=\"camera_moved\"}", 0.0),
            ("verge_frames_total{outcome=\"missing\"}", 3.0),
            ("verge_frames_total{outcome=\"withheld\"}", 8.0),
            ("verge_messages_delivered_total", 4.0),
            ("verge_messages_waiting", 5.0),
            ("verge_messages_dropped_total", 6.0),
            ("verge_turn_duration_seconds", 0.125),
            ("verge_window_end_timestamp_seconds{window=\"60s\"}", 1_767_600_060.0),
            (&format!("{density}{{window=\"60s\",lane=\"1\",direction=\"away\"}}"), 20.25),
            ("verge_lane_completeness_ratio{window=\"60s\",lane=\"2\",direction=\"away\"}", 0.75),
        ] {
            let (name, labels) = series.split_once('{').unwrap_or((series, "}"));
            let comma = if labels == "}" { "" } else { "," };
            let series = format!("{name}{{site=\"a \\\"b\\\" \\\\\"{comma}{labels}");
            assert_eq!(samples.get(&series), Some(&value), "{series} in\n{text}");
        }
        let densities = samples.keys().filter(|series| series.starts_with(density)).count();
        assert_eq!(densities, 1, "a lane without density has no sample");
    }

    #[test]
    fn the_reference_has_every_family() {
        let mut metrics = Metrics::new(Path::new("nowhere"));
        metrics.note(&report());
        metrics.note_turn(Duration::from_millis(125));
        let text = metrics.text(&health(), &Alarm::ALL, true);
        let mut page = String::from(
            "# Metrics\n\nWith `metrics.file` the daemon writes a file for the `textfile` \
             collector of node_exporter with each health message (each minute, and when the \
             status changes), whole or not at all; no socket is opened for it. A lane without \
             density has no sample; flow, speed, occupancy in time and queues are there where \
             vehicles are followed, the days of certificates with TLS, windows lost to a node with \
             one.\n\n\
             | metric | type | labels | what it is |\n|---|---|---|---|\n",
        );
        for family in text.split("# HELP ").skip(1) {
            let (name, help) = family.split_once(' ').expect("a name and its help");
            let (help, rest) = help.split_once('\n').expect("its own line");
            let kind = rest.lines().next().and_then(|line| line.rsplit(' ').next());
            let labels: BTreeSet<&str> = rest
                .lines()
                .skip(1)
                .filter_map(|line| line.split_once('{'))
                .flat_map(|(_, labels)| labels.split(','))
                .filter_map(|label| label.split_once("=\"").map(|(name, _)| name))
                .collect();
            // Families of lanes have the same labels, with a value in this window or without.
            let of_lanes = BTreeSet::from(["direction", "lane", "site", "window"]);
            let labels = if name.starts_with("verge_lane_") { of_lanes } else { labels };
            let labels: Vec<String> = labels.iter().map(|label| format!("`{label}`")).collect();
            let _ = writeln!(
                page,
                "| `{name}` | {} | {} | {help} |",
                kind.unwrap_or_default(),
                labels.join(", ")
            );
        }
        verge_desk::hold("metrics.md", &page);
    }

    #[test]
    fn a_file_that_cannot_be_written_stops_nothing() {
        let mut metrics = Metrics::new(Path::new("/proc/no/such/folder/verge.prom"));
        metrics.write(&health(), &[], false);
        metrics.write(&health(), &[], false);
        assert!(metrics.failed);
    }
}
