//! From a whole picture of a video to pixels, with limits.
//!
//! Owns what a picture must satisfy to be measured: its size is known and allowed before it is
//! decoded, and no part of it is missing or wrong. `h264` and `h265` are the doors of the
//! crates that decode.

mod h264;
#[cfg(feature = "h265")]
mod h265;

use super::Coding;
use crate::daemon::capture::DecodeError;
use crate::daemon::capture::picture::pixels::{self, Colour, Planes};
use crate::daemon::capture::picture::{self};
use crate::daemon::frame::{Picture, Shape};
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
pub fn describe(coding: Coding, sequence_set: &[u8]) -> Option<Description> {
    let described = catch_unwind(|| match coding {
        #[cfg(feature = "h265")]
        Coding::H265 => h265::describe(sequence_set),
        _ => h264::describe(sequence_set),
    });
    described.ok().flatten()
}

/// Decodes pictures one after the other.
#[derive(Debug)]
pub enum Video {
    /// H.264.
    H264(Box<h264::Decoder>),
    /// H.265.
    #[cfg(feature = "h265")]
    H265(Box<h265::Decoder>),
}

impl Video {
    /// For one key picture.
    pub fn alone(coding: Coding) -> Self {
        Self::new(coding, false)
    }

    /// For a stream of which every picture is decoded: the decoder keeps those that others build on.
    pub fn every(coding: Coding) -> Self {
        Self::new(coding, true)
    }

    fn new(coding: Coding, keeps_references: bool) -> Self {
        match coding {
            #[cfg(feature = "h265")]
            Coding::H265 => Self::H265(Box::new(h265::Decoder::new(keeps_references))),
            _ => Self::H264(Box::new(h264::Decoder::new(keeps_references))),
        }
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
        let decoded = catch_unwind(AssertUnwindSafe(|| match self {
            Self::H264(decoder) => decoder.decode(bytes, shape, picture),
            #[cfg(feature = "h265")]
            Self::H265(decoder) => decoder.decode(bytes, shape, picture),
        }));
        decoded.unwrap_or(Err(DecodeError::Decoder))?;
        picture::reduce(picture);
        Ok(())
    }
}

/// The parts of a sequence parameter set that count before a picture is decoded.
#[derive(Clone, Copy, Debug)]
struct Sequence {
    /// Columns and rows as they are shown, and as they are coded, px.
    size: (u32, u32),
    coded: (u32, u32),
    /// Memory that decoding takes, bytes.
    memory: u64,
    /// `matrix_coefficients` (H.273, table 4), 2 where it does not say.
    matrix: u32,
    full_range: bool,
}

impl Sequence {
    /// Refuses what must not be decoded; its colours otherwise.
    fn check(&self, shape: Option<Shape>) -> Result<Colour, DecodeError> {
        let (width, height) = self.size;
        picture::check_size(width, height)?;
        picture::check_size(self.coded.0, self.coded.1)?;
        picture::check_memory(width, height, self.memory)?;
        if let Some(shape) = shape.filter(|shape| !shape.admits(width, height)) {
            return Err(DecodeError::Shape { width, height, shape });
        }
        Ok(match (self.matrix, self.full_range) {
            (1, false) => Colour::Bt709,
            (1, true) => Colour::Bt709Full,
            (5 | 6, false) => Colour::Bt601,
            (5 | 6, true) => Colour::Bt601Full,
            (_, false) if height <= STANDARD_ROWS => Colour::Bt601,
            (_, true) if height <= STANDARD_ROWS => Colour::Bt601Full,
            (_, false) => Colour::Bt709,
            (_, true) => Colour::Bt709Full,
        })
    }
}

/// Refuses samples of more than 8 bits.
fn check_depth(bits: u8) -> Result<(), DecodeError> {
    if bits == 8 {
        return Ok(());
    }
    Err(DecodeError::Format { what: format!("a video of {bits} bits: set the camera to 8 bits") })
}
