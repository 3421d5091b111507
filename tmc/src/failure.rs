//! Why a command failed, and its sysexits code.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Wrong arguments.
pub const USAGE: u8 = 64;
/// Wrong input data.
pub const DATAERR: u8 = 65;
/// An input file that is missing or cannot be read.
pub const NOINPUT: u8 = 66;
/// A broker or a cluster that is not there.
pub const UNAVAILABLE: u8 = 69;
/// A failure of this program, or too little memory for it.
pub const SOFTWARE: u8 = 70;
/// An output file that cannot be made.
pub const CANTCREAT: u8 = 73;
/// Reading or writing failed half-way.
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
    #[error("reading {} broke off: {source}; check the disk and the file", path.display())]
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
    /// An output that cannot be made.
    #[error("cannot write {}: {source}; is there room, and may you write there?", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// Standard output that cannot be written.
    #[error("cannot write to standard output: {0}")]
    Print(io::Error),
    /// A broker that cannot be reached, or that refuses.
    #[error("broker {address}: {reason}; is it running, and are name and password right?")]
    Broker {
        /// Host and port.
        address: String,
        /// What happened.
        reason: String,
    },
    /// A query that the archive's engine could not answer.
    #[error("a query of {} failed: {reason}; more memory, or fewer --threads, may help", path.display())]
    Query {
        /// The archive.
        path: PathBuf,
        /// What the engine says.
        reason: String,
    },
    /// A cluster that cannot be reached, or that failed.
    #[error(
        "cluster {address}: {reason}; do its scheduler and executors run, in this program's \
         version of Ballista, and do they read the archive under the same path?"
    )]
    Cluster {
        /// Host and port of its scheduler.
        address: String,
        /// What happened.
        reason: String,
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
            Self::Read { .. } | Self::Print(_) => IOERR,
            Self::Content { .. } => DATAERR,
            Self::Write { .. } => CANTCREAT,
            Self::Broker { .. } | Self::Cluster { .. } => UNAVAILABLE,
            Self::Query { .. } => SOFTWARE,
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

    /// A failed write.
    pub fn writing(path: &Path, source: io::Error) -> Self {
        Self::Write { path: path.to_owned(), source }
    }

    /// Wrong content of a file; `line` from 1, 0 for the whole.
    pub fn content(path: &Path, line: usize, reason: impl Into<String>) -> Self {
        Self::Content { path: path.to_owned(), line, reason: reason.into() }
    }
}

/// The whole text of a file; one that begins as gzip does is unpacked.
///
/// # Errors
/// [`Failure::Missing`], [`Failure::Read`], [`Failure::Content`] where it is no UTF-8 text.
pub fn read_text(path: &Path) -> Result<String, Failure> {
    let mut bytes = std::fs::read(path).map_err(|source| Failure::reading(path, source))?;
    if bytes.starts_with(&[0x1f, 0x8b]) {
        let mut unpacked = Vec::new();
        let mut reader = flate2::read::MultiGzDecoder::new(bytes.as_slice());
        io::Read::read_to_end(&mut reader, &mut unpacked)
            .map_err(|error| Failure::content(path, 0, format!("is damaged gzip: {error}")))?;
        bytes = unpacked;
    }
    String::from_utf8(bytes).map_err(|_| Failure::content(path, 0, "is not UTF-8 text"))
}

/// Prints to standard output.
///
/// # Errors
/// [`Failure::Print`]; a reader that has gone away (`head`) is none.
pub fn print(text: &str) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(Failure::Print(error)),
        _ => Ok(()),
    }
}
