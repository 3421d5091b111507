//! One file of the spool: records that are on the disk when an append returns.
//!
//! Owns files and their syncing; `record` has the meaning of the bytes. Only the segment that is
//! written to holds a descriptor: others are opened for each reading, so that their number is
//! bounded by the disk alone.
//!
//! A segment is written with zeros to its full length when it is made. An append then
//! changes neither the file's length nor its blocks, so that `fdatasync` writes the touched
//! pages and no journal of the file system: on an SD card that is most of the wear.

use super::record::{self, HEAD, Record, Scan};
use rustix::fs::OFlags;
use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

/// Length of a segment, bytes: room for some 120 windows of eight lanes with all cells. Tests
/// fill many.
pub(super) const SEGMENT: usize = if cfg!(test) { 16 } else { 256 } * 1024;

/// One file of the spool.
#[derive(Debug)]
pub(super) struct Segment {
    path: PathBuf,
    /// Of the segment that is written to.
    file: Option<File>,
    end: usize,
}

/// Result of opening a file with a segment's name.
#[derive(Debug)]
pub(super) enum Opened {
    /// A segment with its good records, and the bytes of the file that were read.
    Segment(Segment, Scan, usize),
    /// Of a format that another version of the program has written.
    Foreign,
    /// Not a file that this program would have made.
    Strange(&'static str),
}

/// Opens a file of ours: no link, and nothing that could keep the program waiting.
pub(super) fn open_plain(path: &Path, options: &mut OpenOptions) -> io::Result<File> {
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK;
    options.custom_flags(i32::try_from(flags.bits()).unwrap_or(0)).open(path)
}

impl Segment {
    /// Makes the segment whose first window has `key`, with `first` as its first record.
    pub(super) fn create(folder: &Path, key: u64, first: &Record) -> io::Result<Self> {
        let path = folder.join(format!("{key:020}.spool"));
        // A file of that name can only be what a failed attempt has left behind.
        let mut options = OpenOptions::new();
        let file = open_plain(&path, options.read(true).write(true).create(true).truncate(true))?;
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
        Ok(Self { path, file: Some(file), end })
    }

    /// Opens a segment that is there, and reads all its good records.
    pub(super) fn open(path: PathBuf) -> io::Result<Opened> {
        let is_link = std::fs::symlink_metadata(&path)?.is_symlink();
        if is_link {
            return Ok(Opened::Strange("it is a link"));
        }
        let file = open_plain(&path, OpenOptions::new().read(true))?;
        let metadata = file.metadata()?;
        if !metadata.is_file() {
            return Ok(Opened::Strange("it is not a plain file"));
        }
        if metadata.len() > SEGMENT as u64 {
            return Ok(Opened::Strange("it is longer than a segment"));
        }
        let mut bytes = Vec::new();
        file.take(SEGMENT as u64).read_to_end(&mut bytes)?;
        let head = &bytes[..bytes.len().min(HEAD.len())];
        if head.len() == HEAD.len() && head[..3] == HEAD[..3] && head != HEAD {
            return Ok(Opened::Foreign);
        }
        let mut scan = record::scan(&bytes);
        scan.damaged += u64::from(head != HEAD && bytes.iter().any(|&byte| byte != 0));
        let end = scan.end;
        Ok(Opened::Segment(Self { path, file: None, end }, scan, bytes.len()))
    }

    /// Makes an opened segment ready for appends: removes what stands behind its end.
    pub(super) fn reopen(&mut self, torn: bool) -> io::Result<()> {
        let file = open_plain(&self.path, OpenOptions::new().read(true).write(true))?;
        let len = usize::try_from(file.metadata()?.len()).unwrap_or(SEGMENT);
        if (torn || len < SEGMENT) && self.end < SEGMENT {
            let zeros = vec![0; SEGMENT - self.end];
            file.write_all_at(&zeros, self.end as u64)?;
            file.sync_all()?;
        }
        self.file = Some(file);
        Ok(())
    }

    /// Nothing more is written here.
    pub(super) fn close(&mut self) {
        self.file = None;
    }

    /// Whether `len` more bytes fit.
    pub(super) fn has_room(&self, len: usize) -> bool {
        self.end + len <= SEGMENT
    }

    /// Whether somebody has removed the file: what is appended is gone when the program ends.
    pub(super) fn is_removed(&self) -> bool {
        match &self.file {
            Some(file) => file.metadata().is_ok_and(|there| there.nlink() == 0),
            None => !self.path.exists(),
        }
    }

    /// Appends bytes of records and returns where they begin; they are on the disk then.
    pub(super) fn append(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let file = self.file.as_ref().ok_or(io::ErrorKind::NotFound)?;
        file.write_all_at(bytes, self.end as u64)?;
        file.sync_data()?;
        let start = self.end;
        self.end += bytes.len();
        Ok(start)
    }

    /// The record at `offset`; `None` where its bytes are damaged, twice over.
    ///
    /// # Errors
    /// The disk cannot be read, which says nothing about the record.
    pub(super) fn read(&self, offset: usize) -> io::Result<Option<Record>> {
        let opened;
        let file = match &self.file {
            Some(file) => file,
            None => {
                opened = open_plain(&self.path, OpenOptions::new().read(true))?;
                &opened
            }
        };
        for _ in 0..2 {
            let mut bytes = [0; record::MAX_RECORD];
            let mut filled = 0;
            while filled < bytes.len() {
                match file.read_at(&mut bytes[filled..], (offset + filled) as u64)? {
                    0 => break,
                    some => filled += some,
                }
            }
            if let Some((record, _)) = Record::read(&bytes[..filled]) {
                return Ok(Some(record));
            }
        }
        Ok(None)
    }

    /// Removes the file.
    pub(super) fn remove(self) -> io::Result<()> {
        std::fs::remove_file(&self.path)
    }
}
