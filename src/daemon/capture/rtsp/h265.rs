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

    /// The first number of a set, but of a sequence set, where it lies behind its profile and may be
    /// anywhere: cameras have one sequence.
    fn set_number(unit: &[u8]) -> Option<u32> {
        match unit[0] >> 1 & 63 {
            VIDEO_SET => Some(u32::from(unit.get(2)? >> 4)),
            SEQUENCE_SET => Some(0),
            _ => Golomb::new(unit.get(2..)?).number(),
        }
    }
}

#[cfg(test)]
#[path = "h265_tests.rs"]
mod tests;
