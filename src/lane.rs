//! The lane table: for every pixel the lane, the distance along it, and its scale.
//!
//! Owns the file format, its writer and a reader that trusts nothing. Does not know how
//! the table was calibrated or who asks it. The table is made offline by `mvcalib table`
//! and is the only thing that calibration and the sensor share.
//!
//! | offset | bytes | field |
//! |---|---|---|
//! | 0 | 8 | magic `VERGELUT` |
//! | 8 | 1 | format version, 1 or 2 |
//! | 9 | 1 | reserved, 0 |
//! | 10 | 2 | length M of the description |
//! | 12 | M | description: [`Description`] in postcard |
//! | 12+M | 5 N | N = width x height cells in row order |
//! | 12+M+5N | 4 | version 2 only: length R of the scene's reference |
//! | 16+M+5N | R | version 2 only: [`crate::scene::Reference`] |
//! | the last | 4 | CRC-32 (ISO-HDLC) of all bytes before |
//!
//! Version 1 is a table without a reference: the camera is then not checked for having
//! moved. It is written where there is none, so that older programs read such tables.
//!
//! Numbers are little-endian. A cell is `lane: u8` (0: no lane), `s_cm: u16` (distance
//! along the lane in cm, to 655 m) and `span_mm: u16` (road length along the lane that
//! one pixel spans there, in mm, to 65 m).

use crate::scene::{MAX_REFERENCE, Reference, ReferenceError};
use crate::units::{Direction, ImagePoint, ImageSize, LaneId, MAX_LANES};
use core::fmt;
use crc::{CRC_32_ISO_HDLC, Crc};
use serde::{Deserialize, Serialize};

/// First bytes of every lane table.
pub const MAGIC: [u8; 8] = *b"VERGELUT";
/// The newest format that this code reads and writes.
pub const VERSION: u8 = 2;
/// The format of a table without a reference of the scene.
const VERSION_BARE: u8 = 1;
/// Longest camera or calibration name, bytes of UTF-8: NTCIP and FIWARE ids fit.
pub const MAX_NAME: usize = 48;
/// Most bytes that a [`Description`] takes in postcard: two names, a hash, eight lanes of
/// at most 6 bytes, sizes and errors come to 200; a half more leaves room.
pub const MAX_DESCRIPTION: usize = 320;
/// Most cells of a table: 1920x1080. A table is held in memory (10 MB at this size).
pub const MAX_CELLS: usize = 1920 * 1080;
/// Longest lane that a cell's `s_cm` can address, m.
pub const MAX_LANE_LENGTH_M: f32 = 655.35;

const HEADER: usize = 12;
const CELL: usize = 5;
const LENGTH: usize = 4;
const TRAILER: usize = 4;
const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// A short name without allocation.
pub type Name = heapless::String<MAX_NAME>;

/// One lane of the table.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lane {
    /// Its number.
    pub id: LaneId,
    /// Which way its traffic moves.
    pub direction: Direction,
    /// Length of its centre line inside the table, m.
    pub length_m: f32,
}

/// What the table says about itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Description {
    /// The camera that it belongs to.
    pub camera_id: Name,
    /// The picture size that its cells address.
    pub image_size: ImageSize,
    /// Its lanes, by rising number.
    pub lanes: heapless::Vec<Lane, MAX_LANES>,
    /// One standard error of a length on the road, as a fraction; `None`: not stated.
    pub length_rel_err: Option<f32>,
    /// Which calibration it was made from, for people.
    pub calibration_id: Name,
    /// SHA-256 of the calibration file.
    pub calibration_sha256: [u8; 32],
}

/// One cell, in units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// The lane.
    pub lane: LaneId,
    /// Distance along the lane's centre line from its upstream end, m.
    pub s_m: f32,
    /// Road length along the lane that one pixel spans here, m.
    pub span_m: f32,
}

