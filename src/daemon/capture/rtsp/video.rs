//! From a whole H.264 picture to pixels, with limits.
//!
//! Owns what a video's picture must satisfy to be measured: its size is known and allowed before
//! it is decoded, and no part of it is missing or wrong. The door of the crate `rust_h264`.

use crate::daemon::capture::DecodeError;
use crate::daemon::capture::picture::pixels::{self, Colour, Planes};
use crate::daemon::capture::picture::{self};
use crate::daemon::frame::{Picture, Shape};
use rust_h264::decoder::{ChromaFormat, Decoder, Frame};
use rust_h264::nal::{NalUnitType, SpsInfo, parse_annex_b, parse_sps_info};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Rows up to which pictures that do not say it are in the colours of standard definition.
const STANDARD_ROWS: u32 = 576;

/// Properties of a stream, from its sequence parameter set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Description {
    /// Columns and rows, px.
    pub size: (u32, u32),
    /// Its profile's name.
    pub profile: String,
}

/// Describes a stream by its sequence set.
pub fn describe(sequence_set: &[u8]) -> Option<Description> {
    let annex_b = [&[0, 0, 0, 1], sequence_set].concat();
    let described = catch_unwind(AssertUnwindSafe(|| {
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
    }));
    described.ok().flatten()
}

/// Decodes pictures one after the other.
pub struct Video {
    decoder: Decoder,
    /// Whether more than one picture is decoded: then the decoder keeps those that others build on.
    keeps_references: bool,
    colour: Colour,
    info: Option<SpsInfo>,
}

impl std::fmt::Debug for Video {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Video").field("info", &self.info).finish_non_exhaustive()
    }
}

impl Default for Video {
    fn default() -> Self {
        let (decoder, colour) = (Decoder::new(), Colour::default());
        Self { decoder, keeps_references: false, colour, info: None }
    }
}

impl Video {
    /// For a stream of which every picture is decoded.
    pub fn every() -> Self {
        Self { keeps_references: true, ..Self::default() }
    }

    /// Decodes a picture in Annex B's form, with its parameter sets in front.
    ///
    /// # Errors
    /// [`DecodeError`]; a picture that builds on this one is then wrong as well.
    pub fn decode(
        &mut self,
        bytes: &[u8],
        shape: Option<Shape>,
        picture: &mut Picture,
    ) -> Result<(), DecodeError> {
        let decoded = catch_unwind(AssertUnwindSafe(|| self.decode_units(bytes, shape)));
        let frame = decoded.unwrap_or(Err(DecodeError::Decoder))?;
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
                    self.check(&info, shape)?;
                    self.info = Some(info);
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

    /// Refuses by the sequence set what must not be decoded.
    fn check(&mut self, info: &SpsInfo, shape: Option<Shape>) -> Result<(), DecodeError> {
        picture::check_size(info.width, info.height)?;
        picture::check_size(info.coded_width, info.coded_height)?;
        let kept = if self.keeps_references { info.reference_frames } else { 0 };
        picture::check_memory(info.width, info.height, memory(info, kept))?;
        if let Some(shape) = shape.filter(|shape| !shape.admits(info.width, info.height)) {
            return Err(DecodeError::Shape { width: info.width, height: info.height, shape });
        }
        self.colour = match (info.matrix, info.full_range) {
            (1, false) => Colour::Bt709,
            (1, true) => Colour::Bt709Full,
            (5 | 6, false) => Colour::Bt601,
            (5 | 6, true) => Colour::Bt601Full,
            (_, false) if info.height <= STANDARD_ROWS => Colour::Bt601,
            (_, true) if info.height <= STANDARD_ROWS => Colour::Bt601Full,
            (_, false) => Colour::Bt709,
            (_, true) => Colour::Bt709Full,
        };
        Ok(())
    }

    fn convert(&self, frame: &Frame, picture: &mut Picture) -> Result<(), DecodeError> {
        if frame.bit_depth != 8 {
            return Err(DecodeError::Format {
                what: "a video of 10 bits: set the camera to 8 bits (profile high)".to_owned(),
            });
        }
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
        pixels::planes(&planes, self.colour, picture)?;
        picture::reduce(picture);
        Ok(())
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
#[path = "video_tests.rs"]
mod tests;
