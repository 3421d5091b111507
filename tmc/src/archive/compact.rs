//! From the journal into the archive: each window once, whatever arrives twice.
//!
//! A partition's file is read, the windows that it lacks are added, and it is replaced as a
//! whole; a segment goes when all its windows are in their files. A crash in between repeats
//! the work and changes nothing. A lock on the archive lets several archivers share it.

use super::gaps::{self, Gap};
use super::journal;
use crate::failure::Failure;
use crate::message;
use crate::store::{self, DAY_MS, Partition, Row};
use crate::whole;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use verge_messages::Density;

/// Partitions that are written at the same time; each holds one site's day in memory.
const WRITERS: usize = 8;
/// Segments are read together up to this size, bytes of messages; in memory they take less.
const AT_ONCE_BYTES: usize = 256 << 20;

/// What a compaction did.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Done {
    /// Windows added to the archive.
    pub windows: usize,
    /// Messages of windows that were there already.
    pub duplicates: usize,
    /// Messages that could not be read; they lie in `_rejected`.
    pub rejected: usize,
    /// Gaps in the numbers of messages that remain in the days that were touched.
    pub gaps: Vec<Gap>,
    /// The days that were touched.
    days: Vec<Partition>,
    /// Those whose first and those whose last window is another than before.
    edges: gaps::Edges,
}

impl Done {
    /// Takes in what was done after it.
    fn take(&mut self, later: Self) {
        self.windows += later.windows;
        self.duplicates += later.duplicates;
        self.rejected += later.rejected;
        // A day that was touched again has new gaps.
        self.gaps.retain(|gap| !later.days.iter().any(|day| gap.begins_in(day)));
        self.gaps.extend(later.gaps);
        self.days.extend(later.days);
        self.edges.first.extend(later.edges.first);
        self.edges.last.extend(later.edges.last);
    }
}

/// Moves closed segments into the archive under `root`.
///
/// Several at once where they are small: a day's file is then rewritten once for all of them.
///
/// # Errors
/// [`Failure`]; the segments then stay and are tried again.
pub fn compact(root: &Path, segments: &[PathBuf]) -> Result<Done, Failure> {
    let mut done = Done::default();
    let mut rest = segments;
    while !rest.is_empty() {
        let mut days = BTreeMap::new();
        let (mut bytes, mut count) = (0, 0);
        while bytes < AT_ONCE_BYTES && count < rest.len() {
            bytes += take_segment(root, &rest[count], &mut days, &mut done)?;
            count += 1;
        }
        let path = root.join("_lock");
        let lock = File::create(&path).map_err(|source| Failure::writing(&path, source))?;
        lock.lock().map_err(|source| Failure::writing(&path, source))?;
        done.take(merge_all(root, days)?);
        for segment in &rest[..count] {
            fs::remove_file(segment).map_err(|source| Failure::writing(segment, source))?;
        }
        rest = &rest[count..];
    }
    // Only now are all days as they will be.
    done.gaps.extend(gaps::between(root, &done.edges)?);
    done.gaps.sort();
    Ok(done)
}

/// Reads a segment's windows into their days and keeps aside what cannot be read; its size.
fn take_segment(
    root: &Path,
    segment: &Path,
    days: &mut BTreeMap<Partition, Vec<Density>>,
    done: &mut Done,
) -> Result<usize, Failure> {
    let (payloads, torn) = journal::read(segment)?;
    if torn > 0 {
        eprintln!("verge-tmc: {}: {torn} bytes are torn, passed over", segment.display());
    }
    let (mut bytes, mut rejected) = (0, Vec::new());
    for payload in payloads {
        bytes += payload.len();
        match message::read(&payload) {
            Ok(window) => {
                let day = window.from.0.div_euclid(DAY_MS);
                let partition = Partition { site: window.site.clone(), day };
                days.entry(partition).or_default().push(window);
            }
            Err(reason) => {
                if done.rejected == 0 {
                    eprintln!("verge-tmc: a message is rejected: {reason}");
                }
                done.rejected += 1;
                rejected.extend(payload);
                rejected.push(b'\n');
            }
        }
    }
    if !rejected.is_empty() {
        let name = |path: Option<&Path>| {
            path.and_then(Path::file_stem).unwrap_or_default().to_string_lossy().into_owned()
        };
        let own = format!("{}-{}.txt", name(segment.parent()), name(Some(segment)));
        whole::write(&root.join("_rejected").join(own), &rejected)?;
    }
    Ok(bytes)
}

