//! The sums of one site: what a report draws.
//!
//! Means are over windows with a known density; what is not known counts in the completeness
//! alone.

use super::sums::Mean;
use crate::store::DAY_MS;

/// Bins of a day: 15 minutes, as the paper's figures have it.
pub const BINS: usize = 96;
/// Lanes are numbered 1 to 8.
pub const LANES: usize = 8;
/// Most cells along a road: more are faults.
const MOST_CELLS: usize = 4096;

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
    /// The site.
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
}

impl Summary {
    /// Of a site, without a window as yet.
    pub(super) fn new(site: &str, window_s: Option<i32>) -> Self {
        Self {
            site: site.to_owned(),
            window_s,
            rows: 0,
            day_by_lane: vec![[Mean::default(); LANES]; BINS],
            week: vec![[Mean::default(); BINS]; 7],
            along: Default::default(),
            days: Vec::new(),
        }
    }

    /// Takes the windows of a lane (from 0) at one weekday and time.
    pub(super) fn add_time(&mut self, weekday: usize, bin: usize, lane: usize, densities: Mean) {
        self.day_by_lane[bin][lane].add(densities);
        self.week[weekday][bin].add(densities);
    }

    /// Takes all groups of cells.
    pub(super) fn add_cells(&mut self, groups: &[CellGroup]) {
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
pub(super) struct CellGroup {
    /// From 0.
    pub lane: usize,
    /// Not a number where it is not known.
    pub position_m: f32,
    pub length_m: f32,
    pub bin: usize,
    pub densities: Mean,
    /// The first window with a density.
    pub since_ms: i64,
}
