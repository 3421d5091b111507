//! Recorded frames: a folder of pictures, or of folders by day, in the order of their times.
//!
//! Owns which files belong to a recording and when each was taken. A file that is not of the
//! recording changes no other file's time: where names tell the times, one whose name does not
//! is left out, and logged.

use super::order::{is_one_instant, keep_rising, median_step, spread};
use super::timestamp;
use super::{CaptureError, Captured, DecodeError, MAX_PICTURE_BYTES, decode};
use crate::daemon::{clock, dates::Dates, disk, foreign::shown, frame::Frame, plain};
use crate::units::UtcMs;
use std::collections::BTreeSet;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::{Duration, UNIX_EPOCH};

/// Time between frames where neither names nor files tell: one picture in two minutes, as
/// the paper's Hong Kong cameras give.
pub const DEFAULT_INTERVAL: Duration = Duration::from_secs(120);

/// Deepest folder that is looked into: year, month, day, hour, minute and one more.
const MAX_DEPTH: usize = 6;
/// Percentage of files, and at least how many, that may be strays.
const MOST_STRAYS: (usize, usize) = (10, 2);

/// Why a folder is not a recording.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The folder cannot be listed.
    #[error("cannot list the frames in {}: {}", folder.display(), unlisted(source))]
    List {
        /// The folder.
        folder: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// Nothing in it is a picture.
    #[error("no .jpg, .jpeg or .png file in {}", folder.display())]
    NoFrames {
        /// The folder.
        folder: PathBuf,
    },
    /// The dates in the names can be read in several ways.
    #[error(
        "the dates in {} can be read in several ways ({example} is {first}, or {second}), and nothing \
         else there tells which: say it with --dates day-first, --dates month-first or --dates \
         year-first", folder.display()
    )]
    Dates {
        /// The folder.
        folder: PathBuf,
        /// One of the names.
        example: String,
        /// A day that it may mean.
        first: String,
        /// Another one.
        second: String,
    },
    /// An interval of no time.
    #[error("a time of {} s between frames: give more than 0", .0.as_secs_f64())]
    Interval(Duration),
}

fn unlisted(source: &std::io::Error) -> String {
    if source.kind() == ErrorKind::NotADirectory {
        return "it is a file: name the folder that holds the frames".to_owned();
    }
    disk::unread(source).to_string()
}

/// Source of the frames' times.
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
        // Whoever asks for no more needs the frames' order and distance rather than their day.
        match Self::open_local(folder, interval, 0, None) {
            Err(RecordingError::Dates { .. }) => {
                Self::open_local(folder, interval, 0, Some(Dates::DayFirst))
            }
            opened => opened,
        }
    }

    /// The same where names without an offset from UTC are `utc_offset_s` ahead of it, and dates that
    /// do not tell by themselves are read in the order of `dates`, where that is known.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_local(
        folder: &Path,
        interval: Option<Duration>,
        utc_offset_s: i32,
        dates: Option<Dates>,
    ) -> Result<Self, RecordingError> {
        let mut names = Vec::new();
        list(folder, "", 0, &mut names)
            .map_err(|source| RecordingError::List { folder: folder.to_owned(), source })?;
        if names.is_empty() {
            return Err(RecordingError::NoFrames { folder: folder.to_owned() });
        }
        names.sort();
        let named = named(folder, &names, utc_offset_s, dates)?;
        let (time_source, times, interval) = times(folder, &names, named, interval)?;
        let strays: Vec<_> = times.iter().zip(&names).filter(|(t, _)| t.is_none()).collect();
        if let Some((_, first)) = strays.first() {
            log::warn!(
                "{} of {} files are left out, for {} does not tell when they were taken: {} and so on",
                strays.len(),
                names.len(),
                if time_source == TimeSource::Files { "their time" } else { "their name" },
                shown(first)
            );
        }
        let mut files: Vec<_> = names
            .into_iter()
            .zip(times)
            .filter_map(|(name, time)| Some((folder.join(&name), name, time?)))
            .collect();
        files.sort_by_key(|(_, _, time)| *time);
        let interval = match time_source {
            TimeSource::Names => one_of_each(&mut files).unwrap_or(interval),
            _ => interval,
        };
        spread(files.iter_mut().map(|(_, _, time)| time).collect());
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
        let decoded = match plain::read_into(path, MAX_PICTURE_BYTES as u64, &mut self.bytes) {
            Ok(()) => decode(&self.bytes, &mut frame.picture),
            Err(error) if error.kind() == ErrorKind::FileTooLarge => Err(DecodeError::TooManyBytes),
            Err(error) => return Err(read(error)),
        };
        decoded.map_err(|source| CaptureError::Decode { name: name.clone(), source })?;
        Ok(Captured::New)
    }
}

