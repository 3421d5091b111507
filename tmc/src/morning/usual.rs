//! Usual densities: those of the same quarter hour on the same weekday of the weeks before.
//!
//! Owns the band (the 10 % and 90 % quantiles and the median of up to [`WEEKS`] weeks) and the table
//! that makes it quick: `ROOT/daily/date=YYYY-MM-DD/daily.parquet` has each site's quarter hours of a
//! day that has ended. It is made from the day's density files when it is first asked for, and again
//! when one of them is younger; an archive that may not be written is read without it.

use super::day::{BINS, Day, Quarter};
use crate::store::events::{Record, read_table, write_table};
use crate::store::{Partition, date};
use arrow_array::cast::AsArray;
use arrow_array::types::Float32Type;
use arrow_array::{Array, ArrayRef, FixedSizeListArray, RecordBatch, StringArray};
use arrow_schema::{DataType, Field};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::SystemTime;

/// Weeks before that make a band.
pub const WEEKS: i64 = 8;
/// With fewer days than these nothing is usual.
const LEAST: usize = 3;

/// The usual densities of a quarter hour, veh/km/lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Band {
    /// One in ten is below.
    pub low: f32,
    /// The middle one.
    pub middle: f32,
    /// One in ten is above.
    pub high: f32,
    /// Of so many days.
    pub days: usize,
}

/// A site's quarter hours of a day.
#[derive(Clone, Debug, PartialEq)]
pub struct SiteDay {
    /// The site.
    pub site: String,
    /// Mean density over lanes, veh/km/lane; not a number where it is not known.
    pub densities: [f32; BINS],
}

impl Record for SiteDay {
    fn columns(rows: &[Self]) -> Vec<(&'static str, ArrayRef)> {
        let sites: StringArray = rows.iter().map(|row| Some(&row.site)).collect();
        let values = rows.iter().map(|row| {
            let known = row.densities.iter().map(|value| value.is_finite().then_some(*value));
            Some(known.collect::<Vec<_>>())
        });
        let field = Arc::new(Field::new_list_field(DataType::Float32, true));
        let list =
            FixedSizeListArray::from_iter_primitive::<Float32Type, _, _>(values, BINS as i32);
        let (_, size, values, nulls) = list.into_parts();
        let list = FixedSizeListArray::new(field, size, values, nulls);
        vec![("site", Arc::new(sites)), ("density_veh_km", Arc::new(list))]
    }

    fn of(batch: &RecordBatch, row: usize) -> Option<Self> {
        let site = batch.column_by_name("site")?.as_string_opt::<i32>()?.value(row).to_owned();
        let list = batch.column_by_name("density_veh_km")?.as_fixed_size_list_opt()?.value(row);
        let list = list.as_primitive_opt::<Float32Type>()?;
        let value = |bin: usize| if list.is_valid(bin) { list.value(bin) } else { f32::NAN };
        (list.len() == BINS).then(|| Self { site, densities: std::array::from_fn(value) })
    }
}

impl SiteDay {
    /// Of a site.
    pub fn of_quarters(site: &str, quarters: &[Quarter]) -> Self {
        let density = |bin: usize| quarters[bin].density.unwrap_or(f32::NAN);
        Self { site: site.to_owned(), densities: std::array::from_fn(density) }
    }
}

/// The days that came before, one after the other.
#[derive(Debug, Default)]
pub struct Usual {
    /// Day since 1970, then site.
    days: BTreeMap<i64, BTreeMap<String, [f32; BINS]>>,
}

/// The table of a day.
fn path(root: &Path, day: i64) -> PathBuf {
    root.join("daily").join(format!("date={}", date(day))).join("daily.parquet")
}

fn changed(path: &Path) -> Option<SystemTime> {
    path.metadata().ok()?.modified().ok()
}

