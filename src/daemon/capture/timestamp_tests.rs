use super::*;

#[test]
fn names_of_cameras_and_recorders() {
    for (path, order) in [
        ("192.168.1.64_01_20260105080000250_MOTION_DETECTION.jpg", None), // Hikvision
        ("NVR_ch1_20260105080000_E.jpg", None),
        ("192.168.1.108_ch1_20260105080000_E.jpg", None), // Dahua
        ("cam/2026-01-05/001/jpg/08/00/00[R][0@0][0].jpg", None),
        ("cam/2026-01-05/pic_001/08.00.00[M][0@0][0].jpg", None),
        ("SD/2026-01-05/001/jpg/08/08.00.00[M][0@0][0].jpg", None),
        ("20260105_08/20260105_080000_A1B2.jpg", None), // Axis
        ("image26-01-05_08-00-00-25.jpg", Some(Dates::YearFirst)),
        ("Driveway_00_20260105080000.jpg", None), // Reolink
        ("RecM01_DST20260105_080000_080010_6D28C08.jpg", None),
        ("1-20260105080000-03.jpg", None),    // motion
        ("Cam1.20260105_080000.1.jpg", None), // Blue Iris
        ("Cam1.2026-01-05 08.00.00.250.3-1.jpg", None),
        ("front-1767600000.250123-x4k2.jpg", None), // Frigate
        ("2026-01-05/08/front/00.00.jpg", None),
        ("Front 1-5-2026, 8.00.00 AM.jpg", Some(Dates::MonthFirst)), // UniFi
        ("05-01-2026_08-00-00.jpg", Some(Dates::DayFirst)),
        ("cam 05_01_2026 08_00_00.jpg", Some(Dates::DayFirst)),
        ("01-05-2026/08-00-00.jpg", Some(Dates::MonthFirst)),
        ("05/01/2026/08/00/00.jpg", Some(Dates::DayFirst)),
        ("05-01-26_08-00-00.jpg", Some(Dates::DayFirst)),
        ("01-05-26_08-00-00.jpg", Some(Dates::MonthFirst)),
    ] {
        let read = order.map_or(from_path(path, 0), |order| from_path_in(path, 0, order));
        let second = read.map(|time| UtcMs(time.0 - time.0 % 1000));
        assert_eq!(second, Some(UtcMs(EIGHT)), "{path}");
        assert!(order.is_none() || from_path(path, 0).is_none(), "{path} tells by itself");
    }
    // Neither numbers of other kinds, nor dates of an age without such cameras.
    for path in ["cam-192.168.1.64-12-30-45.jpg", "1-2-3-4-5-6.jpg", "05-01-09_08-00-00.jpg"] {
        for order in Dates::ALL {
            assert_eq!(from_path_in(path, 0, order), None, "{path} {order:?}");
        }
    }
}

/// 2026-01-05 08:00:00 UTC.
const EIGHT: i64 = 1_767_600_000_000;

#[test]
fn names_of_real_recordings() {
    for (name, expected) in [
        ("20260105T080000.000Z.jpg", Some(0)),
        ("20260105T080000.250Z.jpg", Some(250)),
        ("1001-2026_01_05_080000.jpg", Some(0)),
        ("cam7 2026-01-05 08:00:00.png", Some(0)),
        ("K109F_20260105080000.jpg", Some(0)),
        ("192.168.1.64_01_20260105080000250_TIMING.jpg", Some(250)),
        ("20260105_080000_250.jpg", Some(250)),
        ("2026-01-05_08-00-00-7.jpg", Some(0)),
        ("2026-01-05 at 08.00.00.jpg", Some(0)),
        ("Image 2026-01-05 at 8.00.00 AM.jpg", Some(0)),
        ("Image 2026-01-05 at 08.00.00 PM.jpg", Some(12 * 3_600_000)),
        ("05.01.2026 08.00.00.jpg", Some(0)),
        ("2026.01.05_08h00m00s.jpg", Some(0)),
        ("01-20260105080000-03.jpg", Some(0)),
        ("1767600000.jpg", Some(0)),
        ("frame_1767600000.250.jpg", Some(250)),
        ("cam_1767600000250.jpg", Some(250)),
        ("1767600000250000.jpg", Some(250)),
        ("left_1767600000250000000.png", Some(250)),
        ("vehicle_01.jpg", None),
        ("20261305T080000Z.jpg", None),
        ("20260105T0800.jpg", None),
        ("9920260105080000.jpg", None),
        ("202601050800001.jpg", None),
        ("IMG_0000000123.jpg", None),
    ] {
        assert_eq!(from_path(name, 0), expected.map(|ms| UtcMs(EIGHT + ms)), "{name}");
    }
}

#[test]
fn offsets_in_names_are_honoured() {
    for (name, hours) in [
        ("20260105T090000+0100.jpg", 0),
        ("2026-01-05T09:00:00.000+01:00.jpg", 0),
        ("2026-01-05T03-00-00-0500.jpg", 0),
        ("20260105_090000+01.jpg", 0),
        ("20260105_090000_UTC+1.jpg", 0),
        ("20260105_090000_UTC+01.jpg", 0),
        ("20260105_080000_GMT.jpg", 0),
        // A counter, not an offset.
        ("20260105-080000-0100.jpg", 0),
        ("20260105-080000-01.jpg", 0),
    ] {
        assert_eq!(from_path(name, 0), Some(UtcMs(EIGHT + hours * 3_600_000)), "{name}");
    }
    let local = from_path("20260105_090000.jpg", 3600);
    assert_eq!(local, Some(UtcMs(EIGHT)));
    assert_eq!(from_path("20260105T080000Z.jpg", 3600), Some(UtcMs(EIGHT)), "its own counts");
    assert_eq!(from_path("1767600000.jpg", 3600), Some(UtcMs(EIGHT)));
    for (text, expected) in [
        ("+01:00", Some(3600)),
        ("-0530", Some(-19_800)),
        ("+1", Some(3600)),
        ("Z", Some(0)),
        ("+25:00", None),
        ("Berlin", None),
    ] {
        assert_eq!(offset_s(text), expected, "{text}");
    }
}

#[test]
fn folders_by_day() {
    for (path, expected) in [
        ("2026-01-05/08-00-00.jpg", true),
        ("20260105/080000.jpg", true),
        ("2026/01/05/08/00/00.jpg", true),
        ("cam/2026-01-05/001/jpg/08/00/00[R][0@0][0].jpg", true),
        ("2026-01-05/cam_08.00.00.jpg", true),
        ("2026-01-05/frame_080000.jpg", false),
        ("2026-01-05/readme.jpg", false),
    ] {
        assert_eq!(from_path(path, 0), expected.then_some(UtcMs(EIGHT)), "{path}");
    }
}

#[test]
fn a_name_tells_fractions_of_a_second_or_not() {
    for (path, told) in [
        ("20260105T080000Z.jpg", false),
        ("20260105T080000.000Z.jpg", true),
        ("20260105_080000_0001.jpg", false),
        ("2026-01-05/08.00.00.jpg", false),
        ("1767600000.jpg", false),
        ("1767600000000.jpg", true),
        ("05-01-2026_08-00-00.500.jpg", true),
        ("map.png", false),
    ] {
        assert_eq!(tells_fraction(path), told, "{path}");
    }
}
