//! Recorded frames: a folder of pictures in the order of their names.
//!
//! Owns which files belong to a recording and when each was taken.

use super::timestamp;
use super::{CaptureError, Captured, DecodeError, MAX_PICTURE_BYTES, decode};
use crate::daemon::clock;
use crate::daemon::frame::Frame;
use crate::units::UtcMs;
use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::{Duration, UNIX_EPOCH};

/// Time between frames where neither names nor files tell: one picture in two minutes, as
/// the paper's Hong Kong cameras give.
pub const DEFAULT_INTERVAL: Duration = Duration::from_secs(120);

/// Why a folder is not a recording.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The folder cannot be listed.
    #[error("cannot list the frames in {}: {source}", folder.display())]
    List {
        /// The folder.
        folder: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// Nothing in it is a picture.
    #[error("no .jpg, .jpeg or .png file in {}", folder.display())]
    NoFrames {
        /// The folder.
        folder: PathBuf,
    },
    /// The interval that was asked for is none.
    #[error("a time of {} s between frames: give more than 0", .0.as_secs_f64())]
    Interval(Duration),
}

/// Where the frames' times come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TimeSource {
    /// Each name carries its time (UTC).
    Names,
    /// The times at which the files were last written.
    Files,
    /// An interval that was asked for, from the first frame's time where its name has one,
    /// else 1970.
    Interval,
    /// The same with [`DEFAULT_INTERVAL`], since nothing tells.
    Assumed,
}

/// A folder of pictures, played once.
#[derive(Debug)]
pub struct Recorded {
    files: Vec<(PathBuf, String, UtcMs)>,
    next: usize,
    for_ever: bool,
    interval: Duration,
    time_source: TimeSource,
    bytes: Vec<u8>,
}

impl Recorded {
    /// Lists a folder. `interval` is the time between frames; without it the names' times
    /// count, then the files', then one in two minutes is assumed.
    ///
    /// # Errors
    /// [`RecordingError`] where there is nothing to play.
    pub fn open(folder: &Path, interval: Option<Duration>) -> Result<Self, RecordingError> {
        let list = |source| RecordingError::List { folder: folder.to_owned(), source };
        let mut names = Vec::new();
        for entry in fs::read_dir(folder).map_err(list)? {
            let path = entry.map_err(list)?.path();
            if is_picture(&path)
                && let Some(name) = path.file_name()
            {
                names.push((path.clone(), name.to_string_lossy().into_owned()));
            }
        }
        if names.is_empty() {
            return Err(RecordingError::NoFrames { folder: folder.to_owned() });
        }
        names.sort_by(|a, b| a.1.cmp(&b.1));
        let (time_source, times, interval) = times(&names, interval)?;
        let files = names.into_iter().zip(times).map(|((p, n), t)| (p, n, t)).collect();
        Ok(Self { files, next: 0, for_ever: false, interval, time_source, bytes: Vec::new() })
    }

    /// The same recording as a camera: it begins again at its end, and its frames are
    /// taken when they are asked for.
    pub fn for_ever(self) -> Self {
        Self { for_ever: true, ..self }
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.files.len()
    }

    /// Whether the frames' names tell when they were taken.
    pub fn tells_time(&self) -> bool {
        self.time_source == TimeSource::Names
    }

    /// Whether the time between frames is nowhere told.
    pub fn assumes_interval(&self) -> bool {
        self.time_source == TimeSource::Assumed
    }

    /// Time between two frames (the median, where times come from names or files).
    pub fn interval(&self) -> Duration {
        self.interval
    }

    /// Fills `frame` with the next picture. A picture that fails is passed over.
    pub(super) fn next(&mut self, frame: &mut Frame) -> Result<Captured, CaptureError> {
        if self.for_ever && self.next == self.files.len() {
            self.next = 0;
        }
        let Some((path, name, time)) = self.files.get(self.next) else { return Ok(Captured::End) };
        self.next += 1;
        frame.time = if self.for_ever { clock::now() } else { *time };
        frame.name.clone_from(name);
        let read = |source| CaptureError::Read { path: path.clone(), source };
        self.bytes.clear();
        let file = File::open(path).map_err(read)?;
        file.take(MAX_PICTURE_BYTES as u64 + 1).read_to_end(&mut self.bytes).map_err(read)?;
        let decoded = if self.bytes.len() > MAX_PICTURE_BYTES {
            Err(DecodeError::TooManyBytes)
        } else {
            decode(&self.bytes, &mut frame.picture)
        };
        decoded.map_err(|source| CaptureError::Decode { name: name.clone(), source })?;
        Ok(Captured::New)
    }
}

fn is_picture(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    ["jpg", "jpeg", "png"].iter().any(|known| extension.eq_ignore_ascii_case(known))
}

/// The time of every file, where it comes from, and the time between two.
fn times(
    names: &[(PathBuf, String)],
    interval: Option<Duration>,
) -> Result<(TimeSource, Vec<UtcMs>, Duration), RecordingError> {
    if interval.is_some_and(|i| i.is_zero()) {
        return Err(RecordingError::Interval(Duration::ZERO));
    }
    let named: Option<Vec<_>> = names.iter().map(|(_, name)| timestamp::from_name(name)).collect();
    if interval.is_none() {
        if let Some((times, median)) = named.clone().and_then(with_interval) {
            return Ok((TimeSource::Names, times, median));
        }
        let written: Option<Vec<_>> = names.iter().map(|(path, _)| written_at(path)).collect();
        // Copied or unpacked files carry the time of the copying, not of the picture.
        if let Some((times, median)) = written.and_then(with_interval)
            && median >= Duration::from_secs(1)
        {
            return Ok((TimeSource::Files, times, median));
        }
    }
    let step = interval.unwrap_or(DEFAULT_INTERVAL);
    let first = timestamp::from_name(&names[0].1).unwrap_or_default();
    let times = (0..names.len() as u32).map(|n| first.saturating_add(step.saturating_mul(n)));
    let source = if interval.is_some() { TimeSource::Interval } else { TimeSource::Assumed };
    Ok((source, times.collect(), step))
}

/// The times with their median step, if they rise.
fn with_interval(times: Vec<UtcMs>) -> Option<(Vec<UtcMs>, Duration)> {
    let mut steps: Vec<_> = times
        .windows(2)
        .map(|pair| (pair[1] > pair[0]).then(|| pair[1].saturating_since(pair[0])))
        .collect::<Option<_>>()?;
    steps.sort();
    let median = *steps.get(steps.len() / 2)?;
    Some((times, median))
}

fn written_at(path: &Path) -> Option<UtcMs> {
    let since_1970 = fs::metadata(path).ok()?.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
    Some(UtcMs::default().saturating_add(since_1970))
}
