use super::*;
use crate::lane::LaneTable;
use crate::lane::{Lane, Name};
use crate::units::Direction;

const INPUT: [usize; 2] = [640, 480];
const TABLES: [&str; 3] =
    ["tests/data/curve.lut", "tests/data/freeway.lut", "tests/data/k109f.lut"];

fn table(path: &str) -> LaneTable<Vec<u8>> {
    LaneTable::parse(std::fs::read(path).expect("it ships")).expect("a right table")
}

fn parts(table: &LaneTable<Vec<u8>>) -> Parts {
    Parts::new(table.description(), |point| table.place(point), INPUT)
}

/// A straight road of that many lanes of 3.5 m that begins 10 m before the camera, seen from
/// `height_m` along it with `focal_px` and the horizon at the upper edge.
fn straight(size: ImageSize, lanes: u8, height_m: f32, focal_px: f32, length_m: f32) -> Parts {
    let lane =
        |id| Lane { id: LaneId::new(id).expect("1 to 8"), direction: Direction::Away, length_m };
    let description = Description {
        camera_id: Name::new(),
        image_size: size,
        lanes: (1..=lanes).map(lane).collect(),
        length_rel_err: None,
        calibration_id: Name::new(),
        calibration_sha256: [0; 32],
        cell_length_m: 10.0,
    };
    let place = |point: ImagePoint| {
        let ahead_m = height_m * focal_px / point.v;
        let right_m = (point.u - f32::from(size.width) / 2.0) * ahead_m / focal_px;
        let lane = (right_m / 3.5 + f32::from(lanes) / 2.0).floor();
        let s_m = ahead_m - 10.0;
        let is_on = (0.0..f32::from(lanes)).contains(&lane) && (0.0..length_m).contains(&s_m);
        let span_m = ahead_m * ahead_m / (height_m * focal_px);
        is_on.then(|| Place { lane: LaneId::new(lane as u8 + 1).expect("1 to 8"), s_m, span_m })
    };
    Parts::new(&description, place, INPUT)
}

fn is_in(region: &Region, u: usize, v: usize) -> bool {
    (region.x..region.x + region.width).contains(&u)
        && (region.y..region.y + region.height).contains(&v)
}

#[test]
fn parts_lie_in_the_picture_and_hold_every_lane() {
    for path in TABLES {
        let table = table(path);
        let ImageSize { width, height } = table.description().image_size;
        let (width, height) = (usize::from(width), usize::from(height));
        let parts = parts(&table);
        for factor in [1, 2, 3] {
            let size = (width * factor, height * factor);
            let regions = parts.of(size);
            assert!((1..=MAX_REGIONS).contains(&regions.len()), "{path}");
            for region in &regions {
                let (right, lower) = (region.x + region.width, region.y + region.height);
                assert!(right <= size.0 && lower <= size.1, "{path}: {region:?} of {size:?}");
                let same = |first: usize, scaled: usize| scaled == first * factor;
                let whole = parts.of((width, height));
                let is_scaled =
                    whole.iter().any(|w| same(w.x, region.x) && same(w.width, region.width));
                assert!(is_scaled, "{path}: {region:?}");
            }
        }
        let regions = parts.of((width, height));
        for v in 0..height {
            for u in 0..width {
                let point = ImagePoint { u: u as f32 + 0.5, v: v as f32 + 0.5 };
                let is_lane = table.place(point).is_some();
                assert!(!is_lane || is_in(&regions[0], u, v), "{path}: ({u}, {v})");
            }
        }
    }
}

#[test]
fn a_car_at_the_far_end_is_seen_larger_and_where_it_can_be_large_enough() {
    for path in TABLES {
        let table = table(path);
        let pieces = pieces(table.description(), |point| table.place(point));
        let regions = parts(&table).regions;
        let picture = table.description().image_size;
        let all = Region { x: 0, y: 0, width: picture.width.into(), height: picture.height.into() };
        let [near, far] = regions[..] else { panic!("{path}: {regions:?}") };
        let (whole, near_scale, far_scale) =
            (scale(&all, INPUT), scale(&near, INPUT), scale(&far, INPUT));
        assert!(near_scale >= whole && far_scale > 1.2 * near_scale, "{path}: {regions:?}");
        let mean = |worth: &dyn Fn(&Piece) -> f32| {
            pieces.iter().map(worth).sum::<f32>() / pieces.len() as f32
        };
        let before = mean(&|piece| worth(piece, whole));
        let after = mean(&|piece| {
            let [x0, y0, x1, y1] = piece.extent;
            let holds = |r: &Region| {
                x0.max(0.0) >= r.x as f32 - 1.0
                    && y0.max(0.0) >= r.y as f32 - 1.0
                    && x1 <= (r.x + r.width) as f32 + 1.0
                    && y1 <= (r.y + r.height) as f32 + 1.0
            };
            worth(piece, if holds(&far) { far_scale } else { near_scale })
        });
        assert!(before < 0.75 && after > 0.85, "{path}: {before} to {after}");
    }
}

#[test]
fn a_lane_is_as_wide_as_it_is_drawn() {
    // A road of constant scale, 20 px a lane and 0.25 m a pixel, in both directions.
    for turned in [false, true] {
        let size = ImageSize { width: 400, height: 400 };
        let lane = Lane {
            id: LaneId::new(1).expect("1 to 8"),
            direction: Direction::Away,
            length_m: 80.0,
        };
        let description = Description {
            image_size: size,
            lanes: [lane].into_iter().collect(),
            ..table(TABLES[0]).description().clone()
        };
        let place = |point: ImagePoint| {
            let (along, across) = if turned { (point.u, point.v) } else { (point.v, point.u) };
            let is_on = (200.0..220.0).contains(&across) && (40.0..360.0).contains(&along);
            is_on.then_some(Place { lane: lane.id, s_m: (along - 40.0) * 0.25, span_m: 0.25 })
        };
        let pieces = pieces(&description, place);
        assert_eq!(pieces.len(), 16);
        for piece in &pieces {
            assert!((piece.width - 20.0).abs() < 0.1, "{piece:?}");
            let [x0, y0, x1, y1] = piece.extent;
            // A vehicle reaches 6 m, 24 px, along the lane, whichever way that runs.
            let (beyond, above) = if turned { (36.0, 22.0) } else { (12.0, 46.0) };
            let along = if turned { x1 - x0 } else { y1 - y0 };
            assert!(along > 20.0 + 24.0, "{piece:?}");
            let edge = if turned { (y0, 200.0 - above) } else { (x0, 200.0 - beyond) };
            assert!((edge.0 - edge.1).abs() < 0.2, "{piece:?}: {edge:?}");
        }
    }
}

#[test]
fn one_part_where_a_second_buys_nothing() {
    let size = ImageSize { width: 640, height: 480 };
    // From 10 to 25 m every car is 40 px wide or wider.
    let short = straight(size, 3, 8.0, 700.0, 15.0);
    assert_eq!(short.count(), 1, "{short:?}");
    let long = straight(size, 3, 8.0, 700.0, 110.0);
    assert_eq!(long.count(), 2, "{long:?}");
    let mut one = long.clone();
    one.keep_one();
    assert_eq!(one.of((640, 480))[..], long.of((640, 480))[..1]);
}

#[test]
fn a_table_without_a_pixel_of_road_leaves_the_whole_picture() {
    let table = table(TABLES[0]);
    assert_eq!(Parts::new(table.description(), |_| None, INPUT).count(), 0);
    assert!(Parts::WHOLE.of((320, 240)).is_empty());
}
