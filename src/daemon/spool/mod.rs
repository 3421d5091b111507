//! Spool: windows on the disk from the moment they are accepted until the broker has them.
//!
//! Owns the numbering of windows, and when one leaves; `publish` has topics and connections. A
//! window counts as accepted when it is on the disk. It leaves with its acknowledgement, or as the
//! oldest when the spool is full, which is counted. A crash at any moment loses no accepted window;
//! it may bring one back that the broker had taken already, so that a window may arrive twice, with
//! the same `seq`. A disk that cannot be read acknowledges nothing: what stands there is asked for
//! again.
//!
//! A log of our own and no embedded database: a window is one append and one `fdatasync` of
//! one or two pages in a file of fixed length, where a copy-on-write tree or a database with
//! a journal writes several pages and syncs twice; nothing is ever searched; and recovery is
//! one scan that copes with any bytes. `record` has the format, `storage` writes, `numbers` keeps the
//! numbers in a second place, `recovery` reads what an earlier run has left, `arrears` says which
//! window is sent next.

mod arrears;
mod numbers;
mod record;
mod recovery;
mod segment;
mod storage;

use crate::daemon::disk;
use crate::wire::DensityMessage;
use arrears::Given;
pub use arrears::Waiting;
use numbers::Numbers;
use record::{Checkpoint, Record};
use recovery::lock;
use segment::{SEGMENT, Segment};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use storage::remove;

/// Most windows that are kept in memory while the disk takes none: a day of minutes.
pub const MAX_IN_MEMORY: usize = 1440;

/// Consequence of a disk that takes no windows.
const IN_MEMORY: &str = "until the disk takes them windows are kept in memory alone, and those that the \
                         broker has not taken are lost at the next restart";

/// Why a spool cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SpoolError {
    /// Another program has it.
    #[error("spool {}: in use by another verge; give each daemon a folder of its own", .0.display())]
    InUse(PathBuf),
    /// A segment that this program does not read.
    #[error(
        "spool {}: written by another version of verge; let that version deliver it, or move \
         the file away",
        .0.display()
    )]
    Version(PathBuf),
    /// The disk.
    #[error("spool: {}", disk::unwritten(.0))]
    Disk(#[from] io::Error),
}

/// Counts of held and of lost windows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SpoolCounts {
    /// Windows that wait for their acknowledgement.
    pub waiting: u64,
    /// Of these, windows that only the memory holds because the disk refuses them.
    pub in_memory: u64,
    /// Windows lost since start because the spool was full: the oldest go first.
    pub dropped: u64,
    /// Records that could not be read, and segments that are damaged as a whole.
    pub damaged: u64,
    /// Bytes handed to the disk since start.
    pub written_bytes: u64,
    /// Times the disk was asked to have written them.
    pub syncs: u64,
}

#[derive(Debug)]
enum Place {
    /// Segment by its first key, and offset in it.
    Disk {
        segment: u64,
        offset: usize,
    },
    Memory(Box<DensityMessage>),
}

#[derive(Debug)]
struct Entry {
    key: u64,
    window_s: u32,
    place: Place,
    given: Given,
}

/// Content of a segment's bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SegmentContents {
    /// Good records of windows.
    pub windows: usize,
    /// Other good records.
    pub notes: usize,
    /// Stretches of damage between good records.
    pub damaged: u64,
    /// Whether the last record was not written to its end.
    pub torn: bool,
}

/// Looks through a segment, whatever its bytes are.
pub fn examine(segment: &[u8]) -> SegmentContents {
    let scan = record::scan(segment);
    let is_window = |(_, record): &&(usize, Record)| matches!(record, Record::Window { .. });
    let windows = scan.records.iter().filter(is_window).count();
    let notes = scan.records.len() - windows;
    SegmentContents { windows, notes, damaged: scan.damaged, torn: scan.is_torn() }
}

/// Whether windows can be written in a folder; false where another verge has it. Nothing is left
/// there, and a folder that was not there is not afterwards.
///
/// # Errors
/// The system's error.
pub fn probe(folder: &Path) -> io::Result<bool> {
    let is_new = !folder.exists();
    std::fs::create_dir_all(folder)?;
    let outcome = match lock(folder) {
        Err(_) => Ok(false),
        Ok(_) => {
            let trial = folder.join("check");
            let written = std::fs::write(&trial, vec![0; SEGMENT]);
            let _ = std::fs::remove_file(&trial);
            written.map(|()| true)
        }
    };
    if is_new {
        let _ = std::fs::remove_dir(folder);
    }
    outcome
}

/// Windows on their way to the broker.
#[derive(Debug)]
pub struct Spool {
    folder: Option<PathBuf>,
    max_segments: usize,
    /// By the first key; the last is the one that is written to while `writable`.
    segments: BTreeMap<u64, Segment>,
    writable: bool,
    entries: VecDeque<Entry>,
    /// Acknowledged, but not noted on the disk yet.
    taken: BTreeSet<u64>,
    next: Checkpoint,
    /// The number before the first of a length of which nothing is known.
    floor: u64,
    /// The numbers' second place; `None` while it cannot be had.
    numbers: Option<Numbers>,
    counts: SpoolCounts,
    /// Why the disk takes no windows, in words, until it takes one again.
    fault: Option<String>,
    /// Whether a failed read of the disk was logged.
    unreadable_said: bool,
    /// Held for the life of the spool.
    lock: Option<File>,
}

