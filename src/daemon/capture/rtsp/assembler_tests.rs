use super::super::h264::{Assembler, H264};
use super::*;

/// Units without start codes.
fn units() -> Vec<Vec<u8>> {
    let stream = std::fs::read("tests/data/video/high.h264").expect("it ships");
    split(&stream).filter(|unit| !unit.is_empty() && unit[0] != 0).map(<[u8]>::to_vec).collect()
}

/// The packets of a unit: whole, or in fragments.
fn packets(unit: &[u8], size: usize) -> Vec<Vec<u8>> {
    if unit.len() <= size {
        return vec![unit.to_vec()];
    }
    let parts: Vec<_> = unit[1..].chunks(size).collect();
    let mark = |index| match index {
        0 => 0x80,
        index if index + 1 == parts.len() => 0x40,
        _ => 0,
    };
    let head = |index| [unit[0] & 0xe0 | H264::FRAGMENT, mark(index) | unit[0] & 31];
    parts.iter().enumerate().map(|(index, part)| [&head(index)[..], part].concat()).collect()
}

/// The pictures of a stream: key or not, and their bytes. `drop` loses a packet.
fn assembled(size: usize, drop: Option<usize>, marker: bool) -> (Vec<(bool, Vec<u8>)>, Assembler) {
    let (mut assembler, mut unit, mut given) = (Assembler::default(), Unit::default(), Vec::new());
    let (mut sequence, mut timestamp) = (u16::MAX - 3, 0);
    for one in units() {
        let is_slice = matches!(one[0] & 31, 1 | 5);
        let all = packets(&one, size);
        for (index, payload) in all.iter().enumerate() {
            let marker = marker && is_slice && index + 1 == all.len();
            let packet = Packet { marker, sequence, timestamp, payload };
            sequence = sequence.wrapping_add(1);
            if drop != Some(usize::from(sequence.wrapping_sub(u16::MAX - 3)))
                && assembler.push(&packet, &mut unit)
            {
                given.push((unit.key, unit.bytes.clone()));
            }
        }
        if is_slice {
            timestamp += 3600;
        }
    }
    let end = Packet { marker: false, sequence, timestamp, payload: &[9, 16] };
    if assembler.push(&end, &mut unit) {
        given.push((unit.key, unit.bytes.clone()));
    }
    (given, assembler)
}

#[test]
fn pictures_are_put_together_however_they_are_cut() {
    let (whole, _) = assembled(usize::MAX, None, true);
    assert_eq!(whole.iter().map(|(key, _)| *key).collect::<Vec<_>>(), [true, false, true, false]);
    for size in [50, 300, 1400] {
        for marker in [true, false] {
            let (given, assembler) = assembled(size, None, marker);
            assert!(given == whole, "{size} {marker}");
            assert_eq!((assembler.lost, assembler.refused), (0, 0));
        }
    }
}

#[test]
fn a_clock_that_stands_still_costs_no_picture() {
    let (whole, _) = assembled(300, None, true);
    let (mut assembler, mut unit, mut given) = (Assembler::default(), Unit::default(), Vec::new());
    let mut sequence = 0;
    for one in units() {
        let is_slice = matches!(one[0] & 31, 1 | 5);
        let all = packets(&one, 300);
        for (index, payload) in all.iter().enumerate() {
            let marker = is_slice && index + 1 == all.len();
            sequence += 1;
            if assembler.push(&Packet { marker, sequence, timestamp: 7, payload }, &mut unit) {
                given.push((unit.key, unit.bytes.clone()));
            }
        }
    }
    assert!(given == whole);
}

#[test]
fn a_picture_with_a_packet_missing_is_not_given() {
    let (whole, _) = assembled(300, None, true);
    let count: usize = units().iter().map(|unit| packets(unit, 300).len()).sum();
    let mut fewer = 0;
    // From the first slice on: without a parameter set the decoder refuses.
    for drop in 3..=count {
        for marker in [true, false] {
            let (given, assembler) = assembled(300, Some(drop), marker);
            fewer += usize::from(given.len() < whole.len());
            assert!(given.iter().all(|picture| whole.contains(picture)), "{drop} {marker}");
            assert!(assembler.lost == 1 || drop == count, "{drop}");
        }
    }
    // All but what is sent again with the next key picture.
    assert!(fewer >= 2 * (count - 8), "{fewer} of {count} packets");
}

#[test]
fn a_parameter_set_that_differs_counts_when_it_comes_twice() {
    let sets: Vec<_> =
        units().into_iter().filter(|unit| unit[0] & 31 == H264::SEQUENCE_SET).take(1).collect();
    let mut assembler = Assembler::new(&sets);
    let mut damaged = sets[0].clone();
    *damaged.last_mut().expect("bytes") ^= 0x10;
    assembler.unit(&damaged);
    assert_eq!(assembler.sequence_set(), Some(sets[0].as_slice()));
    assembler.unit(&sets[0]);
    assembler.unit(&damaged);
    assert_eq!(assembler.sequence_set(), Some(sets[0].as_slice()));
    assembler.unit(&damaged);
    assert_eq!(assembler.sequence_set(), Some(damaged.as_slice()));
}

#[test]
fn aggregates_and_start_codes_in_packets_are_read() {
    let all = units();
    let (mut one, mut unit) = (Assembler::default(), Unit::default());
    let aggregate = all[..3].iter().fold(vec![H264::AGGREGATE], |mut bytes, unit| {
        bytes.extend((unit.len() as u16).to_be_bytes());
        bytes.extend(unit);
        bytes
    });
    assert!(
        one.push(
            &Packet { marker: true, sequence: 1, timestamp: 1, payload: &aggregate },
            &mut unit
        )
    );
    let expected = unit.bytes.clone();
    let annex_b: Vec<u8> =
        all[..3].iter().flat_map(|unit| [&[0, 0, 0, 1], unit.as_slice()].concat()).collect();
    let mut other = Assembler::default();
    assert!(
        other.push(
            &Packet { marker: true, sequence: 1, timestamp: 1, payload: &annex_b },
            &mut unit
        )
    );
    assert!(unit.bytes == expected && unit.key);
}

#[test]
fn memory_is_bounded_and_rubbish_never_panics() {
    let (mut assembler, mut unit) = (Assembler::default(), Unit::default());
    let payload = [&[H264::FRAGMENT, 0x85, 0xb8][..], &[7; 60_000]].concat();
    let mut middle = payload.clone();
    middle[1] = 5;
    for sequence in 0..200 {
        let payload = if sequence == 0 { &payload } else { &middle };
        let packet = Packet { marker: false, sequence, timestamp: 1, payload };
        assert!(!assembler.push(&packet, &mut unit));
        assert!(assembler.picture.capacity() <= 2 * (MAX_UNIT + 60_000));
    }
    let mut rng = fastrand::Rng::with_seed(5);
    for sequence in 0..20_000 {
        let mut payload: Vec<u8> = (0..rng.usize(..40)).map(|_| rng.u8(..)).collect();
        if let Some(first) = payload.first_mut() {
            *first = [1, 5, 7, 8, 24, 28, 0, 29][rng.usize(..8)];
        }
        let packet =
            Packet { marker: rng.bool(), sequence, timestamp: rng.u32(..3), payload: &payload };
        assembler.push(&packet, &mut unit);
    }
}
