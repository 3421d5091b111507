//! The door of the crate `rust_h264`: H.264 by its units.
//!
//! Owns what that crate is fed with and when a picture of it is whole.

use super::{
    Colour, DecodeError, Description, Picture, Planes, Sequence, Shape, check_depth, pixels,
};
use rust_h264::decoder::{ChromaFormat, Frame};
use rust_h264::nal::{NalUnitType, SpsInfo, parse_annex_b, parse_sps_info};

/// Describes a stream by its sequence set.
pub fn describe(sequence_set: &[u8]) -> Option<Description> {
    let annex_b = [&[0, 0, 0, 1], sequence_set].concat();
    let units = parse_annex_b(&annex_b);
    let info = parse_sps_info(units.first()?).ok()?;
    let profile = match info.profile {
        66 => "baseline".to_owned(),
        77 => "main".to_owned(),
        88 => "extended".to_owned(),
        100 => "high".to_owned(),
        110 => "high 10".to_owned(),
        122 => "high 4:2:2".to_owned(),
        other => format!("profile {other}"),
    };
    let interlaced = if info.progressive { "" } else { ", interlaced" };
    Some(Description { size: (info.width, info.height), profile: profile + interlaced })
}

/// Decodes pictures one after the other.
#[derive(Default)]
pub struct Decoder {
    decoder: rust_h264::decoder::Decoder,
    keeps_references: bool,
    colour: Colour,
}

impl std::fmt::Debug for Decoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Decoder").field("colour", &self.colour).finish_non_exhaustive()
    }
}

impl Decoder {
    pub fn new(keeps_references: bool) -> Self {
        Self { keeps_references, ..Self::default() }
    }

    /// As [`super::Video::decode`].
    pub fn decode(
        &mut self,
        bytes: &[u8],
        shape: Option<Shape>,
        picture: &mut Picture,
    ) -> Result<(), DecodeError> {
        let frame = self.decode_units(bytes, shape)?;
        self.convert(&frame, picture)
    }

    fn decode_units(&mut self, bytes: &[u8], shape: Option<Shape>) -> Result<Frame, DecodeError> {
        let damaged = |error: rust_h264::error::DecodeError| {
            DecodeError::Damaged(crate::daemon::foreign::shown(&error.to_string()))
        };
        let mut frames = Vec::new();
        for unit in parse_annex_b(bytes) {
            match unit.nal_unit_type {
                NalUnitType::Sps => {
                    let info = parse_sps_info(&unit).map_err(damaged)?;
                    self.colour = self.sequence(&info).check(shape)?;
                }
                NalUnitType::Pps | NalUnitType::Slice | NalUnitType::SliceIdr => {}
                _ => continue,
            }
            frames.extend(self.decoder.decode_nal(&unit).map_err(damaged)?);
        }
        // The decoder gives a picture out when the next one begins: there is none in this unit.
        frames.extend(self.decoder.flush());
        if self.decoder.take_incomplete() {
            return Err(DecodeError::Damaged("macroblocks are missing".to_owned()));
        }
        match frames.pop() {
            Some(frame) if frames.is_empty() => Ok(frame),
            Some(_) => Err(DecodeError::Damaged("several pictures in one".to_owned())),
            None => Err(DecodeError::Damaged("no picture in it".to_owned())),
        }
    }

    fn sequence(&self, info: &SpsInfo) -> Sequence {
        let kept = if self.keeps_references { info.reference_frames } else { 0 };
        Sequence {
            size: (info.width, info.height),
            coded: (info.coded_width, info.coded_height),
            memory: memory(info, kept),
            matrix: info.matrix.into(),
            full_range: info.full_range,
        }
    }

    fn convert(&self, frame: &Frame, picture: &mut Picture) -> Result<(), DecodeError> {
        check_depth(frame.bit_depth)?;
        let (across, down) = match frame.chroma_format {
            ChromaFormat::Yuv422 => (2, 1),
            _ => (2, 2),
        };
        let planes = Planes {
            luma: &frame.y,
            blue: &frame.u,
            red: &frame.v,
            width: frame.width as usize,
            height: frame.height as usize,
            across,
            down,
        };
        pixels::planes(&planes, self.colour, picture)
    }
}

/// Memory that decoding takes, bytes: the picture, a copy that is given out, those that are kept,
/// and the pixels.
fn memory(info: &SpsInfo, kept: u32) -> u64 {
    let pixels = u64::from(info.coded_width) * u64::from(info.coded_height);
    // Halves of a sample for each pixel, by chroma_format_idc (H.264, table 6-1).
    let halves = [2, 3, 4, 6][info.chroma_format.min(3) as usize];
    let bytes = if info.bit_depth_luma.max(info.bit_depth_chroma) > 8 { 2 } else { 1 };
    pixels * halves * bytes / 2 * (u64::from(kept) + 2) + pixels * 3
}

#[cfg(test)]
#[path = "h264_tests.rs"]
mod tests;
