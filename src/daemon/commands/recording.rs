//! The recording that `demo` and `bench` play when none is named.

use crate::daemon::config::DEFAULT_MODEL;
use crate::daemon::exit::Failure;
use std::path::Path;

/// A recording with its lane table.
#[derive(Clone, Copy, Debug)]
pub struct Recording {
    /// Folder of frames.
    pub frames: &'static str,
    /// Lane table.
    pub table: &'static str,
    /// Time between frames where their names do not tell, s.
    pub interval_s: Option<u64>,
    /// Window that it fills several times, s.
    pub window_s: u64,
}

/// In the order of preference: our own first, then the paper's camera.
const RECORDINGS: [Recording; 2] = [
    Recording {
        frames: "tests/data/curve/frames",
        table: "tests/data/curve.lut",
        interval_s: None,
        window_s: 60,
    },
    Recording {
        frames: "../shared/data/k109f/camera_calibration/K109F/images",
        table: "tests/data/k109f.lut",
        interval_s: Some(120),
        window_s: 300,
    },
];

const HINT: &str = "run it in the project's folder, with the shared data and models beside it";

/// The first recording that is there.
pub fn find() -> Result<Recording, Failure> {
    let there = |recording: &&Recording| {
        Path::new(recording.frames).is_dir() && Path::new(recording.table).is_file()
    };
    RECORDINGS.iter().find(there).copied().ok_or_else(|| Failure::DemoFiles {
        what: format!("a recording ({} or {})", RECORDINGS[0].frames, RECORDINGS[1].frames),
        hint: HINT,
    })
}

/// The model, which must be there too.
pub fn model() -> Result<&'static Path, Failure> {
    let model = Path::new(DEFAULT_MODEL);
    if model.is_file() {
        return Ok(model);
    }
    Err(Failure::DemoFiles { what: format!("the model {DEFAULT_MODEL}"), hint: HINT })
}
