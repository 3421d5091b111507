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
