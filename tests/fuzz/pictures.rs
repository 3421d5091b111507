//! Pictures: what the decoder of capture makes of them.

use super::runner::Target;
use super::{CRC, common, magnitude, outcome};
use fastrand::Rng;
use std::fs;
use verge::daemon::capture::{DecodeError, decode};
use verge::daemon::frame::Picture;

/// Words of JPEG and PNG.
pub const WORDS: &[&[u8]] = &[
    b"\xff\xd8",
    b"\xff\xd9",
    b"\xff\xda",
    b"\xff\xdb",
    b"\xff\xc0",
    b"\xff\xc1",
    b"\xff\xc2",
    b"\x08\x08\x70\x0f\x00",
    b"\xff\xc4",
    b"\xff\xc9",
    b"\xff\xdd\0\x04\0\x01",
    b"\xff\xd0",
    b"\xff\xe0",
    b"\xff\xee\0\x0eAdobe",
    b"\xff\0",
    b"IHDR",
    b"IDAT",
    b"IEND",
    b"PLTE",
    b"iCCP",
    b"zTXt",
    b"iTXt",
    b"eXIf",
    b"Exif\0\0MM\0*",
    b"\xff\xe1",
    b"\xff\xc4",
    b"tRNS",
    b"acTL",
];

/// The pictures that the repository has for this, and made ones.
pub fn pictures_to_begin_with() -> Vec<Vec<u8>> {
    let mut pictures = vec![common::jpeg(8, 8, 10), common::jpeg(33, 17, 200)];
    let mut png = Vec::new();
    let grey = image::GrayImage::from_fn(9, 7, |x, y| image::Luma([(x * y) as u8]));
    image::DynamicImage::from(grey)
        .write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png)
        .expect("encoding to memory");
    pictures.push(png);
    let mut files: Vec<_> = fs::read_dir("tests/data/fuzz")
        .expect("it ships")
        .map(|entry| entry.expect("an entry").path())
        .collect();
    files.sort();
    pictures.extend(files.iter().map(|file| fs::read(file).expect("a picture")));
    pictures
}

#[test]
fn pictures() {
    let mut picture = Picture::default();
    let target = Target {
        name: "pictures",
        executions: 3_000,
        corpus: pictures_to_begin_with(),
        tokens: WORDS,
        longest: 1 << 16,
    };
    target.run(|rng, input| {
        if input.starts_with(b"\x89PNG") {
            mend_chunks(rng, input);
        } else if !input.ends_with(b"\xff\xd9") && rng.u8(..4) > 0 {
            input.extend_from_slice(b"\xff\xd9");
        }
        let result = decode(input, &mut picture);
        assert!(!matches!(result, Err(DecodeError::Decoder)), "the decoder panics");
        if result.is_ok() {
            assert_eq!(picture.rgb.len(), picture.width * picture.height * 3);
        }
        // Its buffer is not an input's own memory.
        let picture = std::mem::take(&mut picture);
        outcome(result, |()| magnitude(picture.rgb.len()))
    });
}

/// Pictures that claim the largest size there may be: what one costs at most.
#[test]
fn large_pictures() {
    let claims_4k = |mut jpeg: Vec<u8>| {
        let frame =
            jpeg.windows(2).position(|pair| pair[0] == 0xff && (0xc0..=0xc2).contains(&pair[1]));
        let size = frame.expect("a start of frame") + 5;
        jpeg[size..size + 4].copy_from_slice(&[0x08, 0x70, 0x0f, 0x00]);
        jpeg
    };
    let progressive = fs::read("tests/data/fuzz/progressive.jpg").expect("it ships");
    let target = Target {
        name: "large_pictures",
        executions: 8,
        corpus: vec![claims_4k(progressive), claims_4k(common::jpeg(33, 17, 200))],
        tokens: &[b"\xff\xda", b"\xff\xd9"],
        longest: 1 << 16,
    };
    target.run(|_, input| {
        input.extend_from_slice(b"\xff\xd9");
        let mut picture = Picture::default();
        let result = decode(input, &mut picture);
        assert!(!matches!(result, Err(DecodeError::Decoder)), "the decoder panics");
        outcome(result, |()| magnitude(picture.rgb.len()))
    });
}

/// Makes the checksums of a PNG's chunks right, nine times in ten.
pub fn mend_chunks(rng: &mut Rng, png: &mut [u8]) {
    if rng.u8(..10) == 0 {
        return;
    }
    let mut at = 8;
    while let Some(len) = png.get(at..at + 4) {
        let len = u32::from_be_bytes([len[0], len[1], len[2], len[3]]) as usize;
        let Some(end) = at.checked_add(8).and_then(|begin| begin.checked_add(len)) else { return };
        let Some(chunk) = png.get(at + 4..end) else { return };
        let sum = CRC.checksum(chunk).to_be_bytes();
        let Some(stored) = png.get_mut(end..end + 4) else { return };
        stored.copy_from_slice(&sum);
        at = end + 4;
    }
}