fn is_picture(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    ["jpg", "jpeg", "png"].iter().any(|known| extension.eq_ignore_ascii_case(known))
}

/// Collects the pictures of a folder, relative to the recording's. Folders in it are looked into
/// where their names begin with a digit, as days and hours do, or where there is nothing else.
fn list(root: &Path, within: &str, depth: usize, names: &mut Vec<String>) -> std::io::Result<()> {
    let (before, mut folders) = (names.len(), Vec::new());
    for entry in fs::read_dir(root.join(within))? {
        let entry = entry?;
        let (path, name) = (entry.path(), entry.file_name().to_string_lossy().into_owned());
        let relative = if within.is_empty() { name.clone() } else { format!("{within}/{name}") };
        if path.is_dir() {
            let is_hidden = name.starts_with(['.', '@', '#']);
            if depth < MAX_DEPTH && !is_hidden {
                folders.push((name, relative));
            }
        } else if is_picture(&path) && !name.starts_with('.') {
            // A hidden one is macOS's shadow of a file (`._name.jpg`), or not written to its end.
            names.push(relative);
        }
    }
    let is_empty = names.len() == before;
    for (name, relative) in folders {
        if is_empty || name.starts_with(|first: char| first.is_ascii_digit()) {
            list(root, &relative, depth + 1, names)?;
        }
    }
    Ok(())
}

/// Whether so few of so many files without a time are strays.
fn are_strays(without: usize, of: usize) -> bool {
    let (percent, least) = MOST_STRAYS;
    without <= (of * percent / 100).max(least) && without * 2 < of
}

/// The times in the names. Where dates do not tell by themselves in which order they are to be read,
/// the folder as a whole may: by a day that no month has, or by days that follow one another.
fn named(
    folder: &Path,
    names: &[String],
    utc_offset_s: i32,
    dates: Option<Dates>,
) -> Result<Vec<Option<UtcMs>>, RecordingError> {
    let tells = |times: &[Option<UtcMs>]| {
        are_strays(times.iter().filter(|time| time.is_none()).count(), names.len())
    };
    let read = |dates| -> Vec<_> {
        names.iter().map(|name| timestamp::from_path_in(name, utc_offset_s, dates)).collect()
    };
    if let Some(dates) = dates {
        return Ok(read(dates));
    }
    let plain: Vec<_> = names.iter().map(|name| timestamp::from_path(name, utc_offset_s)).collect();
    if tells(&plain) {
        return Ok(plain);
    }
    let count = |times: &[Option<UtcMs>]| times.iter().flatten().count();
    let mut readings = Dates::ALL.map(|dates| (dates, read(dates))).to_vec();
    // A reading that leaves out what another one understands is not that of this folder.
    let most = readings.iter().map(|(_, times)| count(times)).max().unwrap_or_default();
    readings.retain(|(_, times)| tells(times) && count(times) == most);
    if readings.iter().any(|(_, times)| follow(times)) {
        readings.retain(|(_, times)| follow(times));
    }
    readings.dedup_by(|a, b| a.1 == b.1);
    match readings.as_slice() {
        [] => Ok(plain),
        [(dates, times)] => {
            log::info!("the dates in {} are read {}", folder.display(), dates.words());
            Ok(times.clone())
        }
        [(_, one), (_, other), ..] => {
            let at =
                one.iter().zip(other).position(|(one, other)| one != other).unwrap_or_default();
            Err(RecordingError::Dates {
                folder: folder.to_owned(),
                example: shown(&names[at]),
                first: day(one[at]),
                second: day(other[at]),
            })
        }
    }
}

