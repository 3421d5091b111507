//! The recording that `demo` and `bench` play when none is named.

use crate::daemon::exit::Failure;
use std::path::Path;

/// A recording with its lane table.
#[derive(Clone, Copy, Debug)]
pub struct Recording {
    /// Folder of frames.
    pub frames: &'static str,
    /// Lane table.
    pub table: &'static str,
}

/// Three minutes of the simulated street.
const CURVE: Recording =
    Recording { frames: "tests/data/curve/frames", table: "tests/data/curve.lut" };

/// The recording, if it is there; `needed_by` says for whom, `hint` what to do where it is not.
pub fn find(needed_by: &'static str, hint: &'static str) -> Result<Recording, Failure> {
    if Path::new(CURVE.frames).is_dir() && Path::new(CURVE.table).is_file() {
        return Ok(CURVE);
    }
    let what = format!("{} and {}", CURVE.frames, CURVE.table);
    Err(Failure::DemoFiles { needed_by, what, hint })
}
