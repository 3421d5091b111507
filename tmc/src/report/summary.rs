//! The sums of one site: everything that a report needs, whatever the number of rows.
//!
//! Means are over windows with a known density; what is not known counts in the completeness
//! alone. Time of day is local and in bins of 15 minutes, as the paper's figures have it.

use crate::store::{Columns, DAY_MS};

/// Bins of a day.
pub const BINS: usize = 96;
const BIN_MS: i64 = DAY_MS / BINS as i64;
/// Lanes are numbered 1 to 8.
pub const LANES: usize = 8;
/// Most cells along a road: more are faults.
const MOST_CELLS: usize = 4096;
/// 1970-01-01 was a Thursday; Monday is 0.
const EPOCH_WEEKDAY: i64 = 3;

/// A running mean.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mean {
    sum: f64,
    /// Values in it.
    pub count: u64,
}

impl Mean {
    fn add(&mut self, value: f32) {
        self.sum += f64::from(value);
        self.count += 1;
    }

    /// Takes in another mean's value as one.
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
    fn add(&mut self, bin: usize, position_m: f32, length_m: f32, density: f32) {
        if self.cell_m <= 0.0 {
            // A lane's first cell is a whole one; its last may be short.
            self.cell_m = length_m;
        }
        // Cells of another length, from another lane table, go to the nearest of these.
        let cell = (position_m / self.cell_m).round();
        if !(0.0..MOST_CELLS as f32).contains(&cell) {
            return;
        }
        let cell = cell as usize;
        if cell >= self.day.len() {
            self.day.resize(cell + 1, [Mean::default(); BINS]);
        }
        self.day[cell][bin].add(density);
    }

    /// Where a cell begins, m.
    pub fn position_m(&self, cell: usize) -> f64 {
        cell as f64 * f64::from(self.cell_m)
    }

    /// The mean of each cell over all windows.
    pub fn means(&self) -> impl Iterator<Item = Mean> {
        self.day.iter().map(|bins| {
            let all = |all: Mean, bin: &Mean| Mean {
                sum: all.sum + bin.sum,
                count: all.count + bin.count,
            };
            bins.iter().fold(Mean::default(), all)
        })
    }
}

/// The sums of one site.
#[derive(Clone, Debug)]
pub struct Summary {
    /// Which.
    pub site: String,
    /// Length of the windows, s; none before the first row.
    pub window_s: Option<i32>,
    offset_ms: i64,
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
}

impl Summary {
    /// Of a site, for windows of that length (none: of the first that comes).
    pub fn new(site: &str, window_s: Option<i32>, offset_ms: i64) -> Self {
        Self {
            site: site.to_owned(),
            window_s,
            offset_ms,
            rows: 0,
            day_by_lane: vec![[Mean::default(); LANES]; BINS],
            week: vec![[Mean::default(); BINS]; 7],
            along: Default::default(),
            days: Vec::new(),
        }
    }

    /// Takes the rows of a day's file, lanes or cells.
    pub fn add(&mut self, day: i64, columns: &Columns) {
        let Some(&first) = columns.window_s.first() else { return };
        let window_s = *self.window_s.get_or_insert(first);
        let lanes = columns.length_m.is_empty();
        let mut windows = [Windows::default(); LANES];
        for i in 0..columns.window_s.len() {
            let lane = (columns.lane[i] - 1) as usize;
            if columns.window_s[i] != window_s || lane >= LANES {
                continue;
            }
            self.rows += 1;
            let density = columns.density[i];
            let local = columns.from_ms[i] + self.offset_ms;
            let bin = (local.rem_euclid(DAY_MS) / BIN_MS) as usize;
            if !lanes {
                if !density.is_nan() {
                    let (position_m, length_m) = (columns.position_m[i], columns.length_m[i]);
                    self.along[lane].add(bin, position_m, length_m, density);
                }
                continue;
            }
            windows[lane].archived += 1;
            if !density.is_nan() {
                windows[lane].known += 1;
                self.day_by_lane[bin][lane].add(density);
                let weekday = (local.div_euclid(DAY_MS) + EPOCH_WEEKDAY).rem_euclid(7) as usize;
                self.week[weekday][bin].add(density);
            }
        }
        if lanes && windows.iter().any(|lane| lane.archived > 0) {
            self.days.push((day, windows));
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

    /// The mean density over everything, veh/km/lane.
    pub fn mean(&self) -> Mean {
        let mut mean = Mean::default();
        for bin in self.day_by_lane.iter().flatten() {
            mean.sum += bin.sum;
            mean.count += bin.count;
        }
        mean
    }

    /// The same without what only the site's own page shows, so that many fit into memory.
    pub fn without_places(mut self) -> Self {
        self.along = Default::default();
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_fall_into_local_time_weekday_and_place() {
        // Monday 5 January 2026, 23:30 UTC, is Tuesday 07:30 in Hong Kong.
        let from = 1_767_655_800_000;
        let mut summary = Summary::new("a", None, 8 * 3_600_000);
        let lanes = Columns {
            window_s: vec![60, 60, 60, 900],
            from_ms: vec![from, from, from + 60_000, from],
            lane: vec![1, 2, 1, 1],
            position_m: vec![f32::NAN; 4],
            length_m: vec![],
            density: vec![10.0, f32::NAN, 20.0, 99.0],
        };
        summary.add(20_458, &lanes);
        let cells = Columns {
            window_s: vec![60; 5],
            from_ms: vec![from; 5],
            lane: vec![1, 1, 2, 2, 2],
            // The sixth cell of 11 m of lane 2 is the sixth, whatever the cells of lane 1.
            position_m: vec![0.0, 10.0, 0.0, 55.0, 66.0],
            length_m: vec![10.0, 4.0, 11.0, 11.0, 11.0],
            density: vec![30.0, 40.0, 50.0, 60.0, f32::NAN],
        };
        summary.add(20_458, &cells);
        assert_eq!((summary.rows, summary.lanes()), (8, vec![0, 1]));
        assert_eq!(summary.day_by_lane[30][0].value(), Some(15.0));
        assert_eq!(summary.day_by_lane[30][1].value(), None);
        assert_eq!(summary.week[1][30], Mean { sum: 30.0, count: 2 });
        assert_eq!(summary.lanes_along(), [0, 1]);
        let means = |lane: usize| summary.along[lane].means().map(Mean::value).collect::<Vec<_>>();
        assert_eq!(means(0), [Some(30.0), Some(40.0)]);
        assert_eq!(means(1), [Some(50.0), None, None, None, None, Some(60.0)]);
        assert_eq!(summary.along[0].day[0][30].value(), Some(30.0));
        assert_eq!(
            (summary.along[1].day[5][29].value(), summary.along[1].position_m(5)),
            (None, 55.0)
        );
        let [archived, known] = summary.completeness(&summary.days[0].1);
        assert!((archived - 3.0 / 2880.0).abs() < 1e-12 && (known - 2.0 / 2880.0).abs() < 1e-12);
        assert_eq!(summary.mean().value(), Some(15.0));
    }
}
