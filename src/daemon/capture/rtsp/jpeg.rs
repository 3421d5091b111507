//! From RTP packets to JPEG pictures (RFC 2435).
//!
//! Owns the headers that the format leaves out, rebuilt from the few bytes that it sends.
//! Huffman tables are left out still: the decoder's door adds the standard's.

use super::rtp::{Follows, Order, Packet};
use super::{Coding, MAX_UNIT, Unit};

/// Quantisers of quality 50 in the order in which they are stored (RFC 2435, appendix A; ITU-T
/// T.81, tables K.1 and K.2).
#[rustfmt::skip]
const LUMA: [u8; 64] = [
    16, 11, 12, 14, 12, 10, 16, 14, 13, 14, 18, 17, 16, 19, 24, 40,
    26, 24, 22, 22, 24, 49, 35, 37, 29, 40, 58, 51, 61, 60, 57, 51,
    56, 55, 64, 72, 92, 78, 64, 68, 87, 69, 55, 56, 80, 109, 81, 87,
    95, 98, 103, 104, 103, 62, 77, 113, 121, 112, 100, 120, 92, 101, 103, 99,
];
#[rustfmt::skip]
const CHROMA: [u8; 64] = [
    17, 18, 18, 24, 21, 24, 47, 26, 26, 47, 99, 66, 56, 66, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
];

/// Collects pictures.
#[derive(Debug, Default)]
pub struct Assembler {
    order: Order,
    /// The picture without its header.
    data: Vec<u8>,
    header: Vec<u8>,
    timestamp: Option<u32>,
    broken: bool,
    /// Tables that came under a number, for pictures that name it alone.
    tables: Option<(u8, Vec<u8>)>,
    /// Packets missing so far, and pictures that were not given on.
    pub lost: u64,
    /// See [`Self::lost`].
    pub refused: u64,
}

impl Assembler {
    /// Takes a packet. A picture that it completes is put into `unit`.
    pub fn push(&mut self, packet: &Packet<'_>, unit: &mut Unit) -> bool {
        if let Follows::Gap(missing) = self.order.follows(packet.sequence) {
            self.lost += u64::from(missing);
            self.broken = true;
        }
        if self.timestamp != Some(packet.timestamp) {
            // The one before never ended.
            self.refused += u64::from(!self.header.is_empty());
            self.data.clear();
            self.header.clear();
            self.timestamp = Some(packet.timestamp);
            self.broken = false;
        }
        if self.payload(packet.payload).is_none() || self.data.len() > MAX_UNIT {
            self.broken = true;
            self.data = Vec::new();
        }
        if !packet.marker {
            return false;
        }
        let whole = !self.broken && !self.header.is_empty();
        self.refused += u64::from(!whole);
        if whole {
            unit.coding = Coding::Jpeg;
            unit.key = true;
            unit.bytes.clear();
            unit.bytes.extend_from_slice(&self.header);
            unit.bytes.extend_from_slice(&self.data);
            if !self.data.ends_with(&[0xff, 0xd9]) {
                unit.bytes.extend_from_slice(&[0xff, 0xd9]);
            }
        }
        self.data.clear();
        self.header.clear();
        // Further packets of the same time belong to nothing.
        self.broken = true;
        whole
    }

    fn payload(&mut self, payload: &[u8]) -> Option<()> {
        let (&[_, o2, o1, o0, kind, quality, columns, rows], mut rest) =
            payload.split_first_chunk()?;
        let offset = usize::from(o2) << 16 | usize::from(o1) << 8 | usize::from(o0);
        if offset != self.data.len() {
            return None;
        }
        let mut interval = 0;
        if (64..128).contains(&kind) {
            let (restart, tail) = rest.split_first_chunk::<4>()?;
            (interval, rest) = (u16::from_be_bytes([restart[0], restart[1]]), tail);
        }
        if offset == 0 {
            let tables = if quality >= 128 {
                let (head, tail) = rest.split_first_chunk::<4>()?;
                let length = usize::from(u16::from_be_bytes([head[2], head[3]]));
                let (tables, tail) = tail.split_at_checked(length)?;
                rest = tail;
                if length == 0 {
                    let known = self.tables.as_ref().filter(|(number, _)| *number == quality)?;
                    known.1.clone()
                } else {
                    // Tables of 16 bits are of 12-bit pictures.
                    if head[1] != 0 || length != 128 {
                        return None;
                    }
                    self.tables = Some((quality, tables.to_vec()));
                    tables.to_vec()
                }
            } else {
                scaled(quality)?
            };
            self.header = header(kind & 63, columns, rows, interval, &tables)?;
        }
        self.data.extend_from_slice(rest);
        Some(())
    }
}

/// The tables of a quality from 1 to 99 (RFC 2435, section 4.2).
fn scaled(quality: u8) -> Option<Vec<u8>> {
    let quality = u32::from(quality);
    let factor = match quality {
        1..=49 => 5000 / quality,
        50..=99 => 200 - 2 * quality,
        _ => return None,
    };
    let scale = |&value: &u8| ((u32::from(value) * factor + 50) / 100).clamp(1, 255) as u8;
    Some(LUMA.iter().chain(&CHROMA).map(scale).collect())
}

/// A picture's header (RFC 2435, appendix B), without Huffman tables.
fn header(kind: u8, columns: u8, rows: u8, interval: u16, tables: &[u8]) -> Option<Vec<u8>> {
    let sampling = match kind {
        0 => 0x21,
        1 => 0x22,
        _ => return None,
    };
    let (width, height) = (u16::from(columns) * 8, u16::from(rows) * 8);
    let mut bytes = vec![0xff, 0xd8];
    for (number, table) in (0..).zip(tables.chunks_exact(64)) {
        bytes.extend([0xff, 0xdb, 0, 67, number]);
        bytes.extend_from_slice(table);
    }
    bytes.extend([0xff, 0xc0, 0, 17, 8]);
    bytes.extend(height.to_be_bytes());
    bytes.extend(width.to_be_bytes());
    bytes.extend([3, 0, sampling, 0, 1, 0x11, 1, 2, 0x11, 1]);
    if interval > 0 {
        bytes.extend([0xff, 0xdd, 0, 4]);
        bytes.extend(interval.to_be_bytes());
    }
    bytes.extend([0xff, 0xda, 0, 12, 3, 0, 0, 1, 0x11, 2, 0x11, 0, 63, 0]);
    Some(bytes)
}

#[cfg(test)]
#[path = "jpeg_tests.rs"]
mod tests;
