//! What an earlier run has left on the disk.

use super::record::Record;
use super::segment::Segment;
use super::{Entry, Place, Spool, SpoolError};
use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;

impl Spool {
    /// Reads what an earlier run has left and makes the newest segment ready.
    pub(super) fn recover(&mut self, folder: &Path) -> Result<(), SpoolError> {
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

    pub(super) fn restore(
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

    pub(super) fn remember(&mut self, window_s: u32, seq: u64) {
        match self.next.last_seq.iter_mut().find(|(length, _)| *length == window_s) {
            Some((_, last)) => *last = seq.max(*last),
            None => self.next.last_seq.push((window_s, seq)),
        }
    }
}

/// Takes the folder for this program; `None` where there is none to take yet.
pub(super) fn lock(folder: &Path) -> Result<Option<File>, SpoolError> {
    let made = std::fs::create_dir_all(folder)
        .and_then(|()| File::options().create(true).append(true).open(folder.join("lock")));
    let Ok(file) = made else { return Ok(None) };
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(std::fs::TryLockError::WouldBlock) => Err(SpoolError::InUse(folder.to_owned())),
        Err(std::fs::TryLockError::Error(_)) => Ok(None),
    }
}
