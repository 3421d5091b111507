//! One file of the spool: records that are on the disk when an append returns.
//!
//! Owns files and their syncing; what the bytes mean is `record`'s.
//!
//! A segment is written with zeros to its full length when it is made. An append then
//! changes neither the file's length nor its blocks, so that `fdatasync` writes the touched
//! pages and no journal of the file system: on an SD card that is most of the wear.

use super::record::{self, HEAD, Record, Scan};
use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Length of a segment, bytes: room for some 120 windows of eight lanes with all cells. Tests
/// fill many.
pub(super) const SEGMENT: usize = if cfg!(test) { 16 } else { 256 } * 1024;

/// One file of the spool.
#[derive(Debug)]
pub(super) struct Segment {
    path: PathBuf,
    file: File,
    end: usize,
}

impl Segment {
    /// Makes the segment whose first window has `key`, with `first` as its first record.
    pub(super) fn create(folder: &Path, key: u64, first: &Record) -> io::Result<Self> {
        let path = folder.join(format!("{key:020}.spool"));
        // A file of that name can only be what a failed attempt has left behind.
        let file =
            OpenOptions::new().read(true).write(true).create(true).truncate(true).open(&path)?;
        let mut bytes = HEAD.to_vec();
        first.write(&mut bytes).ok_or(io::ErrorKind::InvalidData)?;
        let end = bytes.len();
        bytes.resize(SEGMENT, 0);
        let written = file.write_all_at(&bytes, 0).and_then(|()| file.sync_all());
        if let Err(error) = written.and_then(|()| File::open(folder)?.sync_all()) {
            // Nothing half-made is left; where even that fails, the next scan copes.
            let _ = std::fs::remove_file(&path);
            return Err(error);
        }
        Ok(Self { path, file, end })
    }

    /// Opens a segment that is there, and reads all its good records. `None` for a format
    /// that another version of the program has written.
    pub(super) fn open(path: PathBuf) -> io::Result<Option<(Self, Scan)>> {
        let bytes = std::fs::read(&path)?;
        let file = File::open(&path)?;
        let head = &bytes[..bytes.len().min(HEAD.len())];
        if head.len() == HEAD.len() && head[..3] == HEAD[..3] && head != HEAD {
            return Ok(None);
        }
        let mut scan = record::scan(&bytes);
        scan.damaged += u64::from(head != HEAD);
        Ok(Some((Self { path, file, end: scan.end }, scan)))
    }

    /// Makes an opened segment ready for appends: removes what stands behind its end.
    pub(super) fn reopen(&mut self, torn: bool) -> io::Result<()> {
        self.file = OpenOptions::new().read(true).write(true).open(&self.path)?;
        let len = usize::try_from(self.file.metadata()?.len()).unwrap_or(SEGMENT);
        if (torn || len < SEGMENT) && self.end < SEGMENT {
            let zeros = vec![0; SEGMENT - self.end];
            self.file.write_all_at(&zeros, self.end as u64)?;
            self.file.sync_all()?;
        }
        Ok(())
    }

    /// Whether `len` more bytes fit.
    pub(super) fn has_room(&self, len: usize) -> bool {
        self.end + len <= SEGMENT
    }

    /// Appends bytes of records and returns where they begin; they are on the disk then.
    pub(super) fn append(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write_all_at(bytes, self.end as u64)?;
        self.file.sync_data()?;
        let start = self.end;
        self.end += bytes.len();
        Ok(start)
    }

    /// The record at `offset`.
    pub(super) fn read(&self, offset: usize) -> io::Result<Record> {
        let mut bytes = [0; record::MAX_RECORD];
        let mut filled = 0;
        while filled < bytes.len() {
            match self.file.read_at(&mut bytes[filled..], (offset + filled) as u64)? {
                0 => break,
                some => filled += some,
            }
        }
        Record::read(&bytes[..filled])
            .map(|(record, _)| record)
            .ok_or_else(|| io::Error::new(io::ErrorKind::InvalidData, "a damaged record"))
    }

    /// Removes the file.
    pub(super) fn remove(self) -> io::Result<()> {
        std::fs::remove_file(&self.path)
    }
}
