//! The sums of one site: what a report draws, from the rows that the queries return.
//!
//! Means are over windows with a known density; what is not known counts in the completeness
//! alone. Densities have 24 bits and are added up in 53: below 2^29 times the least of them
//! their sums are exact, and so the same in whatever order they were added.

use super::queries::{BINS, LANES};
use super::trouble::Trouble;
use crate::store::DAY_MS;
use datafusion::arrow::array::{Array, AsArray, PrimitiveArray, RecordBatch};
use datafusion::arrow::datatypes::{
    ArrowPrimitiveType, Float32Type, Float64Type, Int32Type, Int64Type,
};
use std::collections::BTreeMap;

/// Most cells along a road: more are faults.
const MOST_CELLS: usize = 4096;

/// Standard errors of a mean within which 90 % of it lies.
const Z90: f64 = 1.645;

/// A running mean, with its errors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mean {
    sum: f64,
    /// Values in it.
    pub count: u64,
    /// Of those whose parts of error are known.
    errors: Errors,
}

/// Sums over values of which sampling, calibration and counting errors are known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Errors {
    count: u64,
    /// Of the sampling errors' squares.
    variance: f64,
    calibration: f64,
    counting: f64,
}

impl Mean {
    fn add(&mut self, other: Self) {
        self.sum += other.sum;
        self.count += other.count;
        let (errors, others) = (&mut self.errors, other.errors);
        errors.count += others.count;
        errors.variance += others.variance;
        errors.calibration += others.calibration;
        errors.counting += others.counting;
    }

    /// Takes in another mean's value as one, of which no error is known.
    pub fn add_mean(&mut self, other: Self) {
        if let Some(value) = other.value() {
            self.sum += value;
            self.count += 1;
        }
    }

    /// The mean; none of nothing.
    pub fn value(self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
    }

    /// The interval that holds the mean with a probability of 90 %; none where an error of one of
    /// its values is not known.
    ///
    /// Sampling errors of windows are independent, and their mean is that much smaller; calibration
    /// and counting err alike in all of them, and their errors stay.
    pub fn interval(self) -> Option<[f64; 2]> {
        let (mean, Errors { count, variance, calibration, counting }) =
            (self.value()?, self.errors);
        let n = count as f64;
        let joint = (variance + calibration.powi(2) + counting.powi(2)).sqrt() / n;
        (count == self.count).then_some([(mean - Z90 * joint).max(0.0), mean + Z90 * joint])
    }
}

/// Windows of one day (UTC) and lane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Windows {
    /// In the archive.
    pub archived: u32,
    /// With a density.
    pub known: u32,
}

/// Density along one lane.
#[derive(Clone, Debug, Default)]
pub struct Along {
    /// Length of a cell, m; lanes differ by a little.
    pub cell_m: f32,
    /// Cell, from the lane's upstream end, x time of day.
    pub day: Vec<[Mean; BINS]>,
}

impl Along {
    fn add(&mut self, bin: usize, position_m: f32, densities: Mean) {
        // Cells of another length, from another lane table, go to the nearest of these.
        let cell = (position_m / self.cell_m).round();
        if !(0.0..MOST_CELLS as f32).contains(&cell) {
            return;
        }
        let cell = cell as usize;
        if cell >= self.day.len() {
            self.day.resize(cell + 1, [Mean::default(); BINS]);
        }
        self.day[cell][bin].add(densities);
    }

    /// Where a cell begins, m.
    pub fn position_m(&self, cell: usize) -> f64 {
        cell as f64 * f64::from(self.cell_m)
    }

    /// The mean of each cell over all windows.
    pub fn means(&self) -> impl Iterator<Item = Mean> {
        self.day.iter().map(|bins| {
            let mut all = Mean::default();
            bins.iter().for_each(|bin| all.add(*bin));
            all
        })
    }
}

/// The sums of one site.
#[derive(Clone, Debug)]
pub struct Summary {
    /// Which.
    pub site: String,
    /// Length of the windows, s; none where there are none.
    pub window_s: Option<i32>,
    /// Rows read, of lanes and cells.
    pub rows: u64,
    /// Time of day x lane (from 0).
    pub day_by_lane: Vec<[Mean; LANES]>,
    /// Weekday (Monday first) x time of day, over all lanes.
    pub week: Vec<[Mean; BINS]>,
    /// Each lane (from 0) along the road; empty where boxes measure no cells.
    pub along: [Along; LANES],
    /// Days since 1970 (UTC), each with its lanes.
    pub days: Vec<(i64, [Windows; LANES])>,
    /// What is wrong at the end, the oldest first.
    pub trouble: Vec<Trouble>,
}

