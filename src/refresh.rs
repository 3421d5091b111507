//! How often a camera has a new picture, seen from how often it gave the same one.
//!
//! Owns the rule by which a camera is slower than it is asked. Time since start comes in as an
//! argument.

use core::time::Duration;

/// Gaps from which the period is taken: the median of as many passes over a picture that was missed,
/// and over one that stood still for once.
const GAPS: usize = 4;
/// Gaps from which on a camera is called slow.
const ENOUGH: usize = 2;

/// The latest gaps between new pictures.
#[derive(Clone, Debug, Default)]
pub struct Refresh {
    gaps: [Duration; GAPS],
    /// Gaps since the beginning.
    count: usize,
    last_new: Option<Duration>,
    /// Whether the same picture came since then.
    stood_still: bool,
    /// Whether one of the latest gaps had the same picture in it.
    slow: [bool; GAPS],
}

impl Refresh {
    /// Notes a picture at `now`: a new one, or the same again.
    pub fn note(&mut self, is_new: bool, now: Duration) {
        if !is_new {
            self.stood_still = true;
            return;
        }
        if let Some(last) = self.last_new {
            let at = self.count % GAPS;
            self.gaps[at] = now.saturating_sub(last);
            self.slow[at] = self.stood_still;
            self.count = self.count.saturating_add(1);
        }
        (self.last_new, self.stood_still) = (Some(now), false);
    }

    /// Notes that no picture came, or a damaged one: how long it takes says nothing of the camera's
    /// period.
    pub fn note_gap(&mut self) {
        (self.last_new, self.stood_still) = (None, false);
    }

    /// Time from one new picture to the next, where the camera gives one picture several times; as
    /// soon as one gap is known.
    pub fn gap(&self, interval: Duration) -> Option<Duration> {
        let known = self.count.min(GAPS);
        let gaps = || self.gaps.iter().take(known);
        let shorter = |gap: &Duration| gaps().filter(|&other| other < gap).count();
        let median = *gaps().filter(|gap| shorter(gap) <= known / 2).max()?;
        let is_slower = self.slow.iter().take(known).any(|&slow| slow)
            && median.saturating_mul(2) > interval.saturating_mul(3);
        is_slower.then_some(median)
    }

    /// The same once several gaps agree on it.
    pub fn period(&self, interval: Duration) -> Option<Duration> {
        self.gap(interval).filter(|_| self.count >= ENOUGH)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INTERVAL: Duration = Duration::from_secs(5);

    #[test]
    fn a_camera_that_is_slower_than_it_is_asked_is_noticed() {
        let mut refresh = Refresh::default();
        // New at 0, 30 and 60 s.
        for turn in 0..=12 {
            assert_eq!(refresh.period(INTERVAL), None, "after {turn} answers");
            refresh.note(turn % 6 == 0, INTERVAL * turn);
        }
        assert_eq!(refresh.period(INTERVAL), Some(Duration::from_secs(30)));
        // Asked as often as it has pictures, it is slow no longer.
        for turn in 13..18 {
            refresh.note(true, INTERVAL * turn);
        }
        assert_eq!(refresh.period(INTERVAL), None);
    }

    #[test]
    fn a_picture_that_stands_still_for_once_makes_no_slow_camera() {
        let mut refresh = Refresh::default();
        for turn in 0..50 {
            refresh.note(turn % 10 != 3, INTERVAL * turn);
            assert_eq!(refresh.period(INTERVAL), None);
        }
    }

    #[test]
    fn an_outage_says_nothing_of_the_period() {
        let mut refresh = Refresh::default();
        for outage in 0..10 {
            let begin = Duration::from_secs(600) * outage;
            (0..4).for_each(|turn| refresh.note(turn != 1, begin + INTERVAL * turn));
            refresh.note_gap();
            assert!(refresh.gap(INTERVAL).is_none_or(|gap| gap <= INTERVAL * 2));
        }
    }
}
