//! Gaps in the numbers (`seq`) of a site's messages: within a day, and from day to day.
//!
//! A number that is not above the one before it is a box that was started again.

use crate::failure::Failure;
use crate::store::{self, DAY_MS, Partition, Row};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Messages that are missing between two windows.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Gap {
    /// Whose.
    pub site: String,
    /// Length of the windows, s.
    pub window_s: i32,
    /// Beginning of the window after which they are missing, ms since 1970.
    pub after_ms: i64,
    /// How many.
    pub missing: i64,
}

impl Gap {
    /// Between two windows, if there is one.
    fn between(site: &str, window_s: i32, before: Window, after: Window) -> Option<Self> {
        let missing = after.seq - before.seq - 1;
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
pub struct Window {
    from_ms: i64,
    seq: i64,
}

impl Window {
    fn of(row: &Row) -> Self {
        Self { from_ms: row.from_ms, seq: row.seq }
    }
}

/// Gaps within a day, from its sorted rows.
pub fn within(site: &str, rows: &[Row]) -> Vec<Gap> {
    let lanes = &rows[..rows.partition_point(|row| row.cell.is_none())];
    let pairs = lanes.windows(2).filter(|pair| pair[0].window_s == pair[1].window_s);
    pairs
        .filter_map(|pair| {
            Gap::between(site, pair[0].window_s, Window::of(&pair[0]), Window::of(&pair[1]))
        })
        .collect()
}

/// First and last window for each length of window.
type Ends = BTreeMap<i32, [Window; 2]>;

/// Days whose first or last window has changed. As a day grows, its last one does, and no day
/// is behind it: nothing has to be read for that.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Edges {
    /// The first.
    pub first: BTreeSet<Partition>,
    /// The last.
    pub last: BTreeSet<Partition>,
}

impl Edges {
    /// Of a day with its ends before and now.
    pub fn of(day: &Partition, before: &Ends, now: &Ends) -> Self {
        let changed = |end: usize| {
            let is = now.iter().any(|(length, ends)| {
                before.get(length).is_none_or(|before| before[end] != ends[end])
            });
            is.then(|| day.clone()).into_iter().collect()
        };
        Self { first: changed(0), last: changed(1) }
    }
}

/// First and last window of a day for each length, from its rows in any order.
pub fn ends(rows: &[Row]) -> Ends {
    let mut ends = Ends::new();
    for row in rows.iter().filter(|row| row.cell.is_none()) {
        let window = Window::of(row);
        let [first, last] = ends.entry(row.window_s).or_insert([window; 2]);
        if window.from_ms < first.from_ms {
            *first = window;
        }
        if window.from_ms > last.from_ms {
            *last = window;
        }
    }
    ends
}

/// Gaps between days whose edges changed and the nearest days of their site that have a file.
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
            let [before, after] = [&pair[0], &pair[1]].map(|day| store::read(&day.path(root)));
            let (before, after) = (ends(&before?), ends(&after?));
            for (window_s, [_, last]) in before {
                let Some([first, _]) = after.get(&window_s) else { continue };
                found.extend(Gap::between(site, window_s, last, *first));
            }
        }
    }
    Ok(found)
}
