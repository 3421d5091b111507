//! Detect: the second stage, from a picture to [`Detection`]s.
//!
//! Owns the model: its sidecar, its input, its output, non-maximum suppression. The door
//! of tract; its errors stop here. tract reads and plans the net; what the project's own kernels
//! know of it is computed on them, the rest in tract.

mod engine;
mod error;
mod guess;
mod head;
mod head_key;
mod inspect;
mod letterbox;
mod load;
mod merge;
mod nms;
pub mod regions;
mod self_test;
mod sidecar;

pub use engine::{Precision, Share};
pub use error::{DetectError, ModelError};
pub use head_key::{HeadKind, HeadSpec};
pub use inspect::{Inspection, inspect};
pub use sidecar::{Sidecar, SidecarError, Step};

use super::frame::{Detection, Picture, Region};
use super::plain;
use crate::lane::Name;
use crate::wire::{ModelRef, hex};
use engine::Engine;
use error::sizes;
use head::Head;
use letterbox::Letterbox;
use load::{Refused, Wanted};
use sha2::{Digest, Sha256};
use sidecar::Thresholds;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

/// Most boxes of one picture that reach non-maximum suppression, best first: eight lanes
/// of 100 m at jam density, with ten cells firing on each vehicle, stay below.
pub const MAX_CANDIDATES: usize = 1024;
/// Largest model file, bytes: thirty times the one that ships.
const MOST_MODEL: u64 = 256 << 20;

/// How a model is loaded, beside what its sidecar says.
#[derive(Clone, Copy, Debug, Default)]
pub struct LoadOptions {
    /// Least score, in place of the sidecar's.
    pub score: Option<f32>,
    /// Columns and rows of the net's input, in place of the sidecar's: the same weights over a
    /// larger or smaller picture. Both sides are multiples of 32.
    pub input_px: Option<[usize; 2]>,
    /// The arithmetic.
    pub precision: Precision,
    /// For a model with weights of evidence: give all boxes that these can choose from, which
    /// `score` then has no part in.
    pub candidates: bool,
}

/// A loaded model.
#[derive(Debug)]
pub struct Detector {
    file: PathBuf,
    engine: Engine,
    sidecar: Sidecar,
    model: ModelRef,
    head: Head,
    passes: Vec<Pass>,
    candidates: Vec<Detection>,
    /// Detections of one pass behind the first, before they are merged.
    close: Vec<Detection>,
}

/// One run of the net over a picture.
#[derive(Debug)]
struct Pass {
    /// Where it looks; `None`: at the whole picture.
    region: Option<Region>,
    letterbox: Letterbox,
}

impl Pass {
    fn new(region: Option<Region>, sidecar: &Sidecar) -> Self {
        let input = [sidecar.input.width_px, sidecar.input.height_px];
        Self { region, letterbox: Letterbox::new(input, &sidecar.input.normalisation()) }
    }

    fn region(&self, picture: &Picture) -> Region {
        self.region.map_or_else(|| Region::whole(picture), |region| region.within(picture))
    }
}

impl Detector {
    /// Loads a model from its sidecar (`.toml`) or from the model file itself (`.onnx`),
    /// whose sidecar is then looked for beside it and among the known models.
    /// `score` overrides the sidecar's threshold.
    ///
    /// # Errors
    /// [`ModelError`] where the files are missing, damaged, or do not fit each other.
    pub fn load(path: &Path, score: Option<f32>) -> Result<Self, ModelError> {
        Self::load_as(path, &LoadOptions { score, ..LoadOptions::default() })
    }

