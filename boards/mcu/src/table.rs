//! The lane table behind its length in memory-mapped flash, for the two cores that read one.

use verge::lane::LaneTable;

/// Longest table: 320x240 with a reference of the scene.
const MAX_TABLE: usize = 512 << 10;

/// The table at that address; `None` where none is.
///
/// # Safety
/// Memory of the table's largest size is there, and nothing writes it for as long as the program
/// runs. Any bytes are a table or refused.
pub unsafe fn read(address: usize) -> Option<LaneTable<&'static [u8]>> {
    // SAFETY: guaranteed by the caller.
    let bytes = unsafe {
        let len = (address as *const u32).read_volatile() as usize;
        core::slice::from_raw_parts((address + 4) as *const u8, len.min(MAX_TABLE))
    };
    LaneTable::parse(bytes).ok()
}
