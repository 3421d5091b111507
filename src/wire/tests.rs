//! Tests of the compact message: golden bytes, both formats, damage.

use super::*;
use crate::density::{DensityError, LaneReport, MAX_LANE_CELLS, SampleZoneStatus};
use crate::traffic::Section;
use crate::units::{Direction, LaneId, MAX_LANES, UtcMs, VehicleClass};

pub(crate) fn lane(number: u8, density: Option<f32>) -> LaneReport {
    LaneReport {
        lane: LaneId::new(number).expect("in range"),
        direction: Direction::Toward,
        density_veh_km: density,
        density_se: density.map(|k| k / 4.0),
        vehicles_mean: density.map(|k| k / 8.0),
        by_class: density.map(|k| [k; VehicleClass::COUNT]),
        space_occupancy: density.map(|_| 0.5),
        length_m: 125.0,
        frames_used: 60,
        frames_expected: 60,
        status: SampleZoneStatus::Ok,
        cells: Some(Cells {
            length_m: 62.5,
            density_veh_km: density.map(|k| [k, k / 2.0].into_iter().collect()),
        }),
        error: density.map(|k| DensityError {
            calibration: k / 16.0,
            counting: k / 8.0,
            ci90: [k / 2.0, k * 2.0],
        }),
        traffic: None,
    }
}

pub(crate) fn message(lanes: &[LaneReport]) -> DensityMessage {
    let name = |text| Name::try_from(text).expect("short");
    DensityMessage {
        site: name("k1"),
        seq: 300,
        clock_synced: true,
        report: WindowReport {
            from: UtcMs(60_000),
            to: UtcMs(120_000),
            lanes: lanes.iter().cloned().collect(),
        },
        calibration: CalibrationRef { id: name("c"), sha256: [1; 32], rel_err: Some(0.0625) },
        model: ModelRef { name: name("m"), sha256: [2; 32] },
    }
}

/// A message without cells, as format 1 has it behind the version.
fn golden_body() -> std::vec::Vec<u8> {
    [
        &[][..],
        b"\x02k1",
        &[0xac, 0x02, 1],    // seq 300, clock synced
        &[0xc0, 0xa9, 0x07], // 60,000 ms, zigzag
        &[0x80, 0xd3, 0x0e], // 120,000 ms, zigzag
        &[1, 1, 1],          // one lane, lane 1, toward
        &[0; 5],             // nothing known
        &[0, 0, 0xfa, 0x42], // 125 m
        &[60, 60, 0],        // frames used, expected, ok
        b"\x01c",
        &[1; 32],
        &[1, 0, 0, 0x80, 0x3d],
        b"\x01m",
        &[2; 32],
    ]
    .concat()
}

#[test]
fn golden_bytes() {
    let mut buffer = [0; MAX_MESSAGE];
    let bytes = encode(&message(&[lane(1, None)]), &mut buffer).expect("fits");
    let (body, trailer) = bytes.split_at(bytes.len() - 4);
    // Cells of 62.5 m, whose densities are not known; no error.
    assert_eq!(body, [&[3][..], &golden_body(), &[1, 0, 0, 0x7a, 0x42, 0], &[0]].concat());
    assert_eq!(trailer, CRC.checksum(body).to_le_bytes());
    let known = message(&[lane(1, Some(16.0))]);
    let bytes = encode(&known, &mut buffer).expect("fits");
    let (cells, errors) = bytes[bytes.len() - 4 - 17 - 15..bytes.len() - 4].split_at(15);
    assert_eq!(cells, [1, 0, 0, 0x7a, 0x42, 1, 2, 0, 0, 0x80, 0x41, 0, 0, 0, 0x41]);
    let (one, two, eight, thirty_two) =
        ([0, 0, 0x80, 0x3f], [0, 0, 0, 0x40], [0, 0, 0, 0x41], [0, 0, 0, 0x42]);
    assert_eq!(errors, [&[1][..], &one, &two, &eight, &thirty_two].concat());
    let none = &mut known.clone();
    (none.report.lanes[0].cells, none.report.lanes[0].error) = (None, None);
    let bytes = encode(none, &mut buffer).expect("fits");
    assert_eq!(bytes[bytes.len() - 6..bytes.len() - 4], [0, 0]);
}

#[test]
fn format_2_is_read_without_errors() {
    let mut golden = [&[2][..], &golden_body(), &[1, 0, 0, 0x7a, 0x42, 0]].concat();
    golden.extend_from_slice(&CRC.checksum(&golden).to_le_bytes());
    assert_eq!(decode(&golden), Ok(message(&[lane(1, None)])));
}

/// A message as it was written in format 1.
pub(crate) fn format_1() -> std::vec::Vec<u8> {
    [&[1][..], &golden_body(), &[22, 18, 105, 21]].concat()
}

#[test]
fn format_1_is_read_without_cells() {
    let golden = format_1();
    let mut expected = message(&[lane(1, None)]);
    expected.report.lanes[0].cells = None;
    assert_eq!(decode(&golden), Ok(expected));
    // With cells behind it, it is not of that format.
    let mut longer = [&golden[..golden.len() - 4], &[0]].concat();
    longer.extend_from_slice(&CRC.checksum(&longer).to_le_bytes());
    assert_eq!(decode(&longer), Err(WireError::Body));
}

