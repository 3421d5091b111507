//! Settings of a line, and how it is built.
//!
//! Owns which input, regions and corrections follow from model, lane tables and the site's file.

use super::Line;
use crate::daemon::audit::{MadeWith, SiteFile};
use crate::daemon::config::{ConfigError, NetInput, Views};
use crate::daemon::detect::regions::{Cars, Parts};
use crate::daemon::detect::{Detector, LoadOptions};
use crate::daemon::exit::Failure;
use crate::daemon::locate::LocateError;
use crate::daemon::presets::{Following, Preset, Presets, TableSettings};
use crate::daemon::scene::Scene;
use crate::daemon::vehicles::{self, Vehicles};
use crate::density::Errors;
use std::path::{Path, PathBuf};

/// Whether pictures are judged before they are measured: blank, blurred, unchanged, and whether
/// the camera has moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Judging {
    /// Pictures are judged, and unfit ones are withheld.
    Heeded,
    /// Pictures are judged, and measured all the same: to time the line.
    Ignored,
    /// Pictures are not judged.
    Off,
}

impl From<bool> for Judging {
    fn from(is_on: bool) -> Self {
        if is_on { Self::Heeded } else { Self::Off }
    }
}

/// Settings of a line.
#[derive(Clone, Debug)]
pub struct LineSettings {
    /// The camera's lane tables.
    pub tables: TableSettings,
    /// Whether pictures are judged.
    pub judging: Judging,
    /// Sidecar or model.
    pub model: PathBuf,
    /// Overrides the model's least score; what a site was counted with stands above it.
    pub score: Option<f32>,
    /// Columns and rows of the net's input.
    pub input: NetInput,
    /// The site's own file: what an audit has found.
    pub audit: Option<PathBuf>,
    /// Searched parts of a picture.
    pub views: Views,
}

/// Median side of a car along the lanes, px of the net's input, below which hardly one is found.
const LEAST_CAR_PX: f32 = 8.0;

impl LineSettings {
    /// For a recording, of whichever camera.
    pub fn recorded(table: &Path, model: &Path) -> Self {
        Self {
            tables: TableSettings::of(table),
            judging: Judging::Heeded,
            model: model.to_owned(),
            score: None,
            input: NetInput::default(),
            audit: None,
            views: Views::default(),
        }
    }
}

/// Whether each preset, of these files, has a pose of its own.
fn distinct(presets: &Presets, files: &[PathBuf]) -> Result<(), LocateError> {
    let poses: Vec<_> = presets.iter().map(|preset| preset.table().calibration_sha256).collect();
    let same = |at: usize| poses[..at].iter().position(|pose| *pose == poses[at]);
    match (0..poses.len()).find_map(|at| Some((at, same(at)?))) {
        Some((at, before)) => {
            let [path, other] = [at, before].map(|n| files[n].clone());
            Err(LocateError::SamePose { path, other })
        }
        None => Ok(()),
    }
}

impl Line {
    /// Loads model and tables.
    ///
    /// # Errors
    /// [`Failure`] names the file that is missing or wrong.
    pub fn open(settings: &LineSettings) -> Result<Self, Failure> {
        let mut presets = Presets::load(&settings.tables)?;
        distinct(&presets, &settings.tables.files)?;
        let references = presets.references()?;
        let judging = settings.judging;
        let scene = (judging != Judging::Off).then(|| Scene::new(references));
        let cars = |preset: &Preset| Cars::along(preset.table(), |point| preset.place(point));
        let cars: Vec<Cars> = presets.iter().map(cars).collect();
        let model = Detector::described(&settings.model)?;
        let smallest_cars = |input: [usize; 2]| {
            let in_input = |(preset, cars): (&Preset, &Cars)| {
                let size = preset.table().image_size;
                let size = (usize::from(size.width), usize::from(size.height));
                cars.median_px.map(|px| px * vehicles::scale(input, size))
            };
            presets.iter().zip(&cars).filter_map(in_input).min_by(f32::total_cmp)
        };
        let input_px = match settings.input {
            NetInput::Px(size) => size,
            // Of several presets the one with the smallest cars decides.
            NetInput::Auto => {
                model.input_for(smallest_cars([model.input.width_px, model.input.height_px]))
            }
        };
        if let Some(px) = smallest_cars(input_px).filter(|px| *px < LEAST_CAR_PX) {
            let [width, height] = input_px;
            let reason = format!(
                "cars along the lanes have {px:.1} px in an input of {width}x{height}, and below \
                 {LEAST_CAR_PX} px hardly one is found"
            );
            if settings.input != NetInput::Auto {
                let reason = format!("{reason}: give auto, or a larger one");
                return Err(ConfigError::Camera { key: "model.input", reason }.into());
            }
            log::warn!("{reason}: density will be too low; end the lanes where cars are larger");
        }
        let options = LoadOptions {
            score: settings.score,
            input_px: Some(input_px),
            candidates: true,
            ..LoadOptions::default()
        };
        let detector = Detector::load_as(&settings.model, &options)?;
        let site = settings.audit.as_deref().map(|file| {
            let calibrations = |preset: &Preset| preset.table().calibration_sha256;
            let calibrations: Vec<_> = presets.iter().map(calibrations).collect();
            let camera = presets.active().table().camera_id.as_str();
            let (model, input_px) = (detector.model().sha256, detector.input_size());
            let views = settings.views;
            let calibrations = &calibrations;
            SiteFile::read(file, &MadeWith { camera, calibrations, model, input_px, views })
        });
        let site = site.transpose()?.map(|file| file.correction);
        // The site's factors hold for the score with which it was counted.
        let counted_with = site.as_ref().and_then(|site| site.score);
        if let (Some(counted), Some(asked)) = (counted_with, settings.score)
            && counted != asked
        {
            log::warn!("ignoring score {asked}: the audit was made with {counted}");
        }
        let least = counted_with.or(settings.score);
        let vehicles = Vehicles::new(model.evidence, least, input_px);
        let errors = Errors { counting: model.counting, site };
        let sizes: Vec<_> = cars.iter().map(|cars| cars.size).collect();
        presets.estimate_hidden(&sizes);
        let input = detector.input_size();
        let parts = |preset: &Preset| match settings.views {
            Views::Auto => Parts::new(preset.table(), |point| preset.place(point), input),
            Views::Whole => Parts::WHOLE,
        };
        let parts = presets.iter().map(parts).collect();
        let found = Vec::new();
        let following = Following::Off;
        let (file, is_input_set) = (settings.model.clone(), settings.input != NetInput::Auto);
        Ok(Self {
            file,
            options,
            is_input_set,
            detector,
            scene,
            judging,
            presets,
            parts,
            vehicles,
            sizes,
            errors,
            found,
            following,
        })
    }
}
