//! Reading a file that someone has named: a plain one, and no larger than it can be.
//!
//! Owns that neither a FIFO keeps the program waiting nor a device fills its memory, and what a file is
//! that should be a text.

use rustix::fs::OFlags;
use std::fs::OpenOptions;
use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// First bytes of files that are taken for text by mistake.
const KINDS: [(&[u8], &str); 9] = [
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"\x89PNG", "a PNG picture"),
    (b"PK\x03\x04", "a ZIP archive or a spreadsheet: unpack it, or export it as text"),
    (b"\x1f\x8b", "a gzip file: unpack it"),
    (b"\x7fELF", "a program"),
    (b"%PDF", "a PDF"),
    (&crate::lane::MAGIC, "a lane table"),
    (b"\xff\xfe", "UTF-16: save it as UTF-8"),
    (b"\xfe\xff", "UTF-16: save it as UTF-8"),
];

/// The bytes of a plain file of at most `most` bytes; links are followed.
///
/// # Errors
/// The system's error, or one that names another kind of file, or a larger one.
pub fn read(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    read_into(path, most, &mut bytes).map(|()| bytes)
}

/// The same, in place of what `bytes` holds.
///
/// # Errors
/// As [`read`].
pub fn read_into(path: &Path, most: u64, bytes: &mut Vec<u8>) -> io::Result<()> {
    bytes.clear();
    // The opened file is judged, not the name: that may be another file's a moment later.
    let flags = i32::try_from(OFlags::NONBLOCK.bits()).unwrap_or(0);
    let file = OpenOptions::new().read(true).custom_flags(flags).open(path)?;
    let metadata = file.metadata()?;
    if metadata.is_dir() {
        return Err(ErrorKind::IsADirectory.into());
    }
    if !metadata.is_file() {
        return Err(io::Error::new(ErrorKind::InvalidInput, "it is not a plain file"));
    }
    let too_large = |len: u64| {
        let reason = format!("it has {} MB, more than any that fits", len >> 20);
        io::Error::new(ErrorKind::FileTooLarge, reason)
    };
    if metadata.len() > most {
        return Err(too_large(metadata.len()));
    }
    // Files of the kernel say that they are empty.
    file.take(most + 1).read_to_end(bytes)?;
    if bytes.len() as u64 > most { Err(too_large(bytes.len() as u64)) } else { Ok(()) }
}

/// The text of a plain file of at most `most` bytes, without a byte order mark.
///
/// # Errors
/// As [`read`], and [`ErrorKind::InvalidData`] for what is no UTF-8, with what it is.
pub fn read_text(path: &Path, most: u64) -> io::Result<String> {
    let text = String::from_utf8(read(path, most)?).map_err(|error| {
        let bytes = error.as_bytes();
        let kind = KINDS.iter().find(|(begins, _)| bytes.starts_with(begins));
        let good = error.utf8_error().valid_up_to();
        let line = 1 + bytes[..good].iter().filter(|&&byte| byte == b'\n').count();
        let what = match kind {
            Some((_, kind)) => format!("it is {kind}"),
            None if bytes.contains(&0) => "it is no text file".to_owned(),
            None => format!("line {line} is not UTF-8: save the file as UTF-8"),
        };
        io::Error::new(ErrorKind::InvalidData, what)
    })?;
    Ok(text.strip_prefix('\u{feff}').map(ToOwned::to_owned).unwrap_or(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_text_is_named() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("file");
        for (bytes, said) in [
            (&b"\x89PNG\r\n"[..], "it is a PNG picture"),
            (b"\xff\xfea\0", "it is UTF-16: save it as UTF-8"),
            (b"a\nS\xfcd", "line 2 is not UTF-8: save the file as UTF-8"),
            (b"a\0\xff", "it is no text file"),
        ] {
            std::fs::write(&path, bytes).expect("written");
            assert_eq!(read_text(&path, 100).expect_err(said).to_string(), said);
        }
        std::fs::write(&path, "\u{feff}text").expect("written");
        assert_eq!(read_text(&path, 100).expect("a text"), "text");
    }

    #[test]
    fn neither_devices_nor_fifos_are_read() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = |name: &str| folder.path().join(name);
        let (mode, kind) = (rustix::fs::Mode::RUSR, rustix::fs::FileType::Fifo);
        rustix::fs::mknodat(rustix::fs::CWD, path("fifo"), kind, mode, 0).expect("a FIFO");
        std::os::unix::fs::symlink("/dev/zero", path("zero")).expect("a link");
        std::fs::File::create(path("sparse")).and_then(|f| f.set_len(4 << 30)).expect("sparse");
        for name in ["fifo", "zero", "sparse", "none", "."] {
            assert!(read(&path(name), 1 << 20).is_err(), "{name}");
        }
        // Plain and of no length, says the kernel of these.
        for name in ["/proc/kmsg", "/proc/self/pagemap", "/proc/self/maps"] {
            assert!(read(Path::new(name), 100).is_err(), "{name}");
        }
        std::fs::write(path("right"), b"text").expect("written");
        assert_eq!(read(&path("right"), 4).expect("it fits"), b"text");
    }
}
