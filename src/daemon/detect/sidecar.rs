//! The sidecar: a small TOML file that says how a model is fed and read.
//!
//! Owns its keys, its checks, and the list of models that verge knows without one.

use super::head_key::HeadKey;
use crate::daemon::config::{INPUT_STEP_PX, MAX_INPUT_PX, NetInput};
use crate::daemon::disk;
use crate::daemon::plain;
use crate::daemon::toml_file;
use crate::density::Counting;
use crate::evidence::Evidence;
use crate::units::VehicleClass;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Largest sidecar, bytes.
const MOST_SIDECAR: u64 = 1 << 20;

/// Sidecars of models that may lie anywhere without a sidecar beside them, found by the
/// hash of the model file.
const KNOWN: &[(&str, &str)] = &[
    (
        "models/nanodet_plus_m_coco_640x480.toml",
        include_str!("../../../models/nanodet_plus_m_coco_640x480.toml"),
    ),
    (
        "models/nanodet_plus_m_coco_416x320.toml",
        include_str!("../../../models/nanodet_plus_m_coco_416x320.toml"),
    ),
    (
        "models/yolox_nano_coco_640x480.toml",
        include_str!("../../../models/yolox_nano_coco_640x480.toml"),
    ),
];

/// Why a sidecar cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SidecarError {
    /// It cannot be read.
    #[error("model {}: {}", path.display(), disk::unread(source))]
    Read {
        /// Sidecar or model.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The model has no sidecar.
    #[error(
        "model {}: it is neither a sidecar (.toml) nor a model that verge knows: name the sidecar that \
         came with the model, or lay it beside it as {}",
        model.display(), sidecar.display()
    )]
    Unknown {
        /// The model file.
        model: PathBuf,
        /// Where its sidecar would be.
        sidecar: PathBuf,
    },
    /// It does not parse.
    #[error("sidecar {}: {reason}", path.display())]
    Parse {
        /// The sidecar.
        path: PathBuf,
        /// Key, line and reason.
        reason: String,
    },
    /// A value is out of its range.
    #[error("sidecar {}: {key}: {reason}", path.display())]
    Value {
        /// The sidecar.
        path: PathBuf,
        /// The key.
        key: &'static str,
        /// The fault.
        reason: String,
    },
}

/// A model's description.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sidecar {
    /// Name in messages, at most 48 bytes.
    pub name: String,
    /// The model file, relative to the sidecar.
    pub file: PathBuf,
    /// SHA-256 of the model file, hexadecimal, in small letters or capitals.
    pub sha256: String,
    /// Licence of the weights.
    pub licence: String,
    /// Form of the net's input.
    pub input: Input,
    /// How its output is read: a word, or a table for further settings. Without it the shape
    /// of the output decides.
    #[serde(default)]
    pub head: Option<HeadKey>,
    /// Score columns of vehicles.
    pub class: Vec<ClassColumn>,
    /// Thresholds of score and overlap.
    pub thresholds: Thresholds,
    /// How boxes are weighed where the net's score alone does not decide.
    #[serde(default)]
    pub evidence: Option<Evidence>,
    /// Inputs that the same weights work at, by rising width; `input` is one of them.
    #[serde(default)]
    pub step: Vec<Step>,
    /// How a camera's mean count differs from the truth, over cameras that it was not trained on.
    #[serde(default)]
    pub counting: Option<Counting>,
    /// Detections in the known picture, which is searched when the model is loaded.
    #[serde(default)]
    pub self_test: Option<SelfTest>,
}

/// An input that the weights work at.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Step {
    /// Columns, px.
    pub width_px: usize,
    /// Rows, px.
    pub height_px: usize,
    /// Median side of a car along the lanes, px of this input, from which it is the one to take.
    pub car_px: f32,
}

/// Detections that a model must make in the known picture (`self_test.rs`).
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SelfTest {
    /// Left, upper, right, lower edge in pixels of the known picture, and score.
    pub boxes: Vec<[f32; 5]>,
}

