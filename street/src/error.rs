//! Every way the simulator can fail, with what was wrong, where, and what to do.
//!
//! Owns the error type and its exit codes (sysexits). Printing is `main.rs`.

use std::io;
use std::path::PathBuf;

/// The result of anything in this crate that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// A failure of the simulator.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The scene file cannot be read.
    #[error("scene {path}: cannot read it ({source}); give a readable scene file with --scene")]
    SceneRead {
        /// The file asked for.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The scene file is no TOML, or has a key that no scene has.
    #[error("scene {origin}: {message}; docs/street.md lists the keys")]
    SceneSyntax {
        /// The file, or `<text>`.
        origin: String,
        /// What the TOML reader said, with line and column.
        message: String,
    },
    /// A value of the scene is outside its range.
    #[error("scene {origin}: {key} = {value} is refused: {expected}")]
    SceneValue {
        /// The file, or `<text>`.
        origin: String,
        /// The key, with its table.
        key: String,
        /// What stands there.
        value: String,
        /// What may stand there.
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
    /// The output folder holds something already.
    #[error("output {path}: exists and is not empty; give a new folder with --out")]
    OutputNotEmpty {
        /// The folder.
        path: PathBuf,
    },
    /// The output folder cannot be made.
    #[error("output {path}: cannot create it ({source}); check that its parent is writable")]
    OutputCreate {
        /// The folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A file of the recording cannot be written.
    #[error("output {path}: cannot write it ({source}); nothing was left in the output folder")]
    OutputWrite {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The JPEG encoder refused a frame.
    #[error("frame {frame}: JPEG encoding failed ({message})")]
    Jpeg {
        /// The frame's name.
        frame: String,
        /// What the encoder said.
        message: String,
    },
}

impl Error {
    /// The sysexits code of this failure: 65 bad data, 66 no input, 73 cannot create, 74 I/O.
    pub fn exit_code(&self) -> u8 {
        match self {
            Error::SceneRead { .. } => 66,
            Error::SceneSyntax { .. } | Error::SceneValue { .. } | Error::LaneNotVisible { .. } => {
                65
            }
            Error::OutputNotEmpty { .. } | Error::OutputCreate { .. } => 73,
            Error::OutputWrite { .. } | Error::Jpeg { .. } => 74,
        }
    }
}
