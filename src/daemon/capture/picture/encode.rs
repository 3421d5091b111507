//! Pixels as a JPEG file: for recordings, and for a browser.
//!
//! Owns the writing of what `picture` reads.

use crate::daemon::frame::Picture;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageError};

/// The picture as a JPEG of this quality, 1 to 100. Colour is not halved.
///
/// # Errors
/// Where the picture has no size that a JPEG can have.
pub fn jpeg(picture: &Picture, quality: u8) -> Result<Vec<u8>, String> {
    let side = |px: usize| u32::try_from(px).unwrap_or(u32::MAX);
    let (width, height) = (side(picture.width), side(picture.height));
    let mut bytes = Vec::new();
    if width == 0 || height == 0 {
        return Err(format!("a picture of {width}x{height} px"));
    }
    JpegEncoder::new_with_quality(&mut bytes, quality)
        .encode(&picture.rgb, width, height, ExtendedColorType::Rgb8)
        .map_err(|error: ImageError| error.to_string())?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::super::decode;
    use super::*;

    #[test]
    fn what_is_written_is_read_again() {
        let (width, height) = (64, 48);
        let colour = |at: usize| [(at % width * 4) as u8, (at / width * 5) as u8, 90];
        let rgb = (0..width * height).flat_map(colour).collect();
        let picture = Picture { width, height, rgb };
        let mut again = Picture::default();
        decode(&jpeg(&picture, 95).expect("encodes"), &mut again).expect("decodes");
        assert_eq!((again.width, again.height), (width, height));
        let off = picture.rgb.iter().zip(&again.rgb).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(off.expect("pixels") < 12, "{off:?}");
        assert!(jpeg(&Picture::default(), 95).is_err(), "a picture without pixels");
    }
}
