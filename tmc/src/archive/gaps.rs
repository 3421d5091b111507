//! Gaps in the numbers (`seq`) of a site's messages: within a day, and from day to day.
//!
//! A number that is not above the one before it is a box that was started again. No more
//! windows are missing than there was time for: a box cannot lie about that.

use crate::store::{self, DAY_MS, Partition, Row, Rows};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use verge_desk::Failure;

/// Messages that are missing between two windows.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Gap {
    /// The site.
    pub site: String,
    /// Length of the windows, s.
    pub window_s: i32,
    /// Beginning of the window after which they are missing, ms since 1970.
    pub after_ms: i64,
    /// Number of missing messages.
    pub missing: i64,
}

impl Gap {
    /// Between two windows, if there is one.
    fn between(site: &str, window_s: i32, before: Window, after: Window) -> Option<Self> {
        let length_ms = i64::from(window_s.max(1)) * 1000;
        let room = after.from_ms.saturating_sub(before.from_ms) / length_ms - 1;
        let missing = after.seq.saturating_sub(before.seq).saturating_sub(1).min(room);
        let after_ms = before.from_ms;
        (missing > 0).then(|| Self { site: site.to_owned(), window_s, after_ms, missing })
    }

    /// Whether the window before it is of that day.
    pub fn begins_in(&self, day: &Partition) -> bool {
        self.site == day.site && self.after_ms.div_euclid(DAY_MS) == day.day
    }
}

/// A window's beginning and number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Window {
    from_ms: i64,
    seq: i64,
}

/// The windows of a day, from its rows in their order: for each length, by their beginnings.
#[derive(Clone, Debug, Default)]
pub struct Track(BTreeMap<i32, Vec<Window>>);

impl Track {
    /// Of a day's file.
    ///
    /// # Errors
    /// [`Failure`] where it cannot be read.
    pub fn of(path: &Path) -> Result<Self, Failure> {
        let mut track = Self::default();
        // The lanes stand first: the cells need not be read.
        for row in Rows::open(path)? {
            let row = row?;
            if row.cell.is_some() {
                break;
            }
            track.note(&row);
        }
        Ok(track)
    }

    /// Takes the next row.
    pub fn note(&mut self, row: &Row) {
        if row.cell.is_some() {
            return;
        }
        let window = Window { from_ms: row.from_ms, seq: row.seq };
        let windows = self.0.entry(row.window_s).or_default();
        if windows.last() != Some(&window) {
            windows.push(window);
        }
    }

    /// Number of windows.
    pub fn len(&self) -> usize {
        self.0.values().map(Vec::len).sum()
    }

    /// The lengths of windows, s.
    pub fn lengths(&self) -> impl Iterator<Item = i32> {
        self.0.keys().copied()
    }

    /// Gaps within the day.
    pub fn gaps(&self, site: &str) -> Vec<Gap> {
        let pairs = self.0.iter().flat_map(|(length, windows)| {
            windows.windows(2).map(move |pair| (*length, pair[0], pair[1]))
        });
        pairs.filter_map(|(length, a, b)| Gap::between(site, length, a, b)).collect()
    }

    /// The first or the last window of each length.
    fn ends(&self, last: bool) -> BTreeMap<i32, Window> {
        let end = |windows: &Vec<Window>| {
            let window = if last { windows.last() } else { windows.first() };
            window.copied()
        };
        self.0.iter().filter_map(|(length, all)| Some((*length, end(all)?))).collect()
    }
}

/// Days whose first or last window has changed. As a day grows, its last one does, and no day
/// is behind it: nothing has to be read for that.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Edges {
    /// Whether its first and its last window changed, until the day is known.
    changed: [bool; 2],
    /// The first.
    pub first: BTreeSet<Partition>,
    /// The last.
    pub last: BTreeSet<Partition>,
}

impl Edges {
    /// Of a day before and now.
    pub fn of(before: &Track, now: &Track) -> Self {
        let is_new = |last: bool| {
            let before = before.ends(last);
            now.ends(last).iter().any(|(length, end)| before.get(length) != Some(end))
        };
        Self { changed: [is_new(false), is_new(true)], ..Self::default() }
    }

    /// Says which day it is.
    pub fn set_day(&mut self, day: &Partition) {
        let [first, last] = self.changed;
        self.first.extend(first.then(|| day.clone()));
        self.last.extend(last.then(|| day.clone()));
    }
}

/// Gaps between days whose edges changed and the nearest days of their site that have a file.
/// A day that cannot be read has none: the next compaction that touches it says so.
///
/// # Errors
/// [`Failure`] where the archive cannot be read.
pub fn between(root: &Path, edges: &Edges) -> Result<Vec<Gap>, Failure> {
    let days = edges.first.iter().chain(&edges.last);
    let sites: BTreeSet<&str> = days.map(|day| day.site.as_str()).collect();
    let mut found = Vec::new();
    for site in sites {
        let all = store::site_partitions(root, site)?;
        let met =
            |pair: &&[Partition]| edges.last.contains(&pair[0]) || edges.first.contains(&pair[1]);
        for pair in all.windows(2).filter(met) {
            let [before, after] = [&pair[0], &pair[1]].map(|day| Track::of(&day.path(root)));
            let (Ok(before), Ok(after)) = (before, after) else { continue };
            let (before, after) = (before.ends(true), after.ends(false));
            for (window_s, last) in before {
                let Some(first) = after.get(&window_s) else { continue };
                found.extend(Gap::between(site, window_s, last, *first));
            }
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_that_leaps_hides_no_other_gap() {
        let at = |minute: i64, seq| Window { from_ms: minute * 60_000, seq };
        let missing = |a, b| Gap::between("a", 60, a, b).map(|gap| gap.missing);
        assert_eq!(missing(at(0, 1), at(5, 3)), Some(1));
        assert_eq!(missing(at(0, 1), at(5, i64::MAX)), Some(4), "there was room for four");
        assert_eq!(missing(at(0, 9), at(5, 1)), None, "started again");
        assert_eq!(missing(at(0, i64::MIN), at(1, i64::MAX)), None);
        let (first, last) =
            (Window { from_ms: i64::MIN, seq: 1 }, Window { from_ms: i64::MAX, seq: 9 });
        assert_eq!(missing(first, last), Some(7));
    }
}