/// Merges partitions side by side: the time goes into waiting for the disk.
fn merge_all(root: &Path, days: BTreeMap<Partition, Vec<Density>>) -> Result<Done, Failure> {
    let queue = Mutex::new(days.into_iter());
    let work = || -> Result<Done, Failure> {
        let mut done = Done::default();
        loop {
            let next = queue.lock().expect("no thread panics with it").next();
            let Some((partition, windows)) = next else { return Ok(done) };
            done.take(merge(root, &partition, &windows)?);
        }
    };
    let results: Vec<Result<Done, Failure>> = std::thread::scope(|scope| {
        let running: Vec<_> = (0..WRITERS).map(|_| scope.spawn(work)).collect();
        running.into_iter().map(|thread| thread.join().expect("no thread panics")).collect()
    });
    let mut done = Done::default();
    for result in results {
        done.take(result?);
    }
    Ok(done)
}

fn merge(root: &Path, partition: &Partition, windows: &[Density]) -> Result<Done, Failure> {
    let path = partition.path(root);
    let mut rows = if path.exists() { store::read(&path)? } else { Vec::new() };
    let known = rows.len();
    let mut there: BTreeSet<(i32, i64)> =
        rows.iter().map(|row| (row.window_s, row.from_ms)).collect();
    let mut done = Done { days: vec![partition.clone()], ..Done::default() };
    for window in windows {
        if there.insert((window.window_s as i32, window.from.0)) {
            rows.extend(of_window(window));
            done.windows += 1;
        } else {
            done.duplicates += 1;
        }
    }
    if done.windows > 0 {
        let before = gaps::ends(&rows[..known]);
        rows.sort_by_key(Row::key);
        store::write(&path, &rows)?;
        done.edges = gaps::Edges::of(partition, &before, &gaps::ends(&rows));
    }
    done.gaps = gaps::within(&partition.site, &rows);
    Ok(done)
}

