//! The journal: messages that are safe on the disk and not yet in the archive.
//!
//! Segments `00000001.journal` and so on in a folder of one archiver. A record is its length
//! (4 bytes, little-endian), a CRC-32 of the payload (4 bytes) and the payload. A torn record
//! at the end is what a crash leaves: its message was not acknowledged and comes again. Behind
//! a damaged one the next whole record is looked for, byte by byte, and a segment with damage
//! is kept, for what could not be read in it may have been acknowledged.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use verge_desk::Failure;

/// A segment as large as this is closed, bytes; it is read as a whole.
pub const SEGMENT_BYTES: u64 = 16 << 20;
/// A record is never longer, bytes.
const LONGEST: usize = 1 << 20;
const HEADER: usize = 8;

/// The journal of one archiver, locked.
#[derive(Debug)]
pub struct Journal {
    folder: PathBuf,
    number: u64,
    file: Option<File>,
    written: u64,
    // Held as long as the journal is; the system drops it with the process.
    _lock: File,
}

impl Journal {
    /// Opens the journal in `folder`; what is in it stays for the archive.
    ///
    /// # Errors
    /// [`Failure`] where the folder cannot be made or another archiver has it.
    pub fn open(folder: &Path) -> Result<Self, Failure> {
        let path = folder.join("lock");
        let lock = fs::create_dir_all(folder)
            .and_then(|()| File::create(&path))
            .map_err(|source| Failure::writing(&path, source))?;
        lock.try_lock().map_err(|_| {
            let hint = "is held by another archiver: give each one its own --name";
            Failure::writing(&path, io::Error::other(hint))
        })?;
        let number = segments(folder)?.last().map_or(0, |(number, _)| *number);
        Ok(Self { folder: folder.to_owned(), number, file: None, written: 0, _lock: lock })
    }

    /// Adds messages; they are on the disk when this returns.
    ///
    /// # Errors
    /// [`Failure::Write`]; then none may be acknowledged.
    pub fn append<'a>(&mut self, payloads: impl Iterator<Item = &'a [u8]>) -> Result<(), Failure> {
        let mut bytes = Vec::new();
        for payload in payloads {
            let mut crc = flate2::Crc::new();
            crc.update(payload);
            bytes.extend((payload.len() as u32).to_le_bytes());
            bytes.extend(crc.sum().to_le_bytes());
            bytes.extend(payload);
        }
        let path = self.folder.join(format!("{:08}.journal", self.number + 1));
        let failed = |source| Failure::writing(&path, source);
        if self.file.is_none() {
            let file = File::create(&path).map_err(failed)?;
            File::open(&self.folder).and_then(|folder| folder.sync_all()).map_err(failed)?;
            self.file = Some(file);
        }
        let file = self.file.as_mut().expect("it was just made");
        file.write_all(&bytes).and_then(|()| file.sync_data()).map_err(failed)?;
        self.written += bytes.len() as u64;
        Ok(())
    }

    /// Bytes in the open segment.
    pub fn written(&self) -> u64 {
        self.written
    }

    /// Closes the open segment, so that the next message begins another.
    pub fn close_segment(&mut self) {
        if self.file.take().is_some() {
            self.number += 1;
            self.written = 0;
        }
    }

    /// The closed segments, oldest first.
    ///
    /// # Errors
    /// [`Failure`] where the folder cannot be read.
    pub fn closed(&self) -> Result<Vec<PathBuf>, Failure> {
        let all = segments(&self.folder)?.into_iter();
        Ok(all.filter(|(number, _)| *number <= self.number).map(|(_, path)| path).collect())
    }
}

fn segments(folder: &Path) -> Result<Vec<(u64, PathBuf)>, Failure> {
    let failed = |source| Failure::reading(folder, source);
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let number = name.strip_suffix(".journal").and_then(|number| number.parse().ok());
        found.extend(number.map(|number| (number, path.clone())));
    }
    found.sort();
    Ok(found)
}

/// A segment in memory.
#[derive(Debug)]
pub struct Segment {
    bytes: Vec<u8>,
}

impl Segment {
    /// Reads it.
    ///
    /// # Errors
    /// [`Failure`] where it cannot be read.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let bytes = fs::read(path).map_err(|source| Failure::reading(path, source))?;
        Ok(Self { bytes })
    }

    /// Its whole records, in their order.
    pub const fn records(&self) -> Records<'_> {
        Records { rest: self.bytes.as_slice(), damaged: 0 }
    }
}

/// The whole records of a segment, one after the other.
#[derive(Clone, Debug)]
pub struct Records<'s> {
    rest: &'s [u8],
    damaged: usize,
}

