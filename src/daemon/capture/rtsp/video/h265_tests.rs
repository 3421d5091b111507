use super::super::super::Unit;
use super::super::super::assembler::{Class, Syntax, split};
use super::super::super::h265::{Assembler, H265};
use super::super::super::rtp::Packet;
use super::*;
use sha2::{Digest, Sha256};

/// The pictures of the recorded stream, with whether each stands by itself.
fn pictures() -> Vec<(bool, Vec<u8>)> {
    let stream = std::fs::read("tests/data/video/main.h265").expect("it ships");
    let (mut assembler, mut unit, mut given) = (Assembler::default(), Unit::default(), Vec::new());
    let mut timestamp = 0;
    let units = split(&stream).filter(|unit| unit.len() > 2);
    for (sequence, payload) in (0..).zip(units) {
        let marker = H265::class(payload[0] >> 1 & 63) == Class::Slice;
        let packet = Packet { marker, sequence, timestamp, payload };
        timestamp += u32::from(marker);
        if assembler.push(&packet, &mut unit) {
            given.push((unit.key, unit.bytes.clone()));
        }
    }
    given
}

fn digest(frame: &Frame) -> String {
    let [luma, blue, red] = &frame.picture.planes;
    let all = [luma, blue, red].map(|plane| cropped(plane, 0, 0, plane.width, plane.height));
    let digest = Sha256::digest(all.concat());
    digest[..8].iter().map(|byte| format!("{byte:02x}")).collect()
}

/// What FFmpeg 8.1.2 decodes of the same stream: SHA-256 of the planes of each picture.
const EXPECTED: [&str; 4] =
    ["b1d028c26422b4a9", "9c607316d088c52b", "faba9112a9e6ca85", "91ca8bdf74d0e8f9"];

#[test]
fn it_decodes_to_what_ffmpeg_gives() {
    let mut decoder = Decoder::new(true);
    for ((key, bytes), expected) in pictures().iter().zip(EXPECTED) {
        let frame = decoder.decode_units(bytes, None).expect("a picture");
        assert_eq!(digest(&frame), expected, "one after the other");
        let alone = Decoder::new(false).decode_units(bytes, None);
        assert_eq!(alone.is_ok_and(|frame| digest(&frame) == expected), *key, "alone");
    }
}

/// Cut off, or with bytes taken out: no picture is given. Of flipped bits some hundredth leaves a
/// stream that ends at the right bit; the network flips none without a word.
#[test]
fn a_damaged_picture_is_never_given() {
    let mut rng = fastrand::Rng::with_seed(9);
    let (_, whole) = &pictures()[0];
    let mut wrong = [0; 3];
    for trial in 0..1500 {
        let mut bytes = whole.clone();
        let at = rng.usize(bytes.len() / 3..bytes.len() - 60);
        match trial % 3 {
            0 => bytes.truncate(at),
            1 => drop(bytes.drain(at..at + rng.usize(1..60))),
            _ => bytes[at] ^= 1 << rng.u8(..8),
        }
        let decoded = Decoder::new(false).decode_units(&bytes, None);
        wrong[trial % 3] += u32::from(decoded.is_ok_and(|frame| digest(&frame) != EXPECTED[0]));
    }
    let [cut, short, flips] = wrong;
    assert_eq!((cut, short), (0, 0), "of 500 each");
    assert!(flips <= 15, "{flips} of 500 flips");
}

#[test]
fn sizes_are_compared_before_anything_is_decoded() {
    let (_, whole) = &pictures()[0];
    let mut picture = Picture::default();
    let shape = Some(Shape { width: 160, height: 90 });
    let error = Decoder::new(false).decode(whole, shape, &mut picture).expect_err("another shape");
    assert!(matches!(error, DecodeError::Shape { width: 160, height: 120, .. }), "{error}");
    let shape = Some(Shape { width: 320, height: 240 });
    Decoder::new(false).decode(whole, shape, &mut picture).expect("its shape");
    assert_eq!((picture.width, picture.height), (160, 120));
}

#[test]
fn pictures_that_others_build_on_count_as_memory() {
    let set = |change: fn(&mut Sps)| {
        let mut set = Sps { width: 3840, height: 2160, ..set_of_stream() };
        change(&mut set);
        set
    };
    let many =
        |set: &mut Sps| set.ordering.iter_mut().for_each(|o| o.max_dec_pic_buffering_minus1 = 15);
    let allowed = |keeps, set: &Sps| {
        Decoder::new(keeps).sequence(set).is_ok_and(|sequence| sequence.check(None).is_ok())
    };
    assert!(allowed(false, &set(many)) && !allowed(true, &set(many)));
    let mut reordered = set_of_stream();
    let at = usize::from(reordered.max_sub_layers_minus1);
    reordered.ordering[at].max_num_reorder_pics = 2;
    assert!(allowed(false, &reordered) && !allowed(true, &reordered));
}

fn set_of_stream() -> Sps {
    let (_, picture) = &pictures()[0];
    let set =
        split(picture).find(|unit| unit.first().is_some_and(|head| head >> 1 & 63 == SEQUENCE_SET));
    parse_sps(&unescape(&set.expect("in front")[2..]).data).expect("right")
}

#[test]
fn a_stream_describes_itself() {
    let (_, picture) = &pictures()[0];
    let set =
        split(picture).find(|unit| unit.first().is_some_and(|head| head >> 1 & 63 == SEQUENCE_SET));
    let described = describe(set.expect("a set")).expect("a description");
    assert_eq!((described.size, described.profile.as_str()), ((160, 120), "main"));
    assert_eq!(describe(&[0x42]), None);
}