#[test]
fn the_largest_message_fits_and_returns() {
    let lanes: std::vec::Vec<_> = (1..=MAX_LANES as u8).map(|n| lane(n, Some(123.456))).collect();
    let mut sent = message(&lanes);
    let long = [b'x'; crate::lane::MAX_NAME];
    let long = Name::try_from(core::str::from_utf8(&long).expect("ascii")).expect("fits");
    sent.site = long.clone();
    sent.calibration.id = long.clone();
    sent.model.name = long;
    sent.seq = u64::MAX;
    for lane in &mut sent.report.lanes {
        (lane.frames_used, lane.frames_expected) = (u32::MAX, u32::MAX);
        let densities = core::iter::repeat_n(123.456, MAX_LANE_CELLS).collect();
        lane.cells = Some(Cells { length_m: 12.5, density_veh_km: Some(densities) });
    }
    let mut buffer = [0; MAX_MESSAGE];
    let bytes = encode(&sent, &mut buffer).expect("MAX_MESSAGE holds every message");
    assert!(bytes.len() <= 1996, "{} bytes", bytes.len());
    assert_eq!(decode(bytes).as_ref(), Ok(&sent));
    sent.report.lanes.iter_mut().for_each(|lane| lane.traffic = Some(traffic()));
    let bytes = encode(&sent, &mut buffer).expect("MAX_MESSAGE holds every message");
    assert!(bytes.len() <= 1996 + 8 * 97, "{} bytes", bytes.len());
    assert_eq!(decode(bytes), Ok(sent));
}

/// Traffic of which everything is known.
pub(crate) fn traffic() -> LaneTraffic {
    LaneTraffic {
        status: SampleZoneStatus::Ok,
        flow_veh_h: Some(1.0),
        flow_ci90: Some([0.5, 2.0]),
        speed_kmh: Some(4.0),
        speed_ci90: Some([2.0, 8.0]),
        time_occupancy: Some(0.5),
        time_occupancy_ci90: Some([0.25, 1.0]),
        section: Some(Section {
            by_class: [u16::MAX; VehicleClass::COUNT],
            flow_veh_h: 1.0,
            speed_time_mean_kmh: Some(4.0),
            headway_s: Some(8.0),
            headway_sd_s: Some(2.0),
        }),
        queue_m: Some(16.0),
        queue_max_m: Some(32.0),
        density_difference: Some(-0.5),
    }
}

#[test]
fn format_4_has_traffic_and_format_3_is_written_without() {
    let mut sent = message(&[lane(1, None)]);
    let mut buffer = [0; MAX_MESSAGE];
    sent.report.lanes[0].traffic = Some(LaneTraffic {
        section: None,
        flow_ci90: None,
        speed_ci90: None,
        time_occupancy_ci90: None,
        density_difference: None,
        ..traffic()
    });
    let bytes = encode(&sent, &mut buffer).expect("fits");
    let (half, one, four) = ([0, 0, 0, 0x3f], [0, 0, 0x80, 0x3f], [0, 0, 0x80, 0x40]);
    let (sixteen, thirty_two) = ([0, 0, 0x80, 0x41], [0, 0, 0, 0x42]);
    let golden = [
        &[4][..],
        &golden_body(),
        &[1, 0, 0, 0x7a, 0x42, 0, 0],
        &[1, 0, 1],
        &one,
        &[0, 1],
        &four,
        &[0, 1],
        &half,
        &[0, 0, 1],
        &sixteen,
        &[1],
        &thirty_two,
        &[0],
    ]
    .concat();
    assert_eq!(bytes[..bytes.len() - 4], golden);
    assert_eq!(decode(bytes).as_ref(), Ok(&sent));
}

#[test]
fn damage_is_refused() {
    let mut buffer = [0; MAX_MESSAGE];
    let good = encode(&message(&[lane(1, Some(20.0))]), &mut buffer).expect("fits").to_vec();
    for len in 0..good.len() {
        assert!(decode(&good[..len]).is_err(), "{len} bytes");
    }
    for bit in 0..good.len() * 8 {
        let mut bad = good.clone();
        bad[bit / 8] ^= 1 << (bit % 8);
        assert!(decode(&bad).is_err(), "bit {bit}");
    }
    assert_eq!(decode(&[5, 0, 0, 0, 0, 0]), Err(WireError::Version { found: 5 }));
    let body = &good[..good.len() - 4];
    for wrong in [&body[..body.len() - 1], &[body, &[0]].concat(), &[&[1], &body[1..]].concat()] {
        let sealed = [wrong, &CRC.checksum(wrong).to_le_bytes()].concat();
        assert_eq!(decode(&sealed), Err(WireError::Body), "{sealed:?}");
    }
    assert_eq!(encode(&message(&[]), &mut [0; 20]), Err(WireError::Buffer { actual: 20 }));
}
