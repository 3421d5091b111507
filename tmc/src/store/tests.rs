//! Density files, written and read, whole and damaged.

use super::write::GROUP_ROWS;
use super::*;

fn row(from_ms: i64, lane: i32, cell: Option<i32>) -> Row {
    let known = lane == 1;
    Row {
        window_s: 60,
        from_ms,
        lane,
        cell,
        position_m: cell.map(|cell| cell as f32 * 10.0),
        length_m: 10.0,
        density: known.then_some(from_ms as f32),
        se: known.then_some(0.5),
        vehicles: None,
        occupancy: known.then_some(0.25),
        frames_used: 3,
        frames_expected: 4,
        status: if known { 2 } else { 10 },
        seq: from_ms / 60_000,
        clock_synced: known,
        rel_err: known.then_some(0.02),
        ci90: known.then_some([1.0, 2.5]),
        calibration_se: known.then_some(0.125),
        counting_se: None,
        traffic: (known && cell.is_none()).then_some(Moving {
            status: 2,
            flow: Some(875.5),
            flow_ci90: Some([800.0, 950.0]),
            speed: Some(36.1),
            speed_ci90: None,
            occupancy: Some(0.1),
            queue_m: None,
            passed: Some(12),
        }),
    }
}

#[test]
fn rows_come_back_as_they_were() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.parquet");
    let mut rows: Vec<Row> = (0..500)
        .flat_map(|i| {
            let of = move |lane, cell| row(i * 60_000, lane, cell);
            [of(1, None), of(2, None), of(1, Some(0)), of(1, Some(1))]
        })
        .collect();
    rows.sort_by_key(Row::key);
    write(&path, &rows).unwrap();
    assert_eq!(read(&path).unwrap(), rows);
}

#[test]
fn a_day_of_many_row_groups_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.parquet");
    let most = 2 * GROUP_ROWS as i64 + 7;
    let mut rows = (0..most).map(|i| row(i * 60_000, 1 + (i % 2) as i32, None));
    write_rows(&path, || Ok(rows.next())).unwrap();
    let mut expected = (0..most).map(|i| row(i * 60_000, 1 + (i % 2) as i32, None));
    for row in Rows::open(&path).unwrap() {
        assert_eq!(row.unwrap(), expected.next().unwrap());
    }
    assert!(expected.next().is_none());
    // A row that cannot be had leaves the old file.
    let gone = || Failure::content(Path::new("x"), 0, "is gone");
    let mut count = 0;
    let failed = write_rows(&path, || {
        count += 1;
        if count < 9 { Ok(Some(row(0, 1, None))) } else { Err(gone()) }
    });
    assert_eq!(failed.unwrap_err().to_string(), gone().to_string());
    assert_eq!(read(&path).unwrap().len() as i64, most);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn damage_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.parquet");
    write(&path, &[row(0, 1, None)]).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert!(read(&path).unwrap_err().to_string().contains("is damaged"));
    assert!(matches!(read(&folder.path().join("b")), Err(Failure::Missing { .. })));
}

#[test]
fn whatever_is_damaged_is_an_error_or_rows_and_never_a_panic() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.parquet");
    let rows: Vec<Row> = (0..40).map(|i| row(i * 60_000, 1, (i > 20).then_some(3))).collect();
    write(&path, &rows).unwrap();
    let whole = std::fs::read(&path).unwrap();
    let said = std::panic::take_hook();
    std::panic::set_hook(Box::new(|_| {}));
    let (mut damaged, mut panicked) = (0, 0);
    for bit in (0..whole.len() * 8).step_by(37) {
        let mut wrong = whole.clone();
        wrong[bit / 8] ^= 1 << (bit % 8);
        std::fs::write(&path, &wrong).unwrap();
        let read = read(&path);
        damaged += usize::from(read.is_err());
        panicked += usize::from(read.is_err_and(|e| e.to_string().contains("panicked")));
    }
    std::panic::set_hook(said);
    assert!(damaged > 100 && panicked > 0, "{damaged}, {panicked}");
}
