//! The empty road over restarts: one file beside the windows that wait.
//!
//! Owns the file's format, and when it is not taken. A restart would else begin with what the lane
//! table knows, and count marks for hours until the road is learned again. Nothing depends on the file:
//! what is wrong with it costs that memory and is logged.
//!
//! | offset | bytes | field |
//! |---|---|---|
//! | 0 | 8 | magic `VERGERD` and a zero |
//! | 8 | 1 | format version, 1 |
//! | 9 | 1 | length of the camera's name |
//! | 10 | 2, 2 | columns and rows of the grid |
//! | 14 | 32 | SHA-256 of the lane table |
//! | 46 | 8 | when it was written, ms since 1970 |
//! | 54 | 2 x 12 | by day and by night: pictures learned from, u32; age then, ms, u64, or all ones for never |
//! | 78 | n | the camera's name, UTF-8 |
//! | 78+n | 8 N | by day, then by night: N = columns x rows cells of two i16 |
//! | the last | 4 | CRC-32 (ISO-HDLC) of all bytes before |
//!
//! Numbers are little-endian.

use super::output::{WholeFile, WriteError};
use super::plain;
use crate::scene::{EmptyRoad, Known, MAX_SIDE, MeanCell};
use crate::units::UtcMs;
use crc::{CRC_32_ISO_HDLC, Crc};
use std::path::Path;
use std::time::Duration;

/// Its name in the spool's folder.
pub const NAME: &str = "empty_road";
const MAGIC: [u8; 8] = *b"VERGERD\0";
const VERSION: u8 = 1;
const HEADER: usize = 78;
const CELL: usize = 4;
const TRAILER: usize = 4;
/// Largest file: two lights of the largest grid, and a name. Below 1 MB.
const MOST: u64 = (HEADER + 255 + 2 * MAX_SIDE * MAX_SIDE * CELL + TRAILER) as u64;
/// From this age on it is learned again: the sun stands elsewhere, and lines are painted.
const OLDEST: Duration = Duration::from_secs(14 * 86_400);
const NEVER: u64 = u64::MAX;
const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Why a file is not taken.
#[derive(Debug, thiserror::Error)]
pub enum RoadError {
    /// It cannot be read.
    #[error("it cannot be read: {0}")]
    Read(#[from] std::io::Error),
    /// It is damaged, or another kind of file.
    #[error("it is damaged ({0})")]
    Damaged(&'static str),
    /// A later program wrote it.
    #[error("it has format {0}, this program reads {VERSION}")]
    Version(u8),
    /// It is another camera's.
    #[error("it is of camera {0:?}")]
    Camera(String),
    /// It was learned with another lane table, so that the camera may look elsewhere.
    #[error("it was learned with another lane table")]
    Table,
    /// It says little of the road of now.
    #[error("it is {} days old, {} are the most", .0.as_secs() / 86_400, OLDEST.as_secs() / 86_400)]
    Old(Duration),
}

/// The road as a line has learned it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Road {
    /// SHA-256 of the lane table with which it was learned.
    pub table: [u8; 32],
    /// Columns and rows of the grid.
    pub grid: [usize; 2],
    /// By day and by night.
    pub known: [Known; 2],
    /// The memory.
    pub cells: Vec<MeanCell>,
}

impl Road {
    /// The content of a memory at `now`.
    pub fn of(table: [u8; 32], road: &EmptyRoad<Vec<MeanCell>>, now: Duration) -> Self {
        let (grid, known) = (road.grid(), road.known(now));
        Self { table, grid: [grid.width, grid.height], known, cells: road.cells().to_vec() }
    }

    /// Writes the file, whole or not at all.
    ///
    /// # Errors
    /// `WriteError` names the file.
    pub fn write(&self, path: &Path, camera: &str, now: UtcMs) -> Result<(), WriteError> {
        let mut file = WholeFile::create(path)?;
        file.bytes(&self.encode(camera, now))?;
        file.finish()
    }

    fn encode(&self, camera: &str, now: UtcMs) -> Vec<u8> {
        let name = &camera.as_bytes()[..camera.len().min(255)];
        let mut bytes = Vec::with_capacity(HEADER + name.len() + self.cells.len() * CELL + TRAILER);
        bytes.extend(MAGIC);
        bytes.extend([VERSION, name.len() as u8]);
        self.grid.iter().for_each(|&side| bytes.extend((side as u16).to_le_bytes()));
        bytes.extend(self.table);
        bytes.extend(now.0.to_le_bytes());
        for Known { seen, age } in self.known {
            bytes.extend(seen.to_le_bytes());
            let age = age.map_or(NEVER, |age| u64::try_from(age.as_millis()).unwrap_or(NEVER - 1));
            bytes.extend(age.to_le_bytes());
        }
        bytes.extend(name);
        for value in self.cells.iter().flatten() {
            bytes.extend(value.to_le_bytes());
        }
        bytes.extend(CRC.checksum(&bytes).to_le_bytes());
        bytes
    }

