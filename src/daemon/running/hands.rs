//! Carries out the sensor's actions: messages, metrics and lines of the log.
//!
//! Owns the outlet, and how faults are reported. Decides nothing.

use super::{log_lines, report};
use crate::alarm::Alarm;
use crate::daemon::certificate;
use crate::daemon::clock;
use crate::daemon::config::Config;
use crate::daemon::exit::Failure;
use crate::daemon::line::Line;
use crate::daemon::metrics::Metrics;
use crate::daemon::outlet::Outlet;
use crate::daemon::presets::Following;
use crate::daemon::publish::home_assistant::{self, Announced, Announcement};
use crate::daemon::publish::payload;
use crate::density::{LaneReport, SampleZoneStatus, WindowReport};
use crate::sensor::Action;
use std::time::Duration;

/// Days before the end of a certificate at which the alarm is raised.
const EXPIRY_ALARM_DAYS: i64 = 14;

/// Performs actions.
pub struct Hands {
    site: String,
    pub(super) outlet: Outlet,
    pub(super) metrics: Option<Metrics>,
    announcements: Vec<Announcement>,
    /// Announcements to Home Assistant, of earlier runs too.
    known: Announced,
    /// The session in which it was announced.
    announced: Option<u64>,
    /// The latest fault without and with the picture's name, until a picture is measured.
    last_fault: Option<(String, String)>,
    /// Advice for a camera that is slower than it is asked.
    slow: Option<String>,
    /// Why the latest new configuration was refused.
    refused: Option<String>,
    health_due: bool,
    /// Length of the longest windows, each of which gets a line in the log.
    longest: Duration,
    /// Whether a certificate ends soon, as last reported.
    expiry_told: Option<bool>,
    /// Length of the shortest windows, and the largest difference of densities in the latest.
    difference: Option<(Duration, Option<f32>)>,
}

impl Hands {
    /// Hands that publish as the configuration says.
    pub fn new(config: &Config, line: &Line, outlet: Outlet) -> Self {
        Self {
            site: config.site.id.clone(),
            outlet,
            metrics: config.metrics.file.as_deref().map(Metrics::new),
            announcements: announcements(config, line),
            known: Announced::open(config.spool_folder()),
            announced: None,
            last_fault: None,
            slow: None,
            refused: None,
            health_due: false,
            longest: longest(config),
            expiry_told: None,
            difference: None,
        }
    }

    /// Does what the sensor asks for. Health is written when the sensor has said all.
    pub fn perform(&mut self, action: Action<'_>) {
        match action {
            Action::Window { window, clock_synced } => {
                if window.report.to.saturating_since(window.report.from) == self.longest {
                    log::info!("{}", log_lines::window(window.report));
                }
                self.outlet.density(window, clock_synced);
                self.note_difference(window.report);
                if let Some(metrics) = &mut self.metrics {
                    metrics.note(window.report);
                }
            }
            Action::Alarm { alarm, active } => self.alarm(alarm, active),
            Action::Pace(pace) => {
                log::warn!(
                    "the enclosure's temperature sets the pace: {}",
                    report::pace(pace).name()
                );
            }
            Action::Health(_) => self.health_due = true,
        }
    }

    fn alarm(&self, alarm: Alarm, active: bool) {
        let name = alarm.name();
        if alarm.status() == SampleZoneStatus::Ok {
            // Heat and faults of the board are logged where they are noticed.
        } else if active {
            log::error!("alarm {name}: no density until it is over");
        } else {
            log::info!("alarm {name} is over");
        }
        self.outlet.publisher().alarm(&payload::AlarmMessage {
            schema: payload::Schema::default(),
            site: self.site.clone(),
            time: clock::now().into(),
            name: alarm,
            active,
        });
    }

    fn note_difference(&mut self, report: &WindowReport) {
        let length = report.to.saturating_since(report.from);
        if self.difference.is_some_and(|(shortest, _)| shortest < length) {
            return;
        }
        let of = |lane: &LaneReport| lane.traffic.as_ref()?.density_difference;
        let largest = |a: &f32, b: &f32| a.abs().total_cmp(&b.abs());
        self.difference = Some((length, report.lanes.iter().filter_map(of).max_by(largest)));
    }

    /// The largest difference of densities, for health.
    pub(super) fn density_difference(&self) -> Option<f32> {
        self.difference.and_then(|(_, difference)| difference)
    }

    /// Whether health is to be published; asked once each time.
    pub fn is_health_due(&mut self) -> bool {
        std::mem::take(&mut self.health_due)
    }

    /// A picture went through the line in that time.
    pub fn note_measured(&mut self, took: Duration) {
        self.last_fault = None;
        if let Some(metrics) = &mut self.metrics {
            metrics.note_turn(took);
        }
    }

