//! Reading whole files, with the path in the error.

use crate::failure::Failure;
use std::path::Path;

/// The bytes of a file.
///
/// # Errors
/// [`Failure::Missing`], [`Failure::Read`].
pub fn read_bytes(path: &Path) -> Result<Vec<u8>, Failure> {
    std::fs::read(path).map_err(|source| Failure::reading(path, source))
}

/// The text of a file.
///
/// # Errors
/// As [`read_bytes`] and [`text`].
pub fn read_text(path: &Path) -> Result<String, Failure> {
    text(path, read_bytes(path)?)
}

/// The text that the bytes of a file are; the path is for the error.
///
/// # Errors
/// [`Failure::Content`] with the line where it is not UTF-8.
pub fn text(path: &Path, bytes: Vec<u8>) -> Result<String, Failure> {
    String::from_utf8(bytes).map_err(|error| {
        let before = &error.as_bytes()[..error.utf8_error().valid_up_to()];
        let line = 1 + before.iter().filter(|&&byte| byte == b'\n').count();
        Failure::content(path, line, "is not UTF-8 text")
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Exit;

    #[test]
    fn each_fault_has_its_words_and_its_code() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        let fault = |path: &Path| {
            let failure = read_text(path).unwrap_err();
            (failure.exit_code(), failure.to_string())
        };
        let (code, words) = fault(&path);
        assert!(code == 66 && words.contains("a.txt") && words.contains("path right"), "{words}");
        assert_eq!(fault(folder.path()).0, 66);
        std::fs::write(&path, b"one\ntw\xff\n").unwrap();
        let (code, words) = fault(&path);
        assert!(code == 65 && words.ends_with("a.txt line 2: is not UTF-8 text"), "{words}");
        std::fs::write(&path, "eins\n").unwrap();
        assert_eq!(read_text(&path).unwrap(), "eins\n");
    }
}
