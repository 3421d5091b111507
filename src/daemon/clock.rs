//! The box's clock: what time it is, and whether a time source has set it.
//!
//! Owns the only readings of the wall clock, of the time since the box's start that goes on
//! evenly whatever the wall clock does, and of the thread's processor time.

use crate::units::UtcMs;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// The time now.
pub fn now() -> UtcMs {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    UtcMs::default().saturating_add(since_1970)
}

/// Whether the kernel holds the clock to be synchronised (by NTP, PTP or GNSS).
pub fn is_synchronised() -> bool {
    // SAFETY: all-zero bytes are a valid `timex`; with `modes` 0 the kernel only reads.
    let mut state: libc::timex = unsafe { core::mem::zeroed() };
    // SAFETY: `state` is a live, exclusive `timex`.
    let outcome = unsafe { libc::adjtimex(&mut state) };
    outcome >= 0 && outcome != libc::TIME_ERROR && state.status & libc::STA_UNSYNC == 0
}

/// Processor time that this thread has used; other programs on a busy machine do not count.
pub fn processor_time() -> Duration {
    read(libc::CLOCK_THREAD_CPUTIME_ID)
}

/// Time since the box's start, which nobody sets.
pub fn monotonic() -> Duration {
    read(libc::CLOCK_MONOTONIC)
}

fn read(clock: libc::clockid_t) -> Duration {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `time` is a live, exclusive `timespec`.
    let outcome = unsafe { libc::clock_gettime(clock, &mut time) };
    match (outcome, u64::try_from(time.tv_sec), u32::try_from(time.tv_nsec)) {
        (0, Ok(seconds), Ok(nanoseconds)) => Duration::new(seconds, nanoseconds),
        _ => Duration::ZERO,
    }
}

/// Notices that the wall clock was set.
#[derive(Clone, Copy, Debug)]
pub struct Watch {
    wall: UtcMs,
    monotonic: Duration,
}

/// From one time to another that the clock was set to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// Expected time.
    pub from: UtcMs,
    /// Time that it shows.
    pub to: UtcMs,
}

/// Smallest difference that counts as a step: below it lie a clock that is being slewed and
/// a busy box between two readings.
const LEAST_STEP: Duration = Duration::from_secs(2);

impl Watch {
    /// Begins to watch clocks that show this.
    pub const fn new(wall: UtcMs, monotonic: Duration) -> Self {
        Self { wall, monotonic }
    }

    /// Whether the wall clock was set since the last question; they show this now.
    pub fn step(&mut self, wall: UtcMs, monotonic: Duration) -> Option<Step> {
        let before = std::mem::replace(self, Self { wall, monotonic });
        let passed = monotonic.saturating_sub(before.monotonic);
        let (from, to) = (before.wall.saturating_add(passed), wall);
        let by = to.saturating_since(from).max(from.saturating_since(to));
        (by >= LEAST_STEP).then_some(Step { from, to })
    }
}

/// RFC 3339 in UTC with milliseconds, as all messages have it.
pub fn rfc3339(time: UtcMs) -> String {
    verge_messages::rfc3339(time.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_noticed_once_and_a_slew_is_none() {
        let mut watch = Watch::new(UtcMs(1_000_000), Duration::from_secs(1000));
        assert_eq!(watch.step(UtcMs(4_601_500), Duration::from_secs(4600)), None, "1.5 s off");
        let step = watch.step(UtcMs(4_551_500), Duration::from_secs(4610));
        assert_eq!(step, Some(Step { from: UtcMs(4_611_500), to: UtcMs(4_551_500) }));
        assert_eq!(watch.step(UtcMs(4_551_500), Duration::from_secs(4610)), None);
    }
}
