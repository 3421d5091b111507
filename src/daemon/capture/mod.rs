//! Capture: the first stage, from a camera to [`Frame`]s.
//!
//! Owns where pictures come from (recorded files, cameras on a network, V4L2 devices), their
//! times, and their decoding. The door of the crates `image`, `png`, `http_auth`, `flate2`
//! and `v4l`; their errors stop here.

pub mod backoff;
mod device;
mod latest;
mod mjpeg;
pub mod negotiate;
pub mod network;
mod order;
pub mod picture;
pub mod queue;
mod recorded;
pub mod rtsp;
mod snapshot;
mod timestamp;
#[cfg(all(feature = "v4l2", target_os = "linux"))]
mod v4l2;

pub use device::{DEFAULT_SIZE, DeviceError, DeviceSettings};
pub use mjpeg::Mjpeg;
pub use network::{CameraError, CameraSettings, Credentials, Fault};
#[cfg(feature = "v4l2")]
use picture::decode_held;
pub use picture::{DecodeError, decode, decode_shaped, encode::jpeg};
pub use recorded::{Recorded, RecordingError};
pub use rtsp::Rtsp;
pub use snapshot::Snapshot;
pub use timestamp::offset_s as utc_offset;

use super::address::Protocol;
use super::disk;
use super::frame::Frame;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Largest compressed picture that is read, bytes. A 4K JPEG at best quality has 6 MB.
pub const MAX_PICTURE_BYTES: usize = 8 << 20;
/// Largest picture that a device is asked for, px: 4K.
pub const MAX_PICTURE: (u32, u32) = (3840, 2160);

/// Result of asking a source for the next picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Captured {
    /// A new picture; the frame was filled.
    New,
    /// The same picture as before; the frame is as it was.
    Unchanged,
    /// The recording is over.
    End,
}

/// A picture that could not be had. The line goes on with the next one.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// A file of the recording cannot be read.
    #[error("{}: {}", path.display(), disk::unread(source))]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// A picture that does not decode.
    #[error("{name}: {source}")]
    Decode {
        /// File or snapshot.
        name: String,
        /// The fault.
        source: DecodeError,
    },
    /// A camera on a network gave none.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// A device did not give a picture.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

/// Counts of a stream's frames since start, beside those that were measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StreamCounts {
    /// Marked as damaged by the driver, and passed over.
    pub flagged: u64,
    /// Missing between two sequence numbers while the driver had a buffer for them.
    pub lost: u64,
    /// Times that the stream was given up and opened again.
    pub reopened: u64,
    /// Time between a video's latest two key pictures.
    pub key_interval: Option<Duration>,
}

impl CaptureError {
    /// A picture came, but not a usable one.
    pub fn is_damage(&self) -> bool {
        matches!(self, Self::Decode { .. })
    }
}

/// The camera, and how it is asked for pictures.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SourceSettings {
    /// A folder of pictures that is played in a loop, one each `interval`.
    Recorded {
        /// The folder.
        folder: PathBuf,
        /// Time between two pictures.
        interval: Duration,
    },
    /// A camera on a network.
    Network(CameraSettings),
    /// A camera at the box.
    Device(DeviceSettings),
}

/// Why a source cannot be set up. An absent camera is not such a reason.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// The recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The camera's device.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

/// A source of pictures, open.
#[derive(Debug)]
pub enum Source {
    /// A folder of pictures.
    Recorded(Recorded),
    /// A camera that answers HTTP requests with a picture.
    Snapshot(Box<Snapshot>),
    /// A camera that answers one HTTP request with picture after picture.
    Mjpeg(Box<Mjpeg>),
    /// A camera that plays video.
    Rtsp(Box<Rtsp>),
    /// A camera at the box.
    #[cfg(all(feature = "v4l2", target_os = "linux"))]
    Device(Box<v4l2::V4l2>),
}