impl Usual {
    /// The days that bands of `days` (since 1970, UTC) need, from the archive under `root` with
    /// these partitions; `threads` read at a time. Days that cannot be read are named in `told`.
    pub fn of(
        root: &Path,
        partitions: &[Partition],
        days: &[i64],
        threads: usize,
        told: &mut Vec<String>,
    ) -> Self {
        let mut wanted: Vec<i64> =
            days.iter().flat_map(|day| (1..=WEEKS).map(move |week| day - 7 * week)).collect();
        wanted.sort_unstable();
        wanted.dedup();
        let mut by_day = BTreeMap::<i64, Vec<&Partition>>::new();
        for partition in partitions.iter().filter(|it| wanted.binary_search(&it.day).is_ok()) {
            by_day.entry(partition.day).or_default().push(partition);
        }
        let queue = Mutex::new(by_day.into_iter());
        let work = || {
            let (mut done, mut told) = (Vec::new(), Vec::new());
            loop {
                let next = queue.lock().expect("no thread panics with it").next();
                let Some((day, sites)) = next else { return (done, told) };
                let rows = daily(root, day, &sites, &mut told);
                done.push((day, rows.into_iter().map(|row| (row.site, row.densities)).collect()));
            }
        };
        let mut usual = Self::default();
        std::thread::scope(|scope| {
            let running: Vec<_> = (0..threads.max(1)).map(|_| scope.spawn(work)).collect();
            for thread in running {
                let (done, problems) = thread.join().expect("no thread panics");
                usual.days.extend(done);
                told.extend(problems);
            }
        });
        usual
    }

    /// The band of a site at a quarter hour of a day; none where too few days are known.
    pub fn band(&self, site: &str, day: i64, bin: usize) -> Option<Band> {
        let known = (1..=WEEKS).filter_map(|week| {
            let densities = self.days.get(&(day - 7 * week))?.get(site)?;
            Some(densities[bin]).filter(|density| density.is_finite())
        });
        let mut known: Vec<f32> = known.collect();
        known.sort_by(f32::total_cmp);
        let days = known.len();
        (days >= LEAST).then(|| Band {
            low: quantile(&known, 0.1),
            middle: quantile(&known, 0.5),
            high: quantile(&known, 0.9),
            days,
        })
    }
}

/// By linear interpolation between order statistics, as pandas and NumPy have it.
fn quantile(sorted: &[f32], share: f64) -> f32 {
    let at = share * (sorted.len() - 1) as f64;
    let (below, part) = (at.floor() as usize, at.fract());
    let next = sorted[(below + 1).min(sorted.len() - 1)];
    (f64::from(sorted[below]) * (1.0 - part) + f64::from(next) * part) as f32
}

/// The sites of a day, from its table where that is not older than they are.
fn daily(root: &Path, day: i64, sites: &[&Partition], told: &mut Vec<String>) -> Vec<SiteDay> {
    let path = path(root, day);
    let made = changed(&path);
    let youngest = sites.iter().filter_map(|site| changed(&site.path(root))).max();
    if made.is_some() && youngest <= made {
        match read_table::<SiteDay>(&path) {
            Ok(rows) if rows.len() >= sites.len() => return rows,
            Ok(_) => {}
            Err(failure) => told.push(failure.to_string()),
        }
    }
    let (mut rows, mut is_whole) = (Vec::new(), true);
    for site in sites {
        match Day::read(&site.path(root)) {
            Ok(read) => rows.push(SiteDay::of_quarters(&site.site, &read.quarters())),
            Err(failure) => {
                is_whole = false;
                told.push(failure.to_string());
            }
        }
    }
    // Whoever may only read makes the page without keeping this.
    if is_whole && let Err(failure) = write_table(&path, &rows) {
        // Once, whichever day it is.
        let reason = failure.to_string().replace(&date(day), "DAY");
        told.push(format!("what is usual is not kept for the next time: {reason}"));
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_band_is_of_the_same_weekday() {
        let of = |density: f32| BTreeMap::from([("a".to_owned(), [density; BINS])]);
        let mut usual = Usual::default();
        for (day, density) in [(93, 10.0), (86, 20.0), (79, 30.0), (72, f32::NAN), (94, 999.0)] {
            usual.days.insert(day, of(density));
        }
        let band = usual.band("a", 100, 5).unwrap();
        assert_eq!((band.low, band.middle, band.high, band.days), (12.0, 20.0, 28.0, 3));
        assert_eq!(usual.band("a", 101, 5), None, "one day is not usual");
        assert_eq!(usual.band("b", 100, 5), None);
    }

    #[test]
    fn a_table_comes_back_with_what_is_not_known() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("daily.parquet");
        let mut densities = [7.5; BINS];
        densities[3] = f32::NAN;
        write_table(&path, &[SiteDay { site: "a".into(), densities }]).unwrap();
        let rows: Vec<SiteDay> = read_table(&path).unwrap();
        assert!(rows[0].densities[3].is_nan() && rows[0].densities[4] == 7.5);
    }
}
