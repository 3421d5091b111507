//! The box's clock is set while the sensor measures.

use super::rig::{Arrived, BEGIN, Bench, LENGTHS_S, Window, subscribe};
use crate::daemon::clock::{self, hand};
use crate::daemon::publish::loopback::start_broker;
use crate::units::UtcMs;
use std::time::Duration;

/// Runs for `before` seconds, sets the clock, runs for `after` seconds. Returns the windows of
/// each length.
fn set_clock(before: u64, by_ms: i64, synchronised: [bool; 2], after: u64) -> [Vec<Window>; 2] {
    let port = start_broker().expect("a broker");
    let mut subscriber = subscribe(port);
    let mut bench = Bench::start(port);
    hand::set(0, synchronised[0]);
    bench.pass(before);
    hand::set(by_ms, synchronised[1]);
    bench.pass(after);
    bench.stop();
    let mut arrived = Arrived::default();
    arrived.read(&mut subscriber);
    ["20s", "60s"]
        .map(|name| arrived.windows.remove(name).unwrap_or_default().into_values().collect())
}

/// What holds for the windows of each length, whatever the clock does.
fn check(windows: &[Vec<Window>; 2]) {
    for (windows, length_s) in windows.iter().zip(LENGTHS_S) {
        for window in windows {
            assert_eq!(window.to.0 - window.from.0, length_s as i64 * 1000, "{window:?}");
            assert_eq!(window.from.0 % (length_s as i64 * 1000), 0, "{window:?}");
            // A frame may lie on either side of the step.
            assert!(window.used.abs_diff(window.expected) <= 1, "{window:?}");
        }
    }
}

#[test]
fn windows_before_the_clock_is_right_are_marked_and_a_leap_is_no_gap() {
    // In the middle of a window, into the middle of another.
    let [short, long] = set_clock(90, 3 * 3_600_000 + 7_000, [false, true], 90);
    check(&[short.clone(), long.clone()]);
    for windows in [&short, &long] {
        assert!(windows.windows(2).all(|pair| pair[0].to <= pair[1].from), "none twice");
        let (marked, right): (Vec<_>, Vec<_>) = windows.iter().partition(|w| !w.clock_synced);
        assert!(marked.iter().all(|window| right.iter().all(|later| window.to <= later.from)));
        assert!(!marked.is_empty() && !right.is_empty(), "{windows:?}");
        // Nothing is reported of the time that never was.
        let leap = UtcMs(BEGIN.0 + 90_000)..UtcMs(BEGIN.0 + 3 * 3_600_000);
        let inside = |window: &&Window| leap.contains(&window.from) && leap.contains(&window.to);
        assert_eq!(windows.iter().find(inside).map(|window| window.from), None);
    }
}

#[test]
fn set_back_a_little_the_clock_brings_no_window_twice() {
    let windows = set_clock(100, -50_000, [true; 2], 130);
    check(&windows);
    for windows in &windows {
        assert!(windows.windows(2).all(|pair| pair[0].to == pair[1].from), "{windows:#?}");
        assert!(windows.iter().all(|window| window.clock_synced));
    }
    let last = windows[0].last().expect("windows");
    assert!(last.to > UtcMs(BEGIN.0 + 130_000), "they go on: {last:?}");
}

#[test]
fn a_clock_that_was_hours_ahead_does_not_silence_the_sensor() {
    let windows = set_clock(90, -26 * 3_600_000, [false, true], 130);
    check(&windows);
    for windows in &windows {
        let right: Vec<_> = windows.iter().filter(|window| window.clock_synced).collect();
        assert!(!right.is_empty(), "{windows:#?}");
        assert!(right.iter().all(|window| window.to < BEGIN), "of the day before");
        assert!(right.windows(2).all(|pair| pair[0].to == pair[1].from));
    }
    assert!(
        clock::now().saturating_since(windows[0].last().expect("some").to)
            < Duration::from_secs(20)
    );
}
