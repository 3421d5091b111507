use super::super::decode;
use super::*;
use crate::daemon::frame::Picture;
use image::codecs::jpeg::JpegEncoder;

/// A picture with something in each part of it.
fn jpeg(width: u32, height: u32) -> Vec<u8> {
    let mut rng = fastrand::Rng::with_seed(u64::from(width));
    let pixels: Vec<u8> = (0..width * height * 3)
        .map(|i| ((i / 3 % width) * 200 / width) as u8 + rng.u8(..40))
        .collect();
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, 80)
        .encode(&pixels, width, height, image::ExtendedColorType::Rgb8)
        .expect("encoding to memory");
    bytes
}

fn coded(jpeg: &[u8]) -> usize {
    let at = jpeg.windows(2).position(|pair| pair == [0xff, 0xda]).expect("a scan");
    at + 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]))
}

fn said(bytes: &[u8]) -> String {
    decode(bytes, &mut Picture::default()).expect_err("damaged").to_string()
}

#[test]
fn a_picture_with_a_part_missing_is_damaged_though_it_has_its_end() {
    let whole = jpeg(160, 120);
    decode(&whole, &mut Picture::default()).expect("a whole picture");
    let (from, to) = (coded(&whole), whole.len() - 2);
    let at = |share: f64| from + ((to - from) as f64 * share) as usize;
    let end = &[0xff, 0xd9][..];
    for (what, bytes) in [
        ("half, closed", [&whole[..at(0.5)], end].concat()),
        ("the last row, closed", [&whole[..at(0.97)], end].concat()),
        ("a hole", [&whole[..at(0.4)], &whole[at(0.6)..]].concat()),
        ("a packet's hole", [&whole[..at(0.4)], &whole[at(0.4) + 60..]].concat()),
        ("zeros", [&whole[..at(0.5)], &vec![0; to - at(0.5)], end].concat()),
        ("twice", [&whole[..at(0.6)], &whole[at(0.4)..]].concat()),
        ("another picture's end", [&whole[..at(0.5)], &jpeg(168, 120)[at(0.5)..]].concat()),
    ] {
        assert!(said(&bytes).contains("damaged"), "{what}: {}", said(&bytes));
    }
}

#[test]
fn fill_bytes_may_stand_in_front_of_any_marker() {
    let whole = jpeg(160, 120);
    let (before, end) = whole.split_at(whole.len() - 2);
    for fill in [1, 2, 5] {
        let bytes = [before, &vec![0xff; fill], end].concat();
        decode(&bytes, &mut Picture::default()).unwrap_or_else(|error| panic!("{fill}: {error}"));
    }
}

#[test]
fn a_hole_in_the_coded_data_is_noticed() {
    let whole = jpeg(160, 120);
    let (from, to) = (coded(&whole), whole.len() - 2);
    let mut rng = fastrand::Rng::with_seed(3);
    let mut passed = 0;
    for _ in 0..500 {
        let mut bytes = whole.clone();
        let hole = rng.usize(20..200);
        let at = rng.usize(from..to - hole);
        bytes.drain(at..at + hole);
        passed += usize::from(decode(&bytes, &mut Picture::default()).is_ok());
    }
    // Their remaining data decodes to exactly as many blocks, by chance.
    assert!(passed <= 5, "{passed} of 500 pictures with a hole pass");
}

/// The end mark of a thumbnail is not the picture's.
#[test]
fn a_thumbnail_ends_no_picture() {
    let (whole, thumbnail) = (jpeg(64, 48), jpeg(16, 12));
    let mut segment = vec![0xff, 0xe1];
    segment.extend(((thumbnail.len() + 8) as u16).to_be_bytes());
    segment.extend(b"Exif\0\0");
    segment.extend(&thumbnail);
    let with = [&whole[..2], &segment, &whole[2..]].concat();
    decode(&with, &mut Picture::default()).expect("whole");
    assert!(said(&with[..with.len() * 3 / 4]).contains("cut off"));
}

#[test]
fn tables_that_are_missing_are_the_standard_s() {
    let whole = jpeg(64, 48);
    let (mut bare, mut at) = (whole[..2].to_vec(), 2);
    while whole[at + 1] != 0xda {
        let length = 2 + usize::from(u16::from_be_bytes([whole[at + 2], whole[at + 3]]));
        if whole[at + 1] != 0xc4 {
            bare.extend(&whole[at..at + length]);
        }
        at += length;
    }
    bare.extend(&whole[at..]);
    assert!(bare.len() < whole.len());
    let (mut expected, mut picture) = (Picture::default(), Picture::default());
    decode(&whole, &mut expected).expect("whole");
    decode(&bare, &mut picture).expect("with the standard's tables");
    assert!(expected.rgb == picture.rgb);
}

#[test]
fn a_picture_stands_as_a_viewer_shows_it() {
    let mut upright = Picture::default();
    let whole = jpeg(16, 8);
    decode(&whole, &mut upright).expect("whole");
    let corner = |picture: &Picture, right: bool, low: bool| {
        let (x, y) =
            (if right { picture.width - 1 } else { 0 }, if low { picture.height - 1 } else { 0 });
        let at = 3 * (y * picture.width + x);
        picture.rgb[at..at + 3].to_vec()
    };
    // Where the stored picture's upper left corner goes (Exif 2.32, orientation 1 to 8).
    for (orientation, right, low) in [
        (1, false, false),
        (2, true, false),
        (3, true, true),
        (4, false, true),
        (5, false, false),
        (6, true, false),
        (7, true, true),
        (8, false, true),
    ] {
        let mut tiff = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".to_vec();
        tiff.extend([orientation, 0, 0, 0, 0, 0, 0]);
        let mut segment = vec![0xff, 0xe1];
        segment.extend(((tiff.len() + 2) as u16).to_be_bytes());
        let turned = [&whole[..2], &segment, &tiff, &whole[2..]].concat();
        assert_eq!(header(&turned).expect("a header").orientation, orientation);
        let mut picture = Picture::default();
        decode(&turned, &mut picture).expect("whole");
        let size = if orientation > 4 { (8, 16) } else { (16, 8) };
        assert_eq!((picture.width, picture.height), size, "{orientation}");
        assert_eq!(corner(&picture, right, low), corner(&upright, false, false), "{orientation}");
        let opposite = corner(&picture, !right, !low);
        assert_eq!(opposite, corner(&upright, true, true), "{orientation}");
    }
}

#[test]
fn progressive_pictures_are_checked_as_well() {
    let whole = std::fs::read("tests/data/fuzz/progressive.jpg").expect("it ships");
    verify(&whole).expect("whole");
    let from = coded(&whole);
    for share in 1..20 {
        let at = from + (whole.len() - 2 - from) * share / 20;
        let cut = [&whole[..at], &[0xff, 0xd9]].concat();
        assert!(verify(&cut).is_err(), "cut after {share} twentieths");
    }
}

#[test]
fn rubbish_never_panics() {
    let mut rng = fastrand::Rng::with_seed(11);
    let pictures =
        [jpeg(40, 24), std::fs::read("tests/data/fuzz/progressive.jpg").expect("it ships")];
    for _ in 0..3000 {
        let mut bytes = pictures[rng.usize(..2)].clone();
        for _ in 0..rng.usize(1..4) {
            let at = rng.usize(..bytes.len());
            bytes[at] = rng.u8(..);
        }
        let _ = verify(&bytes);
        let _ = header(&bytes);
    }
}
