use super::*;
use crate::daemon::capture::decode;
use crate::daemon::frame::Picture;
use image::codecs::jpeg::JpegEncoder;

/// A JPEG with standard tables, cut into its tables and its coded data.
fn parts() -> (Vec<u8>, Vec<u8>, Vec<u8>) {
    let mut jpeg = Vec::new();
    let pixels: Vec<u8> = (0..64 * 48 * 3).map(|i: u32| (i * 7 % 251) as u8).collect();
    // Its encoder writes 4:4:4; the format has 4:2:0 and 4:2:2 alone: of a grey picture it is the
    // same in the end, so that the pixels are compared in luma.
    JpegEncoder::new_with_quality(&mut jpeg, 70)
        .encode(&pixels, 64, 48, image::ExtendedColorType::Rgb8)
        .expect("encoding to memory");
    let (mut tables, mut at) = (Vec::new(), 2);
    while jpeg[at + 1] != 0xda {
        let length = usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
        if jpeg[at + 1] == 0xdb {
            jpeg[at + 4..at + 2 + length]
                .chunks_exact(65)
                .for_each(|table| tables.extend(&table[1..]));
        }
        at += 2 + length;
    }
    let coded = at + 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
    (jpeg.clone(), tables, jpeg[coded..jpeg.len() - 2].to_vec())
}

/// A scan of 4:2:2 blocks that are all flat: each of the four blocks is "no difference, end".
fn flat(columns: usize, rows: usize) -> Vec<u8> {
    let macroblocks = columns / 16 * (rows / 8);
    // Luma: 00 1010, twice; chroma: 00 00, twice.
    let bits = "001010001010".to_owned() + "0000" + "0000";
    let mut all = bits.repeat(macroblocks);
    while !all.len().is_multiple_of(8) {
        all.push('1');
    }
    all.as_bytes()
        .chunks(8)
        .map(|byte| byte.iter().fold(0, |value, bit| value << 1 | (bit - b'0')))
        .collect()
}

fn packet(offset: usize, quality: u8, tables: &[u8], data: &[u8]) -> Vec<u8> {
    let o = (offset as u32).to_be_bytes();
    let mut bytes = vec![0, o[1], o[2], o[3], 0, quality, 8, 6];
    if quality >= 128 && offset == 0 {
        bytes.extend([0, 0, 0, tables.len() as u8]);
        bytes.extend(tables);
    }
    bytes.extend(data);
    bytes
}

fn push(assembler: &mut Assembler, sequence: u16, marker: bool, payload: &[u8]) -> Option<Unit> {
    let mut unit = Unit::default();
    let packet = Packet { marker, sequence, timestamp: u32::from(sequence / 10), payload };
    assembler.push(&packet, &mut unit).then_some(unit)
}

#[test]
fn a_picture_is_put_together_and_decodes() {
    let data = flat(64, 48);
    let (_, tables, _) = parts();
    assert_eq!(tables.len(), 128);
    for quality in [50, 200] {
        let mut assembler = Assembler::default();
        assert!(
            push(&mut assembler, 0, false, &packet(0, quality, &tables, &data[..20])).is_none()
        );
        let unit = push(&mut assembler, 1, true, &packet(20, quality, &tables, &data[20..]))
            .expect("whole");
        let mut picture = Picture::default();
        decode(&unit.bytes, &mut picture).expect("a whole picture");
        assert_eq!((picture.width, picture.height, picture.rgb[0]), (64, 48, 128));
    }
}

#[test]
fn the_tables_of_a_quality_are_the_standard_s() {
    let luma: Vec<u8> = scaled(50).expect("tables");
    assert!(luma[..64] == LUMA && luma[64..] == CHROMA);
    let best = scaled(99).expect("tables");
    assert!(best.iter().all(|&value| (1..=3).contains(&value)));
    assert_eq!(scaled(0), None);
}

#[test]
fn a_picture_with_a_part_missing_is_not_given() {
    let data = flat(64, 48);
    let mut assembler = Assembler::default();
    push(&mut assembler, 0, false, &packet(0, 50, &[], &data[..10]));
    assert!(push(&mut assembler, 2, true, &packet(20, 50, &[], &data[20..])).is_none());
    assert_eq!((assembler.lost, assembler.refused), (1, 1));
    // The next is whole again.
    assert!(push(&mut assembler, 10, true, &packet(0, 50, &[], &data)).is_some());
    // Without its beginning, and rubbish.
    assert!(push(&mut assembler, 20, true, &packet(10, 50, &[], &data)).is_none());
    assert!(push(&mut assembler, 30, true, &[1, 2, 3]).is_none());
    assert!(push(&mut assembler, 40, true, &[]).is_none());
}
