//! The door of the crate `rusty_h265`: H.265 by its units.
//!
//! Owns what that crate is fed with and when a picture of it is whole.

use super::{
    Colour, DecodeError, Description, Picture, Planes, Sequence, Shape, check_depth, pixels,
};
use rusty_h265::frame::Plane;
use rusty_h265::nal::{split_annex_b, unescape};
use rusty_h265::ps::{Sps, parse_sps};
use rusty_h265::{Error, Frame};

/// The type of sequence sets (table 7-1).
const SEQUENCE_SET: u8 = 33;

/// Describes a stream by its sequence set.
pub fn describe(sequence_set: &[u8]) -> Option<Description> {
    let set = parse_sps(&unescape(sequence_set.get(2..)?).data).ok()?;
    let profile = match set.ptl.profile() {
        1 => "main".to_owned(),
        2 => "main 10".to_owned(),
        3 => "main still picture".to_owned(),
        other => format!("profile {other}"),
    };
    Some(Description { size: set.output_size(), profile })
}

/// Decodes pictures one after the other.
pub struct Decoder {
    decoder: rusty_h265::Decoder,
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
        let (decoder, colour) = (rusty_h265::Decoder::new(), Colour::default());
        Self { decoder, keeps_references, colour }
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
        let (incomplete, made_up) =
            (self.decoder.stats.incomplete, self.decoder.stats.generated_refs);
        for unit in split_annex_b(bytes) {
            if let [header, _, payload @ ..] = unit
                && header >> 1 & 63 == SEQUENCE_SET
            {
                let set = parse_sps(&unescape(payload).data).map_err(refused)?;
                self.colour = self.sequence(&set)?.check(shape)?;
            }
            self.decoder.push_nal(unit, None).map_err(refused)?;
        }
        // There is no next picture in this unit that would end it.
        self.decoder.end_picture();
        let stats = self.decoder.stats;
        if stats.incomplete > incomplete {
            return Err(DecodeError::Damaged("blocks are missing".to_owned()));
        }
        if stats.generated_refs > made_up {
            return Err(DecodeError::Damaged("a picture that it builds on is missing".to_owned()));
        }
        match (self.decoder.next_frame(), self.decoder.next_frame()) {
            (Ok(frame), Err(_)) => Ok(frame),
            (Ok(_), Ok(_)) => Err(DecodeError::Damaged("several pictures in one".to_owned())),
            (Err(_), _) => Err(DecodeError::Damaged("no picture in it".to_owned())),
        }
    }

    fn sequence(&self, set: &Sps) -> Result<Sequence, DecodeError> {
        let order = set.ordering[usize::from(set.max_sub_layers_minus1).min(7)];
        if self.keeps_references && order.max_num_reorder_pics > 0 {
            return Err(DecodeError::Format {
                what: "a video whose pictures come out of their order: set the camera to no B pictures"
                    .to_owned(),
            });
        }
        let kept =
            if self.keeps_references { u64::from(order.max_dec_pic_buffering_minus1) } else { 0 };
        // Samples of two bytes, 4:2:0; beside the picture what is known of each 4x4 block, and the
        // pixels and planes that are given on.
        let pixels = u64::from(set.width) * u64::from(set.height);
        let matrix = set.vui.as_ref().map_or(2, |vui| u32::from(vui.matrix_coeffs));
        Ok(Sequence {
            size: set.output_size(),
            coded: (set.width, set.height),
            memory: pixels * 3 * (kept + 1) + pixels * 7,
            matrix,
            full_range: set.vui.as_ref().is_some_and(|vui| vui.video_full_range_flag),
        })
    }

    fn convert(&self, frame: &Frame, picture: &mut Picture) -> Result<(), DecodeError> {
        check_depth(frame.picture.bit_depth_luma.max(frame.picture.bit_depth_chroma))?;
        let (left, top, width, height) = frame.picture.crop;
        let [luma, blue, red] = &frame.picture.planes;
        let chroma =
            |plane| cropped(plane, left / 2, top / 2, width.div_ceil(2), height.div_ceil(2));
        let planes = Planes {
            luma: &cropped(luma, left, top, width, height),
            blue: &chroma(blue),
            red: &chroma(red),
            width,
            height,
            across: 2,
            down: 2,
        };
        pixels::planes(&planes, self.colour, picture)
    }
}

fn refused(error: Error) -> DecodeError {
    let said = crate::daemon::foreign::shown(&error.to_string());
    match error {
        Error::Unsupported(_) => DecodeError::Format { what: format!("a video that is {said}") },
        _ => DecodeError::Damaged(said),
    }
}

/// A part of a plane, its samples as bytes.
fn cropped(plane: &Plane, left: usize, top: usize, width: usize, height: usize) -> Vec<u8> {
    let rows = (top..top + height).flat_map(|y| &plane.row(y)[left..left + width]);
    rows.map(|&sample| sample as u8).collect()
}

#[cfg(test)]
#[path = "h265_tests.rs"]
mod tests;
