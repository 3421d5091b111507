//! Cameras on V4L2: the only folder that names the crate `v4l`.
//!
//! Owns opening (format, size and rate by [`format`]), the stream of memory-mapped
//! buffers, and its end. A stream is never repaired: on any error it is dropped, and a new one
//! is opened from the device's path, so that a camera may come back under another number. A
//! stream that has run is opened again at once: most faults are over by then, and no picture
//! is lost. After that the waits grow.
//!
//! Three habits of the crate are met here. It panics where a driver answers with something
//! that it does not know, and when a stream cannot be stopped: every call is made behind
//! [`guarded`]. After a failed `next` it would queue a buffer that the kernel owns: hence
//! "never repaired". `S_FMT` changes what it cannot do: the answer is compared.

mod format;

use self::format::{Given, describe, offers, set};
use super::backoff::{Backoff, LONGEST_AT_THE_BOX};
use super::device::{DeviceError, DeviceSettings};
use super::negotiate;
use super::queue::{Question, Sequence};
use super::{CaptureError, Captured, StreamCounts};
use crate::daemon::clock;
use crate::daemon::dial;
use crate::daemon::frame::Frame;
use std::hash::{DefaultHasher, Hasher};
use std::io::{Error, ErrorKind};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};
use v4l::buffer::{Flags, Type};
use v4l::capability::Flags as Can;
use v4l::io::mmap::Stream;
use v4l::io::traits::{CaptureStream, Stream as _};
use v4l::{Device, FourCC};

/// Frames in a row that may be marked as damaged before the stream is given up.
const MOST_FLAGGED: u32 = 8;

/// A camera that is read through V4L2.
#[derive(Debug)]
pub struct V4l2 {
    settings: DeviceSettings,
    open: Option<Open>,
    asked: Instant,
    backoff: Backoff,
    last_error: Option<DeviceError>,
    last_digest: Option<u64>,
    counts: StreamCounts,
}

impl V4l2 {
    /// A camera; it is opened when the first picture is asked for, and may be absent.
    pub fn new(settings: DeviceSettings) -> Self {
        Self {
            settings,
            open: None,
            asked: Instant::now(),
            backoff: Backoff::up_to(LONGEST_AT_THE_BOX),
            last_error: None,
            last_digest: None,
            counts: StreamCounts::default(),
        }
    }

    /// Counts of the stream's frames since start.
    pub fn counts(&self) -> StreamCounts {
        self.counts
    }

    /// Time between two pictures.
    pub fn interval(&self) -> Duration {
        self.settings.interval
    }

    pub(super) fn next(&mut self, frame: &mut Frame) -> Result<Captured, CaptureError> {
        if let Some(error) = &self.last_error
            && self.backoff.waits(Instant::now())
        {
            return Err(error.clone().into());
        }
        let (begun, has_run) = (Instant::now(), self.open.is_some());
        let mut outcome = self.take(frame, begun);
        if has_run && self.open.is_none() && begun.elapsed() < self.settings.timeout {
            outcome = self.take(frame, begun);
        }
        match &outcome {
            Err(CaptureError::Device(error)) => {
                self.backoff.failed(Instant::now(), 0.0);
                self.last_error = Some(error.clone());
            }
            _ => {
                self.backoff.succeeded();
                self.last_error = None;
            }
        }
        outcome
    }

    /// Takes a frame of the stream, which is opened where it is not open and dropped where
    /// it fails.
    fn take(&mut self, frame: &mut Frame, begun: Instant) -> Result<Captured, CaptureError> {
        let outcome = self.try_take(frame, begun);
        // A frame that does not decode says nothing about the stream.
        if let Err(CaptureError::Device(error)) = &outcome {
            log::debug!("{error}");
            self.counts.reopened += u64::from(self.open.take().is_some());
        }
        outcome
    }

    fn try_take(&mut self, frame: &mut Frame, begun: Instant) -> Result<Captured, CaptureError> {
        let Self { settings, open, asked, last_digest, counts, .. } = self;
        let since_last = asked.elapsed();
        *asked = Instant::now();
        let open = match open {
            Some(open) => open,
            closed => closed.insert(guarded(settings, "opening", || Open::new(settings))?),
        };
        guarded(settings, "taking a frame", || {
            let question = Question::new(since_last, open.buffers);
            open.newest(settings, begun, question, counts, |open, bytes| {
                let mut hasher = DefaultHasher::new();
                hasher.write(bytes);
                let digest = hasher.finish();
                if last_digest.replace(digest) == Some(digest) {
                    return Ok(Captured::Unchanged);
                }
                frame.time = clock::now();
                "device".clone_into(&mut frame.name);
                open.convert(bytes, &mut frame.picture).map_err(|source| CaptureError::Decode {
                    name: settings.path.display().to_string(),
                    source,
                })?;
                Ok(Captured::New)
            })
        })
    }
}

/// A stream that runs.
struct Open {
    stream: Stopping,
    given: Given,
    buffers: u32,
    sequence: Sequence,
}

impl std::fmt::Debug for Open {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Open").field("given", &self.given).finish_non_exhaustive()
    }
}

