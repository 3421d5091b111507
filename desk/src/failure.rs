//! Why a program failed, where all programs fail alike: arguments and files.

use crate::program::Exit;
use crate::sysexits::{CANTCREAT, DATAERR, IOERR, NOINPUT, USAGE};
use std::io;
use std::path::{Path, PathBuf};

/// A failure with arguments or files: what, where, what to do.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// Arguments that contradict each other or make no sense.
    #[error("{0}")]
    Usage(String),
    /// A file or folder that is not there or may not be read.
    #[error("cannot open {}: {source}; is the path right?", path.display())]
    Missing {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// Reading broke off.
    #[error("reading {} broke off: {source}; check the disk and the file", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// A file whose content is wrong.
    #[error("{}{}: {reason}", path.display(), line_text(*line))]
    Content {
        /// The file.
        path: PathBuf,
        /// Line from 1; 0 when the whole file is meant.
        line: usize,
        /// The fault, and what is expected instead.
        reason: String,
    },
    /// An output that cannot be made. What was there before is untouched.
    #[error("cannot write {}: {}", path.display(), unwritten(source))]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// An output folder that holds something already.
    #[error("{} is not empty; give a new or empty folder", path.display())]
    Occupied {
        /// The folder.
        path: PathBuf,
    },
    /// An output under the name of an input.
    #[error("cannot write {}: it is an input, which would be lost; give another file", path.display())]
    Lost {
        /// The file.
        path: PathBuf,
    },
    /// Standard output that cannot be written.
    #[error("cannot write to standard output: {0}")]
    Print(io::Error),
}

fn unwritten(source: &io::Error) -> String {
    match source.kind() {
        io::ErrorKind::NotFound => "its folder is not there: make it first".to_owned(),
        io::ErrorKind::PermissionDenied => "you may not write there: name another place".to_owned(),
        io::ErrorKind::ReadOnlyFilesystem => {
            "the file system is read-only: name another place".to_owned()
        }
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "the disk is full: make room, or name another place".to_owned()
        }
        _ => {
            // Behind it may stand the partial file's name, and the system's number.
            let text = source.to_string();
            let text = text.split(" at path ").next().unwrap_or_default();
            let text = text.split(" (os error").next().unwrap_or_default();
            format!("{text}; is there room, and may you write there?")
        }
    }
}

fn line_text(line: usize) -> String {
    if line == 0 { String::new() } else { format!(" line {line}") }
}

impl Failure {
    /// A failed read: not there, or broken off.
    pub fn reading(path: &Path, source: io::Error) -> Self {
        let path = path.to_owned();
        match source.kind() {
            io::ErrorKind::NotFound
            | io::ErrorKind::PermissionDenied
            | io::ErrorKind::NotADirectory
            | io::ErrorKind::IsADirectory => Self::Missing { path, source },
            _ => Self::Read { path, source },
        }
    }

    /// A failed write.
    pub fn writing(path: &Path, source: io::Error) -> Self {
        Self::Write { path: path.to_owned(), source }
    }

    /// Wrong content of a file; `line` from 1, 0 for the whole.
    pub fn content(path: &Path, line: usize, reason: impl Into<String>) -> Self {
        Self::Content { path: path.to_owned(), line, reason: reason.into() }
    }
}

impl Exit for Failure {
    fn exit_code(&self) -> u8 {
        match self {
            Self::Usage(_) => USAGE,
            Self::Missing { .. } => NOINPUT,
            Self::Read { .. } | Self::Print(_) => IOERR,
            Self::Content { .. } => DATAERR,
            Self::Write { .. } | Self::Lost { .. } | Self::Occupied { .. } => CANTCREAT,
        }
    }
}