/// Why bytes are not a lane table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LaneTableError {
    /// Fewer bytes than the smallest table, or than this table's header asks for.
    TooShort {
        /// Bytes needed.
        needed: usize,
        /// Bytes there.
        actual: usize,
    },
    /// More bytes than the header asks for.
    TooLong {
        /// Bytes that belong to the table.
        needed: usize,
        /// Bytes there.
        actual: usize,
    },
    /// Not a lane table.
    Magic,
    /// A format that this program does not read.
    Version {
        /// The version found.
        found: u8,
    },
    /// The bytes were changed since the table was written.
    Crc {
        /// Checksum in the file.
        stored: u32,
        /// Checksum of the bytes.
        computed: u32,
    },
    /// The description does not decode.
    Description,
    /// The description holds a value that no road has; the text names it.
    Value(&'static str),
    /// A cell names a lane that the description lacks.
    CellLane {
        /// Index of the cell in row order.
        cell: usize,
        /// The lane that it names.
        lane: u8,
    },
    /// A cell lies beyond the end of its lane.
    CellDistance {
        /// Index of the cell in row order.
        cell: usize,
    },
    /// The reference of the scene is wrong.
    Scene(ReferenceError),
    /// The buffer given to the writer is too small.
    Buffer {
        /// Bytes needed.
        needed: usize,
        /// Bytes there.
        actual: usize,
    },
}

impl fmt::Display for LaneTableError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooShort { needed, actual } => {
                write!(f, "has {actual} bytes where {needed} belong: it was cut off; copy it again")
            }
            Self::TooLong { needed, actual } => {
                write!(f, "has {actual} bytes where {needed} belong: something was appended")
            }
            Self::Magic => write!(f, "is no lane table (make one with `mvcalib table`)"),
            Self::Version { found } => {
                write!(
                    f,
                    "has format version {found}, this program reads 1 to {VERSION}: make it anew"
                )
            }
            Self::Crc { stored, computed } => write!(
                f,
                "is damaged: checksum {computed:08x}, its trailer says {stored:08x}; copy it again"
            ),
            Self::Description => write!(f, "has a description that does not decode: make it anew"),
            Self::Value(what) => write!(f, "has an impossible value: {what}"),
            Self::CellLane { cell, lane } => {
                write!(f, "puts cell {cell} into lane {lane}, which it does not describe")
            }
            Self::CellDistance { cell } => {
                write!(f, "puts cell {cell} beyond the end of its lane")
            }
            Self::Scene(error) => error.fmt(f),
            Self::Buffer { needed, actual } => {
                write!(f, "needs {needed} bytes, the buffer has {actual}")
            }
        }
    }
}

impl core::error::Error for LaneTableError {}

/// A checked lane table over bytes that it borrows (flash) or owns (a file in memory).
#[derive(Clone, Debug)]
pub struct LaneTable<B> {
    description: Description,
    bytes: B,
    cells_at: usize,
}

impl<B: AsRef<[u8]>> LaneTable<B> {
    /// Reads and checks a whole table.
    ///
    /// # Errors
    /// [`LaneTableError`] names the first thing that is wrong; nothing of a wrong table
    /// is ever used.
    pub fn parse(table: B) -> Result<Self, LaneTableError> {
        let bytes = table.as_ref();
        let too_short = |needed| LaneTableError::TooShort { needed, actual: bytes.len() };
        let header = bytes.first_chunk::<HEADER>().ok_or(too_short(HEADER + TRAILER))?;
        let [m0, m1, m2, m3, m4, m5, m6, m7, version, reserved, len0, len1] = *header;
        if [m0, m1, m2, m3, m4, m5, m6, m7] != MAGIC {
            return Err(LaneTableError::Magic);
        }
        if version != VERSION && version != VERSION_BARE {
            return Err(LaneTableError::Version { found: version });
        }
        let (body, trailer) = bytes.split_last_chunk::<TRAILER>().ok_or(too_short(HEADER))?;
        let (stored, computed) = (u32::from_le_bytes(*trailer), CRC.checksum(body));
        let description_len = usize::from(u16::from_le_bytes([len0, len1]));
        let cells_at = HEADER + description_len;
        let Some(encoded) = body.get(HEADER..cells_at) else {
            return Err(too_short(cells_at + TRAILER));
        };
        let description = match postcard::take_from_bytes::<Description>(encoded) {
            Ok((description, [])) => description,
            // A changed byte is told apart from a writer's mistake by the checksum.
            _ if stored != computed => return Err(LaneTableError::Crc { stored, computed }),
            _ => return Err(LaneTableError::Description),
        };
        let cell_count = description.cell_count();
        let scene_at = cells_at + cell_count * CELL;
        let scene_len = match version {
            VERSION_BARE => 0,
            _ => LENGTH + length_at(bytes, scene_at),
        };
        let needed = scene_at + scene_len + TRAILER;
        if bytes.len() < needed && cell_count <= MAX_CELLS {
            return Err(too_short(needed));
        }
        if stored != computed {
            return Err(LaneTableError::Crc { stored, computed });
        }
        if bytes.len() > needed {
            return Err(LaneTableError::TooLong { needed, actual: bytes.len() });
        }
        if reserved != 0 {
            return Err(LaneTableError::Value("the reserved byte is not 0"));
        }
        description.check()?;
        check_cells(&description, body.get(cells_at..scene_at).unwrap_or(&[]))?;
        Ok(Self { description, bytes: table, cells_at })
    }

