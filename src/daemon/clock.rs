//! The box's clock: what time it is, and whether a time source has set it.
//!
//! Owns the only readings of the wall clock, of the time since the box's start that goes on
//! evenly whatever the wall clock does, and of the thread's processor time. Tests set them by
//! hand.

use crate::units::UtcMs;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// The time now.
pub fn now() -> UtcMs {
    #[cfg(test)]
    if let Some(hands) = hand::get() {
        return hands.now;
    }
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    UtcMs::default().saturating_add(since_1970)
}

/// Whether the kernel holds the clock to be synchronised (by NTP, PTP or GNSS).
pub fn is_synchronised() -> bool {
    #[cfg(test)]
    if let Some(hands) = hand::get() {
        return hands.synchronised;
    }
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
    #[cfg(test)]
    if let Some(hands) = hand::get() {
        return hands.monotonic;
    }
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
    /// What it would show.
    pub from: UtcMs,
    /// What it shows.
    pub to: UtcMs,
}

/// Smallest difference that counts as a step: below it lie a clock that is being slewed and
/// a busy box between two readings.
const LEAST_STEP: Duration = Duration::from_secs(2);

impl Watch {
    /// Begins to watch.
    pub fn start() -> Self {
        Self { monotonic: monotonic(), wall: now() }
    }

    /// Whether the clock was set since the last question.
    pub fn step(&mut self) -> Option<Step> {
        let before = std::mem::replace(self, Self::start());
        let passed = self.monotonic.saturating_sub(before.monotonic);
        let (from, to) = (before.wall.saturating_add(passed), self.wall);
        let by = to.saturating_since(from).max(from.saturating_since(to));
        (by >= LEAST_STEP).then_some(Step { from, to })
    }
}

/// The clocks of a test, set by hand. Each thread has its own, so that tests run side by side.
#[cfg(test)]
pub mod hand {
    use super::{Duration, UtcMs};
    use std::cell::Cell;

    /// What the clocks show.
    #[derive(Clone, Copy, Debug)]
    pub struct Hands {
        /// The wall clock.
        pub now: UtcMs,
        /// Time since start.
        pub monotonic: Duration,
        /// Whether the wall clock is held to be right.
        pub synchronised: bool,
    }

    thread_local!(static HANDS: Cell<Option<Hands>> = const { Cell::new(None) });

    pub(super) fn get() -> Option<Hands> {
        HANDS.get()
    }

    /// Stops this thread's clocks at that time.
    pub fn stop(now: UtcMs) {
        HANDS.set(Some(Hands { now, monotonic: Duration::from_secs(1000), synchronised: true }));
    }

    /// Lets time pass.
    pub fn pass(time: Duration) {
        let hands = get().expect("the clocks were stopped");
        let (now, monotonic) = (hands.now.saturating_add(time), hands.monotonic + time);
        HANDS.set(Some(Hands { now, monotonic, ..hands }));
    }

    /// Sets the wall clock forwards, or backwards, and says whether it is right then.
    pub fn set(by_ms: i64, synchronised: bool) {
        let hands = get().expect("the clocks were stopped");
        HANDS.set(Some(Hands { now: UtcMs(hands.now.0 + by_ms), synchronised, ..hands }));
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
        hand::stop(UtcMs(1_000_000));
        let mut watch = Watch::start();
        hand::pass(Duration::from_secs(3600));
        hand::set(1_500, true);
        assert_eq!(watch.step(), None);
        hand::pass(Duration::from_secs(10));
        hand::set(-60_000, true);
        let step = watch.step().expect("a minute back");
        assert_eq!(step, Step { from: UtcMs(4_611_500), to: UtcMs(4_551_500) });
        assert_eq!(watch.step(), None);
    }
}
