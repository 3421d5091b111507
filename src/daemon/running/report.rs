//! The sensor's health as it is published, and written for Prometheus.

use super::Running;
use crate::daemon::board::Driven;
use crate::daemon::clock;
use crate::daemon::line::Line;
use crate::daemon::presets::Following;
use crate::daemon::scene::Aiming;
use crate::derate::Pace;
use crate::hal::{Switch, Thermometer, Watchdog};
use crate::health::Actions;
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
            last_fault: self.hands.fault(),
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
