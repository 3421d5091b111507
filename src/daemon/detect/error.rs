//! Why a model cannot be used, or a picture not be searched, in the user's words.

use super::sidecar::SidecarError;
use crate::daemon::disk;
use std::path::PathBuf;

/// Why a model cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The sidecar that describes it is missing or wrong.
    #[error(transparent)]
    Sidecar(#[from] SidecarError),
    /// The file cannot be read.
    #[error("model {}: {}", path.display(), disk::unread(source))]
    Read {
        /// The model file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The file is another one than the sidecar describes.
    #[error(
        "model {}: its SHA-256 is {actual}, sidecar {} says {expected}; they do not belong \
         together", path.display(), sidecar.display()
    )]
    Hash {
        /// The model file.
        path: PathBuf,
        /// The sidecar.
        sidecar: PathBuf,
        /// The hash that the sidecar names.
        expected: String,
        /// The hash of the file.
        actual: String,
    },
    /// tract cannot run the file.
    #[error("model {}: cannot be loaded: {reason}", path.display())]
    Load {
        /// The model file.
        path: PathBuf,
        /// tract's reason.
        reason: String,
    },
    /// Input or output differ from what the sidecar says.
    #[error(
        "model {}: {what} has the shape {}, its sidecar asks for {}: name the sidecar that came with \
         this model",
        path.display(), sizes(actual), sizes(expected)
    )]
    Shape {
        /// The model file.
        path: PathBuf,
        /// Input or output.
        what: &'static str,
        /// The shapes that follow from the sidecar.
        expected: Vec<Vec<usize>>,
        /// The model's own.
        actual: Vec<Vec<usize>>,
    },
    /// It does not find what it must in the known picture.
    #[error("model {}: it failed its test: {reason}", path.display())]
    SelfTest {
        /// The model file.
        path: PathBuf,
        /// The difference.
        reason: String,
    },
}

/// Shapes such as `1x3x480x640`.
pub(super) fn sizes(shapes: &[Vec<usize>]) -> String {
    let size = |shape: &Vec<usize>| {
        let sides: Vec<_> = shape.iter().map(usize::to_string).collect();
        sides.join("x")
    };
    shapes.iter().map(size).collect::<Vec<_>>().join(" and ")
}

/// A picture that could not be searched.
#[derive(Debug, thiserror::Error)]
#[error("inference failed: {reason}")]
pub struct DetectError {
    pub(super) reason: String,
}
