//! Sums over archives with known content.

use super::{Mean, Summary, pass};
use crate::store::{self, DAY_MS, Partition, Row};

/// Monday 5 January 2026, 23:30 UTC, is Tuesday 07:30 in Hong Kong.
const FROM: i64 = 1_767_655_800_000;

fn lane(window_s: i32, from_ms: i64, lane: i32, density: Option<f32>) -> Row {
    Row {
        window_s,
        from_ms,
        lane,
        cell: None,
        position_m: None,
        length_m: 77.0,
        density,
        se: None,
        vehicles: None,
        occupancy: None,
        frames_used: 30,
        frames_expected: 30,
        status: 2,
        seq: 1,
        clock_synced: true,
        rel_err: None,
        ci90: None,
        calibration_se: None,
        counting_se: None,
        traffic: None,
    }
}

/// Sums of one day's rows, Hong Kong time.
fn summary(mut rows: Vec<Row>) -> Summary {
    let folder = tempfile::tempdir().unwrap();
    let day = Partition { site: "a".into(), day: FROM.div_euclid(DAY_MS) };
    rows.sort_by_key(Row::key);
    store::write(&day.path(folder.path()), &rows).unwrap();
    pass::site(folder.path(), "a", &[day], None, 8 * 3_600_000).unwrap()
}

#[test]
fn rows_fall_into_local_time_weekday_and_place() {
    let cell = |number, cell, position_m, length_m, density| Row {
        cell: Some(cell),
        position_m: Some(position_m),
        length_m,
        ..lane(60, FROM, number, density)
    };
    let summary = summary(vec![
        lane(60, FROM, 1, Some(10.0)),
        lane(60, FROM, 2, None),
        lane(60, FROM + 60_000, 1, Some(20.0)),
        lane(900, FROM, 1, Some(99.0)),
        cell(1, 0, 0.0, 10.0, Some(30.0)),
        cell(1, 1, 10.0, 4.0, Some(40.0)),
        // The sixth cell of 11 m of lane 2 is the sixth, whatever the cells of lane 1.
        cell(2, 0, 0.0, 11.0, Some(50.0)),
        cell(2, 5, 55.0, 11.0, Some(60.0)),
        cell(2, 6, 66.0, 11.0, None),
    ]);
    assert_eq!((summary.rows, summary.lanes()), (8, vec![0, 1]));
    assert_eq!(summary.day_by_lane[30][0].value(), Some(15.0));
    assert_eq!(summary.day_by_lane[30][1].value(), None);
    assert_eq!((summary.week[1][30].sum, summary.week[1][30].count), (30.0, 2));
    assert_eq!(summary.lanes_along(), [0, 1]);
    let means = |lane: usize| summary.along[lane].means().map(Mean::value).collect::<Vec<_>>();
    assert_eq!(means(0), [Some(30.0), Some(40.0)]);
    assert_eq!(means(1), [Some(50.0), None, None, None, None, Some(60.0)]);
    assert_eq!(summary.along[0].day[0][30].value(), Some(30.0));
    assert_eq!((summary.along[1].day[5][29].value(), summary.along[1].position_m(5)), (None, 55.0));
    assert_eq!(summary.days[0].0, 20_458);
    let [archived, known] = summary.completeness(&summary.days[0].1);
    assert!((archived - 3.0 / 2880.0).abs() < 1e-12 && (known - 2.0 / 2880.0).abs() < 1e-12);
    assert_eq!(summary.mean().value(), Some(15.0));
}

#[test]
fn the_interval_of_a_mean_is_known_where_that_of_each_window_is() {
    let errors = |sampling: f32, calibration, counting, row: Row| Row {
        se: Some(sampling),
        calibration_se: Some(calibration),
        counting_se: Some(counting),
        ..row
    };
    let of = |minute: i64, density| lane(60, FROM + minute * 60_000, 1, Some(density));
    let stated = [errors(3.0, 1.0, 1.5, of(0, 10.0)), errors(4.0, 2.0, 2.5, of(1, 20.0))];
    let found = summary(stated.to_vec()).day_by_lane[30][0].interval();
    // Sampling 5 / 2, calibration 3 / 2, counting 4 / 2.
    let joint = (2.5f64.powi(2) + 1.5f64.powi(2) + 2.0f64.powi(2)).sqrt();
    let [low, high] = found.expect("all is known");
    assert!((low - (15.0 - 1.645 * joint)).abs() < 1e-12, "{low}");
    assert!((high - (15.0 + 1.645 * joint)).abs() < 1e-12, "{high}");
    let mut partly = stated.to_vec();
    partly.push(of(2, 10.0));
    let mean = summary(partly).day_by_lane[30][0];
    assert_eq!((mean.count, mean.interval()), (3, None));
}

#[test]
fn a_new_lane_table_goes_to_the_cells_of_the_first() {
    let cell = |minute: i64, position_m, length_m, density| Row {
        cell: Some(0),
        position_m: Some(position_m),
        length_m,
        ..lane(60, FROM + minute * 60_000, 1, density)
    };
    let summary = summary(vec![
        lane(60, FROM, 1, None),
        // Not known: its cells of 5 m are not the first.
        cell(0, 0.0, 5.0, None),
        cell(1, 0.0, 10.0, Some(1.0)),
        cell(1, 10.0, 10.0, Some(2.0)),
        cell(2, 0.0, 9.0, Some(3.0)),
        cell(2, 9.0, 9.0, Some(6.0)),
        cell(2, 18.0, 9.0, Some(9.0)),
    ]);
    let means: Vec<_> = summary.along[0].means().map(Mean::value).collect();
    assert_eq!(summary.along[0].cell_m, 10.0);
    assert_eq!(means, [Some(2.0), Some(4.0), Some(9.0)]);
    assert_eq!(summary.rows, 7);
}
