//! From JPEG or PNG bytes to pixels, with limits.
//!
//! Owns what a picture must satisfy to be measured at all.

use crate::daemon::frame::Picture;
use image::{ColorType, ImageDecoder, ImageFormat};
use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Largest picture that is decoded, px: 4K.
pub const MAX_PICTURE: (u32, u32) = (3840, 2160);

/// Why bytes are not a picture to measure.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// Nothing there.
    #[error("the picture is empty (0 bytes)")]
    Empty,
    /// Neither JPEG nor PNG.
    #[error("neither JPEG nor PNG ({bytes} bytes, beginning {beginning})")]
    Format {
        /// Its size.
        bytes: usize,
        /// Its first bytes in hexadecimal.
        beginning: String,
    },
    /// The end is missing.
    #[error("the picture is cut off: {bytes} bytes without an end-of-image marker")]
    Truncated {
        /// Its size.
        bytes: usize,
    },
    /// Too large to be a traffic camera's.
    #[error(
        "a picture of {width}x{height} px; at most {}x{} are read",
        MAX_PICTURE.0,
        MAX_PICTURE.1
    )]
    TooLarge {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// More bytes than a camera's picture has.
    #[error("a picture of more than {} bytes", super::MAX_PICTURE_BYTES)]
    TooManyBytes,
    /// Raw pixels end before the picture does.
    #[error("a picture of {actual} bytes; in its format and size it has {expected}")]
    Short {
        /// Bytes of a whole picture.
        expected: usize,
        /// Bytes that came.
        actual: usize,
    },
    /// The decoder gave up.
    #[error("the picture is damaged: {0}")]
    Damaged(String),
    /// The decoder panicked, which it should not whatever it gets.
    #[error("the decoder broke down over the picture; please report it with the picture")]
    Decoder,
}

/// Decodes `bytes` into `picture`, whose buffer is used again.
///
/// # Errors
/// [`DecodeError`]; `picture` then holds nothing that may be used.
pub fn decode(bytes: &[u8], picture: &mut Picture) -> Result<(), DecodeError> {
    // The decoders are not ours, and what they get comes from outside: one that panics
    // costs a picture and not the daemon. A half-filled picture is not used.
    let decoded = catch_unwind(AssertUnwindSafe(|| decode_format(bytes, picture)));
    decoded.unwrap_or(Err(DecodeError::Decoder))
}

fn decode_format(bytes: &[u8], picture: &mut Picture) -> Result<(), DecodeError> {
    if bytes.is_empty() {
        return Err(DecodeError::Empty);
    }
    let damaged = |error: image::ImageError| DecodeError::Damaged(error.to_string());
    match image::guess_format(bytes) {
        Ok(ImageFormat::Jpeg) => {
            if !has_end_of_image(bytes) {
                return Err(DecodeError::Truncated { bytes: bytes.len() });
            }
            let decoder =
                image::codecs::jpeg::JpegDecoder::new(Cursor::new(bytes)).map_err(damaged)?;
            check_size(decoder.dimensions())?;
            read(decoder, picture)
        }
        Ok(ImageFormat::Png) => {
            check_palette(bytes)?;
            let decoder =
                image::codecs::png::PngDecoder::new(Cursor::new(bytes)).map_err(damaged)?;
            check_size(decoder.dimensions())?;
            read(decoder, picture)
        }
        _ => {
            let beginning = bytes.iter().take(8).map(|b| format!("{b:02x}")).collect();
            Err(DecodeError::Format { bytes: bytes.len(), beginning })
        }
    }
}

/// Refuses a palette that is not up to 256 colours of three bytes: png 0.18.1 panics on it.
fn check_palette(png: &[u8]) -> Result<(), DecodeError> {
    let mut rest = png.get(8..).unwrap_or_default();
    while let Some((&[l0, l1, l2, l3, kind @ ..], body)) = rest.split_first_chunk::<8>() {
        let len = u32::from_be_bytes([l0, l1, l2, l3]) as usize;
        if kind == *b"PLTE" && (!len.is_multiple_of(3) || len > 3 * 256) {
            return Err(DecodeError::Damaged(format!("a palette of {len} bytes")));
        }
        // The body is followed by its checksum.
        rest = body.get(len.saturating_add(4)..).unwrap_or_default();
    }
    Ok(())
}

fn check_size((width, height): (u32, u32)) -> Result<(), DecodeError> {
    if width == 0 || height == 0 {
        return Err(DecodeError::Damaged(format!("it has {width}x{height} px")));
    }
    if width > MAX_PICTURE.0 || height > MAX_PICTURE.1 {
        return Err(DecodeError::TooLarge { width, height });
    }
    Ok(())
}

