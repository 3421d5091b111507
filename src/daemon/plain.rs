//! Reading a file that someone has named: a plain one, and no larger than it can be.
//!
//! Owns that neither a FIFO keeps the program waiting nor a device fills its memory.

use rustix::fs::OFlags;
use std::fs::OpenOptions;
use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// The bytes of a plain file of at most `most` bytes; links are followed.
///
/// # Errors
/// The system's error, or one that names another kind of file, or a larger one.
pub fn read(path: &Path, most: u64) -> io::Result<Vec<u8>> {
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
    let mut bytes = Vec::new();
    file.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most { Err(too_large(bytes.len() as u64)) } else { Ok(bytes) }
}

#[cfg(test)]
mod tests {
    use super::*;

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
