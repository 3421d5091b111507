//! The line without its ends: from a frame to the vehicles in each lane.
//!
//! Owns the order of look, detect and locate, and names these stages so that they need not know
//! each other. Pictures come from `station`; what follows from what was counted is decided by
//! the core's [`crate::sensor`].

mod open;
mod pace;

pub use open::{Judging, LineSettings};

use super::clock;
use super::config::ConfigError;
use super::detect::regions::Parts;
use super::detect::{Detector, LoadOptions, Share};
use super::exit::Failure;
use super::frame::{Detection, Frame, PixelBox};
use super::overlay;
use super::presets::{Following, Preset, Presets, WindowSettings};
use super::road_file::Road;
use super::scene::{Scene, View};
use super::vehicles::Vehicles;
use crate::alarm::Alarm;
use crate::density::{Counting, Errors, FrameCounts};
use crate::evidence::CarSize;
use crate::picture::Light;
use crate::sensor::{self, Outcome};
use crate::units::{ImagePoint, LaneId};
use crate::wire::ModelRef;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// A stage of the line, or a step of one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Judging the picture and finding the scene in it.
    Scene,
    /// The picture into the net's input.
    Prepare,
    /// The net.
    Infer,
    /// The net's output into boxes.
    Read,
    /// Boxes into lanes.
    Count,
}

/// Is told of each stage when it has ended; the first began with the call.
pub type Observer<'o> = &'o mut dyn FnMut(Stage);

/// Result of the search of a picture.
enum Searched {
    /// Candidates, in a picture of this preset that is shifted by so much.
    Found { preset: usize, shift: ImagePoint },
    /// The picture is not measured.
    Nothing(Outcome<'static>),
}

/// The line without its ends: from a frame to the vehicles in each lane.
#[derive(Debug)]
pub struct Line {
    /// The model's file, and how it was loaded.
    file: PathBuf,
    options: LoadOptions,
    /// Whether the net's input is what someone asked for.
    is_input_set: bool,
    detector: Detector,
    scene: Option<Scene>,
    judging: Judging,
    presets: Presets,
    /// Where each preset's pictures are searched.
    parts: Vec<Parts>,
    vehicles: Vehicles,
    /// How large cars are in each preset's pictures.
    sizes: Vec<Option<CarSize>>,
    /// Errors of counting.
    errors: Errors,
    found: Vec<Detection>,
    following: Following,
}

impl Line {
    /// Windows over the lanes of its tables, for a camera with this time between frames.
    ///
    /// # Errors
    /// [`Failure::Aggregate`] where they cannot be kept or never filled.
    pub fn windows(
        &self,
        settings: &WindowSettings,
        interval: Duration,
    ) -> Result<Vec<sensor::Preset>, Failure> {
        self.presets.windows(settings, interval, &self.errors)
    }

    /// From now on vehicles of up to `top_kmh` are followed, where a picture each `interval`
    /// suffices. To be called before [`Self::windows`].
    pub fn follow(&mut self, top_kmh: f32, interval: Duration) {
        self.following = self.presets.follow(top_kmh, interval);
    }

    /// From now on the vehicles of these lanes are counted so far from their upstream ends, m, where
    /// they are followed. To be called after [`Self::follow`].
    ///
    /// # Errors
    /// [`ConfigError::Camera`] names the lane that no table has, that is given twice, or the place that
    /// is not on it.
    pub fn set_sections(
        &mut self,
        sections: impl IntoIterator<Item = (LaneId, f32)>,
    ) -> Result<(), ConfigError> {
        let wrong = |reason| ConfigError::Camera { key: "traffic.section_m", reason };
        let mut given = BTreeSet::new();
        for (lane, section_m) in sections {
            if !given.insert(lane) {
                return Err(wrong(format!("lane {} has two sections; give it one", lane.get())));
            }
            self.presets.set_section(lane, section_m).map_err(wrong)?;
        }
        Ok(())
    }

    /// The rate each lane needs to follow vehicles of up to `top_kmh`, in words.
    pub fn needs(&self, top_kmh: f32) -> String {
        self.presets.needs(top_kmh)
    }

    /// Whether vehicles are followed.
    pub const fn following(&self) -> Following {
        self.following
    }

