//! The recording that `demo` and `bench` play when none is named.

#[cfg(feature = "demo")]
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
    /// Window that it fills several times, s.
    pub window_s: u64,
}

/// Three minutes of the simulated street.
const CURVE: Recording =
    Recording { frames: "tests/data/curve/frames", table: "tests/data/curve.lut", window_s: 60 };

const HINT: &str = "run it in the project's folder";

/// The recording, if it is there.
pub fn find() -> Result<Recording, Failure> {
    if Path::new(CURVE.frames).is_dir() && Path::new(CURVE.table).is_file() {
        return Ok(CURVE);
    }
    Err(Failure::DemoFiles { what: format!("{} and {}", CURVE.frames, CURVE.table), hint: HINT })
}

/// The model, which must be there too.
#[cfg(feature = "demo")]
pub fn model() -> Result<&'static Path, Failure> {
    let model = Path::new(DEFAULT_MODEL);
    if model.is_file() {
        return Ok(model);
    }
    Err(Failure::DemoFiles { what: format!("the model {DEFAULT_MODEL}"), hint: HINT })
}