    /// The reference of the static scene; `None` where the table has none.
    ///
    /// # Errors
    /// [`LaneTableError::Scene`] names what is wrong with it.
    pub fn scene(&self) -> Result<Option<Reference>, LaneTableError> {
        let scene_at = self.cells_at + self.description.cell_count() * CELL + LENGTH;
        let bytes = self.bytes.as_ref();
        let end = bytes.len().saturating_sub(TRAILER);
        match bytes.get(scene_at..end) {
            None => Ok(None),
            Some(bytes) => Reference::parse(bytes).map(Some).map_err(LaneTableError::Scene),
        }
    }

    /// What the table says about itself.
    pub const fn description(&self) -> &Description {
        &self.description
    }

    /// Where an image point lies on the road: `None` outside the lanes and the picture.
    /// `point` is in pixels of [`Description::image_size`]. One memory access, O(1).
    #[inline]
    pub fn place(&self, point: ImagePoint) -> Option<Place> {
        let size = self.description.image_size;
        let (width, height) = (f32::from(size.width), f32::from(size.height));
        // Written so that NaN is outside too.
        let inside = point.u >= 0.0 && point.v >= 0.0 && point.u < width && point.v < height;
        if !inside {
            return None;
        }
        self.cell(point.v as usize * usize::from(size.width) + point.u as usize)
    }

    /// The cell of that index in row order.
    #[inline]
    fn cell(&self, index: usize) -> Option<Place> {
        let cell = self.bytes.as_ref().get(self.cells_at + index * CELL..)?;
        let &[lane, s0, s1, span0, span1] = cell.first_chunk::<CELL>()?;
        Some(Place {
            lane: LaneId::new(lane)?,
            s_m: f32::from(u16::from_le_bytes([s0, s1])) * 0.01,
            span_m: f32::from(u16::from_le_bytes([span0, span1])) * 0.001,
        })
    }
}

/// The length that stands at `at`, held at one that no reference reaches.
fn length_at(bytes: &[u8], at: usize) -> usize {
    let length = bytes.get(at..).and_then(|b| b.first_chunk::<LENGTH>());
    let length = length.map_or(0, |&length| u32::from_le_bytes(length));
    if length as usize > MAX_REFERENCE { MAX_REFERENCE + 1 } else { length as usize }
}

fn check_cells(description: &Description, cells: &[u8]) -> Result<(), LaneTableError> {
    let mut length_m = [None; MAX_LANES + 1];
    for lane in &description.lanes {
        if let Some(slot) = length_m.get_mut(usize::from(lane.id.get())) {
            *slot = Some(lane.length_m);
        }
    }
    for (cell, bytes) in cells.as_chunks::<CELL>().0.iter().enumerate() {
        let &[lane, s0, s1, _, _] = bytes;
        if lane == 0 {
            continue;
        }
        let Some(Some(length_m)) = length_m.get(usize::from(lane)) else {
            return Err(LaneTableError::CellLane { cell, lane });
        };
        // Half a centimetre of rounding in the cell, as much in the length.
        if f32::from(u16::from_le_bytes([s0, s1])) * 0.01 > length_m + 0.01 {
            return Err(LaneTableError::CellDistance { cell });
        }
    }
    Ok(())
}

impl Description {
    /// Number of cells that follow the description.
    pub const fn cell_count(&self) -> usize {
        self.image_size.width as usize * self.image_size.height as usize
    }

    /// The lane of that number.
    pub fn lane(&self, id: LaneId) -> Option<&Lane> {
        self.lanes.iter().find(|lane| lane.id == id)
    }

