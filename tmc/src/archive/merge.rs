//! One partition: a site's day takes the windows that it lacks.
//!
//! Owns what "the same window" means, and the merge: the old file is read twice and rewritten
//! some rows at a time, so that memory does not grow with the day. The first window of a
//! beginning and length counts. The same again is a duplicate; another one is a conflict, which
//! is set aside and reported. An unreadable file is set aside, and its day starts over.

use super::aside;
use super::gaps::{Edges, Gap, Track};
use crate::store::{self, Partition, Row, Rows};
use std::collections::BTreeSet;
use std::collections::btree_map::{BTreeMap, Entry};
use std::path::{Path, PathBuf};
use verge_desk::Failure;

/// Lengths of windows in one day: a box has six at most, and may be configured again.
const MOST_LENGTHS: usize = 12;
/// Windows in one day: six lengths from 10 s on make 17,664.
const MOST_WINDOWS: usize = 20_000;

/// Length, s, and beginning, ms since 1970.
pub(super) type Key = (i32, i64);

/// A window that is to be archived.
#[derive(Clone, Debug)]
pub(super) struct Window {
    pub(super) key: Key,
    /// By their keys.
    pub(super) rows: Vec<Row>,
    /// Index of the message.
    pub(super) message: usize,
}

/// Result of merging a partition's windows.
#[derive(Debug, Default)]
pub(super) struct Merged {
    pub(super) windows: usize,
    pub(super) duplicates: usize,
    /// Messages that were not taken, and why.
    pub(super) refused: Vec<(usize, String)>,
    pub(super) gaps: Vec<Gap>,
    pub(super) edges: Edges,
}

/// Adds windows to a partition.
///
/// # Errors
/// [`Failure`] where its file cannot be read or written; then it is as it was.
pub(super) fn merge(
    root: &Path,
    partition: &Partition,
    windows: Vec<Window>,
) -> Result<Merged, Failure> {
    let mut merged = Merged::default();
    let mut new = BTreeMap::<Key, Window>::new();
    for window in windows {
        match new.entry(window.key) {
            Entry::Vacant(place) => drop(place.insert(window)),
            Entry::Occupied(first) => merged.meet(&first.get().rows, &window),
        }
    }
    let path = partition.path(root);
    let (old, before) = match look(&path, &new) {
        Err(failure @ Failure::Content { .. }) => {
            let to = set_aside(root, partition)?;
            eprintln!("verge-tmc: {failure}; it was moved to {}", to.display());
            (BTreeMap::new(), Track::default())
        }
        looked => looked?,
    };
    for (key, rows) in &old {
        if let Some(window) = new.remove(key) {
            merged.meet(rows, &window);
        }
    }
    merged.limit(&mut new, &before);
    merged.windows = new.len();
    let now = if new.is_empty() { before } else { write(&path, new, &before, &mut merged)? };
    merged.gaps = now.gaps(&partition.site);
    merged.edges.set_day(partition);
    Ok(merged)
}

impl Merged {
    /// A window came that is there.
    fn meet(&mut self, first: &[Row], window: &Window) {
        if is_same(first, &window.rows) {
            self.duplicates += 1;
            return;
        }
        let (length_s, from_ms) = window.key;
        let from = verge_messages::rfc3339(from_ms);
        let reason = format!("another window of {length_s} s from {from} is archived already");
        self.refused.push((window.message, reason));
    }

    /// Takes out what is more than a day has.
    fn limit(&mut self, new: &mut BTreeMap<Key, Window>, before: &Track) {
        let mut lengths: BTreeSet<i32> = before.lengths().collect();
        let mut count = before.len();
        new.retain(|(length, _), window| {
            let fits = lengths.contains(length) || lengths.len() < MOST_LENGTHS;
            if fits && count < MOST_WINDOWS {
                lengths.insert(*length);
                count += 1;
                return true;
            }
            let what = if fits { "windows" } else { "lengths of windows" };
            let most = if fits { MOST_WINDOWS } else { MOST_LENGTHS };
            self.refused.push((window.message, format!("its day has {most} {what} already")));
            false
        });
    }
}

/// Whether these are the rows of one message; an archiver of before kept no flow, and one before
/// that no interval.
fn is_same(first: &[Row], rows: &[Row]) -> bool {
    let without_traffic = |row: &Row| Row { traffic: None, ..row.clone() };
    let without_errors = |row: &Row| {
        let (ci90, calibration_se, counting_se) = (None, None, None);
        Row { ci90, calibration_se, counting_se, ..without_traffic(row) }
    };
    first.len() == rows.len()
        && (first.iter().eq(rows)
            || first.iter().zip(rows).all(|(first, row)| *first == without_traffic(row))
            || first.iter().zip(rows).all(|(first, row)| *first == without_errors(row)))
}