    /// Measures one frame.
    ///
    /// # Errors
    /// [`Failure::Detect`] and [`Failure::Locate`]; the frame then counts as missed.
    pub fn measure(
        &mut self,
        frame: &Frame,
        observe: Observer<'_>,
    ) -> Result<Outcome<'_>, Failure> {
        let size = (frame.picture.width, frame.picture.height);
        let (preset, shift) = match self.search(frame, observe)? {
            Searched::Found { preset, shift } => (preset, shift),
            Searched::Nothing(outcome) => return Ok(outcome),
        };
        let light = self.choose(preset, size);
        let when = (frame.time, size);
        let (counts, moves) = self.presets.count(preset, &self.found, when, shift, light)?;
        observe(Stage::Count);
        Ok(Outcome::Measured { preset, counts, moves })
    }

    /// Measures one frame as [`Self::measure`] does, and counts it with each of these scores first;
    /// for a line that does not follow vehicles. Empty where the picture is not fit to be measured.
    ///
    /// # Errors
    /// As of [`Self::measure`].
    pub fn count_with(
        &mut self,
        frame: &Frame,
        scores: &[f32],
    ) -> Result<Vec<FrameCounts>, Failure> {
        let size = (frame.picture.width, frame.picture.height);
        let Searched::Found { preset, shift } = self.search(frame, &mut |_| ())? else {
            return Ok(Vec::new());
        };
        let candidates = self.found.clone();
        let own = self.vehicles;
        let mut counts = Vec::with_capacity(scores.len());
        for &score in scores {
            self.found.clone_from(&candidates);
            let light = self.choose_by(&own.with_least(score), preset, size);
            let when = (frame.time, size);
            let (counted, _) = self.presets.count(preset, &self.found, when, shift, light)?;
            counts.push(counted.clone());
        }
        self.found = candidates;
        self.choose(preset, size);
        Ok(counts)
    }