/// How a model is fed: one picture as planes of 32-bit floats, `[1, 3, height, width]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Input {
    /// Columns, px.
    pub width_px: usize,
    /// Rows, px.
    pub height_px: usize,
    /// Order of the planes.
    pub channels: Channels,
    /// Subtracted from each channel (0 to 255), in the order of the planes.
    pub mean: [f32; 3],
    /// Divides each channel afterwards.
    pub std: [f32; 3],
}

/// Order of the colour planes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Channels {
    /// Red first.
    Rgb,
    /// Blue first.
    Bgr,
}

/// For each plane: which channel of an RGB pixel, what is subtracted, what multiplies.
pub(super) type Normalisation = [(usize, f32, f32); 3];

impl Input {
    pub(super) fn normalisation(&self) -> Normalisation {
        std::array::from_fn(|plane| {
            let channel = if self.channels == Channels::Rgb { plane } else { 2 - plane };
            (channel, self.mean[plane], 1.0 / self.std[plane])
        })
    }
}

/// One score column that is a vehicle.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClassColumn {
    /// Column, from 0.
    pub index: usize,
    /// Its class.
    pub name: VehicleClass,
}

/// Thresholds of score and overlap.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Thresholds {
    /// Least score, 0 to 1.
    pub score: f32,
    /// Boxes that overlap a better one by more than this (IoU) are dropped, 0 to 1.
    pub iou: f32,
    /// Boxes of which more than this part lies in a better one, or a better one in them, are
    /// dropped (intersection over the smaller), 0 to 1; 1, no box, where the sidecar has none.
    #[serde(default = "no_share")]
    pub ios: f32,
}

fn no_share() -> f32 {
    1.0
}

impl Sidecar {
    /// The input to take for cars of `car_px` (median side, px of the sidecar's own input): the
    /// smallest step that makes them large enough, else the largest. The middle step where their
    /// size is not known, the own input where there is no step.
    pub fn input_for(&self, car_px: Option<f32>) -> [usize; 2] {
        let own = [self.input.width_px, self.input.height_px];
        let step = match car_px {
            None => self.step.get(self.step.len() / 2),
            Some(car_px) => {
                let enough =
                    |step: &&Step| car_px * step.width_px as f32 / own[0] as f32 >= step.car_px;
                self.step.iter().find(enough).or(self.step.last())
            }
        };
        step.map_or(own, |step| [step.width_px, step.height_px])
    }

    /// The sidecar for `path`, its own path, and the model file's.
    pub(super) fn find(path: &Path) -> Result<(Self, PathBuf, PathBuf), SidecarError> {
        if path.extension().is_some_and(|extension| extension == "toml") {
            let sidecar = Self::read(path)?;
            let model = path.parent().unwrap_or(Path::new("")).join(&sidecar.file);
            return Ok((sidecar, path.to_owned(), model));
        }
        let beside = path.with_extension("toml");
        if beside.exists() {
            return Ok((Self::read(&beside)?, beside, path.to_owned()));
        }
        let read = |source| SidecarError::Read { path: path.to_owned(), source };
        let digest = <sha2::Sha256 as sha2::Digest>::digest(
            plain::read(path, super::MOST_MODEL).map_err(read)?,
        );
        let hash = crate::wire::hex(&digest.into());
        for (name, text) in KNOWN {
            let sidecar = Self::parse(text, Path::new(name))?;
            if sidecar.sha256.eq_ignore_ascii_case(hash.as_str()) {
                return Ok((sidecar, PathBuf::from(name), path.to_owned()));
            }
        }
        Err(SidecarError::Unknown { model: path.to_owned(), sidecar: beside })
    }

    /// Takes an input of `size`, columns and rows, in place of its own.
    pub(super) fn set_input(&mut self, size: [usize; 2], path: &Path) -> Result<(), SidecarError> {
        let [width, height] = size;
        if !NetInput::is_possible(size) {
            return Err(SidecarError::Value {
                path: path.to_owned(),
                key: "input",
                reason: format!(
                    "{width}x{height} px is asked for, each side must be a multiple of \
                     {INPUT_STEP_PX} up to {MAX_INPUT_PX}"
                ),
            });
        }
        (self.input.width_px, self.input.height_px) = (width, height);
        Ok(())
    }

