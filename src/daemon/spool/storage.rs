//! Windows onto the disk: appends, segments, room for them, and the numbers beside them.

use super::numbers::Numbers;
use super::record::{Checkpoint, MAX_KEYS, Record};
use super::recovery::lock;
use super::segment::{SEGMENT, Segment};
use super::{Entry, IN_MEMORY, Place, Spool};
use crate::daemon::disk;
use std::io;
use std::path::Path;

impl Spool {
    /// Writes what only the memory holds, oldest first, with what was acknowledged.
    pub(super) fn save(&mut self) {
        if self.folder.is_none() {
            return;
        }
        self.notice_removal();
        while let unsaved @ 1.. = self.in_memory_count() {
            if let Err(error) = self.save_entry(self.entries.len() - unsaved) {
                self.refuse(&error);
                return;
            }
        }
    }

    pub(super) fn save_entry(&mut self, index: usize) -> io::Result<()> {
        let Entry { key, place: Place::Memory(message), .. } = &self.entries[index] else {
            return Ok(());
        };
        let (key, record) = (*key, Record::Window { key: *key, message: message.clone() });
        let mut bytes = Vec::new();
        record.write(&mut bytes).ok_or(io::ErrorKind::InvalidData)?;
        self.make_room(key, bytes.len() + MAX_KEYS * 8 + 9)?;
        self.write_taken(&mut bytes);
        let (segment, offset) = self.append(&bytes)?;
        self.fault = None;
        // Making room may have removed older ones.
        if let Some(index) = self.find(key) {
            self.entries[index].place = Place::Disk { segment, offset };
        }
        Ok(())
    }

    /// Adds a record of acknowledgements to `bytes`, for as many as one holds.
    pub(super) fn write_taken(&mut self, bytes: &mut Vec<u8>) {
        let keys: Vec<_> = self.taken.iter().copied().take(MAX_KEYS).collect();
        if !keys.is_empty() && Record::Acknowledged(keys.clone()).write(bytes).is_some() {
            // Should the append fail they come again, once, after a crash.
            keys.iter().for_each(|key| _ = self.taken.remove(key));
        }
    }

    pub(super) fn append(&mut self, bytes: &[u8]) -> io::Result<(u64, usize)> {
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
    pub(super) fn make_room(&mut self, key: u64, len: usize) -> io::Result<()> {
        let last = self.segments.values().next_back();
        if self.writable && last.is_some_and(|last| last.has_room(len)) {
            return Ok(());
        }
        let folder = self.folder.clone().ok_or(io::ErrorKind::NotFound)?;
        // Where it cannot be made, that is the reason to give.
        std::fs::create_dir_all(&folder)?;
        while self.segments.len() >= self.max_segments {
            self.drop_oldest();
        }
        if self.lock.is_none() {
            self.lock = lock(&folder).map_err(io::Error::other)?;
        }
        let numbers = self.checkpoint(key);
        let made = Segment::create(&folder, key, &Record::Checkpoint(numbers.clone()))?;
        if let Some(last) = self.segments.values_mut().next_back() {
            last.close();
        }
        self.counts.written_bytes += SEGMENT as u64;
        self.counts.syncs += 2;
        self.segments.insert(key, made);
        self.writable = true;
        self.sweep();
        self.write_numbers(&numbers);
        Ok(())
    }

    /// Windows that only the memory holds may be delivered from there: their numbers are kept
    /// apart, so that no later run gives them to other windows.
    pub(super) fn keep_numbers(&mut self) {
        if self.folder.is_some() && self.in_memory_count() > 0 {
            let numbers = self.next.clone();
            self.write_numbers(&numbers);
        }
    }

    fn write_numbers(&mut self, numbers: &Checkpoint) {
        let Some(folder) = &self.folder else { return };
        if self.numbers.is_none() {
            self.numbers = Numbers::open(folder).ok().map(|(file, _)| file);
        }
        let Some(file) = &mut self.numbers else { return };
        if let Err(error) = file.write(numbers) {
            log::warn!("spool: numbers cannot be kept apart: {}", disk::unwritten(&error));
            self.numbers = None;
        }
        self.counts.written_bytes += 4096;
        self.counts.syncs += 1;
    }

    /// The numbers that the disk may know before the window with `key` is on it: were they
    /// ahead of it, a crash between the two would leave a gap.
    pub(super) fn checkpoint(&self, key: u64) -> Checkpoint {
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

    /// Whether somebody has removed the file that is written to, or all of the folder. What can still be
    /// read of such files is in memory then, to be written to a new one.
    pub(super) fn notice_removal(&mut self) -> bool {
        if !self.segments.values().next_back().is_some_and(Segment::is_removed) {
            return false;
        }
        let is_gone = |segment: &u64| self.segments.get(segment).is_none_or(Segment::is_removed);
        let mut lost = 0;
        for mut entry in std::mem::take(&mut self.entries) {
            if let Place::Disk { segment, offset } = entry.place
                && is_gone(&segment)
            {
                let read = self.segments.get(&segment).map(|segment| segment.read(offset));
                let Some(Ok(Some(Record::Window { message, .. }))) = read else {
                    lost += 1;
                    continue;
                };
                entry.place = Place::Memory(message);
            }
            self.entries.push_back(entry);
        }
        self.segments.retain(|_, segment| !segment.is_removed());
        self.counts.damaged += lost;
        self.writable = false;
        let folder = self.folder.as_deref().unwrap_or(Path::new(""));
        if !folder.exists() {
            (self.lock, self.numbers) = (None, None);
        }
        log::error!(
            "spool {}: its files were removed; {lost} waiting windows are lost, the others are written \
             again",
            folder.display()
        );
        true
    }

    /// The disk has refused: nothing more goes into this segment.
    pub(super) fn refuse(&mut self, error: &io::Error) {
        let fault = self.note_refusal(error);
        if self.writable || self.in_memory_count() == 1 {
            log::error!("{fault}");
        }
        self.writable = false;
    }

    /// Keeps in words that windows are in memory alone, and says them.
    pub(super) fn note_refusal(&mut self, error: &io::Error) -> String {
        let folder = self.folder.as_deref().unwrap_or(Path::new("")).display();
        let fault = format!("spool {folder}: {}; {IN_MEMORY}", disk::unwritten(error));
        self.fault = Some(fault.clone());
        fault
    }

    /// Removes segments in which nothing waits, from the oldest on: a later one may hold
    /// acknowledgements of an earlier. The newest stays, it has the numbers to go on with.
    pub(super) fn sweep(&mut self) {
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

pub(super) fn remove(segment: Segment) {
    if let Err(error) = segment.remove() {
        log::warn!(
            "spool: a segment that is done with cannot be removed: {}",
            disk::unwritten(&error)
        );
    }
}
