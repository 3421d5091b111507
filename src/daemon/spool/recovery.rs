//! Recovery of the windows that an earlier run has left on the disk.
//!
//! Owns what counts as damage, and that numbers never begin again: where it cannot be known which
//! were used, they jump over all that may have been.

use super::numbers::Numbers;
use super::record::{Checkpoint, MIN_WINDOW, Record, Scan};
use super::segment::{Opened, SEGMENT, Segment};
use super::{Entry, Given, Place, Spool, SpoolError};
use crate::daemon::disk;
use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};

/// The newest segment, when all are read.
#[derive(Default)]
struct Newest {
    scan: Scan,
    /// Position of the last good window of each length in it.
    last: BTreeMap<u32, usize>,
    torn: bool,
}

impl Spool {
    /// Reads what an earlier run has left and makes the newest segment ready.
    pub(super) fn recover(&mut self, folder: &Path) -> Result<(), SpoolError> {
        self.open_numbers(folder);
        let mut paths: Vec<_> = std::fs::read_dir(folder)?
            .filter_map(|entry| Some(entry.ok()?.path()))
            .filter(|path| path.extension().is_some_and(|ending| ending == "spool"))
            .collect();
        paths.sort();
        let mut found = BTreeMap::new();
        let mut newest = Newest::default();
        // Bytes of segments of which nothing at all could be read, or not to their end.
        let mut unknown = 0;
        let count = paths.len();
        for (index, path) in paths.into_iter().enumerate() {
            let Some(first) = path.file_stem().and_then(|name| name.to_str()?.parse().ok()) else {
                log::warn!("spool: {} has no name of ours and is left alone", path.display());
                continue;
            };
            self.next.next_key = self.next.next_key.max(first);
            let (segment, scan, len) = match Segment::open(path.clone()) {
                Ok(Opened::Segment(segment, scan, len)) => (segment, scan, len),
                Ok(Opened::Foreign) => return Err(SpoolError::Version(path)),
                Ok(Opened::Strange(what)) => {
                    log::error!("spool: {}: {what}, and is left alone", path.display());
                    self.counts.damaged += 1;
                    unknown = SEGMENT;
                    continue;
                }
                Err(error) => {
                    log::error!(
                        "spool: {}: {}; its windows are missing",
                        path.display(),
                        disk::unread(&error)
                    );
                    self.counts.damaged += 1;
                    unknown = SEGMENT;
                    continue;
                }
            };
            let damage = self.judge(&path, &scan, len, index + 1 == count);
            unknown = damage;
            newest = Newest { torn: scan.is_torn(), ..Newest::default() };
            for (offset, record) in &scan.records {
                if let Record::Window { message, .. } = record {
                    newest.last.insert(length_s(message), *offset);
                }
                self.restore(first, *offset, record.clone(), &mut found);
            }
            newest.scan = scan;
            self.segments.insert(first, segment);
        }
        self.entries = found.into_values().collect();
        self.skip_unknown(unknown, &newest);
        if self.counts.damaged > 0 {
            log::error!(
                "spool: damage in {} places: windows that stood there are lost",
                self.counts.damaged
            );
        }
        if !self.entries.is_empty() {
            log::info!("spool: {} windows of an earlier run wait", self.entries.len());
        }
        // A damaged one stays as it is until the next window makes another: what is written there
        // knows the numbers.
        if let Some(mut last) = self.segments.last_entry().filter(|_| unknown == 0) {
            last.get_mut().reopen(newest.torn)?;
            self.writable = true;
        }
        self.sweep();
        Ok(())
    }

    /// Counts and names what is damaged in a segment. Returns over how many bytes behind its
    /// good records it cannot be known what stood there.
    fn judge(&mut self, path: &Path, scan: &Scan, len: usize, is_newest: bool) -> usize {
        self.counts.damaged += scan.damaged;
        let holds_windows = scan.records.iter().any(|(_, r)| matches!(r, Record::Window { .. }));
        // A crash leaves this while a segment is being made.
        let is_unborn = is_newest && !holds_windows && !scan.is_torn() && scan.damaged == 0;
        let mut unknown = 0;
        if len < SEGMENT && !is_unborn {
            log::error!(
                "spool: {} has {len} of its {SEGMENT} bytes: it was cut, and windows may be missing",
                path.display()
            );
            self.counts.damaged += 1;
            unknown += SEGMENT - len;
        }
        if scan.is_torn() && !scan.is_cut_append() {
            log::error!("spool: {} is damaged up to its end", path.display());
            self.counts.damaged += 1;
            unknown += scan.tail;
        } else if scan.is_torn() && is_newest {
            log::warn!(
                "spool: the last record was not written to its end, as a power cut leaves it"
            );
        }
        unknown
    }

