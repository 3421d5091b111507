//! Faults that are bounded and counted: a part that fails is asked less often, and a line
//! that fails too often is given up.
//!
//! Owns the waits and limits. Reads no clock: callers pass the time since start.

use core::time::Duration;

/// First wait after a part has failed; it doubles with each failure in a row.
pub const RETRY_FIRST: Duration = Duration::from_secs(1);
/// Longest wait before a part that fails is asked again.
pub const RETRY_LONGEST: Duration = Duration::from_secs(60);
/// Faults of one stage within [`WITHIN`] that are survived; with one more the program
/// ends, and its supervisor starts it afresh.
pub const MOST_FAULTS: usize = 5;
/// See [`MOST_FAULTS`].
pub const WITHIN: Duration = Duration::from_secs(60);

/// Change of a part's state by its latest outcome.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// As before.
    None,
    /// It worked, and fails now.
    Broke,
    /// It failed, and works again.
    Mended,
}

/// A part that may fail: a pin, a sensor, a watchdog.
#[derive(Clone, Copy, Debug)]
pub struct Part {
    faults: u64,
    in_a_row: u32,
    next: Duration,
    longest: Duration,
}

impl Default for Part {
    fn default() -> Self {
        Self::asked_within(RETRY_LONGEST)
    }
}

impl Part {
    /// A part that is asked again after `longest` at the latest.
    pub const fn asked_within(longest: Duration) -> Self {
        Self { faults: 0, in_a_row: 0, next: Duration::ZERO, longest }
    }

    /// Whether it is to be asked at `now`.
    pub fn is_due(&self, now: Duration) -> bool {
        now >= self.next
    }

    /// Notes whether it worked at `now`.
    pub fn note(&mut self, worked: bool, now: Duration) -> Change {
        let was_broken = self.is_broken();
        if worked {
            (self.in_a_row, self.next) = (0, now);
            return if was_broken { Change::Mended } else { Change::None };
        }
        let wait = RETRY_FIRST.saturating_mul(1 << self.in_a_row.min(16)).min(self.longest);
        self.next = now.saturating_add(wait);
        self.in_a_row = self.in_a_row.saturating_add(1);
        self.faults = self.faults.saturating_add(1);
        if was_broken { Change::None } else { Change::Broke }
    }

    /// Whether it failed when it was last asked.
    pub fn is_broken(&self) -> bool {
        self.in_a_row > 0
    }

    /// Failures since start.
    pub fn faults(&self) -> u64 {
        self.faults
    }
}

/// Faults of a stage that should never happen: how many are survived.
#[derive(Clone, Debug, Default)]
pub struct Allowance {
    recent: heapless::Deque<Duration, MOST_FAULTS>,
    faults: u64,
}

impl Allowance {
    /// Notes a fault at `now`; false when it was one too many.
    pub fn note(&mut self, now: Duration) -> bool {
        self.faults = self.faults.saturating_add(1);
        while self.recent.front().is_some_and(|&then| now.saturating_sub(then) > WITHIN) {
            self.recent.pop_front();
        }
        self.recent.push_back(now).is_ok()
    }

    /// Faults since start.
    pub fn faults(&self) -> u64 {
        self.faults
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    #[test]
    fn a_part_that_fails_is_asked_less_and_less_often_but_always_again() {
        let mut part = Part::default();
        let mut asked = std::vec::Vec::new();
        for second in 0..300 {
            if part.is_due(SECOND * second) {
                asked.push(second);
                part.note(false, SECOND * second);
            }
        }
        assert_eq!(asked, [0, 1, 3, 7, 15, 31, 63, 123, 183, 243]);
        assert_eq!(part.faults(), 10);
    }

    #[test]
    fn breaking_and_mending_are_told_once() {
        let mut part = Part::asked_within(SECOND);
        assert_eq!(part.note(true, SECOND), Change::None);
        assert_eq!(part.note(false, SECOND), Change::Broke);
        assert_eq!(part.note(false, SECOND * 2), Change::None);
        assert!(part.is_broken() && !part.is_due(SECOND * 2) && part.is_due(SECOND * 3));
        assert_eq!(part.note(true, SECOND * 3), Change::Mended);
        assert!(!part.is_broken() && part.is_due(SECOND * 3));
        assert_eq!(part.faults(), 2);
    }

    #[test]
    fn five_faults_a_minute_are_survived_and_the_sixth_is_not() {
        let mut allowance = Allowance::default();
        assert!((0..5).all(|second| allowance.note(SECOND * second)));
        assert!(!allowance.note(SECOND * 5));
        let mut slow = Allowance::default();
        assert!((0..100).all(|n| slow.note(SECOND * 13 * n)), "one in 13 s, indefinitely");
        assert_eq!(slow.faults(), 100);
    }
}
