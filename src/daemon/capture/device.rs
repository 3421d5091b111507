//! A camera at the box: what it is asked for, and why it gives no picture.
//!
//! Owns settings and errors, which are the same whether V4L2 is built in or not. Where it
//! is not, a device is refused with the reason.

use std::path::PathBuf;
use std::time::Duration;

/// Size that is asked for where the lane table is not known, px.
pub const DEFAULT_SIZE: (u32, u32) = (640, 480);

/// The device, and how it is read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceSettings {
    /// The device node. A name under `/dev/v4l/by-id` or `by-path` stays when the camera
    /// comes back under another number.
    pub path: PathBuf,
    /// Wanted columns and rows, px: the lane table's.
    pub size: (u32, u32),
    /// Time between two pictures that are taken.
    pub interval: Duration,
    /// Longest wait for a frame.
    pub timeout: Duration,
}

/// Why a device gave no picture.
#[derive(Clone, Debug, thiserror::Error)]
pub enum DeviceError {
    /// This program knows no devices.
    #[error(
        "camera.source {}: this verge was built without V4L2; build it with --features v4l2, \
         or give an address or a folder",
        path.display()
    )]
    NotBuilt {
        /// The device.
        path: PathBuf,
    },
    /// It cannot be opened.
    #[error("{}: {reason}; is the camera plugged in, and may verge read it (group video)?", path.display())]
    Open {
        /// The device.
        path: PathBuf,
        /// The system's error.
        reason: String,
    },
    /// It opens, but is not a camera.
    #[error("{}: not a camera that streams ({card}); is it the right node?", path.display())]
    NotACamera {
        /// The device.
        path: PathBuf,
        /// The name that it gives itself.
        card: String,
    },
    /// It has no format and size that can be used.
    #[error(
        "{}: no YUYV, NV12, MJPG or GREY in the shape of {}x{} px; it offers {offered}",
        path.display(), wanted.0, wanted.1
    )]
    NothingFits {
        /// The device.
        path: PathBuf,
        /// The wanted size.
        wanted: (u32, u32),
        /// The formats and sizes offered.
        offered: String,
    },
    /// It took another format than the one that it was asked for.
    #[error("{}: asked for {asked}, it gives {given}", path.display())]
    OtherFormat {
        /// The device.
        path: PathBuf,
        /// The format that was asked for.
        asked: String,
        /// The format that the driver then reported.
        given: String,
    },
    /// Frames larger than any picture that is read.
    #[error(
        "{}: its driver says that a frame takes {} MB, more than the largest picture that is read",
        path.display(), bytes >> 20
    )]
    LargeFrames {
        /// The device.
        path: PathBuf,
        /// Size of a frame, as the driver states it.
        bytes: u32,
    },
    /// No frame in time.
    #[error("{}: no frame for {:.1} s", path.display(), timeout.as_secs_f32())]
    Timeout {
        /// The device.
        path: PathBuf,
        /// Time waited.
        timeout: Duration,
    },
    /// A step of streaming failed; the device may be gone.
    #[error("{}: its driver failed ({step}: {reason}); is the camera still plugged in?", path.display())]
    Stream {
        /// The device.
        path: PathBuf,
        /// The step that failed.
        step: &'static str,
        /// The system's error.
        reason: String,
    },
    /// Every frame was marked as damaged.
    #[error("{}: {frames} frames in a row are marked as damaged", path.display())]
    Flagged {
        /// The device.
        path: PathBuf,
        /// Number of damaged frames.
        frames: u32,
    },
}
