//! From JPEG or PNG bytes to pixels, with limits.
//!
//! Owns what a picture must satisfy to be measured at all: whole, of the lane table's shape, and
//! not too large; and that it stands as a viewer shows it. The door of the crates `image`, `png` and
//! `jpeg_decoder`. Nothing that stands beside the pixels is unpacked: a profile or a text of a few bytes
//! may unpack to gigabytes.

pub mod encode;
mod error;
mod half;
pub mod jpeg;
pub mod kind;
pub mod pixels;
pub mod scan;
mod standard_tables;

pub use error::DecodeError;

use crate::daemon::frame::{Picture, Shape};
use image::{ColorType, ImageDecoder};
use kind::Kind;
use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Most pixels that are measured: a larger picture is made smaller by a whole factor.
pub const MAX_MEASURED: usize = 3840 * 2160;
/// Most pixels that are decoded: cameras of 12 megapixels, with room.
pub const MAX_PIXELS: u64 = 16_000_000;
/// Most memory that decoding may take, bytes.
const MAX_MEMORY: u64 = 88 << 20;
/// Copies of a picture's bytes that are held while it is decoded: the stream's, the latest one and
/// that of the question.
const COPIES: u64 = 3;

/// Decodes `bytes` into `picture`, whose buffer is used again.
///
/// # Errors
/// [`DecodeError`]; `picture` then holds nothing that may be used.
pub fn decode(bytes: &[u8], picture: &mut Picture) -> Result<(), DecodeError> {
    decode_shaped(bytes, None, picture)
}

/// The same for pictures of one shape: any other is refused by its header, undecoded.
///
/// # Errors
/// As [`decode`], and [`DecodeError::Shape`].
pub fn decode_shaped(
    bytes: &[u8],
    shape: Option<Shape>,
    picture: &mut Picture,
) -> Result<(), DecodeError> {
    let held = COPIES * bytes.len().min(super::MAX_PICTURE_BYTES) as u64;
    decode_held(bytes, held, shape, picture)
}

/// The same for bytes in memory that takes `held` bytes in all, such as a device's buffers.
///
/// # Errors
/// As [`decode_shaped`].
pub fn decode_held(
    bytes: &[u8],
    held: u64,
    shape: Option<Shape>,
    picture: &mut Picture,
) -> Result<(), DecodeError> {
    // The decoders are not ours, and what they get comes from outside: one that panics
    // costs a picture and not the daemon. A half-filled picture is not used.
    let decoded = catch_unwind(AssertUnwindSafe(|| {
        let bytes = kind::trimmed(bytes);
        match Kind::of(bytes) {
            _ if bytes.is_empty() => Err(DecodeError::Empty),
            Some(Kind::Jpeg) => decode_jpeg(bytes, held, shape, picture),
            Some(Kind::Png) => decode_png(bytes, held, shape, picture),
            None => Err(DecodeError::Format { what: kind::described(bytes) }),
        }
    }));
    let decoded = decoded.unwrap_or(Err(DecodeError::Decoder));
    if decoded.is_err() {
        // A picture that is refused leaves no memory taken.
        *picture = Picture::default();
    }
    decoded
}

fn damaged(error: &impl std::fmt::Display) -> DecodeError {
    DecodeError::Damaged(crate::daemon::foreign::shown(&error.to_string()))
}

