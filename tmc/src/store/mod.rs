//! The archive on disk: one Parquet file a site and day.
//!
//! `ROOT/site=NAME/date=YYYY-MM-DD/density.parquet`, the layout that Parquet readers know as
//! Hive partitions; the date is that of the window's beginning in UTC. The first row groups
//! have a row for each lane and window (`cell` and `position_m` are null), those behind them,
//! where boxes measure it, one for each cell of a lane. What is not known is null. Names in ROOT
//! that begin with `_` are the archivers' own. A folder that is not the archive's is passed
//! over, and named.

mod parquet_file;

pub use parquet_file::{Rows, arrow_schema, read, write, write_rows};

use std::path::{Path, PathBuf};
use verge_desk::Failure;

/// A day, ms.
pub const DAY_MS: i64 = 86_400_000;
const FILE: &str = "density.parquet";

/// One row: a lane, or a cell of it, in a window.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Length of the window, s.
    pub window_s: i32,
    /// Its beginning, ms since 1970.
    pub from_ms: i64,
    /// Lane, from 1.
    pub lane: i32,
    /// Cell of the lane, from 0 at its upstream end; none: the whole lane.
    pub cell: Option<i32>,
    /// Where the cell begins along the lane, m.
    pub position_m: Option<f32>,
    /// Length of lane or cell, m.
    pub length_m: f32,
    /// Density, veh/km.
    pub density: Option<f32>,
    /// One standard error of it from sampling, veh/km.
    pub se: Option<f32>,
    /// Mean number of vehicles.
    pub vehicles: Option<f32>,
    /// Share of the length that vehicles cover.
    pub occupancy: Option<f32>,
    /// Frames used.
    pub frames_used: i32,
    /// Frames expected.
    pub frames_expected: i32,
    /// Status, a number of NTCIP 1209.
    pub status: i32,
    /// Number of the message among the site's.
    pub seq: i64,
    /// Whether the box's clock was set.
    pub clock_synced: bool,
    /// One standard error of a length from calibration, as a fraction.
    pub rel_err: Option<f32>,
    /// Interval that holds the density with a probability of 90 %, veh/km.
    pub ci90: Option<[f32; 2]>,
    /// One standard error of the density from calibration, veh/km.
    pub calibration_se: Option<f32>,
    /// One standard error of the density from counting, veh/km.
    pub counting_se: Option<f32>,
}

impl Row {
    /// Its place in the file.
    pub fn key(&self) -> (bool, i32, i64, i32, i32) {
        let cell = self.cell.unwrap_or(-1);
        (self.cell.is_some(), self.window_s, self.from_ms, self.lane, cell)
    }
}

/// A partition: one site's day.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Partition {
    /// The site.
    pub site: String,
    /// Days since 1970, UTC.
    pub day: i64,
}

impl Partition {
    /// The file of this partition under `root`.
    pub fn path(&self, root: &Path) -> PathBuf {
        root.join(format!("site={}", self.site)).join(format!("date={}", self.date())).join(FILE)
    }

    /// The day as YYYY-MM-DD.
    pub fn date(&self) -> String {
        date(self.day)
    }
}

/// A day since 1970 as YYYY-MM-DD.
pub fn date(day: i64) -> String {
    let time = jiff::Timestamp::from_millisecond(day * DAY_MS).unwrap_or_default();
    time.to_string()[..10].to_owned()
}

/// Every partition that has a file, by site and day.
///
/// # Errors
/// [`Failure`] where `root` is not there.
pub fn partitions(root: &Path) -> Result<Vec<Partition>, Failure> {
    let mut found = Vec::new();
    for (site, folder) in named(root, "site=")? {
        if !crate::message::is_site(&site) {
            pass_over(&folder, "it has no site's name");
            continue;
        }
        match days(&site, &folder) {
            Ok(days) => found.extend(days),
            Err(failure) => eprintln!("verge-tmc: passed over: {failure}"),
        }
    }
    found.sort();
    Ok(found)
}

/// The partitions of one site that have a file, by day.
///
/// # Errors
/// As [`partitions`].
pub fn site_partitions(root: &Path, site: &str) -> Result<Vec<Partition>, Failure> {
    let mut found = days(site, &root.join(format!("site={site}")))?;
    found.sort();
    Ok(found)
}

fn days(site: &str, folder: &Path) -> Result<Vec<Partition>, Failure> {
    let mut found = Vec::new();
    for (date, folder) in named(folder, "date=")? {
        // A box whose clock is not set measures in 1970.
        let day = date.parse::<jiff::civil::Date>().ok().filter(|day| day.year() >= 1970);
        let Some(day) = day.filter(|day| day.to_string() == date) else {
            pass_over(&folder, "it is not a day's: date=YYYY-MM-DD");
            continue;
        };
        let epoch = jiff::civil::Date::constant(1970, 1, 1);
        let day = day.duration_since(epoch).as_hours() / 24;
        if folder.join(FILE).exists() {
            found.push(Partition { site: site.to_owned(), day });
        }
    }
    Ok(found)
}

fn pass_over(folder: &Path, reason: &str) {
    eprintln!("verge-tmc: {:?} is passed over: {reason}", folder.display().to_string());
}

/// Folders named `prefix` and something, with that something.
fn named(folder: &Path, prefix: &str) -> Result<Vec<(String, PathBuf)>, Failure> {
    let failed = |source| Failure::reading(folder, source);
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if let Some(value) = name.strip_prefix(prefix) {
            found.push((value.to_owned(), entry.path()));
        }
    }
    Ok(found)
}
