use super::super::Unit;
use super::super::assembler::split;
use super::super::rtp::Packet;
use super::*;

/// Units without start codes.
fn units() -> Vec<Vec<u8>> {
    let stream = std::fs::read("tests/data/video/main.h265").expect("it ships");
    split(&stream).filter(|unit| unit.len() > 2).map(<[u8]>::to_vec).collect()
}

fn is_slice(unit: &[u8]) -> bool {
    H265::class(unit[0] >> 1 & 63) == Class::Slice
}

/// The packets of a unit: whole, or in parts.
fn packets(unit: &[u8], size: usize) -> Vec<Vec<u8>> {
    if unit.len() <= size {
        return vec![unit.to_vec()];
    }
    let parts: Vec<_> = unit[2..].chunks(size).collect();
    let mark = |index| match index {
        0 => 0x80,
        index if index + 1 == parts.len() => 0x40,
        _ => 0,
    };
    let head =
        |index| [unit[0] & 0x81 | H265::FRAGMENT << 1, unit[1], mark(index) | unit[0] >> 1 & 63];
    parts.iter().enumerate().map(|(index, part)| [&head(index)[..], part].concat()).collect()
}

/// What the pictures of these packets become: key or not, and their bytes.
fn assembled(all: &[(u32, bool, Vec<u8>)], lost: Option<usize>) -> Vec<(bool, Vec<u8>)> {
    let (mut assembler, mut unit, mut given) = (Assembler::default(), Unit::default(), Vec::new());
    for (sequence, (timestamp, marker, payload)) in all.iter().enumerate() {
        let (sequence, timestamp, marker) = (sequence as u16, *timestamp, *marker);
        let packet = Packet { marker, sequence, timestamp, payload };
        if lost != Some(usize::from(sequence)) && assembler.push(&packet, &mut unit) {
            assert_eq!(unit.coding, Coding::H265);
            given.push((unit.key, unit.bytes.clone()));
        }
    }
    given
}

/// All packets with their time and marker.
fn stream(size: usize) -> Vec<(u32, bool, Vec<u8>)> {
    let (mut all, mut timestamp) = (Vec::new(), 0);
    for unit in units() {
        let parts = packets(&unit, size);
        let count = parts.len();
        for (index, part) in parts.into_iter().enumerate() {
            all.push((timestamp, is_slice(&unit) && index + 1 == count, part));
        }
        timestamp += u32::from(is_slice(&unit));
    }
    all
}

#[test]
fn pictures_are_put_together_however_they_are_cut() {
    let whole = assembled(&stream(usize::MAX), None);
    let keys: Vec<_> = whole.iter().map(|(key, _)| *key).collect();
    assert_eq!(keys, [true, false, true, false]);
    for size in [40, 300, 1400] {
        assert!(assembled(&stream(size), None) == whole, "{size}");
    }
    // Sets and the first slice in one packet.
    let units = units();
    let first = units.iter().position(|unit| is_slice(unit)).expect("a slice");
    let mut aggregate = vec![H265::AGGREGATE << 1, 1];
    for unit in &units[..=first] {
        aggregate.extend((unit.len() as u16).to_be_bytes());
        aggregate.extend(unit);
    }
    let given = assembled(&[(0, true, aggregate.clone())], None);
    assert!(given == whole[..1]);
    aggregate.truncate(aggregate.len() - 1);
    assert_eq!(assembled(&[(0, true, aggregate)], None), []);
}

#[test]
fn a_picture_with_a_packet_missing_is_not_given() {
    let all = stream(90);
    let whole = assembled(&all, None);
    for lost in 0..all.len() {
        let given = assembled(&all, Some(lost));
        assert!(given.len() < whole.len() || !is_part_of_slice(&all[lost].2), "{lost}");
        for (key, bytes) in given {
            let sets_aside = |bytes: &[u8]| {
                split(bytes)
                    .filter(|unit| unit.len() > 2 && is_slice(unit))
                    .map(<[u8]>::to_vec)
                    .collect::<Vec<_>>()
            };
            let is_one =
                whole.iter().any(|one| one.0 == key && sets_aside(&one.1) == sets_aside(&bytes));
            assert!(is_one, "{lost}");
        }
    }
}

fn is_part_of_slice(payload: &[u8]) -> bool {
    let kind = payload[0] >> 1 & 63;
    let kind = if kind == H265::FRAGMENT { payload[2] & 63 } else { kind };
    H265::class(kind) == Class::Slice
}

