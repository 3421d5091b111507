//! Writing a lane table; [`super`] has the format.

use super::{
    CELL, CRC, DEFAULT_CELL_LENGTH_M, Description, HEADER, LENGTH, LaneErrors, LaneTable,
    LaneTableError, MAGIC, MAX_DESCRIPTION, Place, TRAILER, VERSION, VERSION_BARE, VERSION_CELLS,
    VERSION_SCENE, errors,
};
use crate::scene::Reference;

/// Writes a lane table into `buffer` and returns how many bytes it takes.
///
/// `cell(u, v)` gives the cell in column `u`, row `v`; `scene` is the reference of the
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
    cell: impl FnMut(u16, u16) -> Option<Place>,
    buffer: &mut [u8],
) -> Result<usize, LaneTableError> {
    encode_with_errors(description, &[], scene, cell, buffer)
}

/// The same with the error of each lane's lengths, in the description's order; none where
/// `lane_errors` is empty.
///
/// # Errors
/// As [`encode`], and [`LaneTableError::Value`] where there are not as many errors as lanes or
/// one is not an error.
pub fn encode_with_errors(
    description: &Description,
    lane_errors: &[LaneErrors<'_>],
    scene: Option<&Reference>,
    mut cell: impl FnMut(u16, u16) -> Option<Place>,
    buffer: &mut [u8],
) -> Result<usize, LaneTableError> {
    description.check()?;
    let each = lane_errors.is_empty() || lane_errors.len() == description.lanes.len();
    let right = |e: f32| e >= 0.0 && e.is_finite();
    if !each
        || !lane_errors
            .iter()
            .all(|l| l.lane.is_none_or(right) && l.cells.iter().all(|&e| right(e)))
    {
        return Err(LaneTableError::Value("the stated errors of the lanes"));
    }
    let actual = buffer.len();
    let needed = encoded_len_with_errors(description, lane_errors, scene);
    let table = buffer.get_mut(..needed).ok_or(LaneTableError::Buffer { needed, actual })?;
    let mut scratch = [0; MAX_DESCRIPTION];
    let encoded =
        postcard::to_slice(description, &mut scratch).map_err(|_| LaneTableError::Description)?;
    let version = version_of(description, lane_errors, scene);
    let cell_length = description.cell_length_m.to_le_bytes();
    let cell_length: &[u8] = if version >= VERSION_CELLS { &cell_length } else { &[] };
    let described = encoded.len() + cell_length.len() + errors::encoded_len(lane_errors);
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
    put(&(described as u16).to_le_bytes()).ok_or(full)?;
    put(encoded).ok_or(full)?;
    put(cell_length).ok_or(full)?;
    errors::encode(lane_errors, &mut put).ok_or(full)?;
    for v in 0..description.image_size.height {
        for u in 0..description.image_size.width {
            put(&encode_cell(cell(u, v))).ok_or(full)?;
        }
    }
    if version > VERSION_BARE {
        let len = scene.map_or(0, Reference::encoded_len);
        put(&(len as u32).to_le_bytes()).ok_or(full)?;
    }
    if let Some(scene) = scene {
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
    encoded_len_with_errors(description, &[], scene)
}

/// The same with the error of each lane's lengths.
pub fn encoded_len_with_errors(
    description: &Description,
    lane_errors: &[LaneErrors<'_>],
    scene: Option<&Reference>,
) -> usize {
    let mut scratch = [0; MAX_DESCRIPTION];
    let len = postcard::to_slice(description, &mut scratch).map_or(MAX_DESCRIPTION, |s| s.len());
    let added = match version_of(description, lane_errors, scene) {
        VERSION_BARE => 0,
        VERSION_SCENE => LENGTH,
        _ => LENGTH + size_of::<f32>() + errors::encoded_len(lane_errors),
    };
    let scene = scene.map_or(0, Reference::encoded_len);
    HEADER + len + description.cell_count() * CELL + added + scene + TRAILER
}

/// The lowest format that holds a table.
fn version_of(
    description: &Description,
    lane_errors: &[LaneErrors<'_>],
    scene: Option<&Reference>,
) -> u8 {
    match scene {
        _ if !lane_errors.is_empty() => VERSION,
        _ if description.cell_length_m != DEFAULT_CELL_LENGTH_M => VERSION_CELLS,
        Some(_) => VERSION_SCENE,
        None => VERSION_BARE,
    }
}

fn encode_cell(place: Option<Place>) -> [u8; CELL] {
    let Some(place) = place else { return [0; CELL] };
    // `as` saturates: a negative or too long value stays at the end of the range.
    let [s0, s1] = ((place.s_m * 100.0 + 0.5) as u16).to_le_bytes();
    let [span0, span1] = ((place.span_m * 1000.0 + 0.5) as u16).to_le_bytes();
    [place.lane.get(), s0, s1, span0, span1]
}
