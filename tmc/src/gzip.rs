//! Text files that may be gzipped, as detectors' data are kept.

use std::io::Read;
use std::path::Path;
use verge_desk::Failure;

/// The text of a file; one that begins as gzip does is unpacked.
///
/// # Errors
/// [`Failure::Missing`], [`Failure::Read`], [`Failure::Content`] where it is not UTF-8 text.
pub fn read_text(path: &Path) -> Result<String, Failure> {
    let mut bytes = verge_desk::read_bytes(path)?;
    if bytes.starts_with(&[0x1f, 0x8b]) {
        let packed = std::mem::take(&mut bytes);
        flate2::read::MultiGzDecoder::new(packed.as_slice())
            .read_to_end(&mut bytes)
            .map_err(|error| Failure::content(path, 0, format!("is damaged gzip: {error}")))?;
    }
    verge_desk::text(path, bytes)
}
