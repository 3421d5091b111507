//! Capture: the first stage, from a camera to [`Frame`]s.
//!
//! Owns where pictures come from (recorded files, HTTP snapshots and streams, V4L2
//! devices), their
//! times, and their decoding. The door of the crates `image`, `ureq` and `v4l`; their errors
//! stop here.

pub mod backoff;
mod decode;
mod device;
mod mjpeg;
pub mod multipart;
pub mod negotiate;
pub mod pixels;
pub mod queue;
mod recorded;
mod snapshot;
mod timestamp;
#[cfg(all(feature = "v4l2", target_os = "linux"))]
mod v4l2;

pub use decode::{DecodeError, MAX_PICTURE, decode};
pub use device::{DEFAULT_SIZE, DeviceError, DeviceSettings};
pub use mjpeg::{Mjpeg, MjpegError, MjpegSettings, SCHEME as MJPEG_SCHEME};
pub use recorded::{Recorded, RecordingError};
pub use snapshot::{Credentials, Snapshot, SnapshotError, SnapshotSettings};

use super::frame::Frame;
use std::path::PathBuf;
use std::time::Duration;

/// Largest compressed picture that is read, bytes. A 4K JPEG at best quality has 6 MB.
pub const MAX_PICTURE_BYTES: usize = 8 << 20;

/// What a source gave when it was asked for the next picture.
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
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A picture that does not decode.
    #[error("{name}: {source}")]
    Decode {
        /// File or snapshot.
        name: String,
        /// What is wrong with it.
        source: DecodeError,
    },
    /// The camera did not give a snapshot.
    #[error(transparent)]
    Snapshot(#[from] SnapshotError),
    /// The camera's stream did not give a picture.
    #[error(transparent)]
    Mjpeg(#[from] MjpegError),
    /// A device did not give a picture.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

/// What became of a stream's frames since start, beside those that were measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StreamCounts {
    /// Marked as damaged by the driver, and passed over.
    pub flagged: u64,
    /// Missing between two sequence numbers while the driver had a buffer for them.
    pub lost: u64,
    /// Times that the stream was given up and opened again.
    pub reopened: u64,
}

impl CaptureError {
    /// A picture came, but not a usable one.
    pub fn is_damage(&self) -> bool {
        matches!(self, Self::Decode { .. })
    }
}

/// Which camera is asked for pictures, and how.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SourceSettings {
    /// A folder of pictures that is played for ever, one each `interval`.
    Recorded {
        /// The folder.
        folder: PathBuf,
        /// Time between two pictures.
        interval: Duration,
    },
    /// See [`Snapshot`].
    Snapshot(SnapshotSettings),
    /// See [`Mjpeg`].
    Mjpeg(MjpegSettings),
    /// A camera at the box.
    Device(DeviceSettings),
}

/// Why a source cannot be set up. A camera that is away is no such reason.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// The recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The camera's address.
    #[error(transparent)]
    Snapshot(#[from] SnapshotError),
    /// The address of the camera's stream.
    #[error(transparent)]
    Mjpeg(#[from] MjpegError),
    /// The camera's device.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

/// Where pictures come from.
#[derive(Debug)]
pub enum Source {
    /// A folder of pictures.
    Recorded(Recorded),
    /// A camera that answers HTTP requests with a picture.
    Snapshot(Box<Snapshot>),
    /// A camera that answers one HTTP request with picture after picture.
    Mjpeg(Box<Mjpeg>),
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
            SourceSettings::Snapshot(settings) => {
                Self::Snapshot(Box::new(Snapshot::new(settings)?))
            }
            SourceSettings::Mjpeg(settings) => Self::Mjpeg(Box::new(Mjpeg::new(settings)?)),
            SourceSettings::Device(settings) => Self::device(settings)?,
        })
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

    /// What became of a stream's frames; all 0 where there is no stream.
    pub fn counts(&self) -> StreamCounts {
        match self {
            Self::Recorded(_) | Self::Snapshot(_) => StreamCounts::default(),
            Self::Mjpeg(mjpeg) => mjpeg.counts(),
            #[cfg(all(feature = "v4l2", target_os = "linux"))]
            Self::Device(device) => device.counts(),
        }
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
            #[cfg(all(feature = "v4l2", target_os = "linux"))]
            Self::Device(device) => device.interval(),
        }
    }
}
