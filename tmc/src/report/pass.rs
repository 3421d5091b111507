//! The sums of a site in one pass over its files.
//!
//! Owns which rows count, and into which group: the groups that `cluster` is asked for in SQL. What
//! is held grows with lanes, cells and days, not with windows.

use super::summary::{BINS, CellGroup, LANES, Summary, Windows};
use super::sums::Mean;
use crate::store::densities::{self, Densities};
use crate::store::{DAY_MS, Partition};
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::Path;
use verge_desk::Failure;
use verge_messages::{LONGEST_WINDOW_S, SHORTEST_WINDOW_S};

const BIN_MS: i64 = DAY_MS / BINS as i64;
/// 1970-01-01 was a Thursday; Monday is 0.
const EPOCH_WEEKDAY: i64 = 3;
/// Densities that a box can measure, and sampling errors of them, veh/km; others are not known.
const DENSITIES: RangeInclusive<f32> = 0.0..=10_000.0;
/// The same of errors from calibration and counting.
const ERRORS: RangeInclusive<f32> = 0.0..=1_000_000.0;

/// Adds up a site's days: windows of `window_s`, or of the shortest length that there is.
///
/// # Errors
/// [`Failure`] with the file that cannot be read.
pub(super) fn site(
    root: &Path,
    site: &str,
    days: &[Partition],
    window_s: Option<i32>,
    offset_ms: i64,
) -> Result<Summary, Failure> {
    let (least, most) = (SHORTEST_WINDOW_S as i32, LONGEST_WINDOW_S as i32);
    let lengths = window_s.map_or(least..=most, |asked| asked.max(least)..=asked.min(most));
    let mut pass = Pass { lengths, offset_ms, sums: Sums::of(None) };
    for day in days {
        densities::each(&day.path(root), |rows| pass.add(rows))?;
    }
    Ok(pass.sums.finish(site))
}

struct Pass {
    /// Lengths of windows that count, s.
    lengths: RangeInclusive<i32>,
    /// Local time ahead of UTC.
    offset_ms: i64,
    sums: Sums,
}

/// Sums of the windows of one length.
struct Sums {
    window_s: Option<i32>,
    rows: u64,
    /// Weekday (Monday first) x time of day x lane.
    week: Vec<[[Mean; LANES]; BINS]>,
    days: BTreeMap<i64, [Windows; LANES]>,
    /// By lane (from 0), and by position and length as bits.
    places: BTreeMap<(usize, u32, u32), Place>,
}

/// Cells of one lane, position and length.
struct Place {
    day: [Mean; BINS],
    /// The first window with a density, ms since 1970.
    since_ms: i64,
}

impl Pass {
    fn add(&mut self, rows: &Densities) {
        let is_cell = |row: usize| rows.is_cell.get(row).copied().unwrap_or(false);
        for (row, window_s) in rows.window_s.iter().enumerate() {
            let (from_ms, lane) = (rows.from_ms[row], rows.lane[row]);
            let counts = self.lengths.contains(window_s)
                && (1..=LANES as i32).contains(&lane)
                && from_ms >= 0;
            if !counts {
                continue;
            }
            let lane = (lane - 1) as usize;
            if is_cell(row) {
                // Files have lanes before cells (`Row::key`): a length that no lane had is not the
                // site's.
                if self.sums.window_s == Some(*window_s) {
                    self.add_cell(rows, row, lane);
                }
                continue;
            }
            if self.sums.window_s != Some(*window_s) {
                if self.sums.window_s.is_some_and(|shortest| shortest < *window_s) {
                    continue;
                }
                self.sums = Sums::of(Some(*window_s));
            }
            self.add_lane(rows, row, lane);
        }
    }

    /// The time of day of a row, as a bin.
    fn bin(&self, from_ms: i64) -> usize {
        ((from_ms + self.offset_ms).rem_euclid(DAY_MS) / BIN_MS) as usize
    }

    fn add_lane(&mut self, rows: &Densities, row: usize, lane: usize) {
        let (from_ms, density) = (rows.from_ms[row], rows.density[row]);
        let bin = self.bin(from_ms);
        let local_day = (from_ms + self.offset_ms).div_euclid(DAY_MS);
        let sums = &mut self.sums;
        sums.rows += 1;
        let windows = &mut sums.days.entry(from_ms / DAY_MS).or_default()[lane];
        windows.archived += 1;
        if !DENSITIES.contains(&density) {
            return;
        }
        windows.known += 1;
        let weekday = (local_day + EPOCH_WEEKDAY).rem_euclid(7) as usize;
        let [sampling, calibration, counting] =
            rows.errors.each_ref().map(|errors| errors.get(row).copied().unwrap_or(f32::NAN));
        let stated = DENSITIES.contains(&sampling)
            && ERRORS.contains(&calibration)
            && ERRORS.contains(&counting);
        let errors = stated.then_some([sampling, calibration, counting]);
        sums.week[weekday][bin][lane].add_one(density, errors);
    }

    fn add_cell(&mut self, rows: &Densities, row: usize, lane: usize) {
        let (from_ms, density) = (rows.from_ms[row], rows.density[row]);
        self.sums.rows += 1;
        if !DENSITIES.contains(&density) {
            return;
        }
        let bin = self.bin(from_ms);
        let [position, length] = rows.places.each_ref().map(|places| places[row].to_bits());
        let new = || Place { day: [Mean::default(); BINS], since_ms: i64::MAX };
        let place = self.sums.places.entry((lane, position, length)).or_insert_with(new);
        place.since_ms = place.since_ms.min(from_ms);
        place.day[bin].add_one(density, None);
    }
}

impl Sums {
    fn of(window_s: Option<i32>) -> Self {
        Self {
            window_s,
            rows: 0,
            week: vec![[[Mean::default(); LANES]; BINS]; 7],
            days: BTreeMap::new(),
            places: BTreeMap::new(),
        }
    }

    fn finish(self, site: &str) -> Summary {
        let mut summary = Summary::new(site, self.window_s);
        summary.rows = self.rows;
        summary.days = self.days.into_iter().collect();
        for (weekday, bins) in self.week.iter().enumerate() {
            for (bin, lanes) in bins.iter().enumerate() {
                for (lane, mean) in lanes.iter().enumerate() {
                    summary.add_time(weekday, bin, lane, *mean);
                }
            }
        }
        let groups = self.places.into_iter().flat_map(|((lane, position, length), place)| {
            let known = place.day.into_iter().enumerate().filter(|(_, mean)| mean.count > 0);
            known.map(move |(bin, densities)| CellGroup {
                lane,
                position_m: f32::from_bits(position),
                length_m: f32::from_bits(length),
                bin,
                densities,
                since_ms: place.since_ms,
            })
        });
        summary.add_cells(&groups.collect::<Vec<_>>());
        summary
    }
}
