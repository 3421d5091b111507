//! Why bytes are not a picture to measure, in the user's words.

use super::MAX_PIXELS;
use crate::daemon::capture::MAX_PICTURE_BYTES;
use crate::daemon::frame::Shape;

/// Why bytes are not a picture to measure.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// Nothing there.
    #[error("the picture is empty (0 bytes)")]
    Empty,
    /// Neither JPEG nor PNG.
    #[error("{what}")]
    Format {
        /// Its kind.
        what: String,
    },
    /// The end is missing.
    #[error("the picture is cut off: {bytes} bytes without an end-of-image marker")]
    Truncated {
        /// Its size.
        bytes: usize,
    },
    /// Too large to be a traffic camera's.
    #[error(
        "a picture of {width}x{height} px: at most {} megapixels are read; choose a smaller picture \
         or the camera's substream", MAX_PIXELS / 1_000_000
    )]
    TooLarge {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// Decoding would take more memory than there is for it.
    #[error(
        "a {width}x{height} px picture that takes {megabytes} MB to decode: set the camera to baseline \
         JPEG, or to a smaller picture"
    )]
    TooMuchMemory {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Memory that it would take.
        megabytes: u64,
    },
    /// Not the shape of the lane table's picture.
    #[error(
        "a picture of {width}x{height} px; the lane table is for {} and pictures of its shape. Was the \
         camera set to another size?",
        shape
    )]
    Shape {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// The table's.
        shape: Shape,
    },
    /// More bytes than a camera's picture has.
    #[error("a picture of more than {} bytes", MAX_PICTURE_BYTES)]
    TooManyBytes,
    /// Raw pixels end before the picture does.
    #[error("a picture of {actual} bytes; in its format and size it has {expected}")]
    Short {
        /// Bytes of a whole picture.
        expected: usize,
        /// Bytes that came.
        actual: usize,
    },
    /// The decoder gave up.
    #[error("the picture is damaged: {0}")]
    Damaged(String),
    /// The decoder panicked, which it should not whatever it gets.
    #[error("the decoder broke down over the picture; please report it with the picture")]
    Decoder,
}
