//! How often a camera has a new picture, seen from how often it gave the same one.
//!
//! Owns the rule by which a camera is slower than it is asked. Time comes in as an argument.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Changes between which the period is taken: the median of as many gaps passes over a picture
/// that was missed.
const CHANGES: usize = 5;
/// Changes after which it is reported.
const ENOUGH: usize = 3;

/// The latest changes of a camera's picture.
#[derive(Clone, Debug, Default)]
pub struct Refresh {
    changes: VecDeque<Instant>,
    /// Answers without a new picture since the first of these changes.
    unchanged: u32,
    said: bool,
}

impl Refresh {
    /// Notes an answer.
    pub fn note(&mut self, is_new: bool, now: Instant) {
        if !is_new {
            self.unchanged = self.unchanged.saturating_add(1);
            return;
        }
        self.changes.push_back(now);
        if self.changes.len() > CHANGES {
            self.changes.pop_front();
            self.unchanged = self.unchanged.min(CHANGES as u32 * 1000);
        }
    }

    /// Time from one new picture to the next, where the camera gives one picture several times.
    pub fn period(&self, interval: Duration) -> Option<Duration> {
        let times = self.changes.iter().zip(self.changes.iter().skip(1));
        let mut gaps: Vec<_> = times.map(|(from, to)| to.duration_since(*from)).collect();
        gaps.sort();
        let median = *gaps.get(gaps.len() / 2)?;
        let is_slower = self.unchanged > 0 && median > interval.mul_f64(1.5);
        (gaps.len() + 1 >= ENOUGH && is_slower).then_some(median)
    }

    /// The period, once: for the log.
    pub fn news(&mut self, interval: Duration) -> Option<Duration> {
        let period = self.period(interval).filter(|_| !self.said)?;
        self.said = true;
        Some(period)
    }
}

/// What to do about a camera that is slower than it is asked.
pub fn advice(period: Duration, interval: Duration) -> String {
    let whole = period.as_secs_f64().round().max(1.0);
    format!(
        "the camera has a new picture each {whole:.0} s and is asked each {} s: set camera.interval_s = \
         {whole:.0}",
        interval.as_secs_f64()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_that_is_slower_than_it_is_asked_is_noticed_once() {
        let (mut refresh, start, interval) =
            (Refresh::default(), Instant::now(), Duration::from_secs(5));
        for n in 0..13 {
            assert_eq!(refresh.news(interval), None, "after {n} answers");
            refresh.note(n % 6 == 0, start + interval * n);
        }
        assert_eq!(refresh.news(interval), Some(Duration::from_secs(30)));
        assert_eq!(refresh.news(interval), None);
        assert!(advice(Duration::from_secs(30), interval).contains("interval_s = 30"));
    }

    #[test]
    fn a_camera_that_is_fast_enough_is_not() {
        let (mut refresh, start, interval) =
            (Refresh::default(), Instant::now(), Duration::from_secs(5));
        for n in 0..50 {
            refresh.note(n % 10 != 3, start + interval * n);
        }
        assert_eq!(refresh.period(interval), None);
    }
}
