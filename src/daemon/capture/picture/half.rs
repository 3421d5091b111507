//! JPEGs with more pixels than are measured, decoded at half their width and height.
//!
//! Owns that the whole picture never lies in memory: 4 in place of 64 values come out of each block
//! (the inverse transform of its 4x4 lowest frequencies). The door of the crate `jpeg_decoder`, which
//! scales; `image`'s decoder, faster otherwise, does not.

use super::{DecodeError, MAX_MEASURED, damaged};
use crate::daemon::frame::Picture;
use jpeg_decoder::{Decoder, PixelFormat};
use std::io::Cursor;

/// Whether a picture of this size is decoded so: where it would be made smaller by two anyway, and
/// leaves no row or column over.
pub fn suits(width: u32, height: u32) -> bool {
    let (width, height) = (width as usize, height as usize);
    width.is_multiple_of(2)
        && height.is_multiple_of(2)
        && width * height > MAX_MEASURED
        && width * height / 4 <= MAX_MEASURED
}

/// Bytes that a picture of so many pixels takes beside what its coding keeps: planes and pixels, three
/// of each for four.
pub const fn memory(pixels: u64) -> u64 {
    pixels * 3 / 2
}

/// Decodes into `picture`; false where the pixels are of a kind that is not read here.
///
/// # Errors
/// [`DecodeError::Damaged`].
pub fn decode(bytes: &[u8], picture: &mut Picture) -> Result<bool, DecodeError> {
    let mut decoder = Decoder::new(Cursor::new(bytes));
    decoder.read_info().map_err(|error| damaged(&error))?;
    let Some(info) = decoder.info() else { return Ok(false) };
    if !matches!(info.pixel_format, PixelFormat::RGB24 | PixelFormat::L8) {
        return Ok(false);
    }
    // Frees the memory of the picture before.
    picture.rgb = Vec::new();
    let (width, height) =
        decoder.scale(info.width / 2, info.height / 2).map_err(|error| damaged(&error))?;
    if (width, height) != (info.width / 2, info.height / 2) {
        return Ok(false);
    }
    let pixels = decoder.decode().map_err(|error| damaged(&error))?;
    (picture.width, picture.height) = (usize::from(width), usize::from(height));
    picture.rgb = match info.pixel_format {
        PixelFormat::L8 => pixels.iter().flat_map(|&level| [level; 3]).collect(),
        _ => pixels,
    };
    if picture.rgb.len() != picture.width * picture.height * 3 {
        return Err(DecodeError::Damaged("rows are missing".to_owned()));
    }
    Ok(true)
}
