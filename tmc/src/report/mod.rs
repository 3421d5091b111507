//! `verge-tmc report`: what the archive says about time, weekday and place.
//!
//! Owns the command and its order: the morning of all sites, then some sites at a time, each added up
//! and written into its folder. `pass` adds up, or `cluster` asks others to, in the words of `queries`;
//! `summary` holds the sums, `charts` draws, `page` writes HTML and CSV, `geojson` what maps read.

mod charts;
#[cfg(feature = "ballista")]
mod cluster;
mod geojson;
mod page;
mod pass;
#[cfg(feature = "ballista")]
mod queries;
mod summary;
#[cfg(test)]
mod summary_tests;
mod sums;

pub use summary::{BINS, Summary};
pub use sums::Mean;

use crate::failure::Failure;
use crate::morning::map::Tiles;
use crate::morning::places::{self, Places};
use crate::morning::{Morning, Options};
use crate::store::{self, DAY_MS, Partition, densities};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use verge_desk::{Batch, Failure as Desk, print};

/// Arguments of `report`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Folder of the archive.
    #[arg(long, value_name = "DIR")]
    archive: PathBuf,
    /// Folder for the report: index.html and a folder for each site.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Names and places of the sites: CSV with `site`, and of `name`, `road`,
    /// `direction`, `latitude`, `longitude` and `bearing` what there is.
    #[arg(long, value_name = "FILE.csv")]
    sites: Option<PathBuf>,
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
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,
    /// Source of the map's tiles, https://HOST/{z}/{x}/{y}.png: whoever looks at the page asks it;
    /// without one the map is plain and nothing is fetched.
    #[arg(long, value_name = "URL", requires = "tiles_by")]
    tiles: Option<String>,
    /// Whose tiles they are, as their licence asks for it.
    #[arg(long, value_name = "TEXT")]
    tiles_by: Option<String>,
    /// Scheduler of a Ballista cluster that is to run the queries; it and its executors see
    /// the archive under the same path.
    #[arg(long, value_name = "HOST:PORT")]
    cluster: Option<String>,
}

/// Runs `report`.
///
/// # Errors
/// [`Failure`]: no archive, nothing in it that was asked for, a damaged file, an output that
/// cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let sites = chosen(arguments)?;
    let places = arguments.sites.as_deref().map_or_else(|| Ok(Places::new()), places::read)?;
    let offset_ms = offset_ms(&arguments.utc_offset)?;
    let tiles = Tiles::of(arguments.tiles.as_deref(), arguments.tiles_by.as_deref())?;
    let threads = threads(arguments.threads);
    let options = Options {
        only: arguments.site.clone(),
        made_ms: now_ms()?,
        now_ms: end_ms(arguments)?,
        offset_ms,
        threads,
    };
    let morning = Morning::of(&arguments.archive, &places, &options)?;
    let mut all = summarise_all(arguments, sites, &morning, offset_ms, threads)?;
    let summaries = &mut all.summaries;
    summaries.sort_by(|a, b| a.site.cmp(&b.site));
    if summaries.is_empty() {
        let reason = "has no window of that length; leave --window out for the shortest";
        let none = || Desk::content(&arguments.archive, 0, reason).into();
        return Err(all.failed.into_iter().next().unwrap_or_else(none));
    }
    // A site of which nothing could be read has no page; what is wrong with it is printed.
    let mut shown = morning;
    shown.sites.retain(|site| summaries.iter().any(|summary| summary.site == site.site));
    write_all(&arguments.out, page::index_files(summaries, &shown, tiles.as_ref()))?;
    let rows: u64 = summaries.iter().map(|summary| summary.rows).sum();
    let count = summaries.len();
    let index = arguments.out.join("index.html");
    print(&format!("{count} sites, {rows} rows: {}\n", index.display()))?;
    if arguments.sites.is_some() {
        let named = |summary: &&Summary| places.contains_key(&summary.site);
        let without: Vec<_> = summaries.iter().filter(|it| !named(it)).collect();
        if let Some(first) = without.first() {
            let count = without.len();
            eprintln!(
                "verge-tmc: note: {count} sites are not in --sites, the first: {}",
                first.site
            );
        }
    }
    for failure in &all.failed {
        eprintln!("verge-tmc: {failure}");
    }
    match all.failed.len() {
        0 => Ok(()),
        failed => {
            let reason = format!("{failed} sites or days could not be read; the others are done");
            Err(Desk::content(&arguments.archive, 0, reason).into())
        }
    }
}

