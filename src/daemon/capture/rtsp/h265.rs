//! The units of H.265 (ITU-T H.265, 7.3; RFC 7798): single ones, aggregates (AP) and parts (FU).

use super::Coding;
use super::assembler::{self, Class, Golomb, SliceHead, Syntax};

/// Collects pictures of H.265.
pub type Assembler = assembler::Assembler<H265>;

/// Types of pictures from which a decoder can begin (table 7-1, IRAP): coded without others.
const FIRST_KEY: u8 = 16;
const LAST_KEY: u8 = 21;
const LAST_SLICE: u8 = 31;
const VIDEO_SET: u8 = 32;
const SEQUENCE_SET: u8 = 33;
const PICTURE_SET: u8 = 34;

/// Lengths of a profile and of a level, bytes, and most layers below the highest (7.3.3).
const PROFILE: usize = 11;
const LEVEL: usize = 1;
const MOST_LAYERS: usize = 6;
/// The most of a sequence set that is read for its number, bytes.
const SEQUENCE_HEAD: usize = 1 + (PROFILE + LEVEL) * (1 + MOST_LAYERS) + 2 + 8;

/// See [`Syntax`].
#[derive(Debug)]
pub struct H265;

impl Syntax for H265 {
    const CODING: Coding = Coding::H265;
    const HEADER: usize = 2;
    const SHIFT: u32 = 1;
    const MASK: u8 = 63;
    const AGGREGATE: u8 = 48;
    const FRAGMENT: u8 = 49;
    const SEQUENCE_SET: u8 = SEQUENCE_SET;

    fn class(kind: u8) -> Class {
        match kind {
            0..=9 | FIRST_KEY..=LAST_KEY => Class::Slice,
            VIDEO_SET..=PICTURE_SET => Class::Set,
            // Reserved pictures, and packets of forms that cameras do not use.
            10..=LAST_SLICE | 48.. => Class::Unread,
            _ => Class::Other,
        }
    }

    fn whole_header(header: &[u8], kind: u8) -> impl AsRef<[u8]> {
        [header[0] & 0x81 | kind << 1, header[1]]
    }

    /// `first_slice_segment_in_pic_flag` (7.3.6.1).
    fn slice(kind: u8, rest: &[u8]) -> Option<SliceHead> {
        let first = rest.first()? & 0x80 != 0;
        Some(SliceHead { first, alone: (FIRST_KEY..=LAST_KEY).contains(&kind) })
    }

    /// The number of a set, within its bounds (7.4.3): the first of it, in a sequence set the one
    /// behind its profile.
    fn set_number(unit: &[u8]) -> Option<u32> {
        let content = unit.get(Self::HEADER..)?;
        let (number, most) = match unit.first()? >> Self::SHIFT & Self::MASK {
            VIDEO_SET => (u32::from(content.first()? >> 4), 15),
            SEQUENCE_SET => (sequence_number(content)?, 15),
            _ => (Golomb::new(content).number()?, 63),
        };
        (number <= most).then_some(number)
    }
}

/// `sps_seq_parameter_set_id` (7.3.2.2.1), behind `profile_tier_level` (7.3.3), whose length the
/// number of its layers decides.
fn sequence_number(content: &[u8]) -> Option<u32> {
    let head: Vec<u8> = without_escapes(content).take(SEQUENCE_HEAD).collect();
    let layers = usize::from(head.first()? >> 1 & 7);
    if layers > MOST_LAYERS {
        return None;
    }
    let mut at = 1 + PROFILE + LEVEL;
    if layers > 0 {
        // For each layer two bits, in two bytes: whether it has a profile and a level of its own.
        let present = u16::from_be_bytes([*head.get(at)?, *head.get(at + 1)?]);
        let layer = |bit: usize, bytes| usize::from(present >> (15 - bit) & 1) * bytes;
        at += 2;
        at += (0..layers).map(|i| layer(2 * i, PROFILE) + layer(2 * i + 1, LEVEL)).sum::<usize>();
    }
    Golomb::new(head.get(at..)?).number()
}

/// The bytes of a unit without those that keep start codes out of it (7.3.1.1).
fn without_escapes(content: &[u8]) -> impl Iterator<Item = u8> {
    let mut zeros = 0;
    content.iter().copied().filter(move |&byte| {
        let is_escape = zeros >= 2 && byte == 3;
        zeros = if byte == 0 { zeros + 1 } else { 0 };
        !is_escape
    })
}

#[cfg(test)]
#[path = "h265_tests.rs"]
mod tests;
