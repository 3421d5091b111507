//! Why a command failed, and its sysexits code.

use std::io;
use std::path::{Path, PathBuf};

/// Wrong arguments.
pub const USAGE: u8 = 64;
/// Wrong input data.
pub const DATAERR: u8 = 65;
/// An input file that is missing or cannot be read.
pub const NOINPUT: u8 = 66;
/// An output file that cannot be made.
pub const CANTCREAT: u8 = 73;
/// Reading failed half-way.
pub const IOERR: u8 = 74;

/// Why a command failed: what, where, what to do.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// Arguments that contradict each other or make no sense.
    #[error("{0}")]
    Usage(String),
    /// A file that is not there or may not be read.
    #[error("cannot open {}: {source}; is the path right?", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// Reading broke off.
    #[error("reading {} broke off: {source}; check the disk", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// A file whose content is wrong.
    #[error("{}{}: {reason}", path.display(), line_text(*line))]
    Content {
        /// The file.
        path: PathBuf,
        /// Line from 1; 0 when the whole file is meant.
        line: usize,
        /// What is wrong and what is expected.
        reason: String,
    },
    /// A linear program without a solution.
    #[error("no allocation satisfies the constraints: {constraint}; {remedy}")]
    Infeasible {
        /// The constraint that cannot hold.
        constraint: String,
        /// What would make it hold.
        remedy: String,
    },
    /// An output that cannot be made.
    #[error("cannot write {}: {source}; is there room, and may you write there?", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
}

fn line_text(line: usize) -> String {
    if line == 0 { String::new() } else { format!(" line {line}") }
}

impl Failure {
    /// The exit code.
    pub fn code(&self) -> u8 {
        match self {
            Self::Usage(_) => USAGE,
            Self::Missing { .. } => NOINPUT,
            Self::Read { .. } => IOERR,
            Self::Content { .. } | Self::Infeasible { .. } => DATAERR,
            Self::Write { .. } => CANTCREAT,
        }
    }

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

    /// Wrong content of a file; `line` from 1, 0 for the whole.
    pub fn content(path: &Path, line: usize, reason: impl Into<String>) -> Self {
        Self::Content { path: path.to_owned(), line, reason: reason.into() }
    }
}

/// The whole text of a file.
pub fn read_text(path: &Path) -> Result<String, Failure> {
    let bytes = std::fs::read(path).map_err(|source| Failure::reading(path, source))?;
    String::from_utf8(bytes).map_err(|_| Failure::content(path, 0, "is not UTF-8 text"))
}