/// Whether there are at least three days, each the next of the one before.
fn follow(times: &[Option<UtcMs>]) -> bool {
    const DAY_MS: i64 = 86_400_000;
    let days: BTreeSet<i64> = times.iter().flatten().map(|t| t.0.div_euclid(DAY_MS)).collect();
    let span = days.first().zip(days.last()).map_or(0, |(first, last)| last - first + 1);
    days.len() >= 3 && usize::try_from(span).is_ok_and(|span| span == days.len())
}

/// A day in words that leave no doubt, as `5 January 2026`.
fn day(time: Option<UtcMs>) -> String {
    let time = time.and_then(|time| jiff::Timestamp::from_millisecond(time.0).ok());
    time.map_or("no date".into(), |time| time.strftime("%-d %B %Y").to_string())
}

/// The time of every file, `None` for strays; where times come from, and the time between two.
fn times(
    folder: &Path,
    names: &[String],
    named: Vec<Option<UtcMs>>,
    interval: Option<Duration>,
) -> Result<(TimeSource, Vec<Option<UtcMs>>, Duration), RecordingError> {
    if interval.is_some_and(|i| i.is_zero()) {
        return Err(RecordingError::Interval(Duration::ZERO));
    }
    let without = named.iter().filter(|time| time.is_none()).count();
    let tells = are_strays(without, names.len());
    if interval.is_none() {
        if tells && let Some(median) = median_step(&named) {
            return Ok((TimeSource::Names, named, median));
        }
        let mut written: Vec<_> = names.iter().map(|name| written_at(&folder.join(name))).collect();
        keep_rising(&mut written);
        let without = written.iter().filter(|time| time.is_none()).count();
        // Copied or unpacked files carry the time of the copying, not of the picture.
        if are_strays(without, names.len())
            && let Some(median) = median_step(&written)
            && median >= Duration::from_secs(1)
        {
            return Ok((TimeSource::Files, written, median));
        }
    }
    let step = interval.unwrap_or(DEFAULT_INTERVAL);
    let first = named.iter().flatten().min().copied().filter(|_| tells).unwrap_or_default();
    let mut count = 0;
    let times = named.iter().map(|time| {
        // A stray among frames that tell their time takes no place.
        let counts = time.is_some() || !tells;
        let time = first.saturating_add(step.saturating_mul(count));
        count += u32::from(counts);
        counts.then_some(time)
    });
    let source = if interval.is_some() { TimeSource::Interval } else { TimeSource::Assumed };
    Ok((source, times.collect(), step))
}

/// Of several frames of one instant the first stays: a copy, or another camera's, would count again.
/// Returns the time between two frames where some are left out.
fn one_of_each(files: &mut Vec<(PathBuf, String, UtcMs)>) -> Option<Duration> {
    let count = files.len();
    let mut times: Vec<_> = files.iter().map(|(_, _, time)| *time).collect();
    times.dedup();
    let times: Vec<_> = times.into_iter().map(Some).collect();
    let step = median_step(&times)?;
    let mut first_out = None;
    files.dedup_by(|(_, name, time), (_, _, before)| {
        let is_out = time == before && is_one_instant(*time, step);
        if is_out {
            first_out.get_or_insert_with(|| shown(name));
        }
        is_out
    });
    log::warn!(
        "{} of {count} files are left out, for others have the same time: {} and so on",
        count - files.len(),
        first_out?
    );
    Some(step)
}

fn written_at(path: &Path) -> Option<UtcMs> {
    let since_1970 = fs::metadata(path).ok()?.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
    Some(UtcMs::default().saturating_add(since_1970))
}

#[cfg(test)]
#[path = "recorded_tests.rs"]
mod tests;
