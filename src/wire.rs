//! The compact message: one window of one site in postcard, with version and checksum.
//!
//! Owns the binary format only; topics and JSON are the daemon's `publish`.
//!
//! | offset | bytes | field |
//! |---|---|---|
//! | 0 | 1 | format version, 1 to 4 |
//! | 1 | M | [`DensityMessage`] in postcard, without cells and errors |
//! | 1+M | C | from version 2: the [`Cells`] of each lane in postcard, an option, lane by lane |
//! | 1+M+C | E | from version 3: the [`DensityError`] of each lane likewise |
//! | 1+M+C+E | T | from version 4: the [`LaneTraffic`] of each lane likewise |
//! | 1+M+C+E+T | 4 | CRC-32 (ISO-HDLC) of all bytes before, little-endian |
//!
//! All four are read. Version 4 is written where a lane has traffic, else version 3, so that older
//! programs read the windows of a box that measures density alone.

use crate::density::{Cells, DensityError, WindowReport};
use crate::lane::{Description, Name};
use crate::traffic::LaneTraffic;
use core::fmt;
use crc::{CRC_32_ISO_HDLC, Crc};
use serde::{Deserialize, Serialize};

/// The newest format that this code reads and writes.
pub const VERSION: u8 = 4;
/// The format without traffic, which it writes where no lane has any.
const VERSION_DENSITY: u8 = 3;
/// The format without cells and errors, which it reads too.
const VERSION_BARE: u8 = 1;
/// The format with cells and without errors, which it reads too.
const VERSION_CELLS: u8 = 2;
/// Most bytes of a message without traffic: eight lanes of at most 67 bytes, each with 32 cells in
/// 135 and errors in 17, three names, two hashes, counters and framing come to 1,996.
pub const MAX_DENSITY_MESSAGE: usize = 2048;
/// Most bytes of any message: traffic takes 97 bytes a lane more.
pub const MAX_MESSAGE: usize = MAX_DENSITY_MESSAGE + 8 * 97;

/// The checksum of everything that the project sends in binary.
pub(crate) const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// The calibration behind the metres of a density.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibrationRef {
    /// Its name.
    pub id: Name,
    /// SHA-256 of the calibration file.
    pub sha256: [u8; 32],
    /// One standard error of a length on the road, as a fraction.
    pub rel_err: Option<f32>,
}

impl CalibrationRef {
    /// The calibration that a lane table names.
    pub fn of(table: &Description) -> Self {
        Self {
            id: table.calibration_id.clone(),
            sha256: table.calibration_sha256,
            rel_err: table.length_rel_err,
        }
    }
}

/// The model that found the vehicles.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelRef {
    /// Its name.
    pub name: Name,
    /// SHA-256 of the model file.
    pub sha256: [u8; 32],
}

/// One window of one site.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DensityMessage {
    /// The site that measured.
    pub site: Name,
    /// Number of this message among the site's messages of this window length, from 1.
    pub seq: u64,
    /// The box's clock was set from a time source when the window ended.
    pub clock_synced: bool,
    /// The measurement.
    pub report: WindowReport,
    /// The calibration behind its metres.
    pub calibration: CalibrationRef,
    /// The model that found the vehicles.
    pub model: ModelRef,
}

/// Why bytes are not a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WireError {
    /// Fewer bytes than the smallest message.
    TooShort {
        /// Bytes there.
        actual: usize,
    },
    /// A format that this program does not read.
    Version {
        /// The version found.
        found: u8,
    },
    /// The bytes changed on the way.
    Crc {
        /// Checksum in the message.
        stored: u32,
        /// Checksum of the bytes.
        computed: u32,
    },
    /// The body does not decode, or does not fill the message.
    Body,
    /// The buffer given to the writer is too small.
    Buffer {
        /// Bytes there.
        actual: usize,
    },
}

impl fmt::Display for WireError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooShort { actual } => write!(f, "a message of {actual} bytes was cut off"),
            Self::Version { found } => {
                write!(
                    f,
                    "message format {found}, this program reads 1 to {VERSION}: update the reader"
                )
            }
            Self::Crc { stored, computed } => {
                write!(f, "damaged message: checksum {computed:08x}, its trailer says {stored:08x}")
            }
            Self::Body => write!(f, "the message's body does not decode"),
            Self::Buffer { actual } => write!(
                f,
                "a buffer of {actual} bytes is too small; {MAX_MESSAGE} bytes hold every message"
            ),
        }
    }
}

