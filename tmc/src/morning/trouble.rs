//! Troubles of a site, and since when: silence, an alarm, a lane without a measurement,
//! the clock, an error that is too wide.
//!
//! Owns the judgement of a site's latest windows and alarms; the clock is read by the command alone.

use super::day::Reading;
use crate::store::events::AlarmRow;
use std::collections::BTreeMap;
use verge_messages::{Alarm, Status};

/// Windows of a length that may be missing before a site counts as silent.
const MISSING_WINDOWS: i64 = 3;
/// A site is not silent before this, ms: an archiver brings windows in every few minutes.
const PATIENCE_MS: i64 = 15 * 60_000;
/// An error is too wide when an end of the 90 % interval is further from the density than this share
/// of it and than [`WIDE_VEH_KM`], in all windows of [`WIDE_MS`].
const WIDE_SHARE: f32 = 0.5;
const WIDE_VEH_KM: f32 = 5.0;
const WIDE_MS: i64 = 3_600_000;

/// Something that is wrong with a site.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Trouble {
    /// Since when, ms since 1970; of what began before the days that are looked at, their first
    /// window.
    pub since_ms: i64,
    /// The trouble in words.
    pub reason: String,
}

/// The alarms that are on at `now_ms`, by site: the name and since when. `rows` are of successive
/// days.
pub fn active(
    rows: impl IntoIterator<Item = AlarmRow>,
    now_ms: i64,
) -> BTreeMap<String, BTreeMap<String, i64>> {
    let mut rows: Vec<AlarmRow> = rows.into_iter().filter(|row| row.time_ms <= now_ms).collect();
    rows.sort_by(|a, b| (a.time_ms, &a.site).cmp(&(b.time_ms, &b.site)));
    let mut on = BTreeMap::<String, BTreeMap<String, i64>>::new();
    for AlarmRow { site, time_ms, name, active } in rows {
        let of_site = on.entry(site).or_default();
        if active {
            of_site.entry(name).or_insert(time_ms);
        } else {
            of_site.remove(&name);
        }
    }
    on.retain(|_, alarms| !alarms.is_empty());
    on
}

/// Troubles at `now_ms`, from a site's windows of `window_s` and the alarms that are on; the oldest
/// first.
pub fn judge(
    readings: &[Reading],
    window_s: i32,
    alarms: &BTreeMap<String, i64>,
    now_ms: i64,
) -> Vec<Trouble> {
    let last_ms = readings.iter().map(|reading| reading.from_ms).filter(|at| *at < now_ms).max();
    let mut found: Vec<Trouble> = alarms
        .iter()
        .map(|(name, since_ms)| Trouble { since_ms: *since_ms, reason: alarm_words(name) })
        .collect();
    let Some(last_ms) = last_ms else {
        found.sort();
        return found;
    };
    let window_ms = i64::from(window_s) * 1000;
    let end_ms = last_ms + window_ms;
    if now_ms - end_ms > PATIENCE_MS.max(MISSING_WINDOWS * window_ms) {
        // An earlier alarm says nothing about now.
        return vec![Trouble { since_ms: end_ms, reason: "silent".into() }];
    }
    let mut lanes = BTreeMap::<i32, Vec<Reading>>::new();
    for reading in readings.iter().filter(|reading| reading.from_ms <= last_ms) {
        lanes.entry(reading.lane).or_default().push(*reading);
    }
    lanes.values_mut().for_each(|all| all.sort_by_key(|reading| reading.from_ms));
    // Lanes with the same trouble since the same time are listed together.
    let mut together = BTreeMap::<(i64, String), Vec<String>>::new();
    let ok = i32::from(Status::Ok.number());
    for (lane, readings) in lanes.into_iter().filter(|(_, all)| last(all).from_ms == last_ms) {
        let status = last(&readings).status;
        let is_told = alarms.keys().any(|name| explains(name) == Some(status));
        if let Some(since_ms) = since(&readings, |reading| reading.status != ok)
            && !is_told
        {
            together.entry((since_ms, words(status))).or_default().push(lane.to_string());
        }
        if let Some(since_ms) = since(&readings, |reading| !reading.clock_synced) {
            together.entry((since_ms, "its clock is not set".into())).or_default();
        }
        if let Some(since_ms) = since(&readings, is_wide)
            && end_ms - since_ms >= WIDE_MS
        {
            let reason = "the error is wider than half the density".to_owned();
            together.entry((since_ms, reason)).or_default().push(lane.to_string());
        }
    }
    found.extend(together.into_iter().map(|((since_ms, reason), lanes)| {
        let of =
            if lanes.is_empty() { String::new() } else { format!("lane {}: ", lanes.join(", ")) };
        Trouble { since_ms, reason: of + &reason }
    }));
    found.sort();
    found
}

fn is_wide(reading: &Reading) -> bool {
    let Some((density, [low, high])) = reading.density.zip(reading.ci90) else { return false };
    (high - density).max(density - low) > WIDE_VEH_KM.max(WIDE_SHARE * density)
}

fn last(readings: &[Reading]) -> &Reading {
    readings.last().expect("a lane has readings")
}

/// The first of the readings at the end of which all are so; none where the last is not.
fn since(readings: &[Reading], is_so: impl Fn(&Reading) -> bool) -> Option<i64> {
    let run = readings.iter().rev().take_while(|reading| is_so(reading));
    run.last().map(|reading| reading.from_ms)
}

fn words(status: i32) -> String {
    let known = Status::ALL.into_iter().find(|known| i32::from(known.number()) == status);
    match known {
        Some(Status::SensorFailure) => "no picture".into(),
        Some(Status::InputDataIntegrity) => "frozen, damaged or too few pictures".into(),
        Some(Status::PoorContrast) => "blinded or too dark".into(),
        Some(Status::DetectionAutoSuspended) => "the camera has moved".into(),
        Some(Status::Ok) | None => format!("status {status}"),
    }
}

