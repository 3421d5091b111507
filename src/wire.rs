//! The compact message: one window of one site in postcard, with version and checksum.
//!
//! Owns the binary format only; topics and JSON are the daemon's `publish`.
//!
//! | offset | bytes | field |
//! |---|---|---|
//! | 0 | 1 | format version, 1 |
//! | 1 | M | [`DensityMessage`] in postcard |
//! | 1+M | 4 | CRC-32 (ISO-HDLC) of all bytes before, little-endian |

use crate::density::WindowReport;
use crate::lane::Name;
use core::fmt;
use crc::{CRC_32_ISO_HDLC, Crc};
use serde::{Deserialize, Serialize};

/// The format that this code writes and reads.
pub const VERSION: u8 = 1;
/// Most bytes of a message: eight lanes of at most 67 bytes, three names, two hashes,
/// counters and framing come to 780.
pub const MAX_MESSAGE: usize = 1024;

const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Where the metres of a density come from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibrationRef {
    /// Its name.
    pub id: Name,
    /// SHA-256 of the calibration file.
    pub sha256: [u8; 32],
    /// One standard error of a length on the road, as a fraction.
    pub rel_err: Option<f32>,
}

/// What found the vehicles.
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
    /// Where its metres come from.
    pub calibration: CalibrationRef,
    /// What found the vehicles.
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
                write!(f, "message format {found}, this program reads {VERSION}: update the reader")
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
    *version = VERSION;
    let body_len = postcard::to_slice(message, rest).map_err(|_| full)?.len();
    let (body, rest) = buffer.split_at_mut_checked(1 + body_len).ok_or(full)?;
    let trailer = rest.first_chunk_mut::<4>().ok_or(full)?;
    *trailer = CRC.checksum(body).to_le_bytes();
    buffer.get(..1 + body_len + 4).ok_or(full)
}

/// Reads a message.
///
/// # Errors
/// [`WireError`] says what is wrong with the bytes.
pub fn decode(bytes: &[u8]) -> Result<DensityMessage, WireError> {
    let too_short = WireError::TooShort { actual: bytes.len() };
    let (body, trailer) = bytes.split_last_chunk::<4>().ok_or(too_short)?;
    let (&version, encoded) = body.split_first().ok_or(too_short)?;
    if version != VERSION {
        return Err(WireError::Version { found: version });
    }
    let (stored, computed) = (u32::from_le_bytes(*trailer), CRC.checksum(body));
    if stored != computed {
        return Err(WireError::Crc { stored, computed });
    }
    match postcard::take_from_bytes(encoded) {
        Ok((message, [])) => Ok(message),
        _ => Err(WireError::Body),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::density::{LaneReport, SampleZoneStatus};
    use crate::units::{Direction, LaneId, MAX_LANES, UtcMs, VehicleClass};

    fn lane(number: u8, density: Option<f32>) -> LaneReport {
        LaneReport {
            lane: LaneId::new(number).expect("in range"),
            direction: Direction::Toward,
            density_veh_km: density,
            density_se: density.map(|k| k / 4.0),
            vehicles_mean: density.map(|k| k / 8.0),
            by_class: density.map(|k| [k; VehicleClass::COUNT]),
            space_occupancy: density.map(|_| 0.5),
            length_m: 125.0,
            frames_used: 60,
            frames_expected: 60,
            status: SampleZoneStatus::Ok,
        }
    }

    fn message(lanes: &[LaneReport]) -> DensityMessage {
        let name = |text| Name::try_from(text).expect("short");
        DensityMessage {
            site: name("k1"),
            seq: 300,
            clock_synced: true,
            report: WindowReport {
                from: UtcMs(60_000),
                to: UtcMs(120_000),
                lanes: lanes.iter().cloned().collect(),
            },
            calibration: CalibrationRef { id: name("c"), sha256: [1; 32], rel_err: Some(0.0625) },
            model: ModelRef { name: name("m"), sha256: [2; 32] },
        }
    }

    #[test]
    fn golden_bytes() {
        let mut buffer = [0; MAX_MESSAGE];
        let bytes = encode(&message(&[lane(1, None)]), &mut buffer).expect("fits");
        let golden: std::vec::Vec<u8> = [
            &[1][..],
            b"\x02k1",
            &[0xac, 0x02, 1],    // seq 300, clock synced
            &[0xc0, 0xa9, 0x07], // 60,000 ms, zigzag
            &[0x80, 0xd3, 0x0e], // 120,000 ms, zigzag
            &[1, 1, 1],          // one lane, lane 1, toward
            &[0; 5],             // nothing known
            &[0, 0, 0xfa, 0x42], // 125 m
            &[60, 60, 0],        // frames used, expected, ok
            b"\x01c",
            &[1; 32],
            &[1, 0, 0, 0x80, 0x3d],
            b"\x01m",
            &[2; 32],
        ]
        .concat();
        let (body, trailer) = bytes.split_at(bytes.len() - 4);
        assert_eq!(body, golden);
        assert_eq!(trailer, &[22, 18, 105, 21]);
    }

    #[test]
    fn the_largest_message_fits_and_returns() {
        let lanes: std::vec::Vec<_> =
            (1..=MAX_LANES as u8).map(|n| lane(n, Some(123.456))).collect();
        let mut sent = message(&lanes);
        let long = [b'x'; crate::lane::MAX_NAME];
        let long = Name::try_from(core::str::from_utf8(&long).expect("ascii")).expect("fits");
        sent.site = long.clone();
        sent.calibration.id = long.clone();
        sent.model.name = long;
        sent.seq = u64::MAX;
        for lane in &mut sent.report.lanes {
            (lane.frames_used, lane.frames_expected) = (u32::MAX, u32::MAX);
        }
        let mut buffer = [0; MAX_MESSAGE];
        let bytes = encode(&sent, &mut buffer).expect("MAX_MESSAGE holds every message");
        assert_eq!(decode(bytes), Ok(sent));
    }

    #[test]
    fn damage_is_refused() {
        let mut buffer = [0; MAX_MESSAGE];
        let good = encode(&message(&[lane(1, Some(20.0))]), &mut buffer).expect("fits").to_vec();
        for len in 0..good.len() {
            assert!(decode(&good[..len]).is_err(), "{len} bytes");
        }
        for bit in 0..good.len() * 8 {
            let mut bad = good.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert!(decode(&bad).is_err(), "bit {bit}");
        }
        assert_eq!(decode(&[2, 0, 0, 0, 0, 0]), Err(WireError::Version { found: 2 }));
        assert_eq!(encode(&message(&[]), &mut [0; 20]), Err(WireError::Buffer { actual: 20 }));
    }
}
