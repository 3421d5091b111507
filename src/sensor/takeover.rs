//! When a new configuration takes over.
//!
//! Owns the instant: the next one at which all windows end together, by the clock, so that
//! every window is whole, measured by the old configuration or by the new one. Where each
//! length divides the longest, that is the end of the longest running window.

use crate::units::UtcMs;
use core::time::Duration;

/// The least common multiple of the windows' lengths. Each divides a day, and so does it.
pub(super) fn common_period(lengths: &[Duration]) -> Duration {
    let gcd = |mut a: u64, mut b: u64| {
        while let Some(rest) = a.checked_rem(b) {
            (a, b) = (b, rest);
        }
        a.max(1)
    };
    let seconds = lengths.iter().map(|length| length.as_secs().max(1));
    Duration::from_secs(seconds.fold(1, |lcm, s| {
        let parts = lcm.checked_div(gcd(lcm, s)).unwrap_or(lcm);
        parts.saturating_mul(s)
    }))
}

/// A configuration that waits for the running windows to end.
#[derive(Clone, Copy, Debug)]
pub(super) struct TakeOver {
    /// All running windows end at its multiples.
    period: Duration,
    at: UtcMs,
}

impl TakeOver {
    /// At the first multiple of `period` after `now`.
    pub(super) fn after(now: UtcMs, period: Duration) -> Self {
        Self { period, at: now.floor_to(period).saturating_add(period) }
    }

    pub(super) const fn at(&self) -> UtcMs {
        self.at
    }

    /// The instant of the change where it has come by `time`.
    pub(super) fn due(&mut self, time: UtcMs) -> Option<UtcMs> {
        let latest = time.floor_to(self.period).saturating_add(self.period);
        if self.at > latest {
            // The clock was set back.
            self.at = latest;
        }
        if time < self.at {
            return None;
        }
        // It may have been set forward, too.
        self.at = self.at.max(time.floor_to(self.period));
        Some(self.at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_change_comes_when_all_windows_end() {
        for (lengths_s, seconds) in [
            (&[60, 900][..], 900),
            (&[10], 10),
            (&[300, 900, 60], 900),
            (&[600, 900], 1800),
            (&[20, 30], 60),
        ] {
            let lengths: std::vec::Vec<_> =
                lengths_s.iter().copied().map(Duration::from_secs).collect();
            assert_eq!(common_period(&lengths), Duration::from_secs(seconds), "{lengths_s:?}");
        }
    }
}
