//! Writing files whole: a new file replaces the old one only when it is complete.
//!
//! Owns the write-then-rename. Does not own what is written.

use crate::error::{Error, Result};
use std::io::Write;
use std::path::Path;

/// Writes `bytes` to `path`: first to a temporary file in the same folder, flushed to the
/// disk, then renamed. After an error the former file is untouched.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<()> {
    let failed = |source| Error::Write { path: path.to_owned(), source };
    let name = path
        .file_name()
        .ok_or_else(|| Error::Usage(format!("{}: not the name of a file", path.display())))?;
    let temporary =
        path.with_file_name(format!(".{}.{}.tmp", name.to_string_lossy(), std::process::id()));
    let written = std::fs::File::create(&temporary)
        .and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync_all()))
        .and_then(|()| std::fs::rename(&temporary, path));
    if written.is_err() {
        // The first error counts; a leftover that cannot be removed adds nothing to it.
        let _ = std::fs::remove_file(&temporary);
    }
    written.map_err(failed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_whole_and_nothing_is_left_over() {
        let folder = std::env::temp_dir().join(format!("mvcalib-output-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("a.json");
        write_whole(&path, b"first").unwrap();
        write_whole(&path, b"second").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"second");
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1);
        let error = write_whole(&folder.join("missing/a.json"), b"x").unwrap_err();
        assert_eq!(error.exit_code(), 73);
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
