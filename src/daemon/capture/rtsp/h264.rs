//! The units of H.264 (ITU-T H.264, 7.3; RFC 6184): single ones, STAP-A and FU-A.

use super::Coding;
use super::assembler::{self, Class, Golomb, SliceHead, Syntax};

/// Collects pictures of H.264.
pub type Assembler = assembler::Assembler<H264>;

const SLICE: u8 = 1;
const SLICE_IDR: u8 = 5;
const SEQUENCE_SET: u8 = 7;
const PICTURE_SET: u8 = 8;

/// See [`Syntax`].
#[derive(Debug)]
pub struct H264;

impl Syntax for H264 {
    const CODING: Coding = Coding::H264;
    const HEADER: usize = 1;
    const SHIFT: u32 = 0;
    const MASK: u8 = 31;
    const AGGREGATE: u8 = 24;
    const FRAGMENT: u8 = 28;
    const SEQUENCE_SET: u8 = SEQUENCE_SET;

    fn class(kind: u8) -> Class {
        match kind {
            SLICE | SLICE_IDR => Class::Slice,
            SEQUENCE_SET | PICTURE_SET => Class::Set,
            // Data partitions, which need all three; interleaved modes, which cameras do not use.
            2..=4 | 0 | 24.. => Class::Unread,
            _ => Class::Other,
        }
    }

    fn whole_header(header: &[u8], kind: u8) -> impl AsRef<[u8]> {
        [header[0] & 0xe0 | kind]
    }

    /// The first macroblock, and whether the slice is coded without other pictures (7.3.3).
    fn slice(kind: u8, rest: &[u8]) -> Option<SliceHead> {
        let mut head = Golomb::new(&rest[..rest.len().min(16)]);
        let first = head.number()? == 0;
        let slice_type = head.number().filter(|&slice_type| slice_type <= 9)?;
        let alone = slice_type % 5 == 2;
        // An IDR picture has no others to be coded from.
        (alone || kind != SLICE_IDR).then_some(SliceHead { first, alone })
    }

    fn set_number(unit: &[u8]) -> Option<u32> {
        let skip = if unit[0] & 31 == SEQUENCE_SET { 4 } else { 1 };
        Golomb::new(unit.get(skip..)?).number()
    }
}
