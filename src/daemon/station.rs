//! A camera with the line behind it.
//!
//! Owns the frame that passes from one to the other, and which camera is asked. Reads no
//! configuration: `assemble` does.

use super::capture::{Captured, Source, SourceSettings, StreamCounts};
use super::exit::Failure;
use super::frame::Frame;
use super::line::{Line, Observer};
use crate::refresh::Refresh;
use crate::sensor::Outcome;
use std::time::{Duration, Instant};

/// Slow answers in a row that make a camera slow.
pub const ANSWERS: usize = 3;

/// Advice for a camera that has a picture to measure less often than it is asked.
pub fn advice(period: Duration, interval: Duration) -> String {
    let whole = period.as_secs_f64().round().max(1.0);
    format!(
        "the camera has a new picture each {whole:.0} s and is asked each {} s, so that windows have too \
         few of them: set camera.interval_s = {whole:.0}, or make the camera faster",
        interval.as_secs_f64()
    )
}

/// How often a camera has a new picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Pace {
    /// It never had one.
    Still,
    /// Less often than it is asked; what to do.
    Slow(String),
    /// As often as it is asked.
    Even,
}

/// A camera with the line behind it.
#[derive(Debug)]
pub struct Station {
    source: Source,
    /// The settings that the source was opened with.
    camera: Option<SourceSettings>,
    frame: Frame,
    line: Line,
    /// How long the camera took for its latest answers.
    answers: [Duration; ANSWERS],
}

impl Station {
    /// A camera in front of a line. It is not asked yet.
    ///
    /// # Errors
    /// Where the camera cannot be set up.
    pub fn open(camera: SourceSettings, line: Line) -> Result<Self, Failure> {
        let source = Source::open(camera.clone())?;
        let (frame, answers) = (Frame::default(), [Duration::ZERO; ANSWERS]);
        Ok(Self { source, camera: Some(camera), frame, line, answers })
    }

    /// A source that has given a frame already, or none yet, in front of a line.
    pub fn with(source: Source, frame: Frame, line: Line) -> Self {
        Self { source, camera: None, frame, line, answers: [Duration::ZERO; ANSWERS] }
    }

    /// Takes a picture; false when it has the bytes of the one before.
    ///
    /// # Errors
    /// [`Failure::Capture`]: there is none.
    pub fn capture(&mut self) -> Result<bool, Failure> {
        let begun = Instant::now();
        let captured = self.source.next(&mut self.frame);
        self.answers.rotate_left(1);
        // A camera that gives none is another fault.
        self.answers[ANSWERS - 1] = captured.as_ref().map_or(Duration::ZERO, |_| begun.elapsed());
        Ok(captured? == Captured::New)
    }

    /// Advice where each of the latest `count` snapshots, at most [`ANSWERS`], took so long that
    /// windows would have too few of them.
    pub fn slow_answers(&self, count: usize) -> Option<String> {
        let Source::Snapshot(_) = self.source else { return None };
        let interval = self.source.interval();
        let least = self.answers.iter().rev().take(count).min().copied()?;
        let is_slower = least.saturating_mul(2) > interval.saturating_mul(3);
        is_slower.then(|| advice(least, interval))
    }

    /// Takes a picture and looks where the camera looks, without measuring. `None`: the picture before
    /// again; else what keeps it from being judged, empty where nothing does.
    ///
    /// # Errors
    /// As [`Self::capture`], and where the picture does not fit the table.
    pub fn aim(&mut self) -> Result<Option<&'static str>, Failure> {
        if !self.capture()? {
            return Ok(None);
        }
        self.line.aim(&self.frame).map(Some)
    }

    /// Asks each `interval`, for at most `limit`, until it is known how often the camera has a new
    /// picture.
    ///
    /// # Errors
    /// As [`Self::capture`] and [`Self::measure`].
    pub fn watch_pace(&mut self, interval: Duration, limit: Duration) -> Result<Pace, Failure> {
        let (begun, mut refresh, mut changes) = (Instant::now(), Refresh::default(), 0);
        refresh.note(true, Duration::ZERO);
        while changes < 2 && refresh.period(interval).is_none() && begun.elapsed() < limit {
            std::thread::sleep(interval.clamp(Duration::from_millis(200), Duration::from_secs(5)));
            // The same picture, compressed once more, is not new.
            let is_new = self.capture()? && self.measure(&mut |_| ())? != Outcome::Unchanged;
            refresh.note(is_new, begun.elapsed());
            changes += u32::from(is_new);
        }
        Ok(match refresh.period(interval) {
            _ if changes == 0 => Pace::Still,
            Some(period) => Pace::Slow(advice(period, interval)),
            None => Pace::Even,
        })
    }

    /// Whether the camera may give one picture several times.
    pub fn may_stand_still(&self) -> bool {
        matches!(self.source, Source::Snapshot(_) | Source::Mjpeg(_))
    }

    /// Advice where a video's key pictures come so seldom that windows would have too few of them.
    pub fn slow_keys(&self) -> Option<String> {
        Some(advice(self.source.slow_keys()?, self.source.interval()))
    }

    /// Measures the picture that was taken last.
    ///
    /// # Errors
    /// As [`Line::measure`].
    pub fn measure(&mut self, observe: Observer<'_>) -> Result<Outcome<'_>, Failure> {
        self.line.measure(&self.frame, observe)
    }

    /// Replaces the line, and the camera where it is another one.
    ///
    /// # Errors
    /// Where the camera cannot be set up; all is as it was then.
    pub fn replace(&mut self, line: Line, camera: SourceSettings) -> Result<(), Failure> {
        if !self.asks(&camera) {
            self.source = Source::open(camera.clone())?;
            self.camera = Some(camera);
            self.answers = [Duration::ZERO; ANSWERS];
        }
        self.line = line;
        Ok(())
    }

    /// Whether pictures come from this camera.
    pub fn asks(&self, camera: &SourceSettings) -> bool {
        self.camera.as_ref() == Some(camera)
    }

    /// Counts of the frames of the camera's stream.
    pub fn stream_counts(&self) -> StreamCounts {
        self.source.counts()
    }

    /// The picture that was taken last.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// The line that measures its pictures.
    pub fn line(&self) -> &Line {
        &self.line
    }
}
