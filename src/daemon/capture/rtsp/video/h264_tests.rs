use super::super::super::Unit;
use super::super::super::h264::Assembler;
use super::super::super::rtp::Packet;
use super::*;
use sha2::{Digest, Sha256};

/// The pictures of a recorded stream, with whether each is a key picture.
fn pictures(name: &str) -> Vec<(bool, Vec<u8>)> {
    let stream = std::fs::read(format!("tests/data/video/{name}.h264")).expect("it ships");
    let mut starts: Vec<_> =
        (0..stream.len() - 3).filter(|&at| stream[at..at + 3] == [0, 0, 1]).collect();
    starts.push(stream.len());
    let (mut assembler, mut unit, mut given) = (Assembler::default(), Unit::default(), Vec::new());
    let mut timestamp = 0;
    for (sequence, pair) in (0..).zip(starts.windows(2)) {
        let mut payload = &stream[pair[0] + 3..pair[1]];
        while let [head @ .., 0] = payload {
            payload = head;
        }
        // A picture begins with its first macroblock: the bit behind the unit's header is 1.
        let begins = !matches!(payload[0] & 31, 1 | 5) || payload[1] & 0x80 != 0;
        timestamp += u32::from(begins && matches!(payload[0] & 31, 1 | 5));
        let timestamp = if matches!(payload[0] & 31, 1 | 5) { timestamp } else { timestamp + 1 };
        let packet = Packet { marker: false, sequence, timestamp, payload };
        if assembler.push(&packet, &mut unit) {
            given.push((unit.key, unit.bytes.clone()));
        }
    }
    let end = Packet {
        marker: false,
        sequence: starts.len() as u16 - 1,
        timestamp: u32::MAX,
        payload: &[9],
    };
    if assembler.push(&end, &mut unit) {
        given.push((unit.key, unit.bytes.clone()));
    }
    given
}