    fn check(&self) -> Result<(), LaneTableError> {
        let known = |ok: bool, what: &'static str| {
            if ok { Ok(()) } else { Err(LaneTableError::Value(what)) }
        };
        known(self.cell_count() > 0, "the picture has no pixels")?;
        known(self.cell_count() <= MAX_CELLS, "the picture is larger than 1920x1080")?;
        known(!self.lanes.is_empty(), "there is no lane")?;
        let rising = self.lanes.iter().zip(self.lanes.iter().skip(1)).all(|(a, b)| a.id < b.id);
        known(rising, "the lanes are not in rising order")?;
        for lane in &self.lanes {
            let length_ok = lane.length_m > 0.0 && lane.length_m <= MAX_LANE_LENGTH_M;
            known(length_ok, "a lane is not between 0 and 655.35 m long")?;
        }
        let rel_err_ok = self.length_rel_err.is_none_or(|e| e >= 0.0 && e.is_finite());
        known(rel_err_ok, "the stated error is negative or not a number")
    }
}

/// Writes a lane table into `buffer` and returns how many bytes it takes.
///
/// `cell(u, v)` gives what stands in column `u`, row `v`; `scene` is the reference of the
/// static scene, where there is one. Distances are rounded to the
/// centimetre and spans to the millimetre; a span over 65 m is held there.
///
/// # Errors
/// [`LaneTableError::Buffer`] where `buffer` is too small ([`encoded_len`] says the size),
/// and whatever [`LaneTable::parse`] would refuse: a table that cannot be read is never
/// written.
pub fn encode(
    description: &Description,
    scene: Option<&Reference>,
    mut cell: impl FnMut(u16, u16) -> Option<Place>,
    buffer: &mut [u8],
) -> Result<usize, LaneTableError> {
    description.check()?;
    let actual = buffer.len();
    let needed = encoded_len(description, scene);
    let table = buffer.get_mut(..needed).ok_or(LaneTableError::Buffer { needed, actual })?;
    let mut scratch = [0; MAX_DESCRIPTION];
    let encoded =
        postcard::to_slice(description, &mut scratch).map_err(|_| LaneTableError::Description)?;
    let version = if scene.is_some() { VERSION } else { VERSION_BARE };
    let mut rest = &mut *table;
    let mut put = |bytes: &[u8]| {
        let (head, tail) = core::mem::take(&mut rest).split_at_mut_checked(bytes.len())?;
        head.copy_from_slice(bytes);
        rest = tail;
        Some(())
    };
    let full = LaneTableError::Buffer { needed, actual };
    put(&MAGIC).ok_or(full)?;
    put(&[version, 0]).ok_or(full)?;
    put(&(encoded.len() as u16).to_le_bytes()).ok_or(full)?;
    put(encoded).ok_or(full)?;
    for v in 0..description.image_size.height {
        for u in 0..description.image_size.width {
            put(&encode_cell(cell(u, v))).ok_or(full)?;
        }
    }
    if let Some(scene) = scene {
        put(&(scene.encoded_len() as u32).to_le_bytes()).ok_or(full)?;
        let place = rest.get_mut(..scene.encoded_len()).ok_or(full)?;
        scene.encode(place).map_err(LaneTableError::Scene)?;
    }
    let (body, trailer) = table.split_last_chunk_mut::<TRAILER>().ok_or(full)?;
    *trailer = CRC.checksum(body).to_le_bytes();
    LaneTable::parse(&*table)?;
    Ok(needed)
}

/// Bytes that a table with this description and reference takes.
pub fn encoded_len(description: &Description, scene: Option<&Reference>) -> usize {
    let mut scratch = [0; MAX_DESCRIPTION];
    let len = postcard::to_slice(description, &mut scratch).map_or(MAX_DESCRIPTION, |s| s.len());
    let scene = scene.map_or(0, |scene| LENGTH + scene.encoded_len());
    HEADER + len + description.cell_count() * CELL + scene + TRAILER
}

fn encode_cell(place: Option<Place>) -> [u8; CELL] {
    let Some(place) = place else { return [0; CELL] };
    // `as` saturates: a negative or too long value stays at the end of the range.
    let [s0, s1] = ((place.s_m * 100.0 + 0.5) as u16).to_le_bytes();
    let [span0, span1] = ((place.span_m * 1000.0 + 0.5) as u16).to_le_bytes();
    [place.lane.get(), s0, s1, span0, span1]
}

#[cfg(test)]
mod tests;
