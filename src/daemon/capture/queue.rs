//! Choice among the frames that wait in a device's buffers, and the count of lost ones.
//!
//! Owns two rules and knows no device. While pictures are asked for less often than frames
//! come, the driver fills every buffer and then drops frames, so that what waits may be as
//! old as the last question.

use std::time::Duration;

/// Most buffers of a stream: one is being read, one is being filled, two wait.
const MOST_BUFFERS: u32 = 4;
/// Fewest: one is being read, one is being filled.
const FEWEST_BUFFERS: u32 = 2;
/// Memory that a stream's buffers may take, bytes: it has room for four frames of 1920x1080 in YUYV, and
/// for two of 3840x2160.
const MOST_BUFFERED: u32 = 36 << 20;
/// Oldest picture that is taken for a new one.
pub const FRESH: Duration = Duration::from_secs(2);
/// Frames that are passed over for one picture; a camera that is faster than the box is
/// read as fast as it goes.
const MOST_PASSED: u32 = 2 * MOST_BUFFERS;
/// Larger leaps of the sequence number are a counter that began again.
const LARGEST_GAP: u32 = 1000;

/// How many buffers a stream gets whose frames take this many bytes; `None` where not even the
/// fewest have room.
pub fn buffers(frame_bytes: u32) -> Option<u32> {
    let room = MOST_BUFFERED / frame_bytes.max(1);
    (room >= FEWEST_BUFFERS).then(|| room.min(MOST_BUFFERS))
}

/// The frames of one question, from the oldest that waits.
#[derive(Clone, Copy, Debug)]
pub struct Question {
    since_last: Duration,
    buffers: u32,
    passed: u32,
}

impl Question {
    /// A question this long after the one before, to a stream of so many buffers.
    pub fn new(since_last: Duration, buffers: u32) -> Self {
        Self { since_last, buffers, passed: 0 }
    }

    /// Whether a frame is passed over: it `waited` (it was there before it was asked for),
    /// and `more` wait behind it or all of them may be old.
    pub fn passes(&mut self, waited: bool, more: bool) -> bool {
        self.passed += u32::from(waited);
        waited && (more || self.since_last > FRESH) && self.passed <= MOST_PASSED
    }

    /// Whether the driver may have been short of a buffer since the last question.
    pub fn starved(&self) -> bool {
        self.passed + 1 >= self.buffers
    }
}

/// Counts the frames that are missing between sequence numbers.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sequence {
    last: Option<u32>,
}

impl Sequence {
    /// Frames lost before number `number`; none where the driver had no buffer for them.
    pub fn lost(&mut self, number: u32, starved: bool) -> u64 {
        let last = self.last.replace(number);
        let gap = last.map_or(0, |last| number.wrapping_sub(last).wrapping_sub(1));
        if starved || gap > LARGEST_GAP { 0 } else { u64::from(gap) }
    }

    /// Whether no frame was taken yet.
    pub fn is_new(&self) -> bool {
        self.last.is_none()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How many frames are passed over when this many wait.
    fn passed(waiting: u32, since_last: Duration) -> u32 {
        let mut question = Question::new(since_last, MOST_BUFFERS);
        (0..100)
            .find(|&n| !question.passes(n < waiting, n + 1 < waiting))
            .expect("a frame is taken in the end")
    }

    #[test]
    fn large_frames_get_fewer_buffers_and_too_large_ones_none() {
        let yuyv = |width: u32, height: u32| 2 * width * height;
        assert_eq!(buffers(yuyv(1920, 1080)), Some(4));
        assert_eq!(buffers(yuyv(3840, 2160)), Some(2));
        assert_eq!(buffers(0), Some(4), "a driver that does not say");
        assert_eq!(buffers(u32::MAX), None);
    }

    #[test]
    fn asked_often_the_newest_waiting_frame_is_taken() {
        let often = Duration::from_millis(100);
        assert_eq!(passed(0, often), 0, "none waits: the next one");
        assert_eq!(passed(1, often), 0, "the only one");
        assert_eq!(passed(3, often), 2, "the last of three");
    }

    #[test]
    fn asked_seldom_all_that_wait_are_old() {
        let seldom = Duration::from_secs(120);
        assert_eq!(passed(0, seldom), 0);
        assert_eq!(passed(3, seldom), 3, "the one behind them");
    }

    #[test]
    fn a_camera_that_outruns_the_box_gives_a_picture_all_the_same() {
        assert!(passed(u32::MAX, Duration::ZERO) <= MOST_PASSED);
    }

    #[test]
    fn gaps_are_lost_frames_unless_the_driver_was_starved_or_began_again() {
        let mut sequence = Sequence::default();
        assert!(sequence.is_new());
        assert_eq!(sequence.lost(7, false), 0);
        assert_eq!(sequence.lost(8, false), 0);
        assert_eq!(sequence.lost(11, false), 2);
        assert_eq!(sequence.lost(15, true), 0, "no buffer was free");
        assert_eq!(sequence.lost(0, false), 0, "the counter began again");
        assert_eq!(sequence.lost(0, false), 0, "the same number twice");
        let mut wrapping = Sequence::default();
        assert_eq!(wrapping.lost(u32::MAX, false), 0);
        assert_eq!(wrapping.lost(1, false), 1);
    }
}
