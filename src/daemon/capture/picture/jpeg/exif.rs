//! Orientation of a picture, from EXIF data.

/// The orientation that an APP1 segment states (Exif 2.32, section 4.6.4, tag 0x0112).
pub(super) fn orientation(app1: &[u8]) -> Option<u8> {
    exif_orientation(app1.strip_prefix(b"Exif\0\0")?)
}

/// The orientation in EXIF data, which are a TIFF without pictures.
pub fn exif_orientation(tiff: &[u8]) -> Option<u8> {
    let big = match tiff.get(..4)? {
        b"MM\0*" => true,
        b"II*\0" => false,
        _ => return None,
    };
    let two = |at: usize| {
        let bytes: [u8; 2] = tiff.get(at..at + 2)?.try_into().ok()?;
        Some(if big { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) })
    };
    let four = |at: usize| {
        let bytes: [u8; 4] = tiff.get(at..at + 4)?.try_into().ok()?;
        Some(if big { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    };
    let first = usize::try_from(four(4)?).ok()?;
    let entries = usize::from(two(first)?);
    let entry = (0..entries).map(|n| first + 2 + 12 * n).find(|&at| two(at) == Some(0x0112))?;
    u8::try_from(two(entry + 8)?).ok().filter(|orientation| (1..=8).contains(orientation))
}