    /// Says a fault when it is another than the last, whichever picture has it: once, not with every
    /// frame. A fault of the program is logged each time.
    pub fn note_fault(&mut self, fault: &Failure) {
        if matches!(fault, Failure::Stage(_)) {
            log::error!("{fault}");
        }
        let (kind, text) = (fault.of_any_picture(), fault.to_string());
        if self.last_fault.as_ref().is_none_or(|(last, _)| *last != kind) {
            log::warn!("no measurement: {text}");
        }
        self.last_fault = Some((kind, text));
    }

    /// The camera is slower than it is asked, and what to do about it, or it is not. It stands in the
    /// state, and once in the log.
    pub fn note_slow(&mut self, advice: Option<String>) {
        if let Some(advice) = advice.as_ref().filter(|_| self.slow.is_none()) {
            log::warn!("{advice}");
        }
        self.slow = advice;
    }

    /// A new configuration is refused, or none is any more.
    pub fn refuse(&mut self, reason: Option<&Failure>) {
        self.refused = reason.map(|failure| format!("reload refused: {failure}"));
    }

    /// The present fault: of the pictures first, then of the disk, then of the pictures' number, else of
    /// a new configuration.
    pub fn fault(&self) -> Option<&str> {
        let pictures = self.last_fault.as_ref().map(|(_, text)| text.as_str());
        pictures
            .or_else(|| self.outlet.fault())
            .or(self.slow.as_deref())
            .or(self.refused.as_deref())
    }

    /// Days until the first certificate in use ends.
    pub fn certificate_days(&self) -> Option<i64> {
        let end = self.outlet.publisher().certificate_end()?;
        Some(certificate::days_left(end, clock::now()))
    }

    /// The alarm of certificates, while it is on.
    pub fn certificate_alarm(&self) -> Option<Alarm> {
        (self.expiry_told == Some(true)).then_some(Alarm::CertificateExpires)
    }

    /// Raises the alarm of a certificate that ends soon, or clears it.
    fn watch_certificates(&mut self) {
        let Some(days) = self.certificate_days() else { return };
        let is_soon = days < EXPIRY_ALARM_DAYS;
        if self.expiry_told.replace(is_soon) == Some(is_soon) {
            return;
        }
        if is_soon {
            log::error!(
                "a certificate of the connection to the broker ends in {days} days: renew it, and \
                 `systemctl reload verge`"
            );
        }
        self.outlet.publisher().alarm(&payload::AlarmMessage {
            schema: payload::Schema::default(),
            site: self.site.clone(),
            time: clock::now().into(),
            name: Alarm::CertificateExpires,
            active: is_soon,
        });
    }

    /// Hears what the broker has taken and sends what waits. Says to Home Assistant what there
    /// is, after each connection: the broker may have lost what it kept.
    pub fn tend(&mut self) {
        self.outlet.tend();
        self.watch_certificates();
        let publisher = self.outlet.publisher();
        let session = publisher.session();
        if session.is_some() && session != std::mem::replace(&mut self.announced, session) {
            self.known.note(&self.announcements);
            for announcement in self.known.given_up(&self.announcements) {
                publisher.announce(announcement);
            }
            for announcement in &self.announcements {
                publisher.announce(announcement.clone());
            }
        }
        let cleared = publisher.cleared();
        self.known.cleared(&cleared, &self.announcements);
    }

    /// Announcements follow another configuration. Of windows that it no longer has, nothing stays in the
    /// metrics and at the broker.
    pub fn change(&mut self, before: &Config, config: &Config, line: &Line) {
        let lengths = config.window_lengths();
        if before.metrics.file != config.metrics.file {
            self.metrics = config.metrics.file.as_deref().map(Metrics::new);
        } else if let Some(metrics) = &mut self.metrics {
            metrics.keep(&lengths);
        }
        let is_kept = |length: &Duration| config.mqtt.latest && lengths.contains(length);
        if before.mqtt.latest {
            let given_up = before.window_lengths().into_iter().filter(|length| !is_kept(length));
            given_up.for_each(|length| self.outlet.publisher().forget_latest(length));
        }
        self.announcements = announcements(config, line);
        self.longest = longest(config);
        self.difference = None;
        self.announced = None;
    }

    /// Says goodbye; what has not arrived waits on the disk.
    pub fn stop(self) {
        self.outlet.stop();
    }
}

fn longest(config: &Config) -> Duration {
    config.window_lengths().into_iter().max().unwrap_or_default()
}

/// The discovery messages that the configuration asks for.
fn announcements(config: &Config, line: &Line) -> Vec<Announcement> {
    let settings = &config.home_assistant;
    if !settings.discovery {
        return Vec::new();
    }
    home_assistant::announcements(
        &settings.prefix,
        &config.site,
        &config.root_topic(),
        &line.preset().table().lanes,
        &config.window_lengths(),
        matches!(line.following(), Following::On { .. }),
    )
}