impl core::error::Error for WireError {}

/// A hash as text, in lower-case hexadecimal.
pub fn hex(hash: &[u8; 32]) -> heapless::String<64> {
    let digit = |nibble: u8| char::from_digit(u32::from(nibble), 16).unwrap_or('0');
    let mut text = heapless::String::new();
    for byte in hash {
        // Two digits a byte: there is always room.
        let _ = text.push(digit(byte >> 4));
        let _ = text.push(digit(byte & 15));
    }
    text
}

/// Writes a message into `buffer` and returns its bytes.
///
/// # Errors
/// [`WireError::Buffer`]; a buffer of [`MAX_MESSAGE`] bytes is always large enough.
pub fn encode<'b>(message: &DensityMessage, buffer: &'b mut [u8]) -> Result<&'b [u8], WireError> {
    let full = WireError::Buffer { actual: buffer.len() };
    let (version, rest) = buffer.split_first_mut().ok_or(full)?;
    let has_traffic = message.report.lanes.iter().any(|lane| lane.traffic.is_some());
    *version = if has_traffic { VERSION } else { VERSION_DENSITY };
    let mut body_len = 1 + postcard::to_slice(message, rest).map_err(|_| full)?.len();
    for lane in &message.report.lanes {
        let rest = buffer.get_mut(body_len..).ok_or(full)?;
        body_len += postcard::to_slice(&lane.cells, rest).map_err(|_| full)?.len();
    }
    for lane in &message.report.lanes {
        let rest = buffer.get_mut(body_len..).ok_or(full)?;
        body_len += postcard::to_slice(&lane.error, rest).map_err(|_| full)?.len();
    }
    if has_traffic {
        for lane in &message.report.lanes {
            let rest = buffer.get_mut(body_len..).ok_or(full)?;
            body_len += postcard::to_slice(&lane.traffic, rest).map_err(|_| full)?.len();
        }
    }
    let (body, rest) = buffer.split_at_mut_checked(body_len).ok_or(full)?;
    let trailer = rest.first_chunk_mut::<4>().ok_or(full)?;
    *trailer = CRC.checksum(body).to_le_bytes();
    buffer.get(..body_len + 4).ok_or(full)
}

/// Reads a message.
///
/// # Errors
/// [`WireError`] says what is wrong with the bytes.
pub fn decode(bytes: &[u8]) -> Result<DensityMessage, WireError> {
    let too_short = WireError::TooShort { actual: bytes.len() };
    let (body, trailer) = bytes.split_last_chunk::<4>().ok_or(too_short)?;
    let (&version, encoded) = body.split_first().ok_or(too_short)?;
    if !(VERSION_BARE..=VERSION).contains(&version) {
        return Err(WireError::Version { found: version });
    }
    let (stored, computed) = (u32::from_le_bytes(*trailer), CRC.checksum(body));
    if stored != computed {
        return Err(WireError::Crc { stored, computed });
    }
    let body = |_| WireError::Body;
    let (mut message, mut rest) =
        postcard::take_from_bytes::<DensityMessage>(encoded).map_err(body)?;
    if version >= VERSION_CELLS {
        for lane in &mut message.report.lanes {
            (lane.cells, rest) = postcard::take_from_bytes::<Option<Cells>>(rest).map_err(body)?;
        }
    }
    if version >= VERSION_DENSITY {
        for lane in &mut message.report.lanes {
            (lane.error, rest) =
                postcard::take_from_bytes::<Option<DensityError>>(rest).map_err(body)?;
        }
    }
    if version >= VERSION {
        for lane in &mut message.report.lanes {
            (lane.traffic, rest) =
                postcard::take_from_bytes::<Option<LaneTraffic>>(rest).map_err(body)?;
        }
    }
    if rest.is_empty() { Ok(message) } else { Err(WireError::Body) }
}

#[cfg(test)]
pub(crate) mod tests;
