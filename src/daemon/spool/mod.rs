//! Spool: windows on the disk from the moment they are accepted until the broker has them.
//!
//! Owns the numbering of windows and the rule what is sent next; topics and connections are
//! `publish`'s. A window counts as accepted when it is on the disk. It leaves with its
//! acknowledgement, or as the oldest when the spool is full, which is counted. A crash at any
//! moment loses no accepted window; it may bring one back that the broker had taken already,
//! so that a window may arrive twice, with the same `seq`.
//!
//! A log of our own and no embedded database: a window is one append and one `fdatasync` of
//! one or two pages in a file of fixed length, where a copy-on-write tree or a database with
//! a journal writes several pages and syncs twice; nothing is ever searched; and recovery is
//! one scan that copes with any bytes. `record` has the format.

mod record;
mod segment;

use crate::wire::DensityMessage;
use record::{Checkpoint, MAX_KEYS, Record};
use segment::{SEGMENT, Segment};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// Most windows that are kept in memory while the disk takes none: a day of minutes.
pub const MAX_IN_MEMORY: usize = 1440;

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
    #[error(transparent)]
    Disk(#[from] io::Error),
}

/// What the spool holds and has lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SpoolCounts {
    /// Windows that wait for their acknowledgement.
    pub waiting: u64,
    /// Of these, windows that only the memory holds because the disk refuses them.
    pub in_memory: u64,
    /// Windows lost since start because the spool was full: the oldest go first.
    pub dropped: u64,
    /// Records that could not be read.
    pub damaged: u64,
    /// Bytes handed to the disk since start.
    pub written_bytes: u64,
    /// Times the disk was asked to have written them.
    pub syncs: u64,
}

/// A window to send, and what to call it in [`Spool::acknowledge`].
#[derive(Clone, Debug, PartialEq)]
pub struct Waiting {
    /// Its key in the spool.
    pub key: u64,
    /// The window.
    pub message: DensityMessage,
    /// No older window of its length waits behind it.
    pub is_last: bool,
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
    /// Given out since the latest [`Spool::rewind`].
    given: bool,
}