    /// Reads the file of `camera`, whose lane tables have these digests; `None` where there is none.
    ///
    /// # Errors
    /// [`RoadError`] says why it is not taken.
    pub fn read(
        path: &Path,
        camera: &str,
        tables: &[[u8; 32]],
        now: UtcMs,
    ) -> Result<Option<Self>, RoadError> {
        match plain::read(path, MOST) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error.into()),
            Ok(bytes) => Self::decode(&bytes, camera, tables, now).map(Some),
        }
    }

    fn decode(
        bytes: &[u8],
        camera: &str,
        tables: &[[u8; 32]],
        now: UtcMs,
    ) -> Result<Self, RoadError> {
        let header = bytes.first_chunk::<HEADER>().ok_or(RoadError::Damaged("it is cut off"))?;
        if header[..8] != MAGIC {
            return Err(RoadError::Damaged("it is another kind of file"));
        }
        if header[8] != VERSION {
            return Err(RoadError::Version(header[8]));
        }
        let (body, trailer) = bytes.split_at(bytes.len() - TRAILER);
        if CRC.checksum(body).to_le_bytes() != trailer {
            return Err(RoadError::Damaged("its checksum is wrong"));
        }
        let number = |at: usize, len: usize| {
            let mut bytes = [0; 8];
            bytes[..len].copy_from_slice(&header[at..at + len]);
            u64::from_le_bytes(bytes)
        };
        let grid = [10, 12].map(|at| number(at, 2) as usize);
        let cells_at = HEADER + usize::from(header[9]);
        if body.len() != cells_at + 2 * grid[0] * grid[1] * CELL {
            return Err(RoadError::Damaged("its length is wrong"));
        }
        let name = String::from_utf8_lossy(&body[HEADER..cells_at]);
        if name != camera {
            return Err(RoadError::Camera(name.into_owned()));
        }
        let table: [u8; 32] = std::array::from_fn(|at| header[14 + at]);
        if !tables.contains(&table) {
            return Err(RoadError::Table);
        }
        // A clock that was set back in between makes it no younger.
        let since = now.saturating_since(UtcMs(number(46, 8) as i64));
        let known = [54, 66].map(|at| {
            let age = Some(number(at + 4, 8)).filter(|&age| age != NEVER);
            let age = age.map(|age| Duration::from_millis(age).saturating_add(since));
            Known { seen: number(at, 4) as u32, age }
        });
        let youngest = known.iter().filter_map(|known| known.age).min();
        if let Some(age) = youngest.filter(|&age| age > OLDEST) {
            return Err(RoadError::Old(age));
        }
        let (cells, _) = body[cells_at..].as_chunks::<CELL>();
        let cell =
            |&[a, b, c, d]: &[u8; CELL]| [i16::from_le_bytes([a, b]), i16::from_le_bytes([c, d])];
        Ok(Self { table, grid, known, cells: cells.iter().map(cell).collect() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TABLE: [u8; 32] = [7; 32];
    const DAY: i64 = 86_400_000;

    fn road() -> Road {
        let known =
            [Known { seen: 200, age: Some(Duration::from_secs(30)) }, Known { seen: 4, age: None }];
        let cells = (0..2 * 24 * 16).map(|i: i16| [i, -i]).collect();
        Road { table: TABLE, grid: [24, 16], known, cells }
    }

    fn read(bytes: &[u8], now: UtcMs) -> Result<Road, RoadError> {
        Road::decode(bytes, "curve", &[[1; 32], TABLE], now)
    }

    #[test]
    fn what_is_written_is_read_again_with_the_time_that_has_passed() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join(NAME);
        let read = |now| Road::read(&path, "curve", &[TABLE], UtcMs(now));
        assert_eq!(read(0).expect("none is no error"), None);
        road().write(&path, "curve", UtcMs(10 * DAY)).expect("writes");
        let mut expected = road();
        expected.known[0].age = Some(Duration::from_secs(30 + 3600));
        assert_eq!(read(10 * DAY + 3_600_000).expect("reads"), Some(expected));
        assert_eq!(read(0).expect("a clock that was set back"), Some(road()));
        let names: Vec<_> = std::fs::read_dir(&folder).expect("a folder").collect();
        assert_eq!(names.len(), 1, "no partial file is left");
    }

    #[test]
    fn what_does_not_belong_here_is_refused_with_its_reason() {
        let bytes = road().encode("curve", UtcMs(0));
        let said = |result: Result<Road, RoadError>| result.expect_err("refused").to_string();
        assert!(said(read(&bytes, UtcMs(15 * DAY))).contains("15 days old"));
        assert!(said(Road::decode(&bytes, "b", &[TABLE], UtcMs(0))).contains("camera \"curve\""));
        assert!(said(Road::decode(&bytes, "curve", &[[1; 32]], UtcMs(0))).contains("lane table"));
        let mut later = bytes.clone();
        later[8] = 2;
        assert!(said(read(&later, UtcMs(0))).contains("format 2"));
        for at in (0..bytes.len()).step_by(7).filter(|&at| at != 8) {
            let mut changed = bytes.clone();
            changed[at] ^= 1;
            assert!(said(read(&changed, UtcMs(0))).contains("damaged"), "byte {at}");
        }
        for length in [0, 8, HEADER, HEADER + 4, bytes.len() - 1] {
            assert!(said(read(&bytes[..length], UtcMs(0))).contains("damaged"), "{length} bytes");
        }
        const { assert!(MOST <= 1_000_000) };
    }
}