fn decode_jpeg(
    bytes: &[u8],
    held: u64,
    shape: Option<Shape>,
    picture: &mut Picture,
) -> Result<(), DecodeError> {
    let header = jpeg::header(bytes)?;
    let kept = if header.keeps_coefficients { header.coefficients * 2 } else { 0 };
    let kept = kept + held + bytes.len() as u64;
    let (pixels, is_half) = (
        u64::from(header.width) * u64::from(header.height),
        half::suits(header.width, header.height),
    );
    let memory = kept + if is_half { half::memory(pixels) } else { 3 * pixels };
    check(header.width, header.height, header.orientation, memory, shape)?;
    let bytes = match jpeg::EndFinder::default().find(bytes) {
        jpeg::End::At(end) => &bytes[..end],
        jpeg::End::Later => return Err(DecodeError::Truncated { bytes: bytes.len() }),
        jpeg::End::Broken(_) => {
            return Err(DecodeError::Damaged("bytes between its segments".into()));
        }
    };
    let with_tables;
    let bytes = match header.tables_missing_at {
        Some(at) => {
            with_tables = [&bytes[..at], &standard_tables::STANDARD_TABLES, &bytes[at..]].concat();
            with_tables.as_slice()
        }
        None => bytes,
    };
    jpeg::verify(bytes)?;
    if is_half && half::decode(bytes, picture)? {
        finish(picture, header.orientation);
        return Ok(());
    }
    check_memory(header.width, header.height, kept + 3 * pixels)?;
    let decoder =
        image::codecs::jpeg::JpegDecoder::new(Cursor::new(bytes)).map_err(|e| damaged(&e))?;
    let (width, height) = decoder.dimensions();
    (picture.width, picture.height) = (width as usize, height as usize);
    match decoder.color_type() {
        ColorType::Rgb8 => {
            picture.rgb.resize(picture.width * picture.height * 3, 0);
            decoder.read_image(&mut picture.rgb).map_err(|e| damaged(&e))?;
        }
        ColorType::L8 => {
            // The levels lie in front of the pixels that they become.
            picture.rgb.resize(picture.width * picture.height * 3, 0);
            let levels = picture.width * picture.height;
            decoder.read_image(&mut picture.rgb[..levels]).map_err(|e| damaged(&e))?;
            for at in (0..levels).rev() {
                let level = picture.rgb[at];
                picture.rgb[3 * at..3 * at + 3].fill(level);
            }
        }
        other => return Err(DecodeError::Format { what: format!("a JPEG of {other:?} pixels") }),
    }
    finish(picture, header.orientation);
    Ok(())
}

fn decode_png(
    bytes: &[u8],
    held: u64,
    shape: Option<Shape>,
    picture: &mut Picture,
) -> Result<(), DecodeError> {
    check_palette(bytes)?;
    let limits = png::Limits { bytes: MAX_MEMORY as usize };
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), limits);
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
    let (width, height) = decoder.read_header_info().map_err(|error| damaged(&error))?.size();
    check_size(width, height)?;
    let mut reader = decoder.read_info().map_err(|error| damaged(&error))?;
    let exif = reader.info().exif_metadata.as_deref();
    let orientation = exif.and_then(jpeg::exif_orientation).unwrap_or(1);
    let (color, _) = reader.output_color_type();
    let interlaced = reader.info().interlaced;
    let kept = u64::from(width) * u64::from(height) * if interlaced { 4 } else { 0 };
    let kept = kept + held + bytes.len() as u64;
    let memory = kept + 3 * u64::from(width) * u64::from(height);
    check(width, height, orientation, memory, shape)?;
    (picture.width, picture.height) = (width as usize, height as usize);
    picture.rgb.clear();
    picture.rgb.reserve(picture.width * picture.height * 3);
    if interlaced {
        let len = reader.output_buffer_size().ok_or(DecodeError::TooLarge { width, height })?;
        let mut whole = vec![0; len];
        reader.next_frame(&mut whole).map_err(|error| damaged(&error))?;
        push_rgb(&whole, color, &mut picture.rgb);
    } else {
        while let Some(row) = reader.next_row().map_err(|error| damaged(&error))? {
            push_rgb(row.data(), color, &mut picture.rgb);
        }
    }
    // Reads to the end of the file: a picture cut off behind the pixels is not whole.
    reader.finish().map_err(|_| DecodeError::Truncated { bytes: bytes.len() })?;
    if picture.rgb.len() != picture.width * picture.height * 3 {
        return Err(DecodeError::Damaged("rows are missing".to_owned()));
    }
    finish(picture, orientation);
    Ok(())
}