    /// Looks where the camera looks in this frame, for [`Self::scene`] to tell; the net does not run.
    /// Returns what keeps the picture from being judged, or nothing.
    ///
    /// # Errors
    /// [`Failure::Locate`] for a picture of another shape.
    pub fn aim(&mut self, frame: &Frame) -> Result<&'static str, Failure> {
        self.presets.check_size((frame.picture.width, frame.picture.height))?;
        let view = self.scene.as_mut().map(|scene| scene.judge(&frame.picture, frame.time));
        Ok(match view {
            Some(View::Withheld(alarm)) if alarm != Alarm::CameraMoved => alarm.name(),
            _ => "",
        })
    }

    /// Fills `found` with what the net finds, where the picture is fit to be measured.
    fn search(&mut self, frame: &Frame, observe: Observer<'_>) -> Result<Searched, Failure> {
        let (picture, size) = (&frame.picture, (frame.picture.width, frame.picture.height));
        self.found.clear();
        // A wrong picture is refused before it costs anything.
        self.presets.check_size(size)?;
        let view = match &mut self.scene {
            Some(scene) => scene.judge(picture, frame.time),
            None => View::UNJUDGED,
        };
        observe(Stage::Scene);
        let (preset, shift) = match view {
            View::Fit { preset, shift } => (preset, shift),
            _ if self.judging == Judging::Ignored => View::NOWHERE,
            View::Unchanged => return Ok(Searched::Nothing(Outcome::Unchanged)),
            View::PassedOver => return Ok(Searched::Nothing(Outcome::PassedOver)),
            View::Withheld(alarm) => return Ok(Searched::Nothing(Outcome::Withheld(alarm))),
        };
        if let Some(scene) = &mut self.scene {
            scene.recall(preset);
        }
        self.detector.look_at(&self.parts[preset].of(size));
        for pass in 0..self.detector.passes() {
            self.detector.prepare(picture, pass);
            observe(Stage::Prepare);
            let output = self.detector.infer()?;
            observe(Stage::Infer);
            self.detector.read(picture, pass, &output, &mut self.found)?;
            observe(Stage::Read);
        }
        Ok(Searched::Found { preset, shift })
    }

    /// Keeps the vehicles among the candidates, and shows the scene the road where none stands.
    /// Returns the light.
    fn choose(&mut self, preset: usize, size: (usize, usize)) -> Light {
        let vehicles = self.vehicles;
        let light = self.choose_by(&vehicles, preset, size);
        if let Some(scene) = &mut self.scene {
            scene.learn(preset, &self.found);
        }
        light
    }

    /// Keeps the candidates that `vehicles` takes for vehicles. Returns the light.
    fn choose_by(&mut self, vehicles: &Vehicles, preset: usize, size: (usize, usize)) -> Light {
        let (scene, car) = (&self.scene, self.sizes[preset]);
        let likeness =
            |bounds: &PixelBox| scene.as_ref().map_or(0.0, |scene| scene.likeness(bounds));
        vehicles.choose(&mut self.found, size, car, likeness);
        scene.as_ref().map_or(Light::Day, Scene::light)
    }

    /// Takes up the empty road that an earlier run has left in `file`; says why where it cannot.
    pub fn recall_road(&mut self, file: &Path) {
        let Some(scene) = &mut self.scene else { return };
        let camera = self.presets.active().table().camera_id.as_str();
        let tables: Vec<_> = self.presets.iter().map(Preset::sha256).collect();
        match Road::read(file, camera, &tables, clock::now()) {
            Ok(Some(road)) => {
                let preset = tables.iter().position(|table| *table == road.table);
                scene.remember(preset.unwrap_or_default(), road);
            }
            Ok(None) => {}
            Err(error) => {
                log::info!("{}: {error}; the empty road is learned again", file.display());
            }
        }
    }

    /// The camera's name and its empty road, as far as it is known; `None` where it is not.
    pub fn road(&self) -> Option<(String, Road)> {
        let (preset, road, now) = self.scene.as_ref()?.road()?;
        let preset = self.presets.iter().nth(preset)?;
        let camera = preset.table().camera_id.as_str().to_owned();
        Some((camera, Road::of(preset.sha256(), road, now)))
    }

    /// The judge of the pictures, unless it is switched off.
    pub fn scene(&self) -> Option<&Scene> {
        self.scene.as_ref()
    }

    /// Detections in the latest frame.
    pub fn found(&self) -> &[Detection] {
        &self.found
    }

    /// A frame, the latest one, with lanes, boxes, contact points and counts, as a PNG; `note`
    /// stands in its last line.
    ///
    /// # Errors
    /// [`Failure::Internal`] where it cannot be encoded.
    pub fn overlay(&self, frame: &Frame, note: &str) -> Result<Vec<u8>, Failure> {
        let drawn = overlay::png(frame, self.presets.active(), &self.found, note);
        drawn.map_err(|error| Failure::Internal(format!("the overlay: {error}")))
    }

    /// How many vehicles the latest frame shows, and how many of them in the lanes.
    pub fn latest(&self) -> (usize, usize) {
        (self.found.len(), self.presets.active().located())
    }

    /// Where the first preset's pictures are searched.
    pub fn parts(&self) -> &Parts {
        &self.parts[0]
    }

    /// The parts that compute the net, with their shares of the time, in words.
    ///
    /// # Errors
    /// [`Failure::Detect`] where inference fails.
    pub fn describe_net(&mut self) -> Result<String, Failure> {
        let one = |share: &Share| format!("{:.0} % {}", share.of_time * 100.0, share.by);
        Ok(self.detector.shares(5)?.iter().map(one).collect::<Vec<_>>().join("; "))
    }

    /// Model and table in a few words.
    pub fn describe(&self) -> (String, String) {
        let (model, table) = (self.detector.sidecar(), self.preset().table());
        let (id, lanes) = (&table.camera_id, table.lanes.len());
        let error = table
            .length_rel_err
            .map_or("not stated".to_owned(), |error| format!("{:.1} %", error * 100.0));
        (
            format!(
                "{} ({}) at {}x{} px, over {}",
                model.name,
                self.file.display(),
                model.input.width_px,
                model.input.height_px,
                self.parts()
            ),
            format!(
                "{lanes} lanes of {id} ({}), {}, length error {error}",
                self.preset().file().display(),
                table.image_size
            ),
        )
    }

    /// The lane table of the preset at which the camera looks.
    pub fn preset(&self) -> &Preset {
        self.presets.active()
    }

    /// The least score that counts.
    pub fn least_score(&self) -> f32 {
        self.vehicles.least()
    }

    /// How counts of cameras differ that were not audited; `None` where the model does not say.
    pub fn counting(&self) -> Option<Counting> {
        self.errors.counting
    }

    /// Columns and rows of the net's input.
    pub fn input_size(&self) -> [usize; 2] {
        self.detector.input_size()
    }

    /// The model, for messages.
    pub fn model(&self) -> &ModelRef {
        self.detector.model()
    }
}
