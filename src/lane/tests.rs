//! Tests of the lane table: golden bytes, round trip, damage.

use super::*;

fn lane(number: u8) -> LaneId {
    LaneId::new(number).expect("a test's lane number is in range")
}

fn description() -> Description {
    Description {
        camera_id: Name::try_from("K1").expect("short"),
        image_size: ImageSize { width: 4, height: 2 },
        lanes: heapless::Vec::from_slice(&[
            Lane { id: lane(1), direction: Direction::Toward, length_m: 50.0 },
            Lane { id: lane(3), direction: Direction::Away, length_m: 40.25 },
        ])
        .expect("two of eight"),
        length_rel_err: Some(0.0625),
        calibration_id: Name::try_from("c").expect("short"),
        calibration_sha256: [0xab; 32],
        cell_length_m: DEFAULT_CELL_LENGTH_M,
    }
}

/// Lane 1 in the first column, lane 3 in the last, nothing between.
fn cell(u: u16, v: u16) -> Option<Place> {
    let at = |number, s_m, span_m| Some(Place { lane: lane(number), s_m, span_m });
    match u {
        0 => at(1, 50.0 - 25.0 * f32::from(v), 0.5),
        3 => at(3, 40.25, 0.125),
        _ => None,
    }
}

fn encoded() -> std::vec::Vec<u8> {
    let mut bytes = std::vec![0; encoded_len(&description(), None)];
    let len = encode(&description(), None, cell, &mut bytes).expect("the test's table is right");
    assert_eq!(len, bytes.len());
    bytes
}

#[test]
fn golden_bytes() {
    let mut golden = std::vec::Vec::new();
    golden.extend_from_slice(b"VERGELUT\x01\x00");
    let description: &[&[u8]] = &[
        b"\x02K1",
        &[4, 2],
        &[2, 1, 1, 0, 0, 0x48, 0x42, 3, 2, 0, 0, 0x21, 0x42],
        &[1, 0, 0, 0x80, 0x3d],
        b"\x01c",
        &[0xab; 32],
    ];
    let description = description.concat();
    golden.extend_from_slice(&(description.len() as u16).to_le_bytes());
    golden.extend_from_slice(&description);
    let none = [0; 5];
    let far = [3, 0xb9, 0x0f, 125, 0];
    for first in [[1, 0x88, 0x13, 0xf4, 1], [1, 0xc4, 0x09, 0xf4, 1]] {
        golden.extend_from_slice(&[first, none, none, far].concat());
    }
    golden.extend_from_slice(&CRC.checksum(&golden).to_le_bytes());
    assert_eq!(encoded(), golden);
    assert_eq!(&golden[golden.len() - 4..], &[62, 62, 150, 240], "the checksum's own bytes");
}

#[test]
fn round_trip() {
    let bytes = encoded();
    let table = LaneTable::parse(&bytes[..]).expect("just written");
    assert_eq!(table.description(), &description());
    for v in 0..2u16 {
        for u in 0..4u16 {
            let point = ImagePoint { u: f32::from(u) + 0.5, v: f32::from(v) + 0.999 };
            assert_eq!(table.place(point), cell(u, v), "cell ({u}, {v})");
        }
    }
}

#[test]
fn points_outside_the_picture_have_no_place() {
    let bytes = encoded();
    let table = LaneTable::parse(&bytes[..]).expect("just written");
    for (u, v) in
        [(-0.01, 0.5), (0.5, -1.0), (4.0, 0.5), (0.5, 2.0), (f32::NAN, 0.5), (0.5, f32::INFINITY)]
    {
        assert_eq!(table.place(ImagePoint { u, v }), None, "({u}, {v})");
    }
}

#[test]
fn every_flipped_bit_is_refused() {
    let good = encoded();
    for bit in 0..good.len() * 8 {
        let mut bad = good.clone();
        bad[bit / 8] ^= 1 << (bit % 8);
        assert!(LaneTable::parse(&bad[..]).is_err(), "bit {bit}");
    }
}

#[test]
fn every_truncation_and_an_added_byte_are_refused() {
    let good = encoded();
    for len in 0..good.len() {
        assert!(LaneTable::parse(&good[..len]).is_err(), "{len} bytes");
    }
    let mut long = good.clone();
    long.push(0);
    assert!(LaneTable::parse(&long[..]).is_err());
}