/// The rows of those windows that are there already, and what is in the file.
fn look(
    path: &Path,
    new: &BTreeMap<Key, Window>,
) -> Result<(BTreeMap<Key, Vec<Row>>, Track), Failure> {
    let (mut met, mut track) = (BTreeMap::<Key, Vec<Row>>::new(), Track::default());
    if path.exists() {
        for row in Rows::open(path)? {
            let row = row?;
            track.note(&row);
            let key = (row.window_s, row.from_ms);
            if new.contains_key(&key) {
                met.entry(key).or_default().push(row);
            }
        }
    }
    Ok((met, track))
}

/// Writes the day with the new windows in it.
fn write(
    path: &Path,
    new: BTreeMap<Key, Window>,
    before: &Track,
    merged: &mut Merged,
) -> Result<Track, Failure> {
    remove_partial(path)?;
    let mut rows: Vec<Row> = new.into_values().flat_map(|window| window.rows).collect();
    rows.sort_by_key(Row::key);
    let mut rows = rows.into_iter().peekable();
    let mut old = if path.exists() { Some(Rows::open(path)?) } else { None }.into_iter().flatten();
    let mut waiting = old.next().transpose()?;
    let mut now = Track::default();
    store::write_rows(path, || {
        let next = match (&waiting, rows.peek()) {
            (Some(old), Some(new)) if old.key() <= new.key() => true,
            (Some(_), None) => true,
            (_, _) => false,
        };
        let row = if next {
            std::mem::replace(&mut waiting, old.next().transpose()?)
        } else {
            rows.next()
        };
        row.iter().for_each(|row| now.note(row));
        Ok(row)
    })?;
    merged.edges = Edges::of(before, &now);
    Ok(now)
}

/// Removes what archivers that were killed have left beside a file; one writes at a time.
fn remove_partial(path: &Path) -> Result<(), Failure> {
    let Some(entries) = path.parent().and_then(|folder| folder.read_dir().ok()) else {
        return Ok(());
    };
    for entry in entries.map_while(Result::ok) {
        let left = entry.path();
        if left.extension().is_some_and(|ending| ending == "partial") {
            std::fs::remove_file(&left).map_err(|source| Failure::writing(&left, source))?;
        }
    }
    Ok(())
}

/// Moves a file that cannot be read out of the archive; where to.
fn set_aside(root: &Path, partition: &Partition) -> Result<PathBuf, Failure> {
    let path = partition.path(root);
    let damaged = partition.path(&root.join("_damaged"));
    aside::move_into(damaged.parent().unwrap_or(root), &path, "density", "parquet")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::rows::of_window;
    use crate::message::{self, tests::message};
    use std::fs;

    fn day() -> Partition {
        Partition { site: "a".into(), day: 20_458 }
    }

    fn window(seq: u64, minute: u64, number: usize) -> Window {
        let text = message("a", seq, &format!("2026-01-05T08:{minute:02}:00.000Z"));
        let window = message::read(text.as_bytes()).unwrap();
        Window { key: (60, window.from.0), rows: of_window(&window), message: number }
    }

    #[test]
    fn the_first_counts_and_another_one_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let add = |windows: Vec<Window>| merge(root, &day(), windows).unwrap();
        let done = add(vec![window(1, 0, 0), window(1, 0, 1), window(9, 0, 2)]);
        assert_eq!((done.windows, done.duplicates), (1, 1));
        let conflict = "another window of 60 s from 2026-01-05T08:00:00.000Z is archived already";
        assert_eq!(done.refused, [(2, conflict.to_owned())]);
        let first = store::read(&day().path(root)).unwrap();
        let done = add(vec![window(1, 0, 0), window(9, 0, 1)]);
        assert_eq!((done.windows, done.duplicates), (0, 1));
        assert_eq!(done.refused, [(1, conflict.to_owned())]);
        assert_eq!(store::read(&day().path(root)).unwrap(), first);
    }

    #[test]
    fn a_damaged_file_is_set_aside_and_its_day_begins_anew() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        merge(root, &day(), vec![window(1, 0, 0)]).unwrap();
        let path = day().path(root);
        let bytes = fs::read(&path).unwrap();
        for (damaged, number) in [(&bytes[..bytes.len() / 2], 1), (b"other".as_slice(), 2)] {
            fs::write(&path, damaged).unwrap();
            let done = merge(root, &day(), vec![window(2, 1, 0)]).unwrap();
            assert_eq!(done.windows, 1);
            let aside = format!("_damaged/site=a/date=2026-01-05/density-{number}.parquet");
            assert_eq!(fs::read(root.join(aside)).unwrap(), damaged);
            assert_eq!(store::read(&path).unwrap().len(), 8);
        }
    }

    #[test]
    fn a_day_has_so_many_lengths_and_windows() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let of_length = |length: i32, number: usize| {
            let mut window = window(1, 0, number);
            window.key.0 = length;
            window.rows.iter_mut().for_each(|row| row.window_s = length);
            window
        };
        let windows = (0..20).map(|n| of_length(10 + n, n as usize)).collect();
        let done = merge(root, &day(), windows).unwrap();
        assert_eq!((done.windows, done.refused.len()), (MOST_LENGTHS, 20 - MOST_LENGTHS));
        assert_eq!(done.refused[0].1, "its day has 12 lengths of windows already");
    }
}