impl Records<'_> {
    /// Bytes that were passed over so far because they are no record; zeros, which a file
    /// system leaves where it never wrote, do not count.
    pub const fn damaged(&self) -> usize {
        self.damaged
    }
}

impl<'s> Iterator for Records<'s> {
    type Item = &'s [u8];

    fn next(&mut self) -> Option<&'s [u8]> {
        while let Some((&first, behind)) = self.rest.split_first() {
            if let Some(payload) = record(self.rest) {
                self.rest = &self.rest[HEADER + payload.len()..];
                return Some(payload);
            }
            self.damaged += usize::from(first != 0);
            self.rest = behind;
        }
        None
    }
}

/// The payload of a whole record at the beginning of these bytes.
fn record(bytes: &[u8]) -> Option<&[u8]> {
    let (header, after) = bytes.split_first_chunk::<HEADER>()?;
    let [l0, l1, l2, l3, c0, c1, c2, c3] = *header;
    let length = u32::from_le_bytes([l0, l1, l2, l3]) as usize;
    let payload = after.get(..length).filter(|_| (1..=LONGEST).contains(&length))?;
    let mut crc = flate2::Crc::new();
    crc.update(payload);
    (crc.sum() == u32::from_le_bytes([c0, c1, c2, c3])).then_some(payload)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(path: &Path) -> (Vec<Vec<u8>>, usize) {
        let segment = Segment::read(path).unwrap();
        let mut records = segment.records();
        let payloads = records.by_ref().map(<[u8]>::to_vec).collect();
        (payloads, records.damaged())
    }

    #[test]
    fn a_flipped_bit_costs_its_own_record_and_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let mut journal = Journal::open(folder.path()).unwrap();
        let sent: Vec<Vec<u8>> = (0..5u8).map(|n| vec![b'a' + n; 40 + usize::from(n)]).collect();
        journal.append(sent.iter().map(Vec::as_slice)).unwrap();
        journal.close_segment();
        let path = journal.closed().unwrap().remove(0);
        let whole = fs::read(&path).unwrap();
        let begins = [0, 48, 97, 147, 198];
        for bit in 0..whole.len() * 8 {
            let mut wrong = whole.clone();
            wrong[bit / 8] ^= 1 << (bit % 8);
            fs::write(&path, &wrong).unwrap();
            let hit = begins.iter().rposition(|begin| *begin <= bit / 8).unwrap();
            let mut left = sent.clone();
            left.remove(hit);
            let (payloads, damaged) = read(&path);
            assert_eq!(payloads, left, "bit {bit}");
            assert!(damaged > 0, "bit {bit}");
        }
    }

    #[test]
    fn records_survive_and_a_torn_end_is_cut() {
        let folder = tempfile::tempdir().unwrap();
        let mut journal = Journal::open(folder.path()).unwrap();
        assert!(Journal::open(folder.path()).is_err(), "a second archiver is refused");
        journal.append([b"one".as_slice(), b"two"].into_iter()).unwrap();
        assert_eq!(journal.closed().unwrap().len(), 0);
        journal.close_segment();
        journal.append([b"three".as_slice()].into_iter()).unwrap();
        let closed = journal.closed().unwrap();
        assert_eq!(closed.len(), 1);
        let whole = fs::read(&closed[0]).unwrap();
        for length in 0..=whole.len() {
            fs::write(&closed[0], &whole[..length]).unwrap();
            let (payloads, torn) = read(&closed[0]);
            let expected = [0, 11, 22].iter().filter(|end| **end > 0 && **end <= length).count();
            assert_eq!(payloads.len(), expected);
            let rest = &whole[expected * 11..length];
            assert_eq!(torn, rest.iter().filter(|byte| **byte != 0).count());
        }
        let mut wrong = whole.clone();
        wrong[9] ^= 1;
        fs::write(&closed[0], &wrong).unwrap();
        assert_eq!(read(&closed[0]).0, [b"two"]);
        fs::write(&closed[0], [&whole[..], &[0; 40]].concat()).unwrap();
        let (payloads, torn) = read(&closed[0]);
        assert_eq!((payloads.len(), torn), (2, 0));
        drop(journal);
        // After a restart both are closed, and a new one has its own number.
        let mut journal = Journal::open(folder.path()).unwrap();
        assert_eq!(journal.closed().unwrap().len(), 2);
        journal.append([b"four".as_slice()].into_iter()).unwrap();
        assert_eq!(segments(folder.path()).unwrap().len(), 3);
    }
}
