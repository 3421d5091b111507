//! The numbers to go on with, in a second place.
//!
//! Owns one file of two pages beside the segments. It is written when a segment is made, and with
//! each window that the disk has no room for: its blocks are there already, so that a full disk
//! takes it. Where segments are damaged, or windows were delivered from memory before a kill,
//! numbers go on from here and none is used twice.
//!
//! Each page holds one checkpoint as `record` writes it; they are written in turn, so that a page
//! that is torn leaves the other. Numbers only grow: the larger ones of both pages hold.

use super::record::{Checkpoint, Record};
use super::segment::open_plain;
use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::FileExt;
use std::path::Path;

/// Name of the file. Segments end in `.spool`.
const NAME: &str = "numbers";
const PAGE: usize = 4096;

/// The file, ready to be written.
#[derive(Debug)]
pub(super) struct Numbers {
    file: File,
    /// The page that is written next.
    page: u64,
}

impl Numbers {
    /// Opens or makes the file in `folder`, and returns what it holds.
    pub(super) fn open(folder: &Path) -> io::Result<(Self, Vec<Checkpoint>)> {
        let mut options = OpenOptions::new();
        let path = folder.join(NAME);
        let file = open_plain(&path, options.read(true).write(true).create(true).truncate(false))?;
        let mut bytes = Vec::new();
        if !file.metadata()?.is_file() {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "it is not a plain file"));
        }
        (&file).take(2 * PAGE as u64).read_to_end(&mut bytes)?;
        if bytes.len() < 2 * PAGE {
            let missing = vec![0; 2 * PAGE - bytes.len()];
            file.write_all_at(&missing, bytes.len() as u64)?;
            file.sync_all()?;
            File::open(folder)?.sync_all()?;
        }
        let found: Vec<_> = bytes.chunks(PAGE).map(read).collect();
        // The page with the larger numbers stays until the other is written.
        let newer = found.get(1).cloned().flatten().map(|page| page.next_key)
            > found.first().cloned().flatten().map(|page| page.next_key);
        Ok((Self { file, page: u64::from(!newer) }, found.into_iter().flatten().collect()))
    }

    /// Writes the numbers; they are on the disk then.
    pub(super) fn write(&mut self, numbers: &Checkpoint) -> io::Result<()> {
        let mut bytes = Vec::with_capacity(PAGE);
        Record::Checkpoint(numbers.clone()).write(&mut bytes).ok_or(io::ErrorKind::InvalidData)?;
        bytes.resize(PAGE, 0);
        self.file.write_all_at(&bytes, self.page * PAGE as u64)?;
        self.file.sync_data()?;
        self.page = 1 - self.page;
        Ok(())
    }
}

fn read(page: &[u8]) -> Option<Checkpoint> {
    match Record::read(page) {
        Some((Record::Checkpoint(numbers), _)) => Some(numbers),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_torn_page_leaves_the_other() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let numbers = |seq| Checkpoint { next_key: seq + 1, last_seq: vec![(60, seq)] };
        let (mut file, found) = Numbers::open(folder.path()).expect("made");
        assert!(found.is_empty());
        for seq in 1..=5 {
            file.write(&numbers(seq)).expect("written");
        }
        let path = folder.path().join(NAME);
        let whole = std::fs::read(&path).expect("readable");
        assert_eq!(whole.len(), 2 * PAGE);
        let (mut again, found) = Numbers::open(folder.path()).expect("there");
        assert_eq!(found, [numbers(4), numbers(5)]);
        // The next one goes over the older.
        again.write(&numbers(6)).expect("written");
        let (_, found) = Numbers::open(folder.path()).expect("there");
        assert_eq!(found, [numbers(6), numbers(5)]);
        for torn in [0, PAGE] {
            let mut bytes = whole.clone();
            bytes[torn + 9] ^= 1;
            std::fs::write(&path, bytes).expect("written");
            let (_, found) = Numbers::open(folder.path()).expect("there");
            assert_eq!(found, [if torn == 0 { numbers(5) } else { numbers(4) }]);
        }
    }
}
