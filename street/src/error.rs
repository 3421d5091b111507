//! Every way the simulator can fail, with what was wrong, where, and what to do.
//!
//! Owns the error type and its exit codes (sysexits); those of files are `verge_desk`'s.

use verge_desk::Exit;
use verge_desk::sysexits::{DATAERR, IOERR};

/// The result of anything in this crate that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// A failure of the simulator.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Arguments or files.
    #[error(transparent)]
    Desk(#[from] verge_desk::Failure),
    /// The scene file is not TOML, or has a key that no scene has.
    #[error("scene {origin}: {message}; docs/explanation/street.md lists the keys")]
    SceneSyntax {
        /// The file, or `<text>`.
        origin: String,
        /// The TOML reader's message, with line and column.
        message: String,
    },
    /// A value of the scene is outside its range.
    #[error("scene {origin}: {key} = {value} is refused: {expected}")]
    SceneValue {
        /// The file, or `<text>`.
        origin: String,
        /// The key, with its table.
        key: String,
        /// The value given.
        value: String,
        /// The values allowed.
        expected: String,
    },
    /// A lane has no stretch on which whole vehicles are seen.
    #[error(
        "scene {scene}: lane {lane} shows only {visible_m:.1} m on which a {envelope_m:.1} m long \
         vehicle is whole in the picture and large enough, at least {required_m:.1} m are needed; \
         move the camera or lower measure.min_car_height_px"
    )]
    LaneNotVisible {
        /// The scene's name.
        scene: String,
        /// Lane number from 1.
        lane: usize,
        /// Length found, m.
        visible_m: f64,
        /// Length needed, m.
        required_m: f64,
        /// Length of the longest vehicle of the scene, m.
        envelope_m: f64,
    },
    /// The JPEG encoder refused a frame.
    #[error("frame {frame}: JPEG encoding failed ({message})")]
    Jpeg {
        /// The frame's name.
        frame: String,
        /// The encoder's message.
        message: String,
    },
}

impl Exit for Error {
    fn exit_code(&self) -> u8 {
        match self {
            Error::Desk(failure) => failure.exit_code(),
            Error::SceneSyntax { .. } | Error::SceneValue { .. } | Error::LaneNotVisible { .. } => {
                DATAERR
            }
            Error::Jpeg { .. } => IOERR,
        }
    }
}
