//! The stated error of lengths in a lane table: of each lane, and of each cell along it.
//!
//! Owns the block behind the description from version 4 of the format. For each lane in the
//! description's order:
//!
//! | bytes | field |
//! |---|---|
//! | 1 | number C of cells along the lane; 0 where only the lane's own is stated |
//! | 2 | standard error of the lane's length, in 1/10000 of it; 65535: not stated |
//! | 2 C | the same of each cell from the upstream end |

use super::LaneTableError;
use crate::units::MAX_LANES;

/// Bytes of one error.
const ERROR: usize = 2;
/// The unit of an error in a table, as a part of a length.
const UNIT: f32 = 1e-4;
/// Not stated.
const NONE: u16 = u16::MAX;

/// The stated error of one lane's lengths, for the writer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LaneErrors<'a> {
    /// One standard error of the lane's length, as a part of it.
    pub lane: Option<f32>,
    /// The same of each of its cells, from the upstream end; empty where they are not stated.
    /// There are as many as [`crate::density::Division`] makes.
    pub cells: &'a [f32],
}

/// Bytes that the block takes.
pub(super) fn encoded_len(errors: &[LaneErrors<'_>]) -> usize {
    errors.iter().map(|e| 1 + ERROR * (1 + e.cells.len())).sum()
}

fn encode_error(error: Option<f32>) -> [u8; ERROR] {
    // `as` saturates: an error of more than 655 % stays there.
    let units = error.map_or(NONE, |e| ((e / UNIT + 0.5) as u16).min(NONE - 1));
    units.to_le_bytes()
}

fn decode_error(bytes: [u8; ERROR]) -> Option<f32> {
    let units = u16::from_le_bytes(bytes);
    (units != NONE).then_some(f32::from(units) * UNIT)
}

/// Calls `put` with the block's bytes, in order.
pub(super) fn encode(
    errors: &[LaneErrors<'_>],
    mut put: impl FnMut(&[u8]) -> Option<()>,
) -> Option<()> {
    for lane in errors {
        put(&[u8::try_from(lane.cells.len()).ok()?])?;
        put(&encode_error(lane.lane))?;
        for &cell in lane.cells {
            put(&encode_error(Some(cell)))?;
        }
    }
    Some(())
}

/// The bytes of one lane and of those behind it.
fn split(block: &[u8]) -> Option<(&[[u8; ERROR]], &[u8])> {
    let (&count, rest) = block.split_first()?;
    let (own, rest) = rest.split_at_checked(ERROR * (1 + usize::from(count)))?;
    Some((own.as_chunks::<ERROR>().0, rest))
}

/// Whether the block holds these many lanes and nothing else.
pub(super) fn check(mut block: &[u8], lanes: usize) -> Result<(), LaneTableError> {
    debug_assert!(lanes <= MAX_LANES);
    for _ in 0..lanes {
        (_, block) = split(block).ok_or(LaneTableError::Description)?;
    }
    if block.is_empty() { Ok(()) } else { Err(LaneTableError::Description) }
}

/// The error of a lane by its place in the description: its own, or that of one of its cells.
pub(super) fn find(mut block: &[u8], lane: usize, cell: Option<usize>) -> Option<f32> {
    for _ in 0..lane {
        (_, block) = split(block)?;
    }
    let (own, _) = split(block)?;
    decode_error(*own.get(cell.map_or(0, |c| c + 1))?)
}
