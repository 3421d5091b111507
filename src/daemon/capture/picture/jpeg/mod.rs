//! Whether a JPEG is whole, found by reading its coded data without making pixels of it.
//!
//! Owns the rule that a picture with a part missing is damaged: decoders fill what is missing
//! with grey, and grey holds no vehicles. Each scan must give exactly the blocks that the header
//! promises, out of exactly the bytes that are there (ITU-T T.81, annexes F and G). Sequential
//! and progressive Huffman coding; what else there is, the decoder refuses.

mod bits;
mod blocks;
mod exif;
mod frame;
mod markers;
mod walk;

pub use exif::exif_orientation;
pub use markers::{End, EndFinder};

use super::DecodeError;
use frame::Component;
use walk::Walk;

/// Most scans of one picture: encoders write about ten.
const MAX_SCANS: usize = 100;

/// The segments before the coded data.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// Columns, px.
    pub width: u32,
    /// Rows, px.
    pub height: u32,
    /// Samples of all components in a row of blocks' worth, times 64 coefficients: what a decoder
    /// keeps of a progressive picture.
    pub coefficients: u64,
    /// Whether the decoder has to keep them.
    pub keeps_coefficients: bool,
    /// Orientation, as EXIF numbers it: 1 to 8.
    pub orientation: u8,
    /// Where Huffman tables are missing: in front of this byte.
    pub tables_missing_at: Option<usize>,
}

/// Reads the header, up to the first scan.
pub fn header(bytes: &[u8]) -> Result<Header, DecodeError> {
    let mut walk = Walk::new(bytes);
    let mut header = Header { orientation: 1, ..Header::default() };
    let scan = loop {
        let segment = walk.segment()?;
        match segment.marker {
            0xe1 => {
                header.orientation = exif::orientation(segment.body).unwrap_or(header.orientation)
            }
            0xda => break segment,
            0xd9 => return Err(damaged("it has no coded data")),
            _ => walk.note(&segment)?,
        }
    };
    let frame = walk.frame.as_ref().ok_or_else(|| damaged("its size is not given"))?;
    (header.width, header.height) = (frame.width as u32, frame.height as u32);
    let coefficients = |c: &Component| (c.stride * c.blocks.1.next_multiple_of(c.v) * 64) as u64;
    header.coefficients = frame.components.iter().map(coefficients).sum();
    let in_scan = usize::from(scan.body.first().copied().unwrap_or_default());
    header.keeps_coefficients = frame.progressive || in_scan < frame.components.len();
    if walk.dc.iter().chain(&walk.ac).all(Option::is_none) {
        header.tables_missing_at = Some(scan.at);
    }
    Ok(header)
}

/// Checks that nothing is missing from the coded data.
pub fn verify(bytes: &[u8]) -> Result<(), DecodeError> {
    let mut walk = Walk::new(bytes);
    let mut scans = 0;
    loop {
        let segment = walk.segment()?;
        match segment.marker {
            0xd9 => break,
            0xda => {
                scans += 1;
                if scans > MAX_SCANS {
                    return Err(damaged("it has more scans than a picture needs"));
                }
                let body = segment.body.to_vec();
                walk.scan(&body)?;
            }
            _ => walk.note(&segment)?,
        }
    }
    let frame = walk.frame.ok_or_else(|| damaged("its size is not given"))?;
    let whole = |component: &Component| {
        let needed = if frame.progressive { 64 } else { 1 };
        component.sent.iter().take(needed).all(|&bit| bit == 0)
    };
    if frame.components.iter().all(whole) { Ok(()) } else { Err(damaged("scans are missing")) }
}

fn damaged(what: &str) -> DecodeError {
    DecodeError::Damaged(what.to_owned())
}

#[cfg(test)]
mod tests;
