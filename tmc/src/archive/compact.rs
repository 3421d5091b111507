//! From the journal into the archive: each window once, whatever arrives twice.
//!
//! Owns the order of work: records are read until they make enough rows, their partitions are
//! merged (`merge`), and a segment goes when all its windows are in their files. A crash in
//! between repeats the work and changes nothing. What cannot be read, in the journal or in the
//! archive, is set aside and costs its own windows alone. A lock on the archive lets several
//! archivers share it.

use super::aside::{self, Aside};
use super::gaps::{self, Gap};
use super::journal::{Journal, Segment};
use super::merge::{self, Merged, Window};
use crate::message;
use crate::store::{DAY_MS, Partition, Row};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use verge_desk::Failure;
use verge_messages::Density;

/// Partitions that are written at the same time; each holds a row group in memory.
const WRITERS: usize = 4;
/// Rows that are merged together: some 60 MB in memory.
const AT_ONCE_ROWS: usize = 300_000;

/// What a compaction did.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Done {
    /// Windows added to the archive.
    pub windows: usize,
    /// Messages of windows that were there already.
    pub duplicates: usize,
    /// Messages that could not be taken; some of them lie in `_rejected`.
    pub rejected: usize,
    /// Gaps in the numbers of messages that remain in the days that were touched.
    pub gaps: Vec<Gap>,
    /// What is to be said of it.
    pub told: Vec<String>,
    /// The days that were touched.
    days: Vec<Partition>,
    /// Those whose first and those whose last window is another than before.
    edges: gaps::Edges,
}

impl Done {
    /// Takes in what was done with a partition after it.
    fn take(&mut self, day: Partition, merged: Merged) {
        self.windows += merged.windows;
        self.duplicates += merged.duplicates;
        self.rejected += merged.refused.len();
        // A day that was touched again has new gaps.
        self.gaps.retain(|gap| !gap.begins_in(&day));
        self.gaps.extend(merged.gaps);
        self.days.push(day);
        self.edges.first.extend(merged.edges.first);
        self.edges.last.extend(merged.edges.last);
    }
}

/// A record of a segment, to be found again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Place {
    segment: usize,
    /// Which of its records.
    record: usize,
}

/// Windows that are merged together.
#[derive(Debug, Default)]
struct Batch {
    days: BTreeMap<Partition, Vec<Window>>,
    places: Vec<Place>,
    rows: usize,
}

/// Where an archiver's windows wait that could not be archived: their site's folder or day
/// cannot be written.
pub fn failed(root: &Path, name: &str) -> PathBuf {
    root.join("_journal").join(name).join("failed")
}

/// Moves closed segments into the archive under `root`; `name` is the archiver's.
///
/// Several at once where they are small: a day's file is then rewritten once for all of them.
///
/// # Errors
/// [`Failure`] where the journal or the archive as a whole cannot be read or written; the
/// segments then stay and are tried again.
pub fn compact(root: &Path, name: &str, segments: &[PathBuf]) -> Result<Done, Failure> {
    let mut work = Work {
        root,
        segments,
        failed: failed(root, name),
        aside: Aside::open(root, &format!("{name}-compact"))?,
        done: Done::default(),
    };
    let (mut batch, mut first) = (Batch::default(), 0);
    for (index, path) in segments.iter().enumerate() {
        let segment = Segment::read(path)?;
        let mut records = segment.records();
        for (record, payload) in records.by_ref().enumerate() {
            work.take(&mut batch, Place { segment: index, record }, payload);
            if batch.rows >= AT_ONCE_ROWS {
                work.merge(std::mem::take(&mut batch))?;
            }
        }
        if records.damaged() > 0 {
            // Its whole records are in the batch; the segment itself is kept.
            work.merge(std::mem::take(&mut batch))?;
            work.keep(path, records.damaged())?;
            work.remove(&segments[first..index])?;
            first = index + 1;
        }
    }
    work.merge(batch)?;
    work.remove(&segments[first..])?;
    let Work { mut done, mut aside, .. } = work;
    done.told.extend(aside.tell()?);
    // Only now are all days as they will be.
    done.gaps.extend(gaps::between(root, &done.edges)?);
    done.gaps.sort();
    Ok(done)
}

struct Work<'a> {
    root: &'a Path,
    segments: &'a [PathBuf],
    failed: PathBuf,
    aside: Aside,
    done: Done,
}

