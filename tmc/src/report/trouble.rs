//! What is wrong with a site at the end of a report: silent, a lane without a measurement, the clock.
//!
//! Owns the judgement of a site's latest windows; the clock is read by the command alone.

use super::summary::column;
use datafusion::arrow::array::{AsArray, RecordBatch};
use datafusion::arrow::datatypes::{Int32Type, Int64Type};
use std::collections::BTreeMap;
use verge_messages::Status;

/// Windows of a length that may be missing before a site counts as silent.
const MISSING_WINDOWS: i64 = 3;
/// A site is not silent before this, ms: an archiver brings windows in every few minutes.
const PATIENCE_MS: i64 = 15 * 60_000;

/// Something that is wrong with a site.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Trouble {
    /// Since when, ms since 1970; of what began before the days that are looked at, their first
    /// window.
    pub since_ms: i64,
    /// What, in words.
    pub reason: String,
}

/// A lane in a window.
#[derive(Clone, Copy, Debug)]
struct Reading {
    from_ms: i64,
    lane: i32,
    status: i32,
    clock_synced: bool,
}

/// What is wrong at `now_ms`, by the rows of `queries::latest` of windows of `window_s`; the oldest
/// trouble first.
pub(super) fn of(batches: &[RecordBatch], window_s: i32, now_ms: i64) -> Vec<Trouble> {
    let readings = |batch| {
        let (at, lanes) = (column::<Int64Type>(batch, "at"), column::<Int32Type>(batch, "lane"));
        let status = column::<Int32Type>(batch, "status");
        let clock = batch.column_by_name("clock_synced").expect("the query names it").as_boolean();
        (0..batch.num_rows()).map(move |row| Reading {
            from_ms: at.value(row),
            lane: lanes.value(row),
            status: status.value(row),
            clock_synced: clock.value(row),
        })
    };
    judge(batches.iter().flat_map(readings).collect(), window_s, now_ms)
}

fn judge(mut readings: Vec<Reading>, window_s: i32, now_ms: i64) -> Vec<Trouble> {
    let Some(last_ms) = readings.iter().map(|reading| reading.from_ms).max() else {
        return Vec::new();
    };
    let window_ms = i64::from(window_s) * 1000;
    let end_ms = last_ms + window_ms;
    if now_ms - end_ms > PATIENCE_MS.max(MISSING_WINDOWS * window_ms) {
        return vec![Trouble { since_ms: end_ms, reason: "silent".into() }];
    }
    readings.sort_by_key(|reading| reading.from_ms);
    let mut lanes = BTreeMap::<i32, Vec<Reading>>::new();
    for reading in readings {
        lanes.entry(reading.lane).or_default().push(reading);
    }
    // Lanes with the same trouble since the same time are told together.
    let mut found = BTreeMap::<(i64, String), Vec<String>>::new();
    let ok = i32::from(Status::Ok.number());
    for (lane, readings) in lanes.into_iter().filter(|(_, all)| last(all).from_ms == last_ms) {
        if let Some(since_ms) = since(&readings, |reading| reading.status != ok) {
            let reason = words(last(&readings).status);
            found.entry((since_ms, reason)).or_default().push(lane.to_string());
        }
        if let Some(since_ms) = since(&readings, |reading| !reading.clock_synced) {
            found.entry((since_ms, "its clock is not set".into())).or_default();
        }
    }
    let trouble = |((since_ms, reason), lanes): ((i64, String), Vec<String>)| {
        let of =
            if lanes.is_empty() { String::new() } else { format!("lane {}: ", lanes.join(", ")) };
        Trouble { since_ms, reason: of + &reason }
    };
    found.into_iter().map(trouble).collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    const MINUTE: i64 = 60_000;

    fn at(minute: i64, lane: i32, status: i32, clock_synced: bool) -> Reading {
        Reading { from_ms: minute * MINUTE, lane, status, clock_synced }
    }

    fn told(readings: Vec<Reading>, now_minute: i64) -> Vec<(i64, String)> {
        let all = judge(readings, 60, now_minute * MINUTE);
        all.into_iter().map(|trouble| (trouble.since_ms / MINUTE, trouble.reason)).collect()
    }

    #[test]
    fn a_site_is_silent_after_its_last_window() {
        let fine = vec![at(1, 1, 2, true), at(0, 1, 10, true)];
        assert_eq!(told(fine.clone(), 17), []);
        assert_eq!(told(fine, 18), [(2, "silent".to_owned())]);
        assert_eq!(told(Vec::new(), 18), []);
    }

    #[test]
    fn what_is_wrong_now_is_told_since_it_began() {
        let readings = vec![
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
        assert_eq!(told(readings, 5), expected);
        assert_eq!(told(vec![at(0, 1, 13, true), at(1, 1, 2, true)], 3), []);
    }
}
