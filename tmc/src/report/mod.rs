//! `verge-tmc report`: what the archive says about time, weekday and place.
//!
//! Owns the command and its order: each site is read day by day by one thread, which keeps
//! its sums and no rows, then writes the site's folder. `summary` sums, `charts` draws,
//! `page` writes HTML and CSV.

mod charts;
mod page;
mod summary;

pub use summary::{BINS, Mean, Summary};

use crate::failure::{Failure, print};
use crate::store::{self, DAY_MS, Partition};
use crate::whole;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Arguments of `report`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Folder of the archive.
    #[arg(long, value_name = "DIR")]
    archive: PathBuf,
    /// Folder for the report: index.html and a folder for each site.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Only this site; several times for several.
    #[arg(long, value_name = "NAME")]
    site: Vec<String>,
    /// First day, UTC.
    #[arg(long, value_name = "YYYY-MM-DD")]
    from: Option<String>,
    /// Last day, UTC.
    #[arg(long, value_name = "YYYY-MM-DD")]
    to: Option<String>,
    /// Length of the windows that are read, s; without it the shortest of each site.
    #[arg(long, value_name = "S")]
    window: Option<i32>,
    /// Local time ahead of UTC, for time of day and weekday: +08:00.
    #[arg(long, value_name = "+HH:MM", default_value = "+00:00", allow_hyphen_values = true)]
    utc_offset: String,
    /// Sites read at the same time; without it as many as there are processors.
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
}

/// Runs `report`.
///
/// # Errors
/// [`Failure`]: no archive, nothing in it that was asked for, a damaged file, an output that
/// cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let offset_ms = offset_ms(&arguments.utc_offset)?;
    let sites = chosen(arguments)?;
    let threads = arguments
        .threads
        .or_else(|| std::thread::available_parallelism().ok().map(Into::into))
        .unwrap_or(1)
        .clamp(1, sites.len());
    let queue = Mutex::new(sites.into_iter());
    let work = || -> Result<Vec<Summary>, Failure> {
        let mut done = Vec::new();
        loop {
            let next = queue.lock().expect("no thread panics with it").next();
            let Some((site, days)) = next else { return Ok(done) };
            let summary = summarise(arguments, &site, &days, offset_ms)?;
            if summary.is_empty() {
                continue;
            }
            let folder = arguments.out.join(&site);
            for (name, bytes) in page::site_files(&summary) {
                whole::write(&folder.join(name), &bytes)?;
            }
            done.push(summary.without_places());
        }
    };
    let results: Vec<Result<Vec<Summary>, Failure>> = std::thread::scope(|scope| {
        let running: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        running.into_iter().map(|thread| thread.join().expect("no thread panics")).collect()
    });
    let mut summaries = Vec::new();
    for result in results {
        summaries.extend(result?);
    }
    summaries.sort_by(|a, b| a.site.cmp(&b.site));
    if summaries.is_empty() {
        let reason = "has no window of that length; leave --window out for the shortest";
        return Err(Failure::content(&arguments.archive, 0, reason));
    }
    for (name, bytes) in page::index_files(&summaries) {
        whole::write(&arguments.out.join(name), &bytes)?;
    }
    let rows: u64 = summaries.iter().map(|summary| summary.rows).sum();
    let count = summaries.len();
    let index = arguments.out.join("index.html");
    print(&format!("{count} sites, {rows} rows: {}\n", index.display()))
}

/// Reads a site's days into sums.
fn summarise(
    arguments: &Arguments,
    site: &str,
    days: &[Partition],
    offset_ms: i64,
) -> Result<Summary, Failure> {
    let mut summary = Summary::new(site, arguments.window, offset_ms);
    for day in days {
        let path = day.path(&arguments.archive);
        store::read_lanes(&path, |columns| summary.add(day.day, columns))?;
    }
    Ok(summary)
}

/// Sites with their days, as asked for.
fn chosen(arguments: &Arguments) -> Result<Vec<(String, Vec<Partition>)>, Failure> {
    let limit = |text: &Option<String>, name: &str, none: i64| {
        let Some(text) = text else { return Ok(none) };
        let time: Result<jiff::Timestamp, _> = format!("{text}T00:00:00Z").parse();
        time.map(|time| time.as_millisecond() / DAY_MS)
            .map_err(|_| Failure::Usage(format!("--{name} {text:?}: give a day as 2026-01-05")))
    };
    let first = limit(&arguments.from, "from", i64::MIN)?;
    let last = limit(&arguments.to, "to", i64::MAX)?;
    let mut sites: Vec<(String, Vec<Partition>)> = Vec::new();
    for partition in store::partitions(&arguments.archive)? {
        let named = arguments.site.is_empty() || arguments.site.contains(&partition.site);
        if !named || !(first..=last).contains(&partition.day) {
            continue;
        }
        match sites.last_mut().filter(|(site, _)| *site == partition.site) {
            Some((_, days)) => days.push(partition),
            None => sites.push((partition.site.clone(), vec![partition])),
        }
    }
    if sites.is_empty() {
        let reason = "has no day that was asked for; look at --site, --from and --to";
        return Err(Failure::content(Path::new(&arguments.archive), 0, reason));
    }
    Ok(sites)
}

fn offset_ms(text: &str) -> Result<i64, Failure> {
    let parsed = || {
        let (sign, rest) = text.split_at_checked(1)?;
        let sign = match sign {
            "+" => 1,
            "-" => -1,
            _ => return None,
        };
        let (hours, minutes) = rest.split_once(':')?;
        let (hours, minutes): (i64, i64) = (hours.parse().ok()?, minutes.parse().ok()?);
        let right = (0..=14).contains(&hours) && (0..60).contains(&minutes);
        right.then_some(sign * (hours * 60 + minutes) * 60_000)
    };
    parsed().ok_or_else(|| Failure::Usage(format!("--utc-offset {text:?}: give +HH:MM")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offsets_are_read() {
        assert_eq!(offset_ms("+08:00").unwrap(), 8 * 3_600_000);
        assert_eq!(offset_ms("-03:30").unwrap(), -12_600_000);
        for wrong in ["8", "+8", "", "+08:60", "+15:00", "08:00"] {
            assert!(offset_ms(wrong).is_err(), "{wrong}");
        }
    }
}