impl Work<'_> {
    fn take(&mut self, batch: &mut Batch, place: Place, payload: &[u8]) {
        match message::read(payload) {
            Ok(message) => {
                let day = message.from.0.div_euclid(DAY_MS);
                let rows = of_window(&message);
                batch.rows += rows.len();
                let window = Window {
                    key: (message.window_s as i32, message.from.0),
                    rows,
                    message: batch.places.len(),
                };
                let partition = Partition { site: message.site, day };
                batch.days.entry(partition).or_default().push(window);
                batch.places.push(place);
            }
            // From before messages were checked at the door.
            Err(reason) => {
                self.done.rejected += 1;
                self.aside.refuse("?", &reason, payload);
            }
        }
    }

    /// Merges what was collected; a partition that fails costs its own windows.
    fn merge(&mut self, batch: Batch) -> Result<(), Failure> {
        if batch.days.is_empty() {
            return Ok(());
        }
        let path = self.root.join("_lock");
        let lock = File::create(&path).map_err(|source| Failure::writing(&path, source))?;
        lock.lock().map_err(|source| Failure::writing(&path, source))?;
        let mut failed = Vec::new();
        for (partition, messages, result) in merge_all(self.root, batch.days) {
            match result {
                Ok(merged) => {
                    self.refuse(&partition.site, &merged.refused, &batch.places)?;
                    self.done.take(partition, merged);
                }
                Err(failure) => {
                    let site = &partition.site;
                    self.done.told.push(format!("{site}: not archived, tried again: {failure}"));
                    failed.extend(messages.into_iter().map(|message| batch.places[message]));
                }
            }
        }
        if failed.is_empty() {
            return Ok(());
        }
        let mut journal = Journal::open(&self.failed)?;
        let payloads = self.payloads(failed)?;
        journal.append(payloads.iter().map(Vec::as_slice))
    }

    /// Counts what a partition did not take, and keeps some of it.
    fn refuse(
        &mut self,
        site: &str,
        refused: &[(usize, String)],
        places: &[Place],
    ) -> Result<(), Failure> {
        let (kept, counted) = refused.split_at(refused.len().min(self.aside.room(site)));
        let payloads = self.payloads(kept.iter().map(|(message, _)| places[*message]).collect())?;
        for ((_, reason), payload) in kept.iter().zip(payloads) {
            self.aside.refuse(site, reason, &payload);
        }
        for (_, reason) in counted {
            self.aside.refuse(site, reason, &[]);
        }
        Ok(())
    }

    /// The messages of records, in the order of the journal.
    fn payloads(&self, mut places: Vec<Place>) -> Result<Vec<Vec<u8>>, Failure> {
        places.sort_unstable();
        let mut found = Vec::new();
        for places in places.chunk_by(|a, b| a.segment == b.segment) {
            let segment = Segment::read(&self.segments[places[0].segment])?;
            let mut wanted = places.iter().peekable();
            for (number, payload) in segment.records().enumerate() {
                if wanted.next_if(|place| place.record == number).is_some() {
                    found.push(payload.to_vec());
                }
            }
        }
        Ok(found)
    }

    /// Keeps a segment in which something could not be read.
    fn keep(&mut self, segment: &Path, damaged: usize) -> Result<(), Failure> {
        let name = |path: Option<&Path>| {
            path.and_then(Path::file_stem).unwrap_or_default().to_string_lossy().into_owned()
        };
        let own = format!("{}-{}", name(segment.parent()), name(Some(segment)));
        let kept = aside::move_into(&self.root.join("_rejected"), segment, &own, "journal")?;
        let told = format!("{damaged} bytes of the journal could not be read: {}", kept.display());
        self.done.told.push(told);
        Ok(())
    }

    fn remove(&self, segments: &[PathBuf]) -> Result<(), Failure> {
        for segment in segments {
            fs::remove_file(segment).map_err(|source| Failure::writing(segment, source))?;
        }
        Ok(())
    }
}

