//! Inspection of a model file before there is a sidecar: for `verge-detector check`.

use super::engine::{Engine, Precision, Share};
use super::error::sizes;
use super::head_key::HeadSpec;
use super::load::{Refused, Wanted};
use super::{ModelError, guess};
use crate::wire::hex;
use sha2::{Digest, Sha256};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Duration, Instant};

/// Runs that are timed.
const TURNS: usize = 5;

/// Properties of a model file.
#[derive(Clone, Debug)]
pub struct Inspection {
    /// SHA-256 of the file, hexadecimal.
    pub sha256: String,
    /// Columns and rows of the input, px.
    pub input_px: [usize; 2],
    /// Shapes of the outputs.
    pub outputs: Vec<Vec<usize>>,
    /// The head that it seems to have.
    pub head: Option<HeadSpec>,
    /// The parts that compute it, in words.
    pub runs_on: String,
    /// Nodes that stay with tract: operator, node and reason.
    pub left: Vec<(String, String, String)>,
    /// The parts that compute it, largest share of the time first.
    pub shares: Vec<Share>,
    /// Time of one run on this machine.
    pub took: Duration,
}

/// Loads the model file at `path` and runs it a few times over nothing. `input_px`, columns and
/// rows, takes the place of the file's size.
///
/// # Errors
/// [`ModelError`] where it cannot be read, loaded or run.
pub fn inspect(path: &Path, input_px: Option<[usize; 2]>) -> Result<Inspection, ModelError> {
    let bytes =
        std::fs::read(path).map_err(|source| ModelError::Read { path: path.to_owned(), source })?;
    let sha256 = hex(&Sha256::digest(&bytes).into()).as_str().to_owned();
    let wanted = Wanted { stored: None, size: input_px, precision: Precision::AsStored };
    let run = || run(path, bytes, sha256, &wanted);
    catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|_| {
        let reason = "tract gave up while it ran".to_owned();
        Err(ModelError::Load { path: path.to_owned(), reason })
    })
}

fn run(
    path: &Path,
    bytes: Vec<u8>,
    sha256: String,
    wanted: &Wanted,
) -> Result<Inspection, ModelError> {
    let load = |reason| ModelError::Load { path: path.to_owned(), reason };
    let mut engine = Engine::load(path, bytes, wanted).map_err(|refused| match refused {
        Refused::Reason(reason) => load(reason),
        Refused::Input(shape) => load(format!(
            "its input has the shape {}; pictures need 1x3xHxW (one picture, three colours)",
            sizes(std::slice::from_ref(&shape))
        )),
    })?;
    engine.run().map_err(load)?;
    let begun = Instant::now();
    for _ in 0..TURNS {
        engine.run().map_err(load)?;
    }
    let took = begun.elapsed() / TURNS as u32;
    let outputs = engine.output_shapes();
    let left = engine
        .left()
        .iter()
        .map(|left| (left.operator.clone(), left.node.clone(), left.reason.clone()));
    Ok(Inspection {
        sha256,
        input_px: engine.size(),
        head: guess::guess(engine.size(), &outputs),
        outputs,
        runs_on: engine.describe(),
        left: left.collect(),
        shares: engine.shares(TURNS).map_err(load)?,
        took,
    })
}