    /// Numbers that may have been used by windows which cannot be read are passed over: the same
    /// number never names another window.
    fn skip_unknown(&mut self, unknown: usize, newest: &Newest) {
        for (window_s, seq) in &mut self.next.last_seq {
            let is_hidden =
                newest.last.get(window_s).is_none_or(|&offset| offset < newest.scan.damaged_until);
            let inside = if is_hidden { newest.scan.damaged_bytes } else { 0 };
            let skipped = (unknown + inside).div_ceil(MIN_WINDOW) as u64;
            if skipped > 0 {
                log::error!(
                    "spool: numbers of windows of {window_s} s go on at {}: up to {skipped} that the \
                     damage hides are passed over",
                    *seq + skipped + 1
                );
                *seq += skipped;
            }
        }
        let bytes = unknown + newest.scan.damaged_bytes;
        if bytes > 0 {
            self.next.next_key += bytes.div_ceil(MIN_WINDOW) as u64;
            // A key counts windows of all lengths: no length had more of them.
            self.floor = self.next.next_key;
        }
    }

    /// Reads the numbers' second place. Where it cannot be had, the segments alone know them.
    pub(super) fn open_numbers(&mut self, folder: &Path) {
        match Numbers::open(folder) {
            Ok((numbers, found)) => {
                self.numbers = Some(numbers);
                found.into_iter().for_each(|numbers| self.take_numbers(numbers));
            }
            Err(error) => log::warn!(
                "spool: numbers cannot be kept apart: {}; after a kill while the disk takes nothing, \
                 numbers may be used twice",
                disk::unwritten(&error)
            ),
        }
    }

    fn take_numbers(&mut self, numbers: Checkpoint) {
        self.next.next_key = self.next.next_key.max(numbers.next_key);
        for (window_s, seq) in numbers.last_seq {
            self.remember(window_s, seq);
        }
    }

    pub(super) fn restore(
        &mut self,
        segment: u64,
        offset: usize,
        record: Record,
        found: &mut BTreeMap<u64, Entry>,
    ) {
        match record {
            Record::Checkpoint(numbers) => self.take_numbers(numbers),
            Record::Window { key, message } => {
                let window_s = length_s(&message);
                self.remember(window_s, message.seq);
                self.next.next_key = self.next.next_key.max(key + 1);
                let place = Place::Disk { segment, offset };
                found.insert(key, Entry { key, window_s, place, given: Given::No });
            }
            Record::Acknowledged(keys) => {
                for key in keys {
                    found.remove(&key);
                }
            }
        }
    }

    pub(super) fn remember(&mut self, window_s: u32, seq: u64) {
        match self.next.last_seq.iter_mut().find(|(length, _)| *length == window_s) {
            Some((_, last)) => *last = seq.max(*last),
            None => self.next.last_seq.push((window_s, seq)),
        }
    }
}

fn length_s(message: &crate::wire::DensityMessage) -> u32 {
    let report = &message.report;
    u32::try_from(report.to.saturating_since(report.from).as_secs()).unwrap_or(u32::MAX)
}

/// Takes the folder for this program; `None` where there is none to take yet. The folder itself is
/// locked, and not a file in it that someone may remove.
pub(super) fn lock(folder: &Path) -> Result<Option<File>, SpoolError> {
    let made = std::fs::create_dir_all(folder).and_then(|()| File::open(folder));
    let Ok(file) = made else { return Ok(None) };
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(std::fs::TryLockError::WouldBlock) => Err(SpoolError::InUse(PathBuf::from(folder))),
        Err(std::fs::TryLockError::Error(_)) => Ok(None),
    }
}
