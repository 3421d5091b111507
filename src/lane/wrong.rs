//! Why bytes are not a lane table, in words that say what to do.

use super::VERSION;
use crate::scene::ReferenceError;
use core::fmt;

/// Why bytes are not a lane table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LaneTableError {
    /// Fewer bytes than the smallest table, or than this table's header asks for.
    TooShort {
        /// Bytes needed.
        needed: usize,
        /// Bytes there.
        actual: usize,
    },
    /// More bytes than the header asks for.
    TooLong {
        /// Bytes that belong to the table.
        needed: usize,
        /// Bytes there.
        actual: usize,
    },
    /// Not a lane table.
    Magic,
    /// A format that this program does not read.
    Version {
        /// The version found.
        found: u8,
    },
    /// The bytes were changed since the table was written.
    Crc {
        /// Checksum in the file.
        stored: u32,
        /// Checksum of the bytes.
        computed: u32,
    },
    /// The description does not decode.
    Description,
    /// The description holds a value that no road has; the text names it.
    Value(&'static str),
    /// A cell names a lane that the description lacks.
    CellLane {
        /// Index of the cell in row order.
        cell: usize,
        /// The lane that it names.
        lane: u8,
    },
    /// A cell lies beyond the end of its lane.
    CellDistance {
        /// Index of the cell in row order.
        cell: usize,
    },
    /// The reference of the scene is wrong.
    Scene(ReferenceError),
    /// The buffer given to the writer is too small.
    Buffer {
        /// Bytes needed.
        needed: usize,
        /// Bytes there.
        actual: usize,
    },
}

impl fmt::Display for LaneTableError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooShort { needed, actual } => {
                write!(f, "has {actual} bytes where {needed} belong: it was cut off; copy it again")
            }
            Self::TooLong { needed, actual } => {
                write!(f, "has {actual} bytes where {needed} belong: something was appended")
            }
            Self::Magic => write!(f, "is not a lane table (make one with `mvcalib table`)"),
            Self::Version { found } => {
                write!(
                    f,
                    "has format version {found}, this program reads 1 to {VERSION}: make it again"
                )
            }
            Self::Crc { stored, computed } => write!(
                f,
                "is damaged: checksum {computed:08x}, its trailer says {stored:08x}; copy it again"
            ),
            Self::Description => write!(f, "has a description that does not decode: make it again"),
            Self::Value(what) => write!(f, "has an impossible value: {what}"),
            Self::CellLane { cell, lane } => {
                write!(f, "puts cell {cell} into lane {lane}, which it does not describe")
            }
            Self::CellDistance { cell } => {
                write!(f, "puts cell {cell} beyond the end of its lane")
            }
            Self::Scene(error) => error.fmt(f),
            Self::Buffer { needed, actual } => {
                write!(f, "needs {needed} bytes, the buffer has {actual}")
            }
        }
    }
}

impl core::error::Error for LaneTableError {}