    fn read(path: &Path) -> Result<Self, SidecarError> {
        let read = |source| SidecarError::Read { path: path.to_owned(), source };
        let text = plain::read_text(path, MOST_SIDECAR).map_err(read)?;
        Self::parse(&text, path)
    }

    fn parse(text: &str, path: &Path) -> Result<Self, SidecarError> {
        let parse = |fault: toml_file::Fault| SidecarError::Parse {
            path: path.to_owned(),
            reason: fault.to_string(),
        };
        let sidecar: Self = toml_file::parse(text, &[]).map_err(parse)?;
        sidecar.check().map_err(|(key, reason)| SidecarError::Value {
            path: path.to_owned(),
            key,
            reason,
        })?;
        Ok(sidecar)
    }

    fn check(&self) -> Result<(), (&'static str, String)> {
        let known = |ok: bool, key, reason: String| if ok { Ok(()) } else { Err((key, reason)) };
        let in_range = |value: f32| (0.0..=1.0).contains(&value);
        known(
            self.step.is_sorted_by_key(|step| step.width_px),
            "step",
            "their widths must rise".to_owned(),
        )?;
        if let Some(evidence) = &self.evidence {
            known(
                [evidence.floor, evidence.same, evidence.least].into_iter().all(in_range),
                "evidence",
                "floor, same and least must be 0 to 1".to_owned(),
            )?;
        }
        let (width, height) = (self.input.width_px, self.input.height_px);
        known(
            self.name.len() <= crate::lane::MAX_NAME,
            "name",
            format!("{} bytes, at most {}", self.name.len(), crate::lane::MAX_NAME),
        )?;
        known(
            (1..=MAX_INPUT_PX).contains(&width) && (1..=MAX_INPUT_PX).contains(&height),
            "input",
            format!("{width}x{height} px, each side must be 1 to {MAX_INPUT_PX}"),
        )?;
        known(
            self.input.mean.iter().all(|mean| mean.is_finite()),
            "input.mean",
            "all must be numbers".to_owned(),
        )?;
        known(
            self.input.std.iter().all(|std| std.is_normal()),
            "input.std",
            "all must be numbers and none 0".to_owned(),
        )?;
        if let Some(HeadKey { strides, bins, .. }) = &self.head {
            let strides = strides.as_deref().unwrap_or(&[8]);
            known(
                !strides.is_empty() && strides.iter().all(|&s| s > 0),
                "head.strides",
                "give at least one, all over 0".to_owned(),
            )?;
            let bins = bins.unwrap_or(8);
            known((2..=64).contains(&bins), "head.bins", format!("{bins}, 2 to 64 are possible"))?;
        }
        known(!self.class.is_empty(), "class", "none named, so nothing would be found".into())?;
        if let Some(HeadKey { classes: Some(classes), .. }) = &self.head {
            self.check_classes(*classes)?;
        }
        let finite = |test: &SelfTest| test.boxes.iter().flatten().all(|value| value.is_finite());
        known(
            self.self_test.as_ref().is_none_or(finite),
            "self_test.boxes",
            "all must be numbers".to_owned(),
        )?;
        let Thresholds { score, iou, ios } = self.thresholds;
        known(
            [score, iou, ios].into_iter().all(in_range),
            "thresholds",
            "score, iou and ios must be 0 to 1".to_owned(),
        )
    }
}

impl Sidecar {
    /// Whether all classes are among `classes` score columns.
    pub(super) fn check_classes(&self, classes: usize) -> Result<(), (&'static str, String)> {
        match self.class.iter().find(|column| column.index >= classes) {
            Some(column) => {
                let reason = format!(
                    "{}: the model has columns 0 to {}",
                    column.index,
                    classes.saturating_sub(1)
                );
                Err(("class.index", reason))
            }
            None => Ok(()),
        }
    }
}

#[cfg(test)]
#[path = "sidecar_tests.rs"]
mod tests;