/// What a segment's bytes hold.
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
    SegmentContents { windows, notes, damaged: scan.damaged, torn: scan.torn }
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
    counts: SpoolCounts,
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
        spool.lock = lock(folder)?;
        match spool.recover(folder) {
            Err(SpoolError::Disk(error)) => {
                log::error!("spool {}: {error}; windows are kept in memory", folder.display());
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
            counts: SpoolCounts::default(),
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
        self.entries.push_back(Entry { key, window_s, place, given: false });
        self.save();
        self.bound_memory();
        (key, message)
    }

    fn next_seq(&mut self, window_s: u32) -> u64 {
        let last_seq = &mut self.next.last_seq;
        if let Some((_, seq)) = last_seq.iter_mut().find(|(length, _)| *length == window_s) {
            *seq += 1;
            return *seq;
        }
        last_seq.push((window_s, 1));
        1
    }

    /// Begins again at the oldest window: a new session knows nothing of an earlier one.
    pub fn rewind(&mut self) {
        self.entries.iter_mut().for_each(|entry| entry.given = false);
    }

    /// Notes that a window that was just accepted is being sent: it is no arrear.
    pub fn give(&mut self, key: u64) {
        if let Some(index) = self.find(key) {
            self.entries[index].given = true;
        }
    }

    /// The oldest window that was not given out yet.
    pub fn next_arrear(&mut self) -> Option<Waiting> {
        loop {
            let index = self.entries.iter().position(|entry| !entry.given)?;
            let Entry { key, window_s, .. } = self.entries[index];
            match self.read(&self.entries[index].place) {
                Ok(message) => {
                    self.entries[index].given = true;
                    let same = |entry: &Entry| !entry.given && entry.window_s == window_s;
                    let is_last = !self.entries.range(index..).any(same);
                    return Some(Waiting { key, message, is_last });
                }
                Err(error) => {
                    log::error!("a window is lost: its record cannot be read: {error}");
                    self.counts.damaged += 1;
                    self.acknowledge(key);
                }
            }
        }
    }

    fn read(&self, place: &Place) -> io::Result<DensityMessage> {
        let (segment, offset) = match place {
            Place::Memory(message) => return Ok(message.as_ref().clone()),
            Place::Disk { segment, offset } => (segment, *offset),
        };
        let segment = self.segments.get(segment).ok_or(io::ErrorKind::NotFound)?;
        match segment.read(offset)? {
            Record::Window { message, .. } => Ok(*message),
            _ => Err(io::ErrorKind::InvalidData.into()),
        }
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

    /// What the spool holds and has lost.
    pub fn counts(&self) -> SpoolCounts {
        SpoolCounts {
            waiting: self.entries.len() as u64,
            in_memory: self.in_memory_count() as u64,
            ..self.counts
        }
    }

    /// How many windows only the memory holds: the newest, for they are saved in their order.
    fn in_memory_count(&self) -> usize {
        let in_memory = |entry: &&Entry| matches!(entry.place, Place::Memory(_));
        self.entries.iter().rev().take_while(in_memory).count()
    }

    fn find(&self, key: u64) -> Option<usize> {
        self.entries.binary_search_by_key(&key, |entry| entry.key).ok()
    }

    /// Reads what an earlier run has left and makes the newest segment ready.
    fn recover(&mut self, folder: &Path) -> Result<(), SpoolError> {
        let mut paths: Vec<_> = std::fs::read_dir(folder)?
            .filter_map(|entry| Some(entry.ok()?.path()))
            .filter(|path| path.extension().is_some_and(|ending| ending == "spool"))
            .collect();
        paths.sort();
        let mut found = BTreeMap::new();
        let mut torn = false;
        for path in paths {
            let Some(first) = path.file_stem().and_then(|name| name.to_str()?.parse().ok()) else {
                log::warn!("spool: {} has no name of ours and is left alone", path.display());
                continue;
            };
            let (segment, scan) = match Segment::open(path.clone()) {
                Ok(opened) => opened.ok_or(SpoolError::Version(path))?,
                Err(error) => {
                    log::error!("spool: {}: {error}", path.display());
                    self.counts.damaged += 1;
                    continue;
                }
            };
            self.counts.damaged += scan.damaged;
            torn = scan.torn;
            for (offset, record) in scan.records {
                self.restore(first, offset, record, &mut found);
            }
            self.next.next_key = self.next.next_key.max(first);
            self.segments.insert(first, segment);
        }
        self.entries = found.into_values().collect();
        if self.counts.damaged > 0 {
            log::error!("spool: {} damaged records were skipped", self.counts.damaged);
        }
        if !self.entries.is_empty() {
            log::info!("spool: {} windows of an earlier run wait", self.entries.len());
        }
        if let Some(mut last) = self.segments.last_entry() {
            last.get_mut().reopen(torn)?;
            self.writable = true;
        }
        self.sweep();
        Ok(())
    }

    fn restore(
        &mut self,
        segment: u64,
        offset: usize,
        record: Record,
        found: &mut BTreeMap<u64, Entry>,
    ) {
        match record {
            Record::Checkpoint(numbers) => {
                self.next.next_key = self.next.next_key.max(numbers.next_key);
                for (window_s, seq) in numbers.last_seq {
                    self.remember(window_s, seq);
                }
            }
            Record::Window { key, message } => {
                let report = &message.report;
                let window_s = report.to.saturating_since(report.from).as_secs();
                let window_s = u32::try_from(window_s).unwrap_or(u32::MAX);
                self.remember(window_s, message.seq);
                self.next.next_key = self.next.next_key.max(key + 1);
                let place = Place::Disk { segment, offset };
                found.insert(key, Entry { key, window_s, place, given: false });
            }
            Record::Acknowledged(keys) => {
                for key in keys {
                    found.remove(&key);
                }
            }
        }
    }

    fn remember(&mut self, window_s: u32, seq: u64) {
        match self.next.last_seq.iter_mut().find(|(length, _)| *length == window_s) {
            Some((_, last)) => *last = seq.max(*last),
            None => self.next.last_seq.push((window_s, seq)),
        }
    }

    /// Writes what only the memory holds, oldest first, with what was acknowledged.
    fn save(&mut self) {
        if self.folder.is_none() {
            return;
        }
        while let unsaved @ 1.. = self.in_memory_count() {
            if let Err(error) = self.save_entry(self.entries.len() - unsaved) {
                self.refuse(&error);
                return;
            }
        }
    }

    fn save_entry(&mut self, index: usize) -> io::Result<()> {
        let Entry { key, place: Place::Memory(message), .. } = &self.entries[index] else {
            return Ok(());
        };
        let (key, record) = (*key, Record::Window { key: *key, message: message.clone() });
        let mut bytes = Vec::new();
        record.write(&mut bytes).ok_or(io::ErrorKind::InvalidData)?;
        self.make_room(key, bytes.len() + MAX_KEYS * 8 + 9)?;
        self.write_taken(&mut bytes);
        let (segment, offset) = self.append(&bytes)?;
        // Making room may have removed older ones.
        if let Some(index) = self.find(key) {
            self.entries[index].place = Place::Disk { segment, offset };
        }
        Ok(())
    }

    /// Adds a record of acknowledgements to `bytes`, for as many as one holds.
    fn write_taken(&mut self, bytes: &mut Vec<u8>) {
        let keys: Vec<_> = self.taken.iter().copied().take(MAX_KEYS).collect();
        if !keys.is_empty() && Record::Acknowledged(keys.clone()).write(bytes).is_some() {
            // Should the append fail they come again, once, after a crash.
            keys.iter().for_each(|key| _ = self.taken.remove(key));
        }
    }

    fn append(&mut self, bytes: &[u8]) -> io::Result<(u64, usize)> {
        let mut last = self.segments.last_entry().ok_or(io::ErrorKind::NotFound)?;
        if !last.get().has_room(bytes.len()) {
            return Err(io::ErrorKind::StorageFull.into());
        }
        let offset = last.get_mut().append(bytes)?;
        self.counts.written_bytes += bytes.len() as u64;
        self.counts.syncs += 1;
        Ok((*last.key(), offset))
    }

    /// Sees to a segment with room for `len` bytes, by a new one where it must.
    fn make_room(&mut self, key: u64, len: usize) -> io::Result<()> {
        let last = self.segments.values().next_back();
        if self.writable && last.is_some_and(|last| last.has_room(len)) {
            return Ok(());
        }
        let folder = self.folder.clone().ok_or(io::ErrorKind::NotFound)?;
        while self.segments.len() >= self.max_segments {
            self.drop_oldest();
        }
        if self.lock.is_none() {
            self.lock = lock(&folder).map_err(io::Error::other)?;
        }
        let head = Record::Checkpoint(self.checkpoint(key));
        let made = Segment::create(&folder, key, &head)?;
        self.counts.written_bytes += SEGMENT as u64;
        self.counts.syncs += 2;
        self.segments.insert(key, made);
        self.writable = true;
        self.sweep();
        Ok(())
    }

    /// The numbers that the disk may know before the window with `key` is on it: were they
    /// ahead of it, a crash between the two would leave a gap.
    fn checkpoint(&self, key: u64) -> Checkpoint {
        let mut last_seq = self.next.last_seq.clone();
        for entry in self.entries.iter().rev() {
            if let Place::Memory(message) = &entry.place
                && let Some((_, last)) = last_seq.iter_mut().find(|(s, _)| *s == entry.window_s)
            {
                *last = message.seq - 1;
            }
        }
        Checkpoint { next_key: key, last_seq }
    }

    /// The disk has refused: nothing more goes into this segment.
    fn refuse(&mut self, error: &io::Error) {
        if self.writable || self.in_memory_count() == 1 {
            log::error!("spool: {error}; windows are kept in memory until the disk takes them");
        }
        self.writable = false;
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

    /// Removes segments in which nothing waits, from the oldest on: a later one may hold
    /// acknowledgements of an earlier. The newest stays, it has the numbers to go on with.
    fn sweep(&mut self) {
        while self.segments.len() > 1
            && let Some((&first, _)) = self.segments.first_key_value()
        {
            let on_it = |entry: &Entry| match entry.place {
                Place::Disk { segment, .. } => segment == first,
                Place::Memory(_) => false,
            };
            // Entries are in the order of their segments.
            if self.entries.front().is_some_and(on_it) {
                return;
            }
            let Some((_, segment)) = self.segments.pop_first() else { return };
            remove(segment);
            let next = self.segments.first_key_value().map_or(u64::MAX, |(&next, _)| next);
            self.taken.retain(|&key| key >= next);
        }
    }
}

fn remove(segment: Segment) {
    if let Err(error) = segment.remove() {
        log::warn!("spool: a segment that is done with cannot be removed: {error}");
    }
}

/// Takes the folder for this program; `None` where there is none to take yet.
fn lock(folder: &Path) -> Result<Option<File>, SpoolError> {
    let made = std::fs::create_dir_all(folder)
        .and_then(|()| File::options().create(true).append(true).open(folder.join("lock")));
    let Ok(file) = made else { return Ok(None) };
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(std::fs::TryLockError::WouldBlock) => Err(SpoolError::InUse(folder.to_owned())),
        Err(std::fs::TryLockError::Error(_)) => Ok(None),
    }
}

#[cfg(test)]
mod tests;