impl Source {
    /// The source of these settings. No camera is asked yet: it may be absent now and come
    /// later.
    ///
    /// # Errors
    /// [`SourceError`] where the settings cannot be right.
    pub fn open(settings: SourceSettings) -> Result<Self, SourceError> {
        Ok(match settings {
            SourceSettings::Recorded { folder, interval } => {
                Self::Recorded(Recorded::open(&folder, Some(interval))?.for_ever())
            }
            SourceSettings::Network(settings) => Self::network(settings),
            SourceSettings::Device(settings) => Self::device(settings)?,
        })
    }

    /// A camera on a network.
    pub fn network(settings: CameraSettings) -> Self {
        match settings.address.protocol {
            Protocol::Mjpeg => Self::Mjpeg(Box::new(Mjpeg::new(settings))),
            Protocol::Rtsp => Self::Rtsp(Box::new(Rtsp::new(settings))),
            Protocol::Snapshot => Self::Snapshot(Box::new(Snapshot::new(settings))),
        }
    }

    /// A camera at the box. It may be absent now and come later.
    ///
    /// # Errors
    /// [`DeviceError::NotBuilt`] where this program knows no devices.
    pub fn device(settings: DeviceSettings) -> Result<Self, DeviceError> {
        #[cfg(all(feature = "v4l2", target_os = "linux"))]
        return Ok(Self::Device(Box::new(v4l2::V4l2::new(settings))));
        #[cfg(not(all(feature = "v4l2", target_os = "linux")))]
        Err(DeviceError::NotBuilt { path: settings.path })
    }

    /// Counts of a stream's frames; all 0 where there is no stream.
    pub fn counts(&self) -> StreamCounts {
        match self {
            Self::Recorded(_) | Self::Snapshot(_) => StreamCounts::default(),
            Self::Mjpeg(mjpeg) => mjpeg.counts(),
            Self::Rtsp(rtsp) => rtsp.counts(),
            #[cfg(all(feature = "v4l2", target_os = "linux"))]
            Self::Device(device) => device.counts(),
        }
    }

    /// Description of a video, and what to set; `None` where the source is not a video.
    pub fn video(&self) -> Option<String> {
        match self {
            Self::Rtsp(rtsp) => Some(rtsp.describe()),
            _ => None,
        }
    }

    /// Waits up to `limit` until it is known how often a video's key pictures come.
    pub fn settle(&self, limit: Duration) {
        let begun = Instant::now();
        while let Self::Rtsp(rtsp) = self
            && rtsp.counts().key_interval.is_none()
            && begun.elapsed() < limit
        {
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// Time between two key pictures of a video, where it is longer than windows need. Of a video whose
    /// every picture is measured it does not matter.
    pub fn slow_keys(&self) -> Option<Duration> {
        let Self::Rtsp(rtsp) = self else { return None };
        let interval = rtsp.key_interval_allowed()?;
        // Three quarters of a window's pictures are needed.
        rtsp.counts().key_interval.filter(|&keys| keys > interval.mul_f64(4.0 / 3.0))
    }

    /// Fills `frame` with the next picture.
    ///
    /// # Errors
    /// [`CaptureError`] names picture and reason; the next call goes on behind it.
    pub fn next(&mut self, frame: &mut Frame) -> Result<Captured, CaptureError> {
        match self {
            Self::Recorded(recorded) => recorded.next(frame),
            Self::Snapshot(snapshot) => snapshot.next(frame),
            Self::Mjpeg(mjpeg) => mjpeg.next(frame),
            Self::Rtsp(rtsp) => rtsp.next(frame),
            #[cfg(all(feature = "v4l2", target_os = "linux"))]
            Self::Device(device) => device.next(frame),
        }
    }

    /// Time between two pictures.
    pub fn interval(&self) -> Duration {
        match self {
            Self::Recorded(recorded) => recorded.interval(),
            Self::Snapshot(snapshot) => snapshot.interval(),
            Self::Mjpeg(mjpeg) => mjpeg.interval(),
            Self::Rtsp(rtsp) => rtsp.interval(),
            #[cfg(all(feature = "v4l2", target_os = "linux"))]
            Self::Device(device) => device.interval(),
        }
    }
}