/// How many work at a time: as asked, or one for each processor.
pub(crate) fn threads(asked: Option<u16>) -> usize {
    let processors = || std::thread::available_parallelism().map_or(1, Into::into);
    asked.map_or_else(processors, usize::from)
}

/// Results of all sites.
#[derive(Default)]
struct All {
    summaries: Vec<Summary>,
    /// Failures of a day or a site, which do not touch the others.
    failed: Vec<Failure>,
}

/// A site with its days.
type Site = (String, Vec<Partition>);

/// Who adds up a site's rows.
enum Adder {
    /// This program, file by file.
    Here,
    #[cfg(feature = "ballista")]
    Cluster(cluster::Cluster),
}

impl Adder {
    fn of(arguments: &Arguments, threads: usize) -> Result<Self, Failure> {
        match &arguments.cluster {
            None => Ok(Self::Here),
            #[cfg(feature = "ballista")]
            Some(address) => {
                Ok(Self::Cluster(cluster::Cluster::open(&arguments.archive, address, threads)?))
            }
            #[cfg(not(feature = "ballista"))]
            Some(address) => {
                let _ = threads;
                let how = "this program was built without the feature ballista";
                Err(Failure::usage(format!("--cluster {address:?}: {how}")))
            }
        }
    }

    /// The sums of a site's days.
    fn site(
        &self,
        arguments: &Arguments,
        site: &str,
        days: &[Partition],
        offset_ms: i64,
    ) -> Result<Summary, Failure> {
        let (archive, window_s) = (&arguments.archive, arguments.window);
        match self {
            Self::Here => Ok(pass::site(archive, site, days, window_s, offset_ms)?),
            #[cfg(feature = "ballista")]
            Self::Cluster(cluster) => {
                let days = days.iter().map(|day| day.day).collect();
                cluster.site(queries::Scope { site: site.to_owned(), days, window_s, offset_ms })
            }
        }
    }
}

/// Writes every site's folder, `threads` at a time; their sums.
fn summarise_all(
    arguments: &Arguments,
    sites: Vec<Site>,
    morning: &Morning,
    offset_ms: i64,
    threads: usize,
) -> Result<All, Failure> {
    let adder = Adder::of(arguments, threads)?;
    let queue = Mutex::new(sites.into_iter());
    let all = Mutex::new(Ok(All::default()));
    let whole = "no thread panics with it";
    let work = || loop {
        let Some((site, days)) = queue.lock().expect(whole).next() else { return };
        let made = || one_site(&adder, arguments, &site, days, morning, offset_ms);
        let made = catch_unwind(AssertUnwindSafe(made));
        let mut all = all.lock().expect(whole);
        let Ok(sums) = &mut *all else { return };
        match made {
            Ok((summary, failed)) => {
                sums.failed.extend(failed);
                match summary {
                    Ok(summary) => sums.summaries.extend(summary),
                    // Without its cluster no site can be asked, and a full disk takes none.
                    Err(
                        failure @ (Failure::Cluster { .. } | Failure::Desk(Desk::Write { .. })),
                    ) => *all = Err(failure),
                    Err(failure) => sums.failed.push(failure),
                }
            }
            Err(_) => {
                let reason = format!("the page of site {site} could not be made: a fault of verge");
                sums.failed.push(Desk::content(&arguments.archive, 0, reason).into());
            }
        }
    };
    std::thread::scope(|scope| (0..threads).for_each(|_| drop(scope.spawn(work))));
    all.into_inner().expect(whole)
}

/// Writes a site's folder. Its sums, none where no window is of the wanted length; and what is wrong
/// with its days.
fn one_site(
    adder: &Adder,
    arguments: &Arguments,
    site: &str,
    mut days: Vec<Partition>,
    morning: &Morning,
    offset_ms: i64,
) -> (Result<Option<Summary>, Failure>, Vec<Failure>) {
    let mut failed = Vec::new();
    let mut summary = adder.site(arguments, site, &days, offset_ms);
    if summary.is_err() {
        // A day that cannot be read costs itself. A cluster does not name the file.
        let mut damaged = damage(&arguments.archive, &days);
        if damaged.len() == days.len() {
            summary = Err(damaged.swap_remove(0).1);
        } else if !damaged.is_empty() {
            days.retain(|day| damaged.iter().all(|(damaged, _)| *damaged != day.day));
            failed.extend(damaged.into_iter().map(|(_, failure)| failure));
            summary = adder.site(arguments, site, &days, offset_ms);
        }
    }
    let folder = arguments.out.join("sites").join(site);
    let written = summary.and_then(|summary| {
        if summary.is_empty() {
            return Ok(None);
        }
        write_all(&folder, page::site_files(&summary, morning))?;
        Ok(Some(summary.without_places()))
    });
    (written, failed)
}