/// Bytes with a right checksum but a wrong inside: the reader trusts no writer.
fn resealed(change: impl FnOnce(&mut std::vec::Vec<u8>)) -> std::vec::Vec<u8> {
    let mut bytes = encoded();
    bytes.truncate(bytes.len() - 4);
    change(&mut bytes);
    let crc = CRC.checksum(&bytes);
    bytes.extend_from_slice(&crc.to_le_bytes());
    bytes
}

#[test]
fn a_well_sealed_lie_is_refused() {
    let cells = encoded().len() - 4 - 8 * CELL;
    let unknown_lane = resealed(|bytes| bytes[cells] = 2);
    assert_eq!(
        LaneTable::parse(&unknown_lane[..]).err(),
        Some(LaneTableError::CellLane { cell: 0, lane: 2 })
    );
    let beyond = resealed(|bytes| bytes[cells + 2] = 0xff);
    assert_eq!(LaneTable::parse(&beyond[..]).err(), Some(LaneTableError::CellDistance { cell: 0 }));
    let lane_zero = resealed(|bytes| bytes[18] = 0);
    assert_eq!(LaneTable::parse(&lane_zero[..]).err(), Some(LaneTableError::Description));
}

#[test]
fn impossible_descriptions_are_not_written() {
    let mut buffer = [0; 512];
    let mut longer = description();
    longer.lanes[0].length_m = f32::NAN;
    assert!(encode(&longer, None, cell, &mut buffer).is_err());
    let mut unordered = description();
    unordered.lanes.swap(0, 1);
    assert!(encode(&unordered, None, cell, &mut buffer).is_err());
    let mut small = [0; 16];
    assert!(matches!(
        encode(&description(), None, cell, &mut small),
        Err(LaneTableError::Buffer { actual: 16, .. })
    ));
}

/// The same with cells of 7.5 m along its lanes.
fn with_cells(scene: Option<&Reference>) -> std::vec::Vec<u8> {
    let description = Description { cell_length_m: 7.5, ..description() };
    let mut bytes = std::vec![0; encoded_len(&description, scene)];
    let len = encode(&description, scene, cell, &mut bytes).expect("a right table");
    assert_eq!(len, bytes.len());
    bytes
}

#[test]
fn the_length_of_cells_is_version_3_and_comes_back() {
    let bare = encoded();
    let cells_at = bare.len() - 4 - 8 * CELL;
    let mut golden = bare[..cells_at].to_vec();
    golden[8] = 3;
    golden[10] += 4;
    golden.extend_from_slice(&[0, 0, 0xf0, 0x40]); // 7.5 m
    golden.extend_from_slice(&bare[cells_at..bare.len() - 4]);
    golden.extend_from_slice(&[0; 4]); // no reference
    golden.extend_from_slice(&CRC.checksum(&golden).to_le_bytes());
    assert_eq!(with_cells(None), golden);
    for scene in [None, Some(reference())] {
        let bytes = with_cells(scene.as_ref());
        let table = LaneTable::parse(&bytes[..]).expect("just written");
        assert_eq!(table.description().cell_length_m, 7.5);
        assert_eq!(table.scene(), Ok(scene));
        assert_eq!(table.place(ImagePoint { u: 0.5, v: 0.5 }), cell(0, 0));
        for len in 0..bytes.len() {
            assert!(LaneTable::parse(&bytes[..len]).is_err(), "{len} bytes");
        }
    }
    let good = with_cells(None);
    for bit in 0..good.len() * 8 {
        let mut bad = good.clone();
        bad[bit / 8] ^= 1 << (bit % 8);
        assert!(LaneTable::parse(&bad[..]).is_err(), "bit {bit}");
    }
    let bare = LaneTable::parse(&bare[..]).expect("just written");
    assert_eq!(bare.description().cell_length_m, 10.0);
}