/// Bits from the highest of the first byte on, with the bytes that keep start codes out.
fn escaped(header: [u8; 2], bits: &str) -> Vec<u8> {
    let (mut unit, mut zeros) = (header.to_vec(), 0);
    for byte in bits.as_bytes().chunks(8) {
        let text = format!("{:0<8}", String::from_utf8_lossy(byte));
        let byte = u8::from_str_radix(&text, 2).expect("bits");
        if zeros == 2 && byte <= 3 {
            unit.push(3);
            zeros = 0;
        }
        zeros = if byte == 0 { zeros + 1 } else { 0 };
        unit.push(byte);
    }
    unit
}

/// A sequence set with these layers below the highest: profile or not, level or not. Its number
/// is the given code.
fn sequence_set(layers: &[(bool, bool)], code: &str) -> Vec<u8> {
    let bit = |is_set| if is_set { "1" } else { "0" };
    // Video set 2, the layers, and a general profile full of zeros, as cameras have it.
    let mut bits = format!("0010{:03b}1{}{:08b}", layers.len(), "0".repeat(88), 93);
    for (profile, level) in layers {
        bits += bit(*profile);
        bits += bit(*level);
    }
    if !layers.is_empty() {
        bits += &"00".repeat(8 - layers.len());
    }
    for (profile, level) in layers {
        bits += &"0".repeat(88 * usize::from(*profile) + 8 * usize::from(*level));
    }
    escaped([SEQUENCE_SET << 1, 1], &(bits + code + "1011011101"))
}

#[test]
fn a_set_has_its_own_number() {
    let shipped: Vec<_> = units().iter().filter(|unit| !is_slice(unit)).cloned().collect();
    assert!(shipped.len() >= 3 && shipped.iter().all(|set| H265::set_number(set) == Some(0)));
    let all = [(true, true); MOST_LAYERS];
    for layers in [&[][..], &[(false, true)], &[(true, false), (false, false)], &all] {
        for (code, number) in [("1", 0), ("010", 1), ("00101", 4), ("000010000", 15)] {
            let set = sequence_set(layers, code);
            assert_eq!(H265::set_number(&set), Some(number), "{layers:?} {code}");
        }
        assert_eq!(H265::set_number(&sequence_set(layers, "000010001")), None, "16 is too many");
    }
    assert_eq!(H265::set_number(&escaped([VIDEO_SET << 1, 1], "1001")), Some(9));
    assert_eq!(H265::set_number(&escaped([PICTURE_SET << 1, 1], "011")), Some(2));
    assert_eq!(H265::set_number(&escaped([PICTURE_SET << 1, 1], "0000001000001")), None, "64");
}

#[test]
fn a_set_that_is_cut_off_has_no_number() {
    let set = sequence_set(&[(true, true), (false, true)], "00101");
    // Its number is in the last byte but one.
    for length in 0..=set.len() {
        let number = (length + 1 >= set.len()).then_some(4);
        assert_eq!(H265::set_number(&set[..length]), number, "{length} of {}", set.len());
    }
    let layers = escaped([SEQUENCE_SET << 1, 1], &format!("00001111{}", "1".repeat(800)));
    assert_eq!(H265::set_number(&layers), None, "eight layers");
    let endless = escaped([SEQUENCE_SET << 1, 1], &"0".repeat(8000));
    assert_eq!(H265::set_number(&endless), None);
}

#[test]
fn two_sequences_live_beside_each_other() {
    let [first, second] = ["1", "010"].map(|code| sequence_set(&[], code));
    let mut assembler = Assembler::new(&[first.clone(), second.clone()]);
    let slice = units().into_iter().find(|unit| is_slice(unit)).expect("a slice");
    let mut unit = Unit::default();
    let mut picture = |assembler: &mut Assembler, payload: &[u8], timestamp| {
        let packet = Packet { marker: true, sequence: timestamp as u16, timestamp, payload };
        assert!(assembler.push(&packet, &mut unit));
        split(&unit.bytes).filter(|unit| unit.len() > 2).map(<[u8]>::to_vec).collect::<Vec<_>>()
    };
    let given = picture(&mut assembler, &slice, 0);
    assert_eq!(given[..2], [first.clone(), second]);
    // What has no number is not kept.
    let cut_off = first[..first.len() - 4].to_vec();
    let mut assembler = Assembler::new(&[cut_off]);
    assert_eq!(picture(&mut assembler, &slice, 0).len(), 1);
}
