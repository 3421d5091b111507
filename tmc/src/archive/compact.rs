//! From the journal into the archive: each window once, whatever arrives twice.
//!
//! Owns the order of work: records are read until they make enough rows, their partitions are
//! merged (`merge`), and a segment goes when all its windows are in their files. A crash in
//! between repeats the work and changes nothing. What cannot be read, in the journal or in the
//! archive, is set aside and costs its own windows alone. A lock on the archive lets several
//! archivers share it.

use super::aside::{self, Aside};
use super::events::Events;
use super::gaps::{self, Gap};
use super::journal::{Journal, Segment};
use super::merge::{self, Merged, Window};
use super::rows::of_window;
use crate::message::{self, Message};
use crate::store::{DAY_MS, Partition};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use verge_desk::Failure;

/// Partitions that are written at the same time; each holds a row group in memory.
const WRITERS: usize = 4;
/// Rows that are merged together: some 60 MB in memory.
const AT_ONCE_ROWS: usize = 300_000;

/// Result of a compaction.
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
    /// Lines for the log.
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
    /// Its index in the segment.
    record: usize,
}

/// Windows that are merged together.
#[derive(Debug, Default)]
struct Batch {
    days: BTreeMap<Partition, Vec<Window>>,
    /// Events in the messages beside densities, and the records they are from.
    events: Events,
    event_places: Vec<Place>,
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
        match message::read_any(payload) {
            Ok(message @ (Message::Alarm(_) | Message::Health(_))) => {
                batch.events.take(&message);
                batch.event_places.push(place);
                batch.rows += 1;
            }
            Ok(Message::Density(message)) => {
                let whole = Message::Density(message);
                batch.events.take(&whole);
                let Message::Density(message) = whole else { return };
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
        if batch.days.is_empty() && batch.events.is_empty() {
            return Ok(());
        }
        let path = self.root.join("_lock");
        let lock = File::create(&path).map_err(|source| Failure::writing(&path, source))?;
        lock.lock().map_err(|source| Failure::writing(&path, source))?;
        let mut failed = Vec::new();
        match batch.events.merge(self.root) {
            Ok(told) => self.done.told.extend(told),
            Err(failure) => {
                self.done.told.push(format!("not archived, tried again: {failure}"));
                failed.extend(batch.event_places);
            }
        }
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

#[cfg(test)]
#[path = "compact_tests.rs"]
mod tests;
