//! How long a source that failed is left alone before it is opened again.
//!
//! Owns the waits. Time comes in as an argument.

use std::time::{Duration, Instant};

/// First wait: a device node that has just come back is not ready at once.
pub const FIRST: Duration = Duration::from_millis(500);
/// Longest wait: a camera that is back is measured again within ten seconds.
pub const LONGEST: Duration = Duration::from_secs(4);
/// The same for a device at the box, where an attempt costs next to nothing and nobody else
/// is asked.
pub const LONGEST_AT_THE_BOX: Duration = Duration::from_secs(1);

/// Waits that double with each failure in a row.
#[derive(Clone, Debug)]
pub struct Backoff {
    longest: Duration,
    failures: u32,
    until: Option<Instant>,
}

impl Default for Backoff {
    fn default() -> Self {
        Self::up_to(LONGEST)
    }
}

impl Backoff {
    /// Waits of at most `longest`.
    pub const fn up_to(longest: Duration) -> Self {
        Self { longest, failures: 0, until: None }
    }

    /// Whether the next attempt has to wait.
    pub fn waits(&self, now: Instant) -> bool {
        self.until.is_some_and(|until| now < until)
    }

    /// Notes a failure. The wait is up to a quarter shorter (`jitter` 0 to 1), so that
    /// many boxes do not ask one server at the same moment.
    pub fn failed(&mut self, now: Instant, jitter: f32) {
        let doubled = FIRST.saturating_mul(1 << self.failures.min(8)).min(self.longest);
        self.failures = self.failures.saturating_add(1);
        self.until = now.checked_add(doubled.mul_f32(1.0 - 0.25 * jitter.clamp(0.0, 1.0)));
    }

    /// Notes a success.
    pub fn succeeded(&mut self) {
        *self = Self::up_to(self.longest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_up_to_the_longest_and_are_forgotten_on_success() {
        let (mut backoff, start) = (Backoff::default(), Instant::now());
        assert!(!backoff.waits(start));
        for expected_ms in [500, 1000, 2000, 4000, 4000] {
            backoff.failed(start, 0.0);
            assert!(backoff.waits(start + Duration::from_millis(expected_ms - 1)));
            assert!(!backoff.waits(start + Duration::from_millis(expected_ms)));
        }
        backoff.succeeded();
        assert!(!backoff.waits(start));
        backoff.failed(start, 1.0);
        assert!(!backoff.waits(start + Duration::from_millis(375)));
        let mut short = Backoff::up_to(LONGEST_AT_THE_BOX);
        for expected_ms in [500, 1000, 1000] {
            short.failed(start, 0.0);
            assert!(short.waits(start + Duration::from_millis(expected_ms - 1)));
            assert!(!short.waits(start + Duration::from_millis(expected_ms)));
        }
    }
}