impl Spool {
    /// A spool that holds `windows` of the largest size in `folder`, with what an earlier
    /// run has left there. Where the disk refuses, windows are kept in memory and the disk
    /// is tried again with each of them.
    ///
    /// # Errors
    /// [`SpoolError::InUse`] and [`SpoolError::Version`].
    pub fn open(folder: &Path, windows: u64) -> Result<Self, SpoolError> {
        let mut spool = Self::in_memory();
        spool.keep(windows);
        spool.folder = Some(folder.to_owned());
        let made = std::fs::create_dir_all(folder);
        spool.lock = lock(folder)?;
        match made.map_err(SpoolError::Disk).and_then(|()| spool.recover(folder)) {
            Err(SpoolError::Disk(error)) => {
                let fault = spool.note_refusal(&error);
                log::error!("{fault}");
            }
            outcome => outcome?,
        }
        Ok(spool)
    }

    /// From here on it holds `windows` of the largest size; where it holds more, the oldest
    /// go when the next segment is made.
    pub fn keep(&mut self, windows: u64) {
        let per_segment = (SEGMENT / record::MAX_RECORD - 1) as u64;
        // One more: the oldest goes when the newest is full.
        self.max_segments = usize::try_from(windows.div_ceil(per_segment) + 1).unwrap_or(2);
    }

    /// A spool without a disk, for recordings.
    pub fn in_memory() -> Self {
        Self {
            folder: None,
            max_segments: 0,
            segments: BTreeMap::new(),
            writable: false,
            entries: VecDeque::new(),
            taken: BTreeSet::new(),
            next: Checkpoint { next_key: 1, last_seq: Vec::new() },
            floor: 0,
            numbers: None,
            counts: SpoolCounts::default(),
            fault: None,
            unreadable_said: false,
            lock: None,
        }
    }

    /// Takes a window of `window_s` seconds, which `number` makes with its `seq`, and
    /// returns it with its key. It is on the disk then, or counted as in memory only.
    pub fn accept(
        &mut self,
        window_s: u32,
        number: impl FnOnce(u64) -> DensityMessage,
    ) -> (u64, DensityMessage) {
        let message = number(self.next_seq(window_s));
        let key = self.next.next_key;
        self.next.next_key += 1;
        let place = Place::Memory(Box::new(message.clone()));
        self.entries.push_back(Entry { key, window_s, place, given: Given::No });
        self.save();
        self.bound_memory();
        self.keep_numbers();
        (key, message)
    }

    fn next_seq(&mut self, window_s: u32) -> u64 {
        let last_seq = &mut self.next.last_seq;
        if let Some((_, seq)) = last_seq.iter_mut().find(|(length, _)| *length == window_s) {
            *seq += 1;
            return *seq;
        }
        last_seq.push((window_s, self.floor + 1));
        self.floor + 1
    }

    /// The broker has taken the window with this key.
    pub fn acknowledge(&mut self, key: u64) {
        let Some(index) = self.find(key) else { return };
        if let Some(Entry { place: Place::Disk { .. }, .. }) = self.entries.remove(index) {
            self.taken.insert(key);
        }
        self.sweep();
    }

    /// Writes down which windows the broker has taken, so that a later run does not send
    /// them again. It is done with every accepted window, too.
    pub fn note_acknowledged(&mut self) {
        if self.notice_removal() {
            self.save();
        }
        while self.writable && !self.taken.is_empty() {
            let mut bytes = Vec::new();
            self.write_taken(&mut bytes);
            let last = self.segments.values().next_back();
            if !last.is_some_and(|last| last.has_room(bytes.len())) {
                // The next window makes a segment; until then these may come twice.
                return;
            }
            if let Err(error) = self.append(&bytes) {
                self.refuse(&error);
            }
        }
    }

    /// Counts of held and of lost windows.
    pub fn counts(&self) -> SpoolCounts {
        SpoolCounts {
            waiting: self.entries.len() as u64,
            in_memory: self.in_memory_count() as u64,
            ..self.counts
        }
    }

    /// Why windows are in memory alone, and what to do; `None` while the disk takes them.
    pub fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }

    /// How many windows only the memory holds: the newest, for they are saved in their order.
    fn in_memory_count(&self) -> usize {
        let in_memory = |entry: &&Entry| matches!(entry.place, Place::Memory(_));
        self.entries.iter().rev().take_while(in_memory).count()
    }

    fn find(&self, key: u64) -> Option<usize> {
        self.entries.binary_search_by_key(&key, |entry| entry.key).ok()
    }

    /// Gives up the oldest segment with what waits in it.
    fn drop_oldest(&mut self) {
        let Some((first, segment)) = self.segments.pop_first() else { return };
        let before = self.entries.len();
        self.entries.retain(
            |entry| !matches!(entry.place, Place::Disk { segment, .. } if segment == first),
        );
        self.count_dropped((before - self.entries.len()) as u64);
        remove(segment);
    }

    fn bound_memory(&mut self) {
        let count = self.in_memory_count();
        let excess = count.saturating_sub(MAX_IN_MEMORY);
        let first = self.entries.len() - count;
        self.entries.drain(first..first + excess);
        self.count_dropped(excess as u64);
    }

    fn count_dropped(&mut self, windows: u64) {
        if windows > 0 && self.counts.dropped == 0 {
            log::error!("the spool is full: the oldest windows are lost");
        }
        self.counts.dropped += windows;
    }
}

#[cfg(test)]
mod damage_tests;
#[cfg(test)]
mod tests;
