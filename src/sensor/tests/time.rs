//! The clock is set, and configurations take over, while the sensor measures.

use super::*;

/// Invariants of windows, whatever the clock does.
fn check_frames(windows: &[Window]) {
    for window in windows {
        // A frame may lie on either side of a step.
        assert!(window.used.abs_diff(window.expected) <= 1, "{window:?}");
    }
}

#[test]
fn windows_before_the_clock_is_right_are_marked_and_a_leap_is_no_gap() {
    // In the middle of a window, into the middle of another.
    let leap_ms = 3 * 3_600_000 + 7_000;
    let script = [SetClock(0, false), Pass(90, ROAD), SetClock(leap_ms, true), Pass(90, ROAD)];
    let bench = Bench::run(&script);
    for windows in LENGTHS_S.map(|length_s| bench.of(length_s)) {
        check_frames(&windows);
        assert!(windows.windows(2).all(|pair| pair[0].to <= pair[1].from), "none twice");
        let (marked, right): (Vec<_>, Vec<_>) = windows.iter().partition(|w| !w.clock_synced);
        assert!(marked.iter().all(|window| right.iter().all(|later| window.to <= later.from)));
        assert!(!marked.is_empty() && !right.is_empty(), "{windows:?}");
        // Nothing is reported of the time that never was.
        let leap = UtcMs(BEGIN.0 + 90_000)..UtcMs(BEGIN.0 + 3 * 3_600_000);
        let inside = |window: &&Window| leap.contains(&window.from) && leap.contains(&window.to);
        assert_eq!(windows.iter().find(inside), None);
    }
}

#[test]
fn set_back_a_little_the_clock_brings_no_window_twice() {
    let bench = Bench::run(&[Pass(100, ROAD), SetClock(-50_000, true), Pass(130, ROAD)]);
    for windows in LENGTHS_S.map(|length_s| bench.of(length_s)) {
        check_frames(&windows);
        assert!(are_seamless(&windows), "{windows:#?}");
        assert!(windows.iter().all(|window| window.clock_synced));
    }
    let last = bench.of(20).pop().expect("windows");
    assert!(last.to > UtcMs(BEGIN.0 + 130_000), "they go on: {last:?}");
}

#[test]
fn a_clock_that_was_hours_ahead_does_not_silence_the_sensor() {
    let script =
        [SetClock(0, false), Pass(90, ROAD), SetClock(-26 * 3_600_000, true), Pass(130, ROAD)];
    let bench = Bench::run(&script);
    for windows in LENGTHS_S.map(|length_s| bench.of(length_s)) {
        check_frames(&windows);
        let right: Vec<_> = windows.iter().filter(|window| window.clock_synced).cloned().collect();
        assert!(!right.is_empty(), "{windows:#?}");
        assert!(right.iter().all(|window| window.to < BEGIN), "of the day before");
        assert!(are_seamless(&right));
    }
    let last = bench.of(20).pop().expect("windows");
    assert!(bench.now.time.saturating_since(last.to) < Duration::from_secs(20));
}

#[test]
fn every_window_is_measured_whole_by_the_old_or_by_the_new_configuration() {
    // In the middle of windows of both lengths.
    let bench = Bench::run(&[Pass(90, ROAD), Prepare("second"), Pass(100, ROAD)]);
    let change = UtcMs(1_767_600_120_000);
    for length_s in LENGTHS_S {
        let windows = bench.of(length_s);
        assert!(are_seamless(&windows), "{windows:#?}");
        let length = Duration::from_secs(length_s);
        let [first, last] = [&windows[0], &windows[windows.len() - 1]];
        assert_eq!(first.from, BEGIN.floor_to(length).saturating_add(length), "the first whole");
        assert_eq!(last.to, bench.now.time.floor_to(length));
        for window in &windows {
            assert_eq!(window.used, window.expected, "{window:?} is whole");
            let calibration = if window.from < change { "first" } else { "second" };
            assert_eq!(window.calibration, calibration, "{window:?}");
        }
        assert!(windows.iter().any(|window| window.from == change), "the end of the minute");
    }
}

#[test]
fn a_configuration_that_waits_is_replaced_by_a_later_one_and_follows_the_clock() {
    let waits = |steps: &[Step]| Bench::run(steps).sensor.takes_over_at();
    let script = [Pass(10, ROAD), Prepare("a"), Pass(10, ROAD), Prepare("b"), Pass(1, ROAD)];
    assert_eq!(waits(&script), Some(UtcMs(1_767_600_060_000)));
    for by_ms in [-7_200_000, 7_200_000] {
        let script =
            [Pass(30, ROAD), Prepare("a"), Prepare("b"), SetClock(by_ms, true), Pass(100, ROAD)];
        let bench = Bench::run(&script);
        assert_eq!(bench.sensor.takes_over_at(), None, "within a minute, set by {by_ms}");
        let last = bench.of(20).pop().expect("windows");
        assert_eq!((last.calibration.as_str(), last.used), ("b", 4));
    }
}