impl Summary {
    /// Of a site, from the rows of `queries::lanes`: of the shortest windows in them.
    pub(super) fn of_lanes(site: &str, batches: &[RecordBatch]) -> Self {
        let windows = |batch| column::<Int32Type>(batch, "window_s");
        let window_s = batches.iter().flat_map(|batch| windows(batch).values()).min().copied();
        let mut summary = Self {
            site: site.to_owned(),
            window_s,
            rows: 0,
            day_by_lane: vec![[Mean::default(); LANES]; BINS],
            week: vec![[Mean::default(); BINS]; 7],
            along: Default::default(),
            days: Vec::new(),
            trouble: Vec::new(),
        };
        let mut days = BTreeMap::<i64, [Windows; LANES]>::new();
        for batch in batches {
            let (windows, lanes) = (windows(batch), column::<Int32Type>(batch, "lane"));
            let integers = |name| column::<Int64Type>(batch, name);
            let (weekdays, bins, dates) = (integers("weekday"), integers("bin"), integers("day"));
            let (archived, sums) = (integers("archived"), Sums::of(batch));
            for row in 0..batch.num_rows() {
                if Some(windows.value(row)) != window_s {
                    continue;
                }
                let lane = (lanes.value(row) - 1) as usize;
                if dates.is_null(row) {
                    let (weekday, bin) = (weekdays.value(row), bins.value(row) as usize);
                    summary.day_by_lane[bin][lane].add(sums.get(row));
                    summary.week[weekday as usize][bin].add(sums.get(row));
                } else {
                    summary.rows += archived.value(row) as u64;
                    let known = sums.get(row).count as u32;
                    days.entry(dates.value(row)).or_default()[lane] =
                        Windows { archived: archived.value(row) as u32, known };
                }
            }
        }
        summary.days = days.into_iter().collect();
        summary
    }

    /// Takes the rows of `queries::cells`.
    pub(super) fn add_cells(&mut self, batches: &[RecordBatch]) {
        let groups: Vec<CellGroup> = batches.iter().flat_map(CellGroup::all).collect();
        self.rows += groups.iter().map(|group| group.archived).sum::<u64>();
        let known = || groups.iter().filter(|group| group.densities.count > 0);
        // A lane's first cell is a whole one; its last may be short.
        let mut first = [(i64::MAX, f32::INFINITY); LANES];
        for group in known() {
            let place = (group.since_ms, group.position_m);
            if place < first[group.lane] {
                first[group.lane] = place;
                self.along[group.lane].cell_m = group.length_m;
            }
        }
        for group in known() {
            self.along[group.lane].add(group.bin, group.position_m, group.densities);
        }
    }

    /// Whether no row was of the wanted length.
    pub fn is_empty(&self) -> bool {
        self.days.is_empty()
    }

    /// Lanes (from 0) that have windows.
    pub fn lanes(&self) -> Vec<usize> {
        (0..LANES).filter(|&lane| self.days.iter().any(|day| day.1[lane].archived > 0)).collect()
    }

    /// Lanes (from 0) of which there are densities along the road.
    pub fn lanes_along(&self) -> Vec<usize> {
        (0..LANES).filter(|&lane| !self.along[lane].day.is_empty()).collect()
    }

    /// Windows that a day and lane would have.
    pub fn expected(&self) -> u32 {
        (DAY_MS / 1000 / i64::from(self.window_s.unwrap_or(60).max(1))) as u32
    }

    /// The share of a day's windows that are archived, and that have a density, over lanes.
    pub fn completeness(&self, windows: &[Windows; LANES]) -> [f64; 2] {
        let lanes = self.lanes();
        let all = f64::from(self.expected()) * lanes.len().max(1) as f64;
        let sum = |f: fn(&Windows) -> u32| -> f64 {
            lanes.iter().map(|&lane| f64::from(f(&windows[lane]))).sum()
        };
        [sum(|w| w.archived) / all, sum(|w| w.known) / all]
    }

    /// The same over all days, in percent; days without a file count as missing.
    pub fn completeness_pct(&self) -> [f64; 2] {
        let all = self.days.last().map_or(0, |d| d.0) - self.days.first().map_or(0, |d| d.0) + 1;
        let mut share = [0.0; 2];
        for (_, windows) in &self.days {
            let [archived, known] = self.completeness(windows);
            share = [share[0] + archived, share[1] + known];
        }
        share.map(|sum| sum / all as f64 * 100.0)
    }