    /// As [`Self::load`], with all that can be asked for.
    ///
    /// # Errors
    /// [`ModelError`] where the files are missing, damaged, or do not fit each other, and where
    /// the net cannot take an input of the size that is asked for.
    pub fn load_as(path: &Path, options: &LoadOptions) -> Result<Self, ModelError> {
        let LoadOptions { score, input_px, precision, candidates: all } = *options;
        let (mut sidecar, sidecar_path, path) = Sidecar::find(path)?;
        let bytes = plain::read(&path, MOST_MODEL)
            .map_err(|source| ModelError::Read { path: path.clone(), source })?;
        let sha256: [u8; 32] = Sha256::digest(&bytes).into();
        let actual = hex(&sha256).as_str().to_owned();
        if !sidecar.sha256.eq_ignore_ascii_case(&actual) {
            let expected = sidecar.sha256;
            return Err(ModelError::Hash { path, sidecar: sidecar_path, expected, actual });
        }
        let stored = [sidecar.input.width_px, sidecar.input.height_px];
        let input_px = input_px.filter(|size| *size != stored);
        if let Some(size) = input_px {
            sidecar.set_input(size, &sidecar_path)?;
        }
        let wanted =
            Wanted { stored: Some(stored), size: Some(input_px.unwrap_or(stored)), precision };
        let mut engine = Engine::load(&path, bytes, &wanted).map_err(|refused| match refused {
            Refused::Reason(reason) => ModelError::Load { path: path.clone(), reason },
            Refused::Input(actual) => ModelError::Shape {
                path: path.clone(),
                what: "the input",
                expected: vec![vec![1, 3, stored[1], stored[0]]],
                actual: vec![actual],
            },
        })?;
        let outputs = engine.output_shapes();
        let (spec, guessed) = guess::resolve(&sidecar, &outputs)
            .map_err(|reason| ModelError::Load { path: path.clone(), reason })?;
        if guessed {
            log::warn!(
                "model {}: its sidecar names no head; outputs of {} look like {} with {} \
                 classes (say head = \"{}\" if that is right)",
                path.display(),
                sizes(&outputs),
                spec.kind.name(),
                spec.classes,
                spec.kind.name()
            );
        }
        if spec.kind != HeadKind::End2end {
            sidecar.check_classes(spec.classes).map_err(|(key, reason)| SidecarError::Value {
                path: sidecar_path.clone(),
                key,
                reason,
            })?;
        }
        let head = Head::new(&spec, &sidecar, &outputs).map_err(|expected| ModelError::Shape {
            path: path.clone(),
            what: "the output",
            expected,
            actual: outputs.clone(),
        })?;
        engine.look_for(&head);
        let passes = vec![Pass::new(None, &sidecar)];
        let name = Name::try_from(sidecar.name.as_str()).unwrap_or_default();
        let candidates = Vec::with_capacity(MAX_CANDIDATES);
        let model = ModelRef { name, sha256 };
        let close = Vec::new();
        let mut detector =
            Self { file: path, engine, sidecar, model, head, passes, candidates, close };
        detector.self_test(input_px.is_none() && precision == Precision::AsStored)?;
        if let Some(score) = score {
            detector.sidecar.thresholds.score = score;
            detector.head.set_threshold(score);
            detector.engine.look_for(&detector.head);
        }
        if let (true, Some(evidence)) = (all, &detector.sidecar.evidence) {
            let (score, iou) = (evidence.floor, evidence.same);
            detector.sidecar.thresholds = Thresholds { score, iou, ios: 1.0 };
            detector.head.set_threshold(score);
            detector.engine.look_for(&detector.head);
        }
        Ok(detector)
    }

    /// Searches the known picture. Where the sidecar says what is in it, and `as_stored` at the
    /// size of the file, that must be found; always every number must be one.
    fn self_test(&mut self, as_stored: bool) -> Result<(), ModelError> {
        let mut found = Vec::new();
        let picture = self_test::picture();
        let searched = catch_unwind(AssertUnwindSafe(|| self.detect(&picture, &mut found)));
        let failed = |reason| ModelError::SelfTest { path: self.file.clone(), reason };
        match searched {
            Err(_) => return Err(failed("tract gave up while it ran".to_owned())),
            Ok(Err(error)) => return Err(failed(error.reason)),
            Ok(Ok(())) => {}
        }
        match &self.sidecar.self_test {
            Some(known) if as_stored => self_test::compare(&found, known).map_err(failed),
            _ => Ok(()),
        }
    }

    /// Reads the sidecar of a model without loading the model.
    ///
    /// # Errors
    /// [`ModelError::Sidecar`].
    pub fn described(path: &Path) -> Result<Sidecar, ModelError> {
        Ok(Sidecar::find(path)?.0)
    }

