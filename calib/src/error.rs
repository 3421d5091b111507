//! The errors of a calibration: what was wrong, where, and what to do about it.
//!
//! Owns the error enum and its mapping to exit codes. Does not own messages of
//! success, warnings or the trust verdict (see `trust`).

use crate::trust::Reason;
use std::path::PathBuf;
use verge_desk::Exit;
use verge_desk::sysexits::{DATAERR, NOINPUT, USAGE};

/// Why a calibration, a check or a table could not be made.
///
/// Every variant carries the numbers and the names a person needs to repair the
/// input: the file, the vehicle and the key point.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file that cannot be read or written.
    #[error(transparent)]
    Desk(#[from] verge_desk::Failure),
    /// A JSON file does not have the expected shape.
    #[error("{path}: not the expected JSON: {detail}", path = path.display())]
    Json {
        /// The file asked for.
        path: PathBuf,
        /// The parser's message, with line and column.
        detail: String,
    },
    /// A picture cannot be decoded or encoded.
    #[error("{path}: picture: {detail}", path = path.display())]
    Picture {
        /// The file asked for.
        path: PathBuf,
        /// The codec's message.
        detail: String,
    },
    /// A folder holds no file of the wanted kind.
    #[error("{path}: no {wanted} in this folder", path = path.display())]
    EmptyFolder {
        /// The folder searched.
        path: PathBuf,
        /// What was looked for.
        wanted: &'static str,
    },
    /// Two sources disagree about the size of the picture.
    #[error(
        "{what}: picture size {actual:?} differs from {expected:?}; \
         use labels, lanes and pictures of one resolution"
    )]
    ImageSize {
        /// The file or thing with the other size.
        what: String,
        /// The size it has, width and height in px.
        actual: [u32; 2],
        /// The size the others have, width and height in px.
        expected: [u32; 2],
    },
    /// A label is not usable: unknown, repeated, not finite, outside the picture.
    #[error("{vehicle}, key point '{label}': {problem}")]
    KeyPoint {
        /// The vehicle, by file name or group.
        vehicle: String,
        /// The label as written.
        label: String,
        /// What is wrong with it and what to do.
        problem: String,
    },
    /// The body stated for a vehicle is not usable: unknown, or one of several.
    #[error("{vehicle}, flag '{flag}': {problem}")]
    Body {
        /// The vehicle, by file name or group.
        vehicle: String,
        /// The flag as written.
        flag: String,
        /// What is wrong with it and what to do.
        problem: String,
    },
    /// A vehicle has too few key points for a pose.
    #[error("{vehicle}: {actual} key points, at least {required} are needed; label more of them")]
    TooFewPoints {
        /// The vehicle.
        vehicle: String,
        /// How many points are needed.
        required: usize,
        /// How many there are.
        actual: usize,
    },
    /// The key points of a vehicle lie on one line.
    #[error(
        "{vehicle}: key points {points} lie on one line (spread across it {spread_px:.2} px); \
         a pose needs points spread over the vehicle"
    )]
    Collinear {
        /// The vehicle.
        vehicle: String,
        /// The labels of the points.
        points: String,
        /// Root mean square distance from the best line, px.
        spread_px: f64,
    },
    /// Left and right (or front and back) labels contradict each other.
    #[error("{vehicle}: key points {first} and {second} look swapped: {reason}")]
    SwappedLabels {
        /// The vehicle.
        vehicle: String,
        /// The first label of the pair.
        first: u8,
        /// The second label of the pair.
        second: u8,
        /// What contradicts them.
        reason: String,
    },
    /// A vehicle model is not usable.
    #[error("vehicle model '{model}': {problem}")]
    Model {
        /// The model's name.
        model: String,
        /// What is wrong with it.
        problem: String,
    },
    /// No solver found a pose for a vehicle.
    #[error(
        "{vehicle}: no pose fits its key points with any of the {models} vehicle models: {detail}"
    )]
    NoPose {
        /// The vehicle.
        vehicle: String,
        /// How many models were tried.
        models: usize,
        /// The last reason.
        detail: String,
    },
    /// A point of the picture does not lie on the road plane before the camera.
    #[error(
        "{what} at ({u:.1}, {v:.1}) px is at or above the horizon of this calibration; \
         it cannot lie on the road"
    )]
    AboveHorizon {
        /// The vehicle and point, lane and vertex, or mark and point.
        what: String,
        /// Horizontal image coordinate, px.
        u: f64,
        /// Vertical image coordinate, px.
        v: f64,
    },
    /// A solver ended without a usable answer.
    #[error("{method}: {detail}")]
    Solver {
        /// The method's name.
        method: &'static str,
        /// Why it ended.
        detail: String,
    },
    /// A lane polygon is not usable.
    #[error("lane {lane}: {problem}")]
    Lane {
        /// The lane as labelled.
        lane: String,
        /// What is wrong with it and what to do.
        problem: String,
    },
    /// Road marks are not usable.
    #[error("marks: {0}")]
    Marks(String),
    /// The same of those in a file.
    #[error("{path}: {problem}", path = path.display())]
    MarksIn {
        /// The file.
        path: PathBuf,
        /// The mark, and what is wrong with it.
        problem: String,
    },
    /// The calibration must not be trusted and was not forced.
    #[error(
        "the calibration says it cannot be trusted: {0}; \
         calibrate again with more (lengths first), or pass --force"
    )]
    NotTrusted(Reason),
    /// The command line asks for something impossible.
    #[error("{0}")]
    Usage(String),
}

/// The result type of this crate.
pub type Result<T> = std::result::Result<T, Error>;

impl Exit for Error {
    fn exit_code(&self) -> u8 {
        match self {
            Error::Desk(failure) => failure.exit_code(),
            Error::Usage(_) => USAGE,
            Error::EmptyFolder { .. } => NOINPUT,
            _ => DATAERR,
        }
    }
}