    /// The mean density over everything, veh/km/lane.
    pub fn mean(&self) -> Mean {
        let mut mean = Mean::default();
        self.day_by_lane.iter().flatten().for_each(|bin| mean.add(*bin));
        mean
    }

    /// The same without what only the site's own page shows, so that many fit into memory.
    pub fn without_places(mut self) -> Self {
        self.along = Default::default();
        self
    }
}

/// Cells of one lane, place and time of day.
struct CellGroup {
    /// From 0.
    lane: usize,
    position_m: f32,
    length_m: f32,
    bin: usize,
    archived: u64,
    densities: Mean,
    /// The first window with a density.
    since_ms: i64,
}

impl CellGroup {
    fn all(batch: &RecordBatch) -> impl Iterator<Item = Self> {
        let (lanes, sums) = (column::<Int32Type>(batch, "lane"), Sums::of(batch));
        let metres = |name| column::<Float32Type>(batch, name);
        let (positions, lengths) = (metres("position_m"), metres("length_m"));
        let integers = |name| column::<Int64Type>(batch, name);
        let (bins, archived, since) = (integers("bin"), integers("archived"), integers("first"));
        (0..batch.num_rows()).map(move |row| Self {
            lane: (lanes.value(row) - 1) as usize,
            position_m: if positions.is_null(row) { f32::NAN } else { positions.value(row) },
            length_m: lengths.value(row),
            bin: bins.value(row) as usize,
            archived: archived.value(row) as u64,
            densities: sums.get(row),
            since_ms: since.value(row),
        })
    }
}

/// Sums of densities and their counts, and of their errors where the query asks for them.
struct Sums<'a> {
    density: &'a PrimitiveArray<Float64Type>,
    known: &'a PrimitiveArray<Int64Type>,
    errors: Option<(&'a PrimitiveArray<Int64Type>, [&'a PrimitiveArray<Float64Type>; 3])>,
}

impl<'a> Sums<'a> {
    fn of(batch: &'a RecordBatch) -> Self {
        let errors = batch.column_by_name("stated").is_some().then(|| {
            let parts = ["variance", "calibration", "counting"].map(|name| column(batch, name));
            (column(batch, "stated"), parts)
        });
        Self { density: column(batch, "density"), known: column(batch, "known"), errors }
    }

    fn get(&self, row: usize) -> Mean {
        // A sum of nothing is null, and 0 below that.
        let sum = |of: &PrimitiveArray<Float64Type>| {
            if of.is_null(row) { 0.0 } else { of.value(row) }
        };
        let errors = self.errors.map_or_else(Errors::default, |(count, parts)| {
            let [variance, calibration, counting] = parts.map(sum);
            Errors { count: count.value(row) as u64, variance, calibration, counting }
        });
        Mean { sum: sum(self.density), count: self.known.value(row) as u64, errors }
    }
}

pub(super) fn column<'a, T: ArrowPrimitiveType>(
    batch: &'a RecordBatch,
    name: &str,
) -> &'a PrimitiveArray<T> {
    batch.column_by_name(name).expect("the queries name it").as_primitive()
}

#[cfg(test)]
mod tests {
    use super::super::engine::Engine;
    use super::super::queries::{self, Scope};
    use super::*;
    use crate::store::{self, Partition, Row};

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
        }
    }

    /// Sums of one day's rows, Hong Kong time.
    fn summary(mut rows: Vec<Row>) -> Summary {
        let folder = tempfile::tempdir().unwrap();
        let day = Partition { site: "a".into(), day: FROM.div_euclid(DAY_MS) };
        rows.sort_by_key(Row::key);
        store::write(&day.path(folder.path()), &rows).unwrap();
        let mut scope = Scope {
            site: "a".into(),
            days: [day.day; 2],
            without: Vec::new(),
            window_s: None,
            offset_ms: 8 * 3_600_000,
        };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let engine = Engine::open(folder.path(), None, 1).await.unwrap();
            let batches = engine.ask(&queries::lanes(&scope)).await.unwrap();
            let mut summary = Summary::of_lanes("a", &batches);
            scope.window_s = summary.window_s;
            summary.add_cells(&engine.ask(&queries::cells(&scope)).await.unwrap());
            summary
        })
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
        assert_eq!(
            (summary.along[1].day[5][29].value(), summary.along[1].position_m(5)),
            (None, 55.0)
        );
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
}
