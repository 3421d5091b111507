//! The archive on disk: one Parquet file a site and day.
//!
//! `ROOT/site=NAME/date=YYYY-MM-DD/density.parquet`, the layout that Parquet readers know as
//! Hive partitions; the date is that of the window's beginning in UTC. The first row groups
//! have a row for each lane and window (`cell` and `position_m` are null), those behind them,
//! where boxes measure it, one for each cell of a lane. What is not known is null. Names in ROOT
//! that begin with `_` are the archivers' own. A folder that is not the archive's is passed
//! over, and named.

pub mod densities;
pub mod events;
mod read;
mod row;
mod schema;
mod write;

pub use read::{Rows, read};
pub use row::{Moving, Row};
pub use schema::arrow_schema;
pub use write::{write, write_rows};

use std::path::{Path, PathBuf};
use verge_desk::Failure;

/// A day, ms.
pub const DAY_MS: i64 = 86_400_000;
const FILE: &str = "density.parquet";

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

/// The sites that have a folder, by name.
///
/// # Errors
/// [`Failure`] where `root` is not there.
pub fn sites(root: &Path) -> Result<Vec<String>, Failure> {
    let all = named(root, "site=")?.into_iter().map(|(site, _)| site);
    let mut sites: Vec<_> = all.filter(|site| crate::message::is_site(site)).collect();
    sites.sort();
    Ok(sites)
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

#[cfg(test)]
mod tests;
