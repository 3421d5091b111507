//! The system's errors about files, in an installer's words and with what to do.
//!
//! Owns the words. The file's name, and the consequence, are added by its reader or writer.

use std::fmt::{self, Display};
use std::io::{self, ErrorKind};

/// Why a file was not read.
pub fn unread(error: &io::Error) -> impl Display {
    Words { error, writing: false }
}

/// Why a file or a folder was not written.
pub fn unwritten(error: &io::Error) -> impl Display {
    Words { error, writing: true }
}

struct Words<'e> {
    error: &'e io::Error,
    writing: bool,
}

impl Display for Words<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match (self.error.kind(), self.writing) {
            // A reason of ours says more than its kind.
            _ if self.error.get_ref().is_some() => return Display::fmt(self.error, f),
            (ErrorKind::NotFound, false) => "there is no such file or folder",
            (ErrorKind::NotFound, true) => "its folder is not there: make its folder, or name another place",
            (ErrorKind::PermissionDenied, false) => {
                "this user may not read it: give it to the user that verge runs as (chown verge), and let \
                 that user into its folder"
            }
            (ErrorKind::PermissionDenied, true) => {
                "this user may not write there: give the place to the user that verge runs as (chown -R \
                 verge), or name another"
            }
            (ErrorKind::IsADirectory, _) => "a folder has this name: name a file",
            (ErrorKind::NotADirectory, false) => "a part of its path is a file and no folder",
            (ErrorKind::NotADirectory | ErrorKind::AlreadyExists, true) => {
                "a file is in its way: move that away, or name another place"
            }
            (ErrorKind::ReadOnlyFilesystem, _) => {
                "the file system is read-only, or the unit makes it so (ReadWritePaths= in `systemctl \
                 edit verge`): name a place that is not, or mount it writable"
            }
            (ErrorKind::StorageFull | ErrorKind::QuotaExceeded, _) => {
                "the disk is full: make room, or name another place"
            }
            (ErrorKind::InvalidFilename, _) => "the name is too long, or none",
            _ => {
                // The number is the system's own affair.
                let text = self.error.to_string();
                return f.write_str(text.split(" (os error").next().unwrap_or_default());
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_words_name_the_reason_and_a_remedy_and_no_number() {
        for (error, reading, writing) in [
            (2, "no such file", "make its folder"),
            (13, "chown verge", "chown -R verge"),
            (20, "no folder", "in its way"),
            (21, "name a file", "name a file"),
            (28, "make room", "make room"),
            (30, "read-only", "mount it writable"),
            (5, "put/output error", "put/output error"),
        ] {
            let error = io::Error::from_raw_os_error(error);
            for (said, expected) in
                [(unread(&error).to_string(), reading), (unwritten(&error).to_string(), writing)]
            {
                assert!(said.contains(expected) && !said.contains("os error"), "{said}");
            }
        }
        let ours = io::Error::new(ErrorKind::InvalidInput, "it is not a plain file");
        assert_eq!(unread(&ours).to_string(), "it is not a plain file");
    }
}