/// A table that states the errors of its lanes.
fn with_errors(errors: &[LaneErrors<'_>]) -> Result<std::vec::Vec<u8>, LaneTableError> {
    let mut bytes = std::vec![0; encoded_len_with_errors(&description(), errors, None)];
    encode_with_errors(&description(), errors, None, cell, &mut bytes)?;
    Ok(bytes)
}

#[test]
fn the_errors_of_lanes_and_cells_are_version_4_and_come_back() {
    let near_to_far = [0.01, 0.0225, 0.04, 9.0];
    let errors = [
        LaneErrors { lane: Some(0.0312), cells: &near_to_far },
        LaneErrors { lane: None, cells: &[] },
    ];
    let bytes = with_errors(&errors).expect("right errors");
    assert_eq!(bytes[8], 4);
    let table = LaneTable::parse(&bytes[..]).expect("just written");
    assert_eq!(table.description(), &description());
    assert_eq!(table.scene().expect("whole"), None);
    let near = |a: Option<f32>, b: f32| a.is_some_and(|a| (a - b).abs() < 1e-6);
    assert!(near(table.lane_rel_err(lane(1)), 0.0312));
    assert!(near(table.cell_rel_err(lane(1), 1), 0.0225));
    assert!(near(table.cell_rel_err(lane(1), 3), 6.5534), "held at the largest");
    assert!(near(table.cell_rel_err(lane(1), 4), 0.0312), "beyond the cells the lane's");
    // A lane without an error of its own has the calibration's.
    assert!(near(table.lane_rel_err(lane(3)), 0.0625));
    assert!(near(table.cell_rel_err(lane(3), 0), 0.0625));
    // The block behind the description, byte by byte.
    let block = [4, 0x38, 1, 100, 0, 225, 0, 0x90, 1, 0xfe, 0xff, 0, 0xff, 0xff];
    let at = bytes.windows(block.len()).position(|w| w == block);
    assert!(at.is_some(), "the block stands in the file");
    let older = encoded();
    assert!(near(LaneTable::parse(&older[..]).expect("older").lane_rel_err(lane(1)), 0.0625));
}

#[test]
fn wrong_errors_are_neither_written_nor_read() {
    let one = LaneErrors { lane: Some(0.03), cells: &[] };
    let negative = LaneErrors { lane: Some(-0.1), ..one };
    let unknown = LaneErrors { lane: None, cells: &[f32::NAN] };
    for wrong in [&[one][..], &[one, negative], &[one, unknown], &[one, one, one]] {
        assert!(matches!(with_errors(wrong), Err(LaneTableError::Value(_))), "{wrong:?}");
    }
    let bytes = with_errors(&[one, one]).expect("right errors");
    let block = 12 + usize::from(u16::from_le_bytes([bytes[10], bytes[11]])) - 6;
    let mut longer = bytes.clone();
    longer[block] = 1;
    let body = longer.len() - TRAILER;
    let checksum = CRC.checksum(&longer[..body]).to_le_bytes();
    longer[body..].copy_from_slice(&checksum);
    assert_eq!(LaneTable::parse(&longer[..]).err(), Some(LaneTableError::Description));
}

#[test]
fn impossible_lengths_of_cells_are_refused() {
    let good = with_cells(None);
    let length_at = good.len() - 8 - 8 * CELL - 4;
    for length_m in [0.0, 1.99, 100.01, -10.0, f32::NAN, f32::INFINITY] {
        let mut buffer = [0; 512];
        let description = Description { cell_length_m: length_m, ..description() };
        let refused = encode(&description, None, cell, &mut buffer);
        assert!(matches!(refused, Err(LaneTableError::Value(_))), "{length_m}: {refused:?}");
        let mut bytes = good.clone();
        bytes[length_at..length_at + 4].copy_from_slice(&length_m.to_le_bytes());
        let (body, trailer) = bytes.split_last_chunk_mut::<4>().expect("a trailer");
        *trailer = CRC.checksum(body).to_le_bytes();
        assert!(matches!(LaneTable::parse(bytes), Err(LaneTableError::Value(_))), "{length_m}");
    }
}

/// A reference of the scene: a row of points.
fn reference() -> Reference {
    let mut scene = Reference { width: 320, height: 240, ..Reference::default() };
    for x in 0..200 {
        let point = crate::scene::Point { x, y: 7, edge: [100, -20] };
        scene.fine.push(point).expect("200 of 1440");
        let _ = scene.coarse.push(crate::scene::Point { x: x / 2, y: 3, ..point });
    }
    scene
}

#[test]
fn a_table_with_a_reference_is_version_2_and_comes_back() {
    let scene = reference();
    let mut bytes = std::vec![0; encoded_len(&description(), Some(&scene))];
    let len = encode(&description(), Some(&scene), cell, &mut bytes).expect("a right table");
    assert_eq!((len, bytes[8]), (bytes.len(), 2));
    // Up to the reference it is the same table.
    let bare = encoded();
    let same = bare.len() - 4;
    assert_eq!(bytes[9..same], bare[9..same]);
    assert_eq!(bytes[same..same + 4], (scene.encoded_len() as u32).to_le_bytes());
    let table = LaneTable::parse(&bytes[..]).expect("just written");
    assert_eq!(table.scene(), Ok(Some(scene)));
    assert_eq!(table.place(ImagePoint { u: 0.5, v: 0.5 }), cell(0, 0));
    let bare = LaneTable::parse(&bare[..]).expect("just written");
    assert_eq!(bare.scene(), Ok(None));
}

#[test]
fn damage_in_the_reference_is_named() {
    let scene = reference();
    let mut whole = std::vec![0; encoded_len(&description(), Some(&scene))];
    encode(&description(), Some(&scene), cell, &mut whole).expect("a right table");
    for len in (0..whole.len()).step_by(7) {
        assert!(LaneTable::parse(&whole[..len]).is_err(), "{len} of {} bytes", whole.len());
    }
    let end = whole.len() - 4;
    let scene_at = end - scene.encoded_len();
    let damaged = |at: usize, value: u8| {
        let mut bytes = whole.clone();
        bytes[at] = value;
        let crc = CRC.checksum(&bytes[..end]).to_le_bytes();
        bytes[end..].copy_from_slice(&crc);
        LaneTable::parse(bytes).and_then(|table| table.scene()).expect_err("damaged")
    };
    use crate::scene::ReferenceError;
    assert_eq!(damaged(scene_at, 9), LaneTableError::Scene(ReferenceError::Version(9)));
    assert!(matches!(damaged(scene_at + 6, 9), LaneTableError::Scene(_)));
    assert!(matches!(damaged(scene_at + 11, 9), LaneTableError::Scene(ReferenceError::Value(_))));
    assert!(matches!(damaged(scene_at - 1, 9), LaneTableError::TooShort { .. }));
}

#[test]
fn how_steeply_a_lane_is_seen_follows_from_its_pixels() {
    // A camera 10 m up with 400 px, whose horizon is the picture's upper edge, over a straight lane.
    let (height_m, focal_px, far_m) = (10.0, 400.0, 60.0);
    let image_size = ImageSize { width: 320, height: 200 };
    let one = Lane { id: lane(1), direction: Direction::Toward, length_m: 40.0 };
    let lanes = heapless::Vec::from_slice(&[one]).expect("one of eight");
    let description = Description { image_size, lanes, ..description() };
    let ahead_m = |v: u16| focal_px * height_m / (f32::from(v) + 0.5);
    let place = |u: u16, v: u16| {
        let (s_m, aside_m) = (far_m - ahead_m(v), (f32::from(u) - 160.0) * ahead_m(v) / focal_px);
        let is_on = (0.0..=40.0).contains(&s_m) && aside_m.abs() < LANE_WIDTH_M / 2.0;
        let span_m = ahead_m(v) * ahead_m(v) / (focal_px * height_m);
        is_on.then_some(Place { lane: lane(1), s_m, span_m })
    };
    let mut bytes = std::vec![0; encoded_len(&description, None)];
    encode(&description, None, place, &mut bytes).expect("the test's table is right");
    let table = LaneTable::parse(bytes).expect("just written");
    for at_m in [10.0, 20.0, 30.0] {
        let found = table.foreshortening(lane(1), [at_m - 8.0, at_m + 8.0]).expect("many pixels");
        let true_ratio = (far_m - at_m) / height_m;
        assert!((found / true_ratio - 1.0).abs() < 0.12, "{at_m} m: {found}, {true_ratio}");
    }
    assert_eq!(table.foreshortening(lane(2), [0.0, 40.0]), None);
    assert_eq!(table.foreshortening(lane(1), [50.0, 60.0]), None);
}