fn read(decoder: impl ImageDecoder, picture: &mut Picture) -> Result<(), DecodeError> {
    let damaged = |error: image::ImageError| DecodeError::Damaged(error.to_string());
    let (width, height) = decoder.dimensions();
    (picture.width, picture.height) = (width as usize, height as usize);
    let rgb_len = picture.width * picture.height * 3;
    if decoder.color_type() == ColorType::Rgb8 {
        picture.rgb.resize(rgb_len, 0);
        return decoder.read_image(&mut picture.rgb).map_err(damaged);
    }
    let image = image::DynamicImage::from_decoder(decoder).map_err(damaged)?;
    picture.rgb.clear();
    picture.rgb.extend_from_slice(&image.into_rgb8());
    Ok(())
}

/// A JPEG that was cut off still decodes, grey where bytes are missing. In the coded data
/// 0xff is always followed by 0x00 or a marker, so that after the first start of scan
/// (0xffda) the end of image (0xffd9) cannot appear by chance.
fn has_end_of_image(jpeg: &[u8]) -> bool {
    let mut pairs = jpeg.windows(2);
    pairs.any(|pair| pair == [0xff, 0xda]) && pairs.any(|pair| pair == [0xff, 0xd9])
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::codecs::jpeg::JpegEncoder;

    fn jpeg(width: u32, height: u32) -> Vec<u8> {
        let mut bytes = Vec::new();
        let pixels: Vec<u8> = (0..width * height * 3).map(|i| (i * 7 % 251) as u8).collect();
        JpegEncoder::new_with_quality(&mut bytes, 90)
            .encode(&pixels, width, height, image::ExtendedColorType::Rgb8)
            .expect("encoding to memory");
        bytes
    }

    #[test]
    fn a_whole_jpeg_decodes_into_the_same_buffer() {
        let mut picture = Picture::default();
        decode(&jpeg(32, 24), &mut picture).expect("a whole picture");
        assert_eq!((picture.width, picture.height, picture.rgb.len()), (32, 24, 32 * 24 * 3));
        let buffer = picture.rgb.as_ptr();
        decode(&jpeg(32, 24), &mut picture).expect("a whole picture");
        assert_eq!(picture.rgb.as_ptr(), buffer);
    }

    #[test]
    fn every_truncation_is_an_error() {
        let whole = jpeg(32, 24);
        for len in 0..whole.len() {
            let result = decode(&whole[..len], &mut Picture::default());
            assert!(result.is_err(), "{len} of {} bytes", whole.len());
        }
    }

    #[test]
    fn a_huge_picture_is_refused_before_it_is_decoded() {
        // A PNG header that claims 20000x20000, and nothing behind it but its checksum.
        let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
        png.extend_from_slice(&[0, 0, 0x4e, 0x20, 0, 0, 0x4e, 0x20, 8, 2, 0, 0, 0]);
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&png[12..]);
        png.extend_from_slice(&crc.to_be_bytes());
        png.extend_from_slice(b"\0\0\0\x04IDAT\0\0\0\0\x35\xaf\x06\x1e");
        let error = decode(&png, &mut Picture::default()).expect_err("too large");
        assert!(
            matches!(error, DecodeError::TooLarge { width: 20_000, height: 20_000 }),
            "{error}"
        );
    }

    #[test]
    fn a_palette_that_is_none_is_refused() {
        let chunk = |kind: &[u8], body: &[u8]| {
            let mut bytes = (body.len() as u32).to_be_bytes().to_vec();
            bytes.extend_from_slice(kind);
            bytes.extend_from_slice(body);
            let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&bytes[4..]);
            bytes.extend_from_slice(&crc.to_be_bytes());
            bytes
        };
        for colours in [vec![7; 3 * 256 + 3], vec![7; 4]] {
            let mut png = b"\x89PNG\r\n\x1a\n".to_vec();
            png.extend(chunk(b"IHDR", &[0, 0, 0, 1, 0, 0, 0, 1, 8, 3, 0, 0, 0]));
            png.extend(chunk(b"PLTE", &colours));
            png.extend(chunk(b"IDAT", b""));
            let error = decode(&png, &mut Picture::default()).expect_err("no palette");
            assert!(error.to_string().contains("a palette of"), "{error}");
        }
    }

    #[test]
    fn other_bytes_are_named() {
        assert!(matches!(decode(&[], &mut Picture::default()), Err(DecodeError::Empty)));
        let error = decode(b"<html>503</html>", &mut Picture::default()).expect_err("no picture");
        assert!(error.to_string().contains("3c68746d"), "{error}");
    }

    #[test]
    fn grey_pictures_become_rgb() {
        let mut bytes = Vec::new();
        JpegEncoder::new(&mut bytes)
            .encode(&[128; 64], 8, 8, image::ExtendedColorType::L8)
            .expect("encoding to memory");
        let mut picture = Picture::default();
        decode(&bytes, &mut picture).expect("a whole picture");
        assert_eq!(picture.rgb.len(), 192);
    }
}
