//! The sensor's health as it is published, and written for Prometheus.

use super::Sensor;
use crate::alarm::Alarm;
use crate::daemon::board::Driven;
use crate::daemon::clock;
use crate::daemon::line::Line;
use crate::daemon::publish::payload::{self, Messages, Stream, status_name};
use crate::derate::Pace;
use crate::hal::{Switch, Thermometer, Watchdog};
use crate::health::Actions;
use crate::units::UtcMs;

impl Sensor {
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
        let now: UtcMs = clock::now();
        let (delivered, refused) = self.outlet.publisher().counts();
        let spool = self.outlet.counts();
        let stream = self.station.stream_counts();
        let faults = board.faults();
        let fault = self.fault().map(str::to_owned);
        let line = self.station.line();
        let health = payload::Health {
            site: &self.config.site,
            time: clock::rfc3339(now),
            version: env!("CARGO_PKG_VERSION"),
            status: status_name(actions.status),
            alarm: actions.alarm.map(Alarm::name),
            uptime_s: self.since_start().as_secs(),
            clock_synced: clock::is_synchronised(),
            camera: camera(line),
            frames: self.frames,
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
            board: payload::Board {
                enclosure_c: board.enclosure_c(),
                pace: pace_name(self.pace),
                faults: payload::BoardFaults {
                    status_led: faults.status_led,
                    camera_power: faults.camera_power,
                    watchdog: faults.watchdog,
                    thermometer: faults.thermometer,
                },
                last_fault: board.last_fault(),
            },
            stage_faults: self.stage_faults.faults(),
            last_fault: fault.as_deref(),
        };
        self.outlet.publisher().health(&health);
        let (alarms, is_open) = (self.alarms(), self.outlet.is_open());
        if let Some(metrics) = &mut self.metrics {
            metrics.write(&health, &alarms, is_open);
        }
    }
}

fn camera(line: &Line) -> Option<payload::Camera<'_>> {
    let scene = line.scene()?;
    let tenths = |px: f32| (px * 10.0).round() / 10.0;
    Some(payload::Camera {
        aim: scene.aiming().name(),
        preset: &line.counting().table().calibration_id,
        shift_px: scene.shift().map(|shift| [tenths(shift.u), tenths(shift.v)]),
        light: scene.latest().map(|look| if look.is_night() { "night" } else { "day" }),
    })
}

pub(super) const fn pace_name(pace: Pace) -> &'static str {
    match pace {
        Pace::Full => "full",
        Pace::Half => "half",
        Pace::Stopped => "stopped",
    }
}
