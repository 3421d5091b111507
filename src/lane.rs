//! The lane table: for every pixel the lane, the distance along it, and its scale.
//!
//! Owns the file format, its writer and a reader that trusts nothing. Does not know how
//! the table was calibrated or who asks it. The table is made offline by `mvcalib table`
//! and is the only thing that calibration and the sensor share.
//!
//! | offset | bytes | field |
//! |---|---|---|
//! | 0 | 8 | magic `VERGELUT` |
//! | 8 | 1 | format version, 1 to 4 |
//! | 9 | 1 | reserved, 0 |
//! | 10 | 2 | length M of the description |
//! | 12 | M | description: [`Description`] in postcard; from version 3: then `cell_length_m`, f32; from version 4: then the errors of lengths (`lane/errors.rs`) |
//! | 12+M | 5 N | N = width x height cells in row order |
//! | 12+M+5N | 4 | from version 2: length R of the scene's reference; from version 3 it may be 0 |
//! | 16+M+5N | R | from version 2: [`crate::scene::Reference`] |
//! | the last | 4 | CRC-32 (ISO-HDLC) of all bytes before |
//!
//! Version 1 is a table without a reference: the camera is then not checked for having
//! moved. Versions 1 and 2 say nothing of the cells along a lane, which are then 10 m long.
//! Versions 1 to 3 state one error for all lengths, version 4 one for each lane and cell.
//! The lowest version that holds a table is written, so that older programs read it.
//!
//! Numbers are little-endian. A cell is `lane: u8` (0: no lane), `s_cm: u16` (distance
//! along the lane in cm, to 655 m) and `span_mm: u16` (road length along the lane that
//! one pixel spans there, in mm, to 65 m).

mod errors;
mod name;
mod write;
mod wrong;

pub use errors::LaneErrors;
pub use name::{Name, NameTooLong};
pub use write::{encode, encode_with_errors, encoded_len, encoded_len_with_errors};
pub use wrong::LaneTableError;

use crate::scene::{MAX_REFERENCE, Reference};
use crate::units::{Direction, ImagePoint, ImageSize, LaneId, MAX_LANES};
use crc::{CRC_32_ISO_HDLC, Crc};
use serde::{Deserialize, Serialize};

/// First bytes of every lane table.
pub const MAGIC: [u8; 8] = *b"VERGELUT";
/// The newest format that this code reads and writes.
pub const VERSION: u8 = 4;
/// The format of a table without a reference of the scene.
const VERSION_BARE: u8 = 1;
/// The format of a table with one, and with cells of the default length.
const VERSION_SCENE: u8 = 2;
/// The format of a table that states the length of its cells along a lane.
const VERSION_CELLS: u8 = 3;
/// Length of the cells along a lane where a table does not state it, m.
pub const DEFAULT_CELL_LENGTH_M: f32 = 10.0;
/// Shortest such cell, m: a vehicle's place is not known better.
pub const MIN_CELL_LENGTH_M: f32 = 2.0;
/// Longest such cell, m: a camera sees few lanes that are longer.
pub const MAX_CELL_LENGTH_M: f32 = 100.0;
/// Longest camera or calibration name, bytes of UTF-8: NTCIP and FIWARE ids fit.
pub const MAX_NAME: usize = 48;
/// Most bytes that a [`Description`] takes in postcard: two names, a hash, eight lanes of
/// at most 6 bytes, sizes, errors and the cells' length come to 204; a half more leaves room.
pub const MAX_DESCRIPTION: usize = 320;
/// Most cells of a table: 1920x1080. A table is held in memory (10 MB at this size).
pub const MAX_CELLS: usize = 1920 * 1080;
/// Width of a lane where nothing states it, m.
pub const LANE_WIDTH_M: f32 = 3.5;
/// Fewer pixels tell no angle.
const FEW_PIXELS: f32 = 30.0;
/// Longest lane that a cell's `s_cm` can address, m.
pub const MAX_LANE_LENGTH_M: f32 = 655.35;

const HEADER: usize = 12;
const CELL: usize = 5;
const LENGTH: usize = 4;
const TRAILER: usize = 4;
const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// One lane of the table.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lane {
    /// Its number.
    pub id: LaneId,
    /// Direction of its traffic.
    pub direction: Direction,
    /// Length of its centre line inside the table, m.
    pub length_m: f32,
}

/// Metadata of a table.
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
    /// Name of the calibration it was made from, for people.
    pub calibration_id: Name,
    /// SHA-256 of the calibration file.
    pub calibration_sha256: [u8; 32],
    /// Approximate length of the cells along a lane, m. From version 3
    /// of the format it stands behind the others.
    #[serde(skip, default = "default_cell_length_m")]
    pub cell_length_m: f32,
}