fn digest(frame: &Frame) -> String {
    let digest = Sha256::digest([frame.y.as_slice(), &frame.u, &frame.v].concat());
    digest[..8].iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The same streams decoded by ffmpeg 9.0: SHA-256 of the planes of each picture.
const STREAMS: [(&str, [&str; 4]); 5] = [
    ("baseline", ["79ec22b19ca0095f", "f874ea312b5cd363", "e490ccb56fc6aa3c", "68ae1a5f874d6c2a"]),
    ("main", ["f543085d7974af23", "ccb99098127f7af8", "b8012b4b63e40bc7", "24ba6c262b7f6ff9"]),
    ("high", ["b3b5f8b8d0c889d3", "4e6033265c5dac58", "716d1ba159b357c0", "e52cf7269400b930"]),
    ("mbaff", ["422eacb7a81f774b", "5b7e4bc2f839e9b6", "f79a6c58cc25bf05", "43d4661793e940d8"]),
    ("full", ["25de2eb89984d395", "5d98bfdaaee0f1fa", "8aa0339ed7268068", "e81fe3942cabd101"]),
];

#[test]
fn every_profile_decodes_to_what_ffmpeg_gives() {
    for (name, expected) in STREAMS {
        let pictures = pictures(name);
        assert_eq!(
            pictures.iter().map(|(key, _)| *key).collect::<Vec<_>>(),
            [true, false, true, false]
        );
        let mut decoder = Decoder::default();
        for ((key, bytes), expected) in pictures.iter().zip(expected) {
            let frame = decoder.decode_units(bytes, None).expect(name);
            assert_eq!(digest(&frame), expected, "{name}, one after the other");
            let alone = Decoder::default().decode_units(bytes, None);
            assert_eq!(alone.is_ok_and(|frame| digest(&frame) == expected), *key, "{name}, alone");
        }
    }
}

/// Cut off: no picture is given, of no stream. With bytes taken out none is given with CABAC; of
/// CAVLC (baseline) some hundredth is valid syntax for another picture that ends at the same bit, and
/// nothing in the stream could tell: the codes have no redundancy, and a decoder that went astray
/// finds its way back. Flipped bits likewise. The network does neither without a gap that is noticed
/// before the decoder.
#[test]
fn a_damaged_picture_is_never_given() {
    let mut rng = fastrand::Rng::with_seed(9);
    for (name, expected) in STREAMS {
        let (_, whole) = &pictures(name)[0];
        let header = 80.min(whole.len() / 3);
        let (mut silent, mut flips) = (0, 0);
        let mut cut = 0;
        for trial in 0..600 {
            let mut bytes = whole.clone();
            let at = rng.usize(header..bytes.len() - 60);
            let is_flip = trial % 3 == 2;
            match trial % 3 {
                0 => bytes.truncate(at),
                1 => drop(bytes.drain(at..at + rng.usize(1..60))),
                _ => bytes[at] ^= 1 << rng.u8(..8),
            }
            let decoded = Decoder::default().decode_units(&bytes, None);
            let is_wrong = decoded.is_ok_and(|frame| digest(&frame) != expected[0]);
            cut += usize::from(is_wrong && trial % 3 == 0);
            silent += usize::from(is_wrong && trial % 3 == 1);
            flips += usize::from(is_wrong && is_flip);
        }
        assert_eq!(cut, 0, "{name}: of 200 that were cut off");
        assert!(
            silent == 0 || name == "baseline" && silent <= 6,
            "{name}: {silent} of 200 with bytes missing"
        );
        assert!(flips <= 6 || name == "baseline", "{name}: {flips} of 200 flips");
    }
}

#[test]
fn sizes_are_compared_before_anything_is_decoded() {
    let (_, whole) = &pictures("high")[0];
    let mut picture = Picture::default();
    let shape = Some(Shape { width: 160, height: 90 });
    let error = Decoder::default().decode(whole, shape, &mut picture).expect_err("another shape");
    assert!(matches!(error, DecodeError::Shape { width: 160, height: 120, .. }), "{error}");
    Decoder::default()
        .decode(whole, Some(Shape { width: 320, height: 240 }), &mut picture)
        .expect("its shape");
    assert_eq!((picture.width, picture.height), (160, 120));
    // 16384x16384 in a sequence set of baseline: refused by its header.
    let huge = [0, 0, 0, 1, 0x67, 66, 0, 51, 0xf8, 0x20, 0x00, 0x40, 0x00, 0x20, 0x00, 0x88];
    assert!(Decoder::default().decode(&huge, None, &mut picture).is_err());
}

#[test]
fn pictures_that_others_build_on_count_as_memory() {
    let unit = |reference_frames| SpsInfo {
        width: 3840,
        height: 2160,
        coded_width: 3840,
        coded_height: 2160,
        chroma_format: 1,
        reference_frames,
        ..info_of("high")
    };
    let allowed =
        |decoder: Decoder, references| decoder.sequence(&unit(references)).check(None).is_ok();
    assert!(allowed(Decoder::new(true), 2) && allowed(Decoder::default(), 16));
    // 16 pictures of 12 MB: a stream of a few kilobytes would fill the box.
    assert!(!allowed(Decoder::new(true), 16));
}

/// A stream's own sequence set.
fn info_of(name: &str) -> SpsInfo {
    let (_, picture) = &pictures(name)[0];
    let units = parse_annex_b(picture);
    let set = units.iter().find(|unit| unit.nal_unit_type == NalUnitType::Sps);
    parse_sps_info(set.expect("in front")).expect("right")
}

#[test]
fn colours_are_those_of_the_stream() {
    let mean = |name: &str| {
        let mut picture = Picture::default();
        Decoder::default().decode(&pictures(name)[0].1, None, &mut picture).expect(name);
        picture.rgb.iter().map(|&level| f64::from(level)).sum::<f64>() / picture.rgb.len() as f64
    };
    // The same scene, in both ranges.
    assert!((mean("high") - mean("full")).abs() < 1.5, "{} {}", mean("high"), mean("full"));
}

#[test]
fn a_stream_describes_itself() {
    let stream = std::fs::read("tests/data/video/mbaff.h264").expect("it ships");
    let at = stream.windows(4).position(|w| w[..3] == [0, 0, 1] && w[3] & 31 == 7).expect("a set");
    let described = describe(&stream[at + 3..at + 40]).expect("a description");
    assert_eq!((described.size, described.profile.as_str()), ((160, 120), "high, interlaced"));
    assert_eq!(describe(&[0x67]), None);
}
