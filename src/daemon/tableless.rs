//! The line without a lane table, for `verge detect`: vehicles in pictures of one camera.
//!
//! Joins `detect` and `scene`. What a table would tell comes from the pictures themselves: a first
//! look at some of them gives the size of cars by place, the input of the net that it asks for, and
//! what the road looks like without vehicles.

use super::config::NetInput;
use super::detect::{Detector, LoadOptions, Sidecar};
use super::exit::Failure;
use super::frame::{Detection, Picture};
use super::scene::Scene;
use super::vehicles::{Sample, Vehicles};
use crate::evidence::CarSize;
use crate::units::UtcMs;
use std::path::{Path, PathBuf};

/// Time between two pictures for the empty road's memory: as far apart as it asks for at least.
const APART_MS: i64 = 60_000;

/// A detector that learns its camera.
pub struct Tableless {
    model: PathBuf,
    described: Sidecar,
    options: LoadOptions,
    input: NetInput,
    detector: Detector,
    sample: Sample,
    vehicles: Vehicles,
    size: Option<CarSize>,
    scene: Scene,
    pictures: i64,
    /// Columns and rows of the first picture, and whether the log names one of another size.
    shape: Option<(usize, usize)>,
    has_warned: bool,
}

impl Tableless {
    /// Loads a model, sidecar or file.
    ///
    /// # Errors
    /// [`Failure::Model`].
    pub fn open(model: &Path, score: Option<f32>, input: NetInput) -> Result<Self, Failure> {
        let described = Detector::described(model)?;
        let looks_first = described.evidence.is_some();
        let input_px = match input {
            // The first look sees cars that are small in the model's own input, too.
            _ if looks_first => Some(described.input_for(None)),
            NetInput::Px(size) => Some(size),
            NetInput::Auto => None,
        };
        let options = LoadOptions { score, input_px, candidates: true, ..LoadOptions::default() };
        let detector = Detector::load_as(model, &options)?;
        let input_px = if looks_first { detector.input_size() } else { [0; 2] };
        Ok(Self {
            model: model.to_owned(),
            vehicles: Vehicles::new(described.evidence, score, input_px),
            described,
            options,
            input,
            detector,
            sample: Sample::default(),
            size: None,
            scene: Scene::new(Vec::new()),
            pictures: 0,
            shape: None,
            has_warned: false,
        })
    }

    /// Whether pictures should be looked at before any is searched.
    pub fn looks_first(&self) -> bool {
        self.described.evidence.is_some()
    }

    /// Looks at a picture before the search.
    ///
    /// # Errors
    /// [`Failure::Detect`].
    pub fn look(&mut self, picture: &Picture, found: &mut Vec<Detection>) -> Result<(), Failure> {
        self.detector.detect(picture, found)?;
        self.sample.add((picture.width, picture.height), found);
        self.choose(picture, found);
        Ok(())
    }

    /// Ends the first look: takes the size of cars and the net's input from it.
    ///
    /// # Errors
    /// [`Failure::Model`].
    pub fn settle(&mut self) -> Result<(), Failure> {
        self.size = self.sample.size();
        if self.size.is_none() {
            log::warn!(
                "the size of cars is not used: too few are seen, or the frames are of several cameras"
            );
        }
        let input_px = match self.input {
            NetInput::Px(size) => size,
            NetInput::Auto => {
                let own = [self.described.input.width_px, self.described.input.height_px];
                self.described.input_for(self.sample.car_px(own))
            }
        };
        self.vehicles = Vehicles::new(self.described.evidence, self.options.score, input_px);
        let options = LoadOptions { input_px: Some(input_px), ..self.options };
        self.detector = Detector::load_as(&self.model, &options)?;
        Ok(())
    }

    /// Finds the vehicles of a picture.
    ///
    /// # Errors
    /// [`Failure::Detect`].
    pub fn detect(&mut self, picture: &Picture, found: &mut Vec<Detection>) -> Result<(), Failure> {
        let shape = (picture.width, picture.height);
        let first = *self.shape.get_or_insert(shape);
        if shape != first && !self.has_warned {
            self.has_warned = true;
            log::warn!(
                "a picture has {}x{} px, the first {}x{}: frames of one camera belong in a folder of \
                 their own",
                shape.0,
                shape.1,
                first.0,
                first.1
            );
        }
        self.detector.detect(picture, found)?;
        self.choose(picture, found);
        Ok(())
    }

    /// Leaves the vehicles in what was found, and learns the road.
    fn choose(&mut self, picture: &Picture, found: &mut Vec<Detection>) {
        self.scene.judge(picture, UtcMs(self.pictures * APART_MS));
        self.pictures += 1;
        let Self { scene, size, .. } = self;
        let picture = (picture.width, picture.height);
        self.vehicles.choose(found, picture, *size, |bounds| scene.likeness(bounds));
        scene.learn(0, found);
    }
}