    /// The model file.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// The net's input for `picture` as other runtimes take it: three planes of floats.
    pub fn planes(&mut self, picture: &Picture) -> Vec<f32> {
        let Pass { letterbox, .. } = &mut self.passes[0];
        let mut planes = vec![0.0; letterbox.len()];
        letterbox.fill(picture, Region::whole(picture), letterbox::Into::Planes(&mut planes));
        planes
    }

    /// Name and hash of the model, for messages.
    pub fn model(&self) -> &ModelRef {
        &self.model
    }

    /// Columns and rows of the net's input.
    pub fn input_size(&self) -> [usize; 2] {
        [self.sidecar.input.width_px, self.sidecar.input.height_px]
    }

    /// The model's description of itself.
    pub fn sidecar(&self) -> &Sidecar {
        &self.sidecar
    }

    /// Looks at these parts of each picture from now on, one pass each, the widest first;
    /// without any at the whole picture. Costs nothing while they stay the same.
    pub fn look_at(&mut self, regions: &[Region]) {
        let asked = regions.iter().copied().map(Some);
        let is = self.passes.iter().map(|pass| pass.region);
        if is.clone().eq(asked.clone()) || (regions.is_empty() && is.eq([None])) {
            return;
        }
        self.passes = asked.map(|region| Pass::new(region, &self.sidecar)).collect();
        if self.passes.is_empty() {
            self.passes.push(Pass::new(None, &self.sidecar));
        }
    }

    /// How often the net runs over a picture.
    pub fn passes(&self) -> usize {
        self.passes.len()
    }

    /// Finds the vehicles in `picture`, best first, in pixels of the picture.
    ///
    /// # Errors
    /// [`DetectError`] where inference fails; `found` is then empty.
    pub fn detect(
        &mut self,
        picture: &Picture,
        found: &mut Vec<Detection>,
    ) -> Result<(), DetectError> {
        found.clear();
        for pass in 0..self.passes() {
            self.prepare(picture, pass);
            let output = self.infer()?;
            self.read(picture, pass, &output, found)?;
        }
        Ok(())
    }

    /// The instruction set of the kernels, and the part left to tract.
    pub fn runs_on(&self) -> String {
        self.engine.describe()
    }

    /// The parts that compute the net, with their shares of the time, largest first: from `turns`
    /// runs over the latest search.
    ///
    /// # Errors
    /// [`DetectError`] where inference fails.
    pub fn shares(&mut self, turns: usize) -> Result<Vec<Share>, DetectError> {
        self.engine.shares(turns).map_err(|reason| DetectError { reason })
    }

    /// First step of a pass: its part of the picture into the net's input.
    pub fn prepare(&mut self, picture: &Picture, pass: usize) {
        let pass = &mut self.passes[pass];
        pass.letterbox.fill(picture, pass.region(picture), self.engine.input());
    }

    /// Second step: the net.
    ///
    /// # Errors
    /// [`DetectError`] where inference fails.
    pub fn infer(&mut self) -> Result<Inferred, DetectError> {
        self.engine.run().map(|()| Inferred(())).map_err(|reason| DetectError { reason })
    }

    /// Third step: the net's output into boxes, beside what the passes before have `found`.
    ///
    /// # Errors
    /// [`DetectError`] where a score or a box is not a number.
    pub fn read(
        &mut self,
        picture: &Picture,
        pass: usize,
        _output: &Inferred,
        found: &mut Vec<Detection>,
    ) -> Result<(), DetectError> {
        self.candidates.clear();
        self.engine
            .read(&self.head, &mut self.candidates)
            .map_err(|reason| DetectError { reason })?;
        let thresholds = &self.sidecar.thresholds;
        let Pass { letterbox, .. } = &self.passes[pass];
        let region = self.passes[pass].region(picture);
        self.close.clear();
        let boxes = if pass == 0 { &mut *found } else { &mut self.close };
        nms::suppress(&mut self.candidates, thresholds, MAX_CANDIDATES, boxes);
        for detection in boxes {
            detection.bounds = letterbox.to_picture(&detection.bounds, region);
        }
        if pass > 0 {
            merge::merge(found, &self.close, region, picture);
        }
        Ok(())
    }
}

/// That the net has given its output for one picture; it is there until the next one is prepared.
#[derive(Debug)]
pub struct Inferred(());
