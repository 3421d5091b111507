//! Picture files as a viewer shows them.
//!
//! Owns their size and their decoding, turned as their EXIF data say: labels are drawn on the
//! turned picture, and verge measures it. Does not own what is drawn on them (see `report`).

use crate::error::{Error, Result};
use image::{DynamicImage, ImageDecoder, ImageReader};
use std::path::Path;

/// Width and height of a picture file as it is shown, px, without decoding it.
pub fn picture_size(path: &Path) -> Result<[u32; 2]> {
    let wrong =
        |e: image::ImageError| Error::Picture { path: path.to_owned(), detail: e.to_string() };
    let mut decoder = decoder(path).map_err(wrong)?;
    let (width, height) = decoder.dimensions();
    // Orientations from 5 on exchange columns and rows.
    let is_turned = decoder.orientation().map_err(wrong)?.to_exif() > 4;
    Ok(if is_turned { [height, width] } else { [width, height] })
}

/// A picture file as a viewer shows it, labelme too, and as verge measures it: turned as its EXIF
/// data say.
///
/// # Errors
/// Where it cannot be read or decoded.
pub fn upright(path: &Path) -> image::ImageResult<DynamicImage> {
    let mut decoder = decoder(path)?;
    let orientation = decoder.orientation()?;
    let mut image = DynamicImage::from_decoder(decoder)?;
    image.apply_orientation(orientation);
    Ok(image)
}

fn decoder(path: &Path) -> image::ImageResult<impl ImageDecoder> {
    ImageReader::open(path)?.with_guessed_format()?.into_decoder()
}
