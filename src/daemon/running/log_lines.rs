//! Log lines about windows: the longest ones, and when the first come.
//!
//! Owns the words. `hands` and the loop decide when they are written.

use crate::daemon::clock;
use crate::daemon::publish::payload::status_name;
use crate::density::{LaneReport, WindowReport};
use crate::units::UtcMs;
use std::time::Duration;

/// A window as it stands in the log.
pub(super) fn window(report: &WindowReport) -> String {
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
