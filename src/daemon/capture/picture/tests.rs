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
    assert!(matches!(error, DecodeError::TooLarge { width: 20_000, height: 20_000 }), "{error}");
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
    assert!(error.to_string().contains("HTML page"), "{error}");
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

fn chunk(kind: &[u8], body: &[u8]) -> Vec<u8> {
    let mut bytes = (body.len() as u32).to_be_bytes().to_vec();
    bytes.extend_from_slice(kind);
    bytes.extend_from_slice(body);
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&bytes[4..]);
    bytes.extend_from_slice(&crc.to_be_bytes());
    bytes
}

/// Chunks beside the pixels that unpack to a thousand times their size stay packed.
#[test]
fn nothing_beside_the_pixels_is_unpacked() {
    use std::io::Write;
    let mut plain = Vec::new();
    let grey = image::GrayImage::from_fn(9, 7, |x, y| image::Luma([(x * y) as u8]));
    image::DynamicImage::from(grey)
        .write_to(&mut std::io::Cursor::new(&mut plain), image::ImageFormat::Png)
        .expect("encoding to memory");
    let mut packed = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    for _ in 0..200 {
        packed.write_all(&[0; 1 << 20]).expect("memory");
    }
    let packed = packed.finish().expect("memory");
    for (kind, head) in [
        (b"iCCP", &b"profile\0\0"[..]),
        (b"zTXt", b"Comment\0\0"),
        (b"iTXt", b"Comment\0\x01\0\0\0"),
    ] {
        let bomb = chunk(kind, &[head, &packed].concat());
        let png = [&plain[..33], &bomb, &plain[33..]].concat();
        let begun = resident();
        let mut picture = Picture::default();
        decode(&png, &mut picture).expect("the pixels are right");
        assert_eq!((picture.width, picture.height), (9, 7));
        assert!(resident() < begun + (60 << 20), "{kind:?}");
    }
}

/// The most memory that this program has held, bytes.
fn resident() -> usize {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM")).unwrap_or("x 0");
    line.split_whitespace().nth(1).and_then(|kb| kb.parse::<usize>().ok()).unwrap_or(0) << 10
}

#[test]
fn large_pictures_are_made_smaller_and_upright_ones_read() {
    let mut picture = Picture::default();
    decode(&jpeg(2160, 3840), &mut picture).expect("as many pixels as are measured");
    assert_eq!((picture.width, picture.height), (2160, 3840));
    decode(&jpeg(4056, 3040), &mut picture).expect("12 megapixels");
    assert_eq!((picture.width, picture.height, picture.rgb.len()), (2028, 1520, 2028 * 1520 * 3));
    let error = decode(&jpeg(5000, 4000), &mut picture).expect_err("20 megapixels").to_string();
    assert!(error.contains("substream"), "{error}");
}

#[test]
fn turned_pictures_are_made_smaller_as_upright_ones_are() {
    // Sizes that leave columns and rows over; both orders, pixel by pixel.
    let rgb: Vec<u8> = (0..3841 * 2163 * 3).map(|n: usize| ((n * 7919) >> 5) as u8).collect();
    for orientation in 1..=8 {
        let mut first = Picture { width: 3841, height: 2163, rgb: rgb.clone() };
        let mut second = Picture { width: 3841, height: 2163, rgb: rgb.clone() };
        turn(&mut first, orientation);
        reduce(&mut first);
        finish(&mut second, orientation);
        assert_eq!((first.width, first.height), (second.width, second.height));
        assert!(first.rgb == second.rgb, "orientation {orientation}");
    }
}

/// A smooth picture with edges in it, as roads have.
fn scene(width: u32, height: u32) -> image::RgbImage {
    image::RgbImage::from_fn(width, height, |x, y| {
        let edge = if (x / 97 + y / 61) % 3 == 0 { 70 } else { 0 };
        image::Rgb([(x / 24) as u8 % 180 + edge, (y / 18) as u8 % 180 + edge, 90 + edge])
    })
}

/// Half the size while it is decoded gives what half the size afterwards gives, but for rounding, upright
/// and turned, coloured and grey.
#[test]
fn decoded_at_half_its_size_a_picture_is_what_its_half_is() {
    let (width, height) = (4056, 3040);
    assert!(half::suits(width, height) && !half::suits(3840, 2160) && !half::suits(4057, 3040));
    let whole = scene(width, height);
    for is_grey in [false, true] {
        let mut bytes = Vec::new();
        let mut encoder = JpegEncoder::new_with_quality(&mut bytes, 90);
        let mut reference = if is_grey {
            let grey = image::DynamicImage::from(whole.clone()).to_luma8();
            encoder.encode_image(&grey).expect("encoding to memory");
            let rgb = grey.into_raw().iter().flat_map(|&level| [level; 3]).collect();
            Picture { width: width as usize, height: height as usize, rgb }
        } else {
            encoder.encode_image(&whole).expect("encoding to memory");
            let rgb = whole.clone().into_raw();
            Picture { width: width as usize, height: height as usize, rgb }
        };
        reduce(&mut reference);
        let mut picture = Picture::default();
        decode(&bytes, &mut picture).expect("12 megapixels");
        assert_eq!((picture.width, picture.height), (reference.width, reference.height));
        let difference: u64 =
            picture.rgb.iter().zip(&reference.rgb).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
        let mean = difference as f64 / picture.rgb.len() as f64;
        assert!(mean < 1.5, "grey {is_grey}: {mean} levels");
        // A shift by a pixel would show at the edges.
        let shifted: u64 = picture.rgb[3..]
            .iter()
            .zip(&reference.rgb)
            .map(|(a, b)| u64::from(a.abs_diff(*b)))
            .sum();
        assert!(shifted as f64 / picture.rgb.len() as f64 > 1.3 * mean, "grey {is_grey}: {mean}");
    }
}

#[test]
fn another_shape_is_refused_by_its_header() {
    let shape = Some(Shape { width: 64, height: 48 });
    let mut picture = Picture::default();
    decode_shaped(&jpeg(32, 24), shape, &mut picture).expect("the same shape, scaled");
    let mut wide = jpeg(64, 36);
    // Nothing behind the header: it is not decoded.
    wide.truncate(wide.len() / 2);
    let error = decode_shaped(&wide, shape, &mut picture).expect_err("another shape").to_string();
    assert!(error.contains("64x36") && error.contains("64x48"), "{error}");
}

#[test]
fn pngs_of_every_kind_are_read() {
    let level = |x: u32, y: u32| (x * 20 + y) as u8;
    let rgba = image::RgbaImage::from_fn(9, 7, |x, y| image::Rgba([level(x, y), 7, 9, 255]));
    let deep = image::ImageBuffer::from_fn(9, 7, |x, y| {
        image::Rgb([u16::from(level(x, y)) << 8, 7 << 8, 9 << 8])
    });
    for image in [
        image::DynamicImage::from(rgba.clone()),
        image::DynamicImage::from(image::DynamicImage::from(rgba).to_rgb8()),
        image::DynamicImage::ImageRgb16(deep),
    ] {
        let mut bytes = Vec::new();
        let mut out = std::io::Cursor::new(&mut bytes);
        image.write_to(&mut out, image::ImageFormat::Png).expect("encoding to memory");
        let mut picture = Picture::default();
        decode(&bytes, &mut picture).expect("right");
        assert_eq!(picture.rgb[3 * (2 * 9 + 5)..][..3], [level(5, 2), 7, 9]);
        for len in 0..bytes.len() {
            assert!(decode(&bytes[..len], &mut picture).is_err(), "{len} of {} bytes", bytes.len());
        }
    }
}