/// The rows of a window: its lanes, then their cells.
pub fn of_window(window: &Density) -> Vec<Row> {
    let mut rows = Vec::new();
    for lane in &window.lanes {
        let row = Row {
            window_s: window.window_s as i32,
            from_ms: window.from.0,
            lane: i32::from(lane.lane),
            cell: None,
            position_m: None,
            length_m: lane.length_m,
            density: lane.density_veh_km,
            se: lane.density_se,
            vehicles: lane.vehicles_mean,
            occupancy: lane.space_occupancy,
            frames_used: lane.frames_used as i32,
            frames_expected: lane.frames_expected as i32,
            status: lane.status.number().into(),
            seq: window.seq as i64,
            clock_synced: window.clock_synced,
            rel_err: window.calibration.rel_err,
        };
        rows.push(row.clone());
        let Some(cells) = &lane.cells else { continue };
        // A list that is not known is a cell of which nothing is known, as often as there are.
        let densities = cells.density_veh_km.as_deref();
        for cell in 0..cells.count(lane.length_m) {
            let density = densities.and_then(|all| all.get(cell)).copied();
            let begin = cell as f32 * cells.length_m;
            let length_m = cells.length_m.min(lane.length_m - begin).max(0.0);
            rows.push(Row {
                cell: Some(cell as i32),
                position_m: Some(begin),
                length_m,
                density,
                se: None,
                vehicles: density.map(|density| density * length_m / 1000.0),
                occupancy: None,
                ..row.clone()
            });
        }
    }
    rows.sort_by_key(Row::key);
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::journal::Journal;
    use crate::message::tests::message;

    fn minute(site: &str, seq: u64) -> String {
        message(site, seq, &format!("2026-01-05T08:{:02}:00.000Z", seq - 1))
    }

    #[test]
    fn each_window_stands_once_and_gaps_close_when_they_are_filled() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let mut journal = Journal::open(&root.join("_journal/a")).unwrap();
        let mut archive = |messages: &[String]| {
            journal.append(messages.iter().map(String::as_bytes)).unwrap();
            journal.close_segment();
            compact(root, &journal.closed().unwrap()).unwrap()
        };
        let done = archive(&[minute("a", 1), minute("a", 2), minute("a", 2), minute("a", 5)]);
        assert_eq!((done.windows, done.duplicates, done.rejected), (3, 1, 0));
        let gap =
            |missing| Gap { site: "a".into(), window_s: 60, after_ms: 1_767_600_060_000, missing };
        assert_eq!(done.gaps, [gap(2)]);
        let done = archive(&[minute("a", 4), minute("a", 1), "{}".into(), minute("b", 9)]);
        assert_eq!((done.windows, done.duplicates, done.rejected), (2, 1, 1));
        assert_eq!(done.gaps, [gap(1)]);
        let done = archive(&[minute("a", 3)]);
        assert_eq!((done.windows, done.duplicates, done.gaps), (1, 0, vec![]));
        let partitions = store::partitions(root).unwrap();
        assert_eq!(partitions.iter().map(|p| p.site.as_str()).collect::<Vec<_>>(), ["a", "b"]);
        assert_eq!(partitions[0].date(), "2026-01-05");
        let rows = store::read(&partitions[0].path(root)).unwrap();
        // Five windows of two lanes, with two cells and with four of which nothing is known.
        assert_eq!(rows.len(), 5 * 8);
        assert_eq!(rows.iter().filter(|row| row.cell.is_some()).count(), 5 * 6);
        let keys: BTreeSet<_> = rows.iter().map(Row::key).collect();
        assert_eq!(keys.len(), rows.len());
        assert_eq!(fs::read_dir(root.join("_rejected")).unwrap().count(), 1);
        assert!(journal.closed().unwrap().is_empty());
    }

    #[test]
    fn a_gap_over_midnight_is_found_whichever_day_comes_first() {
        let at = |seq, time: &str| message("a", seq, &format!("2026-01-{time}:00.000Z"));
        let (evening, later) = (at(7, "05T23:58"), at(8, "05T23:59"));
        // A day without a file lies between; 900 s is no neighbour of 60 s.
        let (morning, other) = (at(11, "07T00:00"), at(40, "07T00:00").replace(":60,", ":900,"));
        let other = other.replace("07T00:01:00.000Z", "07T00:15:00.000Z");
        let second = at(12, "07T00:01");
        for order in [[&evening, &morning], [&morning, &evening]] {
            let folder = tempfile::tempdir().unwrap();
            let root = folder.path();
            let mut journal = Journal::open(&root.join("_journal/a")).unwrap();
            let mut missing = |messages: &[&String]| {
                journal.append(messages.iter().map(|message| message.as_bytes())).unwrap();
                journal.close_segment();
                let done = compact(root, &journal.closed().unwrap()).unwrap();
                done.gaps.iter().map(|gap| gap.missing).collect::<Vec<_>>()
            };
            assert_eq!(missing(&order[..1]), [0; 0]);
            assert_eq!(missing(&order[1..]), [3]);
            assert_eq!(missing(&[&other]), [3], "the day has another first window");
            assert_eq!(missing(&[&second]), [0; 0], "that is not beside the gap");
            assert_eq!(missing(&[&later]), [2]);
        }
    }

    #[test]
    fn several_segments_become_one_day() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let mut journal = Journal::open(&root.join("_journal/a")).unwrap();
        for seq in [2, 1, 2, 3] {
            journal.append([minute("a", seq).as_bytes()].into_iter()).unwrap();
            journal.close_segment();
        }
        let segments = journal.closed().unwrap();
        assert_eq!(segments.len(), 4);
        let done = compact(root, &segments).unwrap();
        assert_eq!((done.windows, done.duplicates, done.gaps), (3, 1, vec![]));
        assert!(journal.closed().unwrap().is_empty());
    }

    #[test]
    fn a_compaction_that_is_repeated_changes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let mut journal = Journal::open(&root.join("_journal/a")).unwrap();
        let messages: Vec<String> = (1..=9).map(|seq| minute("a", seq)).collect();
        journal.append(messages.iter().map(String::as_bytes)).unwrap();
        journal.close_segment();
        let segment = journal.closed().unwrap().remove(0);
        let kept = fs::read(&segment).unwrap();
        compact(root, std::slice::from_ref(&segment)).unwrap();
        let path = store::partitions(root).unwrap()[0].path(root);
        let first = fs::read(&path).unwrap();
        // As after a crash before the segment was removed.
        fs::write(&segment, &kept).unwrap();
        let done = compact(root, std::slice::from_ref(&segment)).unwrap();
        assert_eq!((done.windows, done.duplicates), (0, 9));
        assert_eq!(fs::read(&path).unwrap(), first);
    }
}
