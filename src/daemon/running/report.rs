//! The sensor's health as it is published, and written for Prometheus.

use super::Running;
use crate::daemon::board::Driven;
use crate::daemon::clock;
use crate::daemon::line::Line;
use crate::daemon::presets::Following;
use crate::daemon::publish::payload::status_name;
use crate::daemon::scene::Aiming;
use crate::density::{LaneReport, WindowReport};
use crate::derate::Pace;
use crate::hal::{Switch, Thermometer, Watchdog};
use crate::health::Actions;
use crate::units::UtcMs;
use std::time::Duration;
use verge_messages::{self as payload, Messages, Stream};

impl Running {
    fn following(&self, following: Following) -> Option<payload::Following> {
        let Following::On { longest, .. } = following else { return None };
        Some(payload::Following {
            longest_interval_s: longest.as_secs_f32(),
            density_difference_veh_km: self.hands.density_difference().map(payload::rounded),
        })
    }

    pub(super) fn publish_health<L, R, W, T>(
        &mut self,
        actions: Actions,
        board: &Driven<L, R, W, T>,
    ) where
        L: Switch,
        R: Switch,
        W: Watchdog,
        T: Thermometer,
    {
        let (outlet, frames) = (&self.hands.outlet, self.sensor.frames());
        let (delivered, refused) = outlet.publisher().counts();
        let spool = outlet.counts();
        let stream = self.station.stream_counts();
        let faults = board.faults();
        let line = self.station.line();
        let health = payload::Health {
            schema: payload::Schema::default(),
            site: self.config.site.id.clone(),
            time: clock::now().into(),
            version: env!("CARGO_PKG_VERSION").into(),
            status: actions.status,
            alarm: actions.alarm,
            uptime_s: self.since_start().as_secs(),
            clock_synced: clock::is_synchronised(),
            camera: camera(line),
            frames: payload::Frames {
                measured: frames.measured,
                unchanged: frames.unchanged,
                damaged: frames.damaged,
                missing: frames.missing,
                withheld: frames.withheld,
            },
            stream: Stream {
                flagged: stream.flagged,
                lost: stream.lost,
                reopened: stream.reopened,
            },
            messages: Messages {
                delivered,
                refused,
                waiting: spool.waiting,
                in_memory: spool.in_memory,
                dropped: spool.dropped,
                damaged: spool.damaged,
            },
            traffic: self.following(line.following()),
            board: payload::Board {
                enclosure_c: board.enclosure_c(),
                pace: pace(self.sensor.pace()),
                faults: payload::BoardFaults {
                    status_led: faults.status_led,
                    camera_power: faults.camera_power,
                    watchdog: faults.watchdog,
                    thermometer: faults.thermometer,
                },
                last_fault: board.last_fault().map(str::to_owned),
            },
            stage_faults: self.sensor.stage_faults(),
            certificate_days: self.hands.certificate_days(),
            node_windows_lost: outlet.lost_to_node(),
            last_fault: self.hands.fault().map(str::to_owned),
        };
        outlet.publisher().health(&health);
        let alarms: Vec<_> = self.sensor.alarms().chain(self.hands.certificate_alarm()).collect();
        let is_open = outlet.is_open();
        if let Some(metrics) = &mut self.hands.metrics {
            metrics.write(&health, &alarms, is_open);
        }
    }
}

fn camera(line: &Line) -> Option<payload::Camera> {
    let scene = line.scene()?;
    let tenths = |px: f32| (px * 10.0).round() / 10.0;
    Some(payload::Camera {
        aim: aim(scene.aiming()),
        preset: line.preset().table().calibration_id.as_str().to_owned(),
        shift_px: scene.shift().map(|shift| [tenths(shift.u), tenths(shift.v)]),
        light: scene
            .latest()
            .map(|look| if look.is_night() { payload::Light::Night } else { payload::Light::Day }),
        road_age_s: scene.road_age().map(|age| age.as_secs()),
    })
}

/// A window as it stands in the log.
pub(super) fn in_words(report: &WindowReport) -> String {
    let one = |lane: &LaneReport| {
        let density = match lane.density_veh_km {
            Some(density) => format!("{density:.1}"),
            None => format!("none ({})", status_name(lane.status)),
        };
        format!("{} {density}", lane.lane.get())
    };
    let lanes: Vec<_> = report.lanes.iter().map(one).collect();
    let (used, expected) =
        report.lanes.first().map_or((0, 0), |lane| (lane.frames_used, lane.frames_expected));
    format!(
        "window {} s to {}: veh/km by lane: {}; {used} of {expected} pictures",
        report.to.saturating_since(report.from).as_secs(),
        clock::rfc3339(report.to),
        lanes.join(", ")
    )
}

/// When the first numbers come: windows begin at whole multiples of their lengths, and none that
/// was begun in its middle is reported.
pub(super) fn first_numbers(lengths: &[Duration], now: UtcMs) -> String {
    let first = |length: &Duration| {
        let ms = i64::try_from(length.as_millis()).unwrap_or(i64::MAX).max(1);
        let begins = now.0.saturating_add(ms - 1).div_euclid(ms).saturating_mul(ms);
        UtcMs(begins.saturating_add(ms))
    };
    let said = |length: Duration| {
        format!("of {} s at {}", length.as_secs(), clock::rfc3339(first(&length)))
    };
    let shortest = lengths.iter().min().copied().map(said).unwrap_or_default();
    let longest = lengths.iter().max().filter(|_| lengths.len() > 1).copied().map(said);
    let longest = longest.map_or(String::new(), |longest| format!(", {longest}"));
    format!("the first windows end: {shortest}{longest}; there is no density before")
}

const fn aim(aiming: Aiming) -> payload::Aim {
    match aiming {
        Aiming::Unchecked => payload::Aim::Unchecked,
        Aiming::Unverified => payload::Aim::Unverified,
        Aiming::InPlace => payload::Aim::InPlace,
        Aiming::Moved => payload::Aim::Moved,
    }
}

pub(super) const fn pace(pace: Pace) -> payload::Pace {
    match pace {
        Pace::Full => payload::Pace::Full,
        Pace::Half => payload::Pace::Half,
        Pace::Stopped => payload::Pace::Stopped,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_numbers_come_with_the_first_whole_windows() {
        let at = |seconds: i64| UtcMs(1_767_600_000_000 + 1000 * seconds);
        let lengths = [Duration::from_secs(900), Duration::from_secs(60)];
        assert_eq!(
            first_numbers(&lengths, at(61)),
            "the first windows end: of 60 s at 2026-01-05T08:03:00.000Z, of 900 s at \
             2026-01-05T08:30:00.000Z; there is no density before"
        );
        let one = first_numbers(&lengths[1..], at(60));
        assert!(one.contains("of 60 s at 2026-01-05T08:02:00.000Z; there"), "{one}");
    }
}