/// Merges partitions side by side, those with the smallest files first: a site with much waits
/// for the others, and they not for it.
fn merge_all(
    root: &Path,
    days: BTreeMap<Partition, Vec<Window>>,
) -> Vec<(Partition, Vec<usize>, Result<Merged, Failure>)> {
    let mut days: Vec<_> = days.into_iter().collect();
    days.sort_by_key(|(partition, windows)| {
        let bytes = fs::metadata(partition.path(root)).map_or(0, |file| file.len());
        (bytes, windows.len())
    });
    let queue = Mutex::new(days.into_iter());
    let work = || {
        let mut all = Vec::new();
        loop {
            let next = queue.lock().expect("no thread panics with it").next();
            let Some((partition, windows)) = next else { return all };
            let messages = windows.iter().map(|window| window.message).collect();
            let merged = merge::merge(root, &partition, windows);
            all.push((partition, messages, merged));
        }
    };
    std::thread::scope(|scope| {
        let running: Vec<_> = (0..WRITERS).map(|_| scope.spawn(work)).collect();
        running.into_iter().flat_map(|thread| thread.join().expect("no thread panics")).collect()
    })
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
            ci90: lane.density_ci90,
            calibration_se: lane.calibration_se,
            counting_se: lane.counting_se,
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
                ci90: None,
                calibration_se: None,
                counting_se: None,
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
    use crate::message::tests::message;
    use crate::store;
    use std::collections::BTreeSet;

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
            compact(root, "a", &journal.closed().unwrap()).unwrap()
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
                let done = compact(root, "a", &journal.closed().unwrap()).unwrap();
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
        let done = compact(root, "a", &segments).unwrap();
        assert_eq!((done.windows, done.duplicates, done.gaps), (3, 1, vec![]));
        assert!(journal.closed().unwrap().is_empty());
    }

    #[test]
    fn a_damaged_segment_gives_what_is_whole_in_it_and_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let mut journal = Journal::open(&root.join("_journal/a")).unwrap();
        let messages: Vec<String> = (1..=9).map(|seq| minute("a", seq)).collect();
        journal.append(messages.iter().map(String::as_bytes)).unwrap();
        journal.close_segment();
        let segment = journal.closed().unwrap().remove(0);
        let mut bytes = fs::read(&segment).unwrap();
        // A bit of the second record's length.
        let second = 8 + messages[0].len();
        bytes[second + 1] ^= 1;
        // After a restart another segment may have the same number.
        for (round, windows) in [(1, 8), (2, 0)] {
            fs::write(&segment, &bytes).unwrap();
            let done = compact(root, "a", std::slice::from_ref(&segment)).unwrap();
            assert_eq!((done.windows, done.duplicates, done.rejected), (windows, 8 - windows, 0));
            assert_eq!(done.gaps.len(), 1, "one window is missing, and that is told");
            let said = &done.told[0];
            assert!(said.contains("bytes of the journal could not be read"), "{said}");
            let kept = format!("_rejected/a-00000001-{round}.journal");
            assert_eq!(fs::read(root.join(kept)).unwrap(), bytes);
            assert!(journal.closed().unwrap().is_empty());
        }
    }

    #[test]
    fn a_site_that_cannot_be_written_stops_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let mut journal = Journal::open(&root.join("_journal/a")).unwrap();
        journal.append([minute("a", 1).as_bytes(), minute("b", 1).as_bytes()].into_iter()).unwrap();
        journal.close_segment();
        fs::write(root.join("site=a"), "in the way").unwrap();
        let segments = journal.closed().unwrap();
        let done = compact(root, "a", &segments).unwrap();
        assert_eq!(done.windows, 1);
        assert!(done.told[0].starts_with("a: not archived, tried again: "), "{:?}", done.told);
        assert_eq!(store::site_partitions(root, "b").unwrap().len(), 1);
        assert!(journal.closed().unwrap().is_empty());
        fs::remove_file(root.join("site=a")).unwrap();
        let waiting = Journal::open(&failed(root, "a")).unwrap().closed().unwrap();
        let done = compact(root, "a", &waiting).unwrap();
        assert_eq!((done.windows, done.duplicates), (1, 0));
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
        compact(root, "a", std::slice::from_ref(&segment)).unwrap();
        let path = store::partitions(root).unwrap()[0].path(root);
        let first = fs::read(&path).unwrap();
        // As after a crash before the segment was removed.
        fs::write(&segment, &kept).unwrap();
        let done = compact(root, "a", std::slice::from_ref(&segment)).unwrap();
        assert_eq!((done.windows, done.duplicates), (0, 9));
        assert_eq!(fs::read(&path).unwrap(), first);
    }
}