fn known(name: &str) -> Option<Alarm> {
    Alarm::ALL.into_iter().find(|alarm| alarm.name() == name)
}

fn alarm_words(name: &str) -> String {
    match known(name) {
        Some(Alarm::NoPicture) => "no picture".into(),
        Some(Alarm::FrozenPicture) => "the picture is frozen".into(),
        Some(Alarm::BlankPicture) => "the picture is blank".into(),
        Some(Alarm::BlindedPicture) => "the camera is blinded".into(),
        Some(Alarm::BlurredPicture) => "the picture is blurred".into(),
        Some(Alarm::CameraMoved) => "the camera has moved".into(),
        Some(Alarm::Overheated) => "the box is too warm".into(),
        Some(Alarm::BoardFault) => "a part of the box does not work".into(),
        Some(Alarm::CertificateExpires) => "a certificate ends soon".into(),
        None => format!("alarm {name}"),
    }
}

/// The status that lanes have because of an alarm, which is listed once.
fn explains(name: &str) -> Option<i32> {
    let status = match known(name)? {
        Alarm::NoPicture => Status::SensorFailure,
        Alarm::FrozenPicture | Alarm::BlankPicture | Alarm::Overheated => {
            Status::InputDataIntegrity
        }
        Alarm::BlindedPicture | Alarm::BlurredPicture => Status::PoorContrast,
        Alarm::CameraMoved => Status::DetectionAutoSuspended,
        Alarm::BoardFault | Alarm::CertificateExpires => return None,
    };
    Some(status.number().into())
}

#[cfg(test)]
mod tests {
    use super::*;

    const MINUTE: i64 = 60_000;

    fn at(minute: i64, lane: i32, status: i32, clock_synced: bool) -> Reading {
        Reading {
            from_ms: minute * MINUTE,
            lane,
            status,
            clock_synced,
            density: None,
            ci90: None,
            flow: None,
            speed: None,
        }
    }

    fn found(readings: &[Reading], alarms: &[(&str, i64)], now_minute: i64) -> Vec<(i64, String)> {
        let alarms = alarms.iter().map(|(name, at)| ((*name).to_owned(), at * MINUTE)).collect();
        let all = judge(readings, 60, &alarms, now_minute * MINUTE);
        all.into_iter().map(|trouble| (trouble.since_ms / MINUTE, trouble.reason)).collect()
    }

    #[test]
    fn a_site_is_silent_after_its_last_window() {
        let fine = [at(1, 1, 2, true), at(0, 1, 10, true)];
        assert_eq!(found(&fine, &[], 17), []);
        assert_eq!(found(&fine, &[("no_picture", 0)], 18), [(2, "silent".to_owned())]);
        assert_eq!(found(&[], &[], 18), []);
    }

    #[test]
    fn what_is_wrong_now_is_told_since_it_began() {
        let readings = [
            // Wrong, fine, and wrong again from 2 on, in both lanes; lane 3 is not measured any more.
            at(0, 1, 13, true),
            at(1, 1, 2, true),
            at(2, 1, 12, true),
            at(3, 1, 12, false),
            at(2, 2, 12, true),
            at(3, 2, 12, false),
            at(1, 3, 10, true),
        ];
        let expected = [
            (2, "lane 1, 2: blinded or too dark".to_owned()),
            (3, "its clock is not set".to_owned()),
        ];
        assert_eq!(found(&readings, &[], 5), expected);
        assert_eq!(found(&[at(0, 1, 13, true), at(1, 1, 2, true)], &[], 3), []);
    }

    #[test]
    fn an_alarm_is_told_once_with_its_own_time() {
        let moved = [at(2, 1, 13, true), at(2, 2, 13, true)];
        let expected = [(-500, "the camera has moved".to_owned())];
        assert_eq!(found(&moved, &[("camera_moved", -500)], 4), expected);
        let other = found(&moved, &[("board_fault", 1)], 4);
        assert_eq!(other[0], (1, "a part of the box does not work".to_owned()));
        assert_eq!(other[1], (2, "lane 1, 2: the camera has moved".to_owned()));
    }

    #[test]
    fn an_error_is_too_wide_after_an_hour() {
        let wide = |minute: i64, half: f32| Reading {
            density: Some(20.0),
            ci90: Some([20.0 - half, 20.0 + half]),
            ..at(minute, 1, 2, true)
        };
        let hour: Vec<_> = (0..60).map(|minute| wide(minute, 11.0)).collect();
        assert_eq!(found(&hour[..59], &[], 59), []);
        let reason = "lane 1: the error is wider than half the density".to_owned();
        assert_eq!(found(&hour, &[], 60), [(0, reason)]);
        let narrow: Vec<_> = (0..60).map(|minute| wide(minute, 9.0)).collect();
        assert_eq!(found(&narrow, &[], 60), []);
    }

    #[test]
    fn an_alarm_is_on_until_it_is_over() {
        let row = |site: &str, time_ms, name: &str, active| AlarmRow {
            site: site.into(),
            time_ms,
            name: name.into(),
            active,
        };
        let rows = [
            row("a", 1, "no_picture", true),
            row("a", 2, "no_picture", false),
            row("a", 3, "camera_moved", true),
            // Said again after a restart: it is on since 3.
            row("a", 4, "camera_moved", true),
            row("b", 5, "no_picture", true),
            row("b", 6, "no_picture", false),
            row("c", 9, "no_picture", true),
        ];
        let on = active(rows, 8);
        assert_eq!(on.keys().collect::<Vec<_>>(), ["a"]);
        assert_eq!(on["a"], BTreeMap::from([("camera_moved".to_owned(), 3)]));
    }
}
