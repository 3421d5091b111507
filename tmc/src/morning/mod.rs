//! The morning page: every site, the one with trouble first, and its last day against what is usual.
//!
//! Owns what is gathered of the archive for it: `day` reads a file, `usual` the weeks before,
//! `trouble` judges, `level` gives densities their letter, `places` says where sites are. `page`,
//! `spark` and `map` draw. Reads the archive's files itself, not by query: it asks for two days of
//! each site, and for what was kept of the others.

pub mod day;
pub mod level;
pub mod map;
pub mod page;
pub mod places;
mod spark;
pub mod trouble;
pub mod usual;

use crate::failure::Failure;
use crate::store::events::{self, AlarmRow};
use crate::store::{self, DAY_MS, Partition};
use day::{BIN_MS, BINS, Day, Quarter, Reading};
use places::{Known, Places};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;
use trouble::Trouble;
use usual::{Band, Usual};

/// Days back in which an alarm that is still on is looked for.
const ALARM_DAYS: i64 = 92;
/// Extent of "now": the last quarter of an hour that a site has sent.
const NOW_MS: i64 = 15 * 60_000;

/// A lane now.
#[derive(Clone, Debug, PartialEq)]
pub struct LaneNow {
    /// From 1.
    pub lane: i32,
    /// Means over the last quarter of an hour.
    pub quarter: Quarter,
    /// Its latest status, a number of NTCIP 1209.
    pub status: i32,
}

/// A quarter of an hour of the last day, and what is usual then.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Its beginning, ms since 1970.
    pub from_ms: i64,
    /// The measurement.
    pub quarter: Quarter,
    /// The usual densities.
    pub band: Option<Band>,
}

/// A site this morning.
#[derive(Clone, Debug)]
pub struct SiteNow {
    /// Its name in topics.
    pub site: String,
    /// Position and names.
    pub known: Known,
    /// Its troubles, the oldest first.
    pub trouble: Vec<Trouble>,
    /// The end of its latest window, ms since 1970.
    pub heard_ms: i64,
    /// Its lanes; none where it is silent.
    pub lanes: Vec<LaneNow>,
    /// The last 24 hours.
    pub points: Vec<Point>,
}

impl SiteNow {
    /// The lane that is densest, and its level of service.
    pub fn level(&self) -> Option<(i32, char)> {
        let known = self.lanes.iter().filter_map(|it| Some((it.lane, it.quarter.density?)));
        let (lane, density) = known.max_by(|a, b| a.1.total_cmp(&b.1))?;
        Some((lane, level::level(density)))
    }

    /// The last quarter of an hour of which a density is known, while the site is heard.
    pub fn now(&self) -> Option<&Point> {
        if self.lanes.is_empty() {
            return None;
        }
        self.points.iter().rev().take(2).find(|point| point.quarter.density.is_some())
    }
}

/// All sites this morning.
#[derive(Clone, Debug)]
pub struct Morning {
    /// When it was made, ms since 1970.
    pub made_ms: i64,
    /// The instant that it is of.
    pub now_ms: i64,
    /// Local time ahead of UTC, ms.
    pub offset_ms: i64,
    /// Those with trouble first, the oldest trouble first; then the densest.
    pub sites: Vec<SiteNow>,
    /// Faults of files that could not be read.
    pub told: Vec<String>,
}

/// Settings of a morning page.
#[derive(Clone, Debug)]
pub struct Options {
    /// Only these sites; empty: all.
    pub only: Vec<String>,
    /// When it is made and what instant it is of, ms since 1970.
    pub made_ms: i64,
    /// The instant that it is of.
    pub now_ms: i64,
    /// Local time ahead of UTC, ms.
    pub offset_ms: i64,
    /// Files read at the same time.
    pub threads: usize,
}

impl Morning {
    /// Gathers it from the archive under `root`; `listed` is the centre's own table of its sites.
    ///
    /// # Errors
    /// [`Failure`] where the archive cannot be read; a damaged file is named in `told`.
    pub fn of(root: &Path, listed: &Places, options: &Options) -> Result<Self, Failure> {
        let &Options { made_ms, now_ms, offset_ms, threads, .. } = options;
        let today = (now_ms - 1).div_euclid(DAY_MS);
        let by_site = wanted(root, today, &options.only)?;
        let partitions: Vec<_> = by_site.values().flatten().cloned().collect();
        let mut told = Vec::new();
        let places = places::of_archive(root, listed, &mut told);
        let alarms = trouble::active(alarms(root, today, &mut told), now_ms);
        let usual = Usual::of(root, &partitions, &[today - 1, today], threads, &mut told);
        let (none, unknown) = (BTreeMap::new(), Known::default());
        let queue = Mutex::new(by_site.into_iter());
        let work = || {
            let (mut done, mut told) = (Vec::new(), Vec::new());
            loop {
                let next = queue.lock().expect("no thread panics with it").next();
                let Some((site, days)) = next else { return (done, told) };
                let known = places.get(&site).unwrap_or(&unknown).clone();
                let on = alarms.get(&site).unwrap_or(&none);
                let recent = recent(root, &days, today, &mut told);
                done.push(site_now(site, known, &recent, on, &usual, now_ms));
            }
        };
        let mut sites = Vec::new();
        std::thread::scope(|scope| {
            let running: Vec<_> = (0..threads.max(1)).map(|_| scope.spawn(work)).collect();
            for thread in running {
                let (done, problems) = thread.join().expect("no thread panics");
                sites.extend(done);
                told.extend(problems);
            }
        });
        let density = |site: &SiteNow| site.now().and_then(|point| point.quarter.density);
        sites.sort_by(|a: &SiteNow, b: &SiteNow| {
            let first = |site: &SiteNow| site.trouble.first().map_or(i64::MAX, |it| it.since_ms);
            let by_trouble = first(a).cmp(&first(b));
            let by_density = density(b).unwrap_or(-1.0).total_cmp(&density(a).unwrap_or(-1.0));
            by_trouble.then(by_density).then_with(|| a.site.cmp(&b.site))
        });
        told.sort();
        told.dedup();
        Ok(Self { made_ms, now_ms, offset_ms, sites, told })
    }
}