const fn default_cell_length_m() -> f32 {
    DEFAULT_CELL_LENGTH_M
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

/// A checked lane table over bytes that it borrows (flash) or owns (a file in memory).
#[derive(Clone, Debug)]
pub struct LaneTable<B> {
    description: Description,
    bytes: B,
    errors_at: usize,
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
        if bytes.iter().zip(&MAGIC).any(|(byte, right)| byte != right) {
            return Err(LaneTableError::Magic);
        }
        let header = bytes.first_chunk::<HEADER>().ok_or(too_short(HEADER + TRAILER))?;
        let [.., version, reserved, len0, len1] = *header;
        if !(VERSION_BARE..=VERSION).contains(&version) {
            return Err(LaneTableError::Version { found: version });
        }
        let (body, trailer) = bytes.split_last_chunk::<TRAILER>().ok_or(too_short(HEADER))?;
        let (stored, computed) = (u32::from_le_bytes(*trailer), CRC.checksum(body));
        let description_len = usize::from(u16::from_le_bytes([len0, len1]));
        let cells_at = HEADER + description_len;
        let Some(encoded) = body.get(HEADER..cells_at) else {
            return Err(too_short(cells_at + TRAILER));
        };
        let mut errors_at = cells_at;
        let description = match postcard::take_from_bytes::<Description>(encoded) {
            Ok((description, [])) if version < VERSION_CELLS => description,
            Ok((description, &[l0, l1, l2, l3, ref errors @ ..]))
                if version == VERSION || (version == VERSION_CELLS && errors.is_empty()) =>
            {
                errors_at = cells_at - errors.len();
                Description { cell_length_m: f32::from_le_bytes([l0, l1, l2, l3]), ..description }
            }
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
        if version == VERSION {
            let block = body.get(errors_at..cells_at).unwrap_or(&[]);
            errors::check(block, description.lanes.len())?;
        }
        check_cells(&description, body.get(cells_at..scene_at).unwrap_or(&[]))?;
        Ok(Self { description, bytes: table, errors_at, cells_at })
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
            Some([]) if self.version() >= VERSION_CELLS => Ok(None),
            Some(bytes) => Reference::parse(bytes).map(Some).map_err(LaneTableError::Scene),
        }
    }

    /// The format in which it stands.
    fn version(&self) -> u8 {
        self.bytes.as_ref().get(MAGIC.len()).copied().unwrap_or_default()
    }

    /// The table's metadata.
    pub const fn description(&self) -> &Description {
        &self.description
    }

    /// One standard error of the length of a lane, as a part of it: its own where the table
    /// states it (version 4), else the one of the whole calibration. The density of the lane
    /// has the same relative error from calibration.
    pub fn lane_rel_err(&self, id: LaneId) -> Option<f32> {
        self.stated(id, None).or(self.description.length_rel_err)
    }

    /// The same for one of the equal cells of a lane, counted from its upstream end as
    /// [`crate::density::Division`] does.
    pub fn cell_rel_err(&self, id: LaneId, cell: usize) -> Option<f32> {
        self.stated(id, Some(cell)).or_else(|| self.lane_rel_err(id))
    }

    fn stated(&self, id: LaneId, cell: Option<usize>) -> Option<f32> {
        let lane = self.description.lanes.iter().position(|lane| lane.id == id)?;
        errors::find(self.bytes.as_ref().get(self.errors_at..self.cells_at)?, lane, cell)
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

    /// By how much the road that a pixel shows is longer along a lane than across it, between two
    /// places of the lane, m: 1 from right above, 4 where it is seen at 14 degrees. `None` where few
    /// pixels show it. Takes lanes to be [`LANE_WIDTH_M`] wide; reads every cell.
    pub fn foreshortening(&self, id: LaneId, [from_m, to_m]: [f32; 2]) -> Option<f32> {
        let cells = (0..self.description.cell_count()).filter_map(|index| self.cell(index));
        let on_it = cells.filter(|at| at.lane == id && (from_m..to_m).contains(&at.s_m));
        let (pixels, area) =
            on_it.fold((0.0_f32, 0.0_f32), |(n, sum), at| (n + 1.0, sum + at.span_m));
        // A pixel's length of road, and the lane's width in pixels: area in px m by its length.
        let (span_m, width_px) = (area / pixels, area / (to_m - from_m));
        (pixels >= FEW_PIXELS).then_some(span_m * width_px / LANE_WIDTH_M)
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
        let cell_ok = (MIN_CELL_LENGTH_M..=MAX_CELL_LENGTH_M).contains(&self.cell_length_m);
        known(cell_ok, "the cells along a lane are not between 2 and 100 m long")?;
        let rel_err_ok = self.length_rel_err.is_none_or(|e| e >= 0.0 && e.is_finite());
        known(rel_err_ok, "the stated error is negative or not a number")
    }
}

#[cfg(test)]
mod tests;