impl Open {
    fn new(settings: &DeviceSettings) -> Result<Self, CaptureError> {
        let path = || settings.path.clone();
        let device = Device::with_path(&settings.path)
            .map_err(|error| DeviceError::Open { path: path(), reason: dial::system(&error) })?;
        let about = device.query_caps().map_err(|error| match error.raw_os_error() {
            Some(libc::ENOTTY | libc::EINVAL) => {
                let card = "it answers as none".to_owned();
                DeviceError::NotACamera { path: path(), card }.into()
            }
            _ => failed(settings, "QUERYCAP", &error),
        })?;
        if !about.capabilities.contains(Can::VIDEO_CAPTURE | Can::STREAMING) {
            return Err(DeviceError::NotACamera { path: path(), card: about.card }.into());
        }
        let offers = offers(&device, settings)?;
        let least = negotiate::least_rate(settings.interval);
        let choice = negotiate::choose(&offers, settings.size, least).ok_or_else(|| {
            let offered = describe(&offers);
            DeviceError::NothingFits { path: path(), wanted: settings.size, offered }
        })?;
        let (given, buffers) = set(&device, settings, choice)?;
        let stream = Stream::with_buffers(&device, Type::VideoCapture, buffers)
            .map_err(|e| failed(settings, "REQBUFS", &e))?;
        let (encoding, layout) = (FourCC::new(&given.encoding.fourcc()), given.layout);
        log::info!(
            "{}: {} as {encoding} {}x{}",
            settings.path.display(),
            about.card,
            layout.width,
            layout.height
        );
        let (stream, sequence) = (Stopping(Some(stream)), Sequence::default());
        Ok(Self { stream, given, buffers, sequence })
    }

    /// Takes the newest frame that is not marked as damaged, for a question of `begun`.
    fn newest<T>(
        &mut self,
        settings: &DeviceSettings,
        begun: Instant,
        mut question: Question,
        counts: &mut StreamCounts,
        mut take: impl FnMut(Given, &[u8]) -> Result<T, CaptureError>,
    ) -> Result<T, CaptureError> {
        let stream = self.stream.0.as_mut().expect("it is taken out only when it is dropped");
        let handle = stream.handle();
        let waits = || handle.poll(libc::POLLIN, 0).is_ok_and(|ready| ready > 0);
        let mut flagged = 0;
        loop {
            let Some(rest) = settings.timeout.checked_sub(begun.elapsed()) else {
                return Err(timed_out(settings));
            };
            stream.set_timeout(rest);
            // Before the first frame the stream does not run and polls as an error.
            let waited = !self.sequence.is_new() && waits();
            let (bytes, meta) = stream.next().map_err(|error| match error.kind() {
                ErrorKind::TimedOut => timed_out(settings),
                _ => failed(settings, "DQBUF", &error),
            })?;
            let passes = question.passes(waited, waits());
            counts.lost += self.sequence.lost(meta.sequence, question.starved());
            if meta.flags.contains(Flags::ERROR) {
                counts.flagged += 1;
                flagged += 1;
                if flagged == MOST_FLAGGED {
                    let path = settings.path.clone();
                    return Err(DeviceError::Flagged { path, frames: flagged }.into());
                }
            } else if !passes {
                let used = bytes.len().min(meta.bytesused as usize);
                return take(self.given, &bytes[..used]);
            }
        }
    }
}

/// A stream whose end cannot take the daemon with it.
struct Stopping(Option<Stream<'static>>);

impl Drop for Stopping {
    fn drop(&mut self) {
        let Some(mut stream) = self.0.take() else { return };
        // The crate panics in `drop` where the stream cannot be stopped, twice where the
        // buffers cannot be given back either, and the second ends the process. So it is
        // stopped here; one that does not stop is kept, and its device stays busy.
        match stream.stop() {
            Err(error) if error.raw_os_error() != Some(libc::ENODEV) => {
                log::error!("a stream cannot be stopped and is left behind: {error}");
                std::mem::forget(stream);
            }
            _ => {
                let _ = catch_unwind(AssertUnwindSafe(move || drop(stream)));
            }
        }
    }
}

/// Makes a panic of the crate an error like its others.
fn guarded<T>(
    settings: &DeviceSettings,
    step: &'static str,
    call: impl FnOnce() -> Result<T, CaptureError>,
) -> Result<T, CaptureError> {
    catch_unwind(AssertUnwindSafe(call)).unwrap_or_else(|_| {
        let reason = "the driver gave an answer that the V4L2 library does not know".to_owned();
        Err(DeviceError::Stream { path: settings.path.clone(), step, reason }.into())
    })
}

fn failed(settings: &DeviceSettings, step: &'static str, error: &Error) -> CaptureError {
    let (path, reason) = (settings.path.clone(), dial::system(error));
    DeviceError::Stream { path, step, reason }.into()
}

fn timed_out(settings: &DeviceSettings) -> CaptureError {
    let DeviceSettings { path, timeout, .. } = settings.clone();
    DeviceError::Timeout { path, timeout }.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(path: &str) -> V4l2 {
        V4l2::new(DeviceSettings {
            path: path.into(),
            size: (640, 480),
            interval: Duration::from_secs(1),
            timeout: Duration::from_secs(1),
        })
    }

    #[test]
    fn an_absent_camera_is_an_error_each_time_and_asked_for_again_later() {
        let mut camera = camera("/dev/v4l/by-id/none");
        for _ in 0..2 {
            let error = camera.next(&mut Frame::default()).expect_err("none is there");
            assert!(!error.is_damage());
            let text = error.to_string();
            assert!(text.contains("/dev/v4l/by-id/none") && text.contains("plugged in"), "{text}");
        }
        assert_eq!(camera.counts(), StreamCounts::default(), "nothing was open");
    }

    #[test]
    fn a_node_that_is_no_camera_is_named() {
        let error = camera("/dev/null").next(&mut Frame::default()).expect_err("no camera");
        assert!(error.to_string().contains("not a camera"), "{error}");
    }

    #[test]
    fn a_panic_of_the_library_is_an_error() {
        let camera = camera("/dev/video0");
        let error = guarded(&camera.settings, "opening", || -> Result<(), _> { panic!("odd") });
        let text = error.expect_err("it panicked").to_string();
        assert!(text.starts_with("/dev/video0: ") && text.contains("opening"), "{text}");
    }
}