/// The days that a morning reads of each site: yesterday, today and those that make the bands; of a
/// site that has neither of the two its last one. An archive of years is not looked through for it.
fn wanted(
    root: &Path,
    today: i64,
    only: &[String],
) -> Result<BTreeMap<String, Vec<Partition>>, Failure> {
    let mut days: Vec<i64> =
        (0..=usual::WEEKS).flat_map(|week| [today - 7 * week, today - 1 - 7 * week]).collect();
    days.sort_unstable();
    let mut found = BTreeMap::new();
    for site in store::sites(root)? {
        if !only.is_empty() && !only.contains(&site) {
            continue;
        }
        let of = |day: &i64| Partition { site: site.clone(), day: *day };
        let mut there: Vec<_> =
            days.iter().map(of).filter(|partition| partition.path(root).exists()).collect();
        if there.last().is_none_or(|last| last.day < today - 1) {
            let mut all = store::site_partitions(root, &site)?;
            all.retain(|partition| partition.day <= today);
            there.extend(all.pop());
        }
        if !there.is_empty() {
            found.insert(site, there);
        }
    }
    Ok(found)
}

/// The alarms of the days in which one that is on may have begun.
fn alarms(root: &Path, today: i64, told: &mut Vec<String>) -> Vec<AlarmRow> {
    let mut rows = Vec::new();
    for day in today - ALARM_DAYS..=today {
        match events::read_table(&events::alarms_path(root, day)) {
            Ok(more) => rows.extend::<Vec<AlarmRow>>(more),
            Err(failure) => told.push(failure.to_string()),
        }
    }
    rows
}

/// A site's windows of yesterday and today, or of the last day that it has.
fn recent(root: &Path, days: &[Partition], today: i64, told: &mut Vec<String>) -> Day {
    let mut all = Day::default();
    let is_recent = |day: &&Partition| day.day >= today - 1;
    let chosen: Vec<_> = days.iter().filter(is_recent).collect();
    let chosen = if chosen.is_empty() { days.last().into_iter().collect() } else { chosen };
    for partition in chosen {
        match Day::read(&partition.path(root)) {
            // A box that was set up again yesterday has the length that it has now.
            Ok(day) if day.window_s != all.window_s => all = day,
            Ok(day) => all.readings.extend(day.readings),
            Err(failure) => told.push(failure.to_string()),
        }
    }
    all
}

fn site_now(
    site: String,
    known: Known,
    recent: &Day,
    alarms: &BTreeMap<String, i64>,
    usual: &Usual,
    now_ms: i64,
) -> SiteNow {
    let trouble = trouble::judge(&recent.readings, recent.window_s, alarms, now_ms);
    let readings: Vec<Reading> =
        recent.readings.iter().filter(|it| it.from_ms < now_ms).copied().collect();
    let heard_ms = readings.last().map_or(0, |it| it.from_ms + i64::from(recent.window_s) * 1000);
    let is_silent = trouble.iter().any(|it| it.reason == "silent");
    let lanes = if is_silent { Vec::new() } else { lanes_now(&readings, heard_ms) };
    let by_bin: BTreeMap<i64, Quarter> = readings
        .chunk_by(|a, b| a.from_ms.div_euclid(BIN_MS) == b.from_ms.div_euclid(BIN_MS))
        .map(|all| (all[0].from_ms.div_euclid(BIN_MS), Quarter::of(all)))
        .collect();
    let last_bin = (now_ms - 1).div_euclid(BIN_MS);
    let points = (last_bin - BINS as i64 + 1..=last_bin)
        .map(|at| {
            let from_ms = at * BIN_MS;
            let bin = at.rem_euclid(BINS as i64) as usize;
            Point {
                from_ms,
                quarter: by_bin.get(&at).copied().unwrap_or_default(),
                band: usual.band(&site, from_ms.div_euclid(DAY_MS), bin),
            }
        })
        .collect();
    SiteNow { site, known, trouble, heard_ms, lanes, points }
}

fn lanes_now(readings: &[Reading], heard_ms: i64) -> Vec<LaneNow> {
    let mut lanes = BTreeMap::<i32, Vec<Reading>>::new();
    for reading in readings.iter().filter(|it| it.from_ms >= heard_ms - NOW_MS) {
        lanes.entry(reading.lane).or_default().push(*reading);
    }
    let now = |(lane, all): (i32, Vec<Reading>)| LaneNow {
        lane,
        quarter: Quarter::of(&all),
        status: all.last().map_or(0, |reading| reading.status),
    };
    lanes.into_iter().map(now).collect()
}