/// Writes files into a folder: all of them or, where one cannot be made, none.
fn write_all(folder: &Path, files: Vec<page::File>) -> Result<(), Desk> {
    let mut batch = Batch::default();
    for (name, bytes) in files {
        batch.add(&folder.join(name), &bytes)?;
    }
    batch.commit()
}

/// The days whose files are not as they should be, and what is wrong with them.
fn damage(archive: &Path, days: &[Partition]) -> Vec<(i64, Failure)> {
    let wrong = |day: &Partition| {
        let read = densities::each(&day.path(archive), |_| ());
        read.err().map(|failure| (day.day, failure.into()))
    };
    days.iter().filter_map(wrong).collect()
}

/// The day of an argument, since 1970; none where it is not given.
fn day(text: Option<&String>, name: &str) -> Result<Option<i64>, Desk> {
    let Some(text) = text else { return Ok(None) };
    let time: Result<jiff::Timestamp, _> = format!("{text}T00:00:00Z").parse();
    time.map(|time| Some(time.as_millisecond() / DAY_MS))
        .map_err(|_| Desk::Usage(format!("--{name} {text:?}: give a day as 2026-01-05")))
}

/// Now, or what `SOURCE_DATE_EPOCH` says instead (reproducible-builds.org), ms since 1970.
pub(crate) fn now_ms() -> Result<i64, Desk> {
    let Ok(text) = std::env::var("SOURCE_DATE_EPOCH") else {
        return Ok(jiff::Timestamp::now().as_millisecond());
    };
    let seconds = text.parse::<i64>().ok().filter(|seconds| (0..1 << 40).contains(seconds));
    let wrong = || Desk::Usage(format!("SOURCE_DATE_EPOCH {text:?}: give seconds since 1970"));
    seconds.map(|seconds| seconds * 1000).ok_or_else(wrong)
}

/// The time that the report is made of: now, or the end of the last day that was asked for.
fn end_ms(arguments: &Arguments) -> Result<i64, Desk> {
    let now = now_ms()?;
    let last = day(arguments.to.as_ref(), "to")?;
    Ok(last.map_or(now, |day| now.min((day + 1) * DAY_MS)))
}

/// Sites with their days, as asked for.
fn chosen(arguments: &Arguments) -> Result<Vec<Site>, Failure> {
    let first = day(arguments.from.as_ref(), "from")?.unwrap_or(i64::MIN);
    // Boxes whose clock was wrong have days that are to come.
    let tomorrow = jiff::Timestamp::now().as_millisecond() / DAY_MS + 1;
    let last = day(arguments.to.as_ref(), "to")?.unwrap_or(tomorrow);
    if arguments.from.is_some() && arguments.to.is_some() && first > last {
        return Err(Failure::usage("--from is after --to: give the earlier day as --from"));
    }
    let archive = &arguments.archive;
    let mut sites: Vec<Site> = Vec::new();
    let partitions = store::partitions(archive)?;
    if partitions.is_empty() {
        let reason = "has no site yet: is it the folder of `verge-tmc archive --out`?";
        return Err(Desk::content(archive, 0, reason).into());
    }
    for name in &arguments.site {
        // They are sorted by site.
        if partitions.binary_search_by(|it| it.site.cmp(name)).is_err() {
            return Err(not_there(archive, name).into());
        }
    }
    for partition in partitions {
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
        return Err(Desk::content(archive, 0, reason).into());
    }
    Ok(sites)
}

/// The failure for a site that the archive does not have.
pub(crate) fn not_there(archive: &Path, site: &str) -> Desk {
    let sites = store::sites(archive).unwrap_or_default();
    let some: Vec<_> = sites.iter().take(3).map(String::as_str).collect();
    let more = if sites.len() > some.len() { ", ..." } else { "" };
    let (count, some) = (sites.len(), some.join(", "));
    let reason = format!("has no site {site:?}; it has {count}: {some}{more}");
    Desk::content(archive, 0, reason)
}

pub(crate) fn offset_ms(text: &str) -> Result<i64, Desk> {
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
    parsed().ok_or_else(|| Desk::Usage(format!("--utc-offset {text:?}: give +HH:MM")))
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
