//! Capture: the first stage, from a camera to [`Frame`]s.
//!
//! Owns where pictures come from (recorded files, HTTP snapshots), their times, and their
//! decoding. The door of the crates `image` and `ureq`; their errors stop here.

mod decode;
mod recorded;
mod snapshot;
mod timestamp;

pub use decode::{DecodeError, MAX_PICTURE, decode};
pub use recorded::{Recorded, RecordingError};
pub use snapshot::{Credentials, Snapshot, SnapshotError, SnapshotSettings};

use super::flow::Frame;
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
}

impl CaptureError {
    /// A picture came, but not a usable one.
    pub fn is_damage(&self) -> bool {
        matches!(self, Self::Decode { .. })
    }
}

/// Where pictures come from.
#[derive(Debug)]
pub enum Source {
    /// A folder of pictures.
    Recorded(Recorded),
    /// A camera that answers HTTP requests with a picture.
    Snapshot(Box<Snapshot>),
}

impl Source {
    /// Fills `frame` with the next picture.
    ///
    /// # Errors
    /// [`CaptureError`] names picture and reason; the next call goes on behind it.
    pub fn next(&mut self, frame: &mut Frame) -> Result<Captured, CaptureError> {
        match self {
            Self::Recorded(recorded) => recorded.next(frame),
            Self::Snapshot(snapshot) => snapshot.next(frame),
        }
    }

    /// Time between two pictures.
    pub fn interval(&self) -> Duration {
        match self {
            Self::Recorded(recorded) => recorded.interval(),
            Self::Snapshot(snapshot) => snapshot.interval(),
        }
    }
}
