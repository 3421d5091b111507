//! The box's clock: what time it is, and whether a time source has set it.
//!
//! Owns the only reading of the wall clock, and of the thread's processor time.

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
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `time` is a live, exclusive `timespec`.
    let outcome = unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &mut time) };
    match (outcome, u64::try_from(time.tv_sec), u32::try_from(time.tv_nsec)) {
        (0, Ok(seconds), Ok(nanoseconds)) => Duration::new(seconds, nanoseconds),
        _ => Duration::ZERO,
    }
}

/// RFC 3339 in UTC with milliseconds, as all messages have it.
pub fn rfc3339(time: UtcMs) -> String {
    match jiff::Timestamp::from_millisecond(time.0) {
        Ok(timestamp) => format!("{timestamp:.3}"),
        Err(_) => format!("{} ms since 1970", time.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_written_in_utc() {
        assert_eq!(rfc3339(UtcMs(1_767_600_000_250)), "2026-01-05T08:00:00.250Z");
        assert_eq!(rfc3339(UtcMs(0)), "1970-01-01T00:00:00.000Z");
    }
}