fn push_rgb(pixels: &[u8], color: png::ColorType, rgb: &mut Vec<u8>) {
    match color {
        png::ColorType::Rgb => rgb.extend_from_slice(pixels),
        png::ColorType::Rgba => pixels.chunks_exact(4).for_each(|p| rgb.extend_from_slice(&p[..3])),
        png::ColorType::GrayscaleAlpha => {
            pixels.chunks_exact(2).for_each(|p| rgb.extend([p[0]; 3]))
        }
        _ => pixels.iter().for_each(|&level| rgb.extend([level; 3])),
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

/// Whether a picture of this size is read at all.
///
/// # Errors
/// [`DecodeError::TooLarge`], [`DecodeError::Damaged`] for one without pixels.
pub fn check_size(width: u32, height: u32) -> Result<(), DecodeError> {
    if width == 0 || height == 0 {
        return Err(DecodeError::Damaged(format!("it has {width}x{height} px")));
    }
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(DecodeError::TooLarge { width, height });
    }
    Ok(())
}

/// Whether a picture of this size may take so much memory, bytes.
///
/// # Errors
/// [`DecodeError::TooMuchMemory`].
pub fn check_memory(width: u32, height: u32, memory: u64) -> Result<(), DecodeError> {
    if memory > MAX_MEMORY {
        return Err(DecodeError::TooMuchMemory { width, height, megabytes: memory >> 20 });
    }
    Ok(())
}

/// Checks what a header promises: the size, the shape as it will stand, and the memory, bytes.
fn check(
    width: u32,
    height: u32,
    orientation: u8,
    memory: u64,
    shape: Option<Shape>,
) -> Result<(), DecodeError> {
    check_size(width, height)?;
    check_memory(width, height, memory)?;
    let (width, height) = if orientation > 4 { (height, width) } else { (width, height) };
    match shape {
        Some(shape) if !shape.admits(width, height) => {
            Err(DecodeError::Shape { width, height, shape })
        }
        _ => Ok(()),
    }
}

/// Turns a picture upright and makes it smaller where it is too large. What is turned is a copy: it
/// is made smaller before.
fn finish(picture: &mut Picture, orientation: u8) {
    // Upright pictures lose the same columns and rows as ever: the last.
    reduce_from(
        picture,
        matches!(orientation, 2 | 3 | 7 | 8),
        matches!(orientation, 3 | 4 | 6 | 7),
    );
    turn(picture, orientation);
}

/// Turns a picture as EXIF says that it is to be shown (Exif 2.32, section 4.6.4, tag 0x0112).
fn turn(picture: &mut Picture, orientation: u8) {
    let (width, height) = (picture.width, picture.height);
    let (across, down) = if orientation > 4 { (height, width) } else { (width, height) };
    let source = |x: usize, y: usize| match orientation {
        2 => (width - 1 - x, y),
        3 => (width - 1 - x, height - 1 - y),
        4 => (x, height - 1 - y),
        5 => (y, x),
        6 => (y, height - 1 - x),
        7 => (width - 1 - y, height - 1 - x),
        _ => (width - 1 - y, x),
    };
    if !(2..=8).contains(&orientation) {
        return;
    }
    let mut turned = Vec::with_capacity(picture.rgb.len());
    for y in 0..down {
        for x in 0..across {
            let (x, y) = source(x, y);
            let at = 3 * (y * width + x);
            turned.extend_from_slice(&picture.rgb[at..at + 3]);
        }
    }
    *picture = Picture { width: across, height: down, rgb: turned };
}

/// Makes a picture with more than [`MAX_MEASURED`] pixels smaller: each pixel is the mean of a
/// square.
pub fn reduce(picture: &mut Picture) {
    reduce_from(picture, false, false);
}

/// The same. Columns that are left over are those on the right, or on the `left`; rows those at the
/// bottom, or at the `top`.
fn reduce_from(picture: &mut Picture, left: bool, top: bool) {
    let (width, height) = (picture.width, picture.height);
    let fits = |factor: &usize| (width / factor) * (height / factor) <= MAX_MEASURED;
    let factor = (1..).find(fits).unwrap_or(1);
    if factor == 1 {
        return;
    }
    let (across, down) = (width / factor, height / factor);
    let count = (factor * factor) as u32;
    let first_column = if left { width % factor } else { 0 };
    let first_row = if top { height % factor } else { 0 };
    // In place: a pixel is never written in front of those that are read for it.
    for y in 0..down {
        for x in 0..across {
            let mut sum = [count / 2; 3];
            for row in 0..factor {
                let at = 3 * ((first_row + y * factor + row) * width + first_column + x * factor);
                for pixel in picture.rgb[at..at + 3 * factor].chunks_exact(3) {
                    (0..3).for_each(|channel| sum[channel] += u32::from(pixel[channel]));
                }
            }
            let at = 3 * (y * across + x);
            (0..3).for_each(|channel| picture.rgb[at + channel] = (sum[channel] / count) as u8);
        }
    }
    picture.rgb.truncate(3 * across * down);
    picture.rgb.shrink_to_fit();
    (picture.width, picture.height) = (across, down);
}

#[cfg(test)]
mod tests;
