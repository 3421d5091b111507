//! The line without its ends: from a frame to density.
//!
//! Owns the order of look, detect, locate and aggregate, and names these stages so that they
//! need not know each other. Pictures come from `station`, windows go to [`super::outlet`].

use super::clock;
use super::config::Views;
use super::counting::{Counting, Presets};
use super::detect::regions::Parts;
use super::detect::{Detector, Share};
use super::exit::Failure;
use super::frame::{Detection, Frame};
use super::locate::Anchor;
use super::publish::Identity;
use super::scene::{Scene, View};
use crate::density::{Closed, SampleZoneStatus, Start};
use crate::health::Event;
use crate::lane::Description;
use crate::units::UtcMs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Share of the time between two pictures that the net may take of the processor: the rest is
/// for the camera, the picture, and what else runs on the box.
const NET_SHARE: f64 = 0.5;

/// What a line is built from.
#[derive(Clone, Debug)]
pub struct LineSettings {
    /// The lane table.
    pub table: PathBuf,
    /// The tables of the camera's other presets.
    pub presets: Vec<PathBuf>,
    /// Whether pictures are judged before they are measured: blank, blurred, unchanged, and
    /// whether the camera has moved.
    pub watch: bool,
    /// The camera that it must belong to; `None`: whichever it belongs to.
    pub camera: Option<String>,
    /// Sidecar or model.
    pub model: PathBuf,
    /// Overrides the model's least score.
    pub score: Option<f32>,
    /// Which parts of a picture are searched.
    pub views: Views,
    /// Which point of a box stands for the vehicle.
    pub anchor: Anchor,
    /// Window lengths.
    pub windows: Vec<Duration>,
    /// Share of its frames that a window needs.
    pub min_completeness: f32,
    /// What happens to a window that was begun in its middle.
    pub start: Start,
}

impl LineSettings {
    /// For a recording: every frame counts, whichever camera it is of.
    pub fn recorded(table: &Path, model: &Path, window: Duration) -> Self {
        Self {
            table: table.to_owned(),
            presets: Vec::new(),
            watch: true,
            camera: None,
            model: model.to_owned(),
            score: None,
            views: Views::default(),
            anchor: Anchor::default(),
            windows: vec![window],
            min_completeness: 0.0,
            start: Start::WithFirstFrame,
        }
    }
}

/// What the stages took for one frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct StageTimes {
    /// Reading and decoding the picture.
    pub capture: Duration,
    /// Judging the picture and finding the scene in it.
    pub scene: Duration,
    /// The picture into the net's input.
    pub prepare: Duration,
    /// The net.
    pub infer: Duration,
    /// The net's output into boxes.
    pub read: Duration,
    /// Boxes into lanes and windows.
    pub count: Duration,
}

/// What became of a frame.
#[derive(Clone, Debug)]
pub struct Measured {
    /// What it was: measured, unchanged, or not fit to be measured.
    pub event: Event,
    /// The windows that it closes.
    pub closed: Closed,
}

/// The line without its ends: from a frame to density.
#[derive(Debug)]
pub struct Line {
    detector: Detector,
    scene: Option<Scene>,
    presets: Presets,
    /// Where each preset's pictures are searched.
    parts: Vec<Parts>,
    found: Vec<Detection>,
}

impl Line {
    /// Loads model and tables.
    ///
    /// # Errors
    /// [`Failure`] names the file that is missing or wrong.
    pub fn open(settings: &LineSettings, interval: Duration) -> Result<Self, Failure> {
        let presets = Presets::open(settings, interval)?;
        let references = presets.references()?;
        let scene = settings.watch.then(|| Scene::new(references));
        let detector = Detector::load(&settings.model, settings.score)?;
        let input = detector.input_size();
        let parts = |preset: &Counting| match settings.views {
            Views::Auto => Parts::new(preset.table(), |point| preset.place(point), input),
            Views::Whole => Parts::WHOLE,
        };
        let parts = presets.iter().map(parts).collect();
        Ok(Self { detector, scene, presets, parts, found: Vec::new() })
    }

    /// Searches each picture once, and not its far part again, where the net is too slow for
    /// that with pictures in this interval. A box that falls behind its camera loses windows.
    ///
    /// # Errors
    /// [`Failure::Detect`] where the net does not run.
    pub fn keep_within(&mut self, interval: Duration) -> Result<(), Failure> {
        let Some(passes) = self.parts.iter().map(Parts::count).max().filter(|&count| count > 1)
        else {
            return Ok(());
        };
        // The first run brings the net's memory in.
        self.detector.infer()?;
        let begun = clock::processor_time();
        self.detector.infer()?;
        let took = clock::processor_time() - begun;
        if took.mul_f64(passes as f64) > interval.mul_f64(NET_SHARE) {
            log::warn!(
                "the net takes {took:.0?}: with pictures each {interval:?} their far part is not \
                 searched again (model.views)"
            );
            self.parts.iter_mut().for_each(Parts::keep_one);
        }
        Ok(())
    }

    /// Measures one frame.
    ///
    /// # Errors
    /// [`Failure::Detect`] and [`Failure::Locate`]; the frame then counts as missed.
    pub fn measure(&mut self, frame: &Frame) -> Result<Measured, Failure> {
        self.found.clear();
        let (preset, shift) = match self.look(frame)? {
            View::Fit { preset, shift } => (preset, shift),
            View::Unchanged => {
                let closed = self.miss(frame.time, SampleZoneStatus::InputDataIntegrity);
                return Ok(Measured { event: Event::Unchanged, closed });
            }
            View::PassedOver => {
                let closed = self.miss(frame.time, SampleZoneStatus::DetectionAutoSuspended);
                return Ok(Measured { event: Event::PassedOver, closed });
            }
            View::Withheld(alarm) => {
                let closed = self.miss(frame.time, alarm.status());
                return Ok(Measured { event: Event::Withheld(alarm), closed });
            }
        };
        let size = (frame.picture.width, frame.picture.height);
        self.detector.look_at(&self.parts[preset].of(size));
        self.detector.detect(&frame.picture, &mut self.found)?;
        let closed = self.presets.count(preset, &self.found, size, shift, frame.time)?;
        Ok(Measured { event: Event::Measured, closed })
    }

    /// Judges a frame. A wrong picture is refused before it costs anything.
    fn look(&mut self, frame: &Frame) -> Result<View, Failure> {
        self.presets.check_size((frame.picture.width, frame.picture.height))?;
        Ok(match &mut self.scene {
            Some(scene) => scene.judge(&frame.picture, frame.time),
            None => View::UNJUDGED,
        })
    }

    /// Measures one frame and tells what each stage took. A frame that would be withheld is
    /// measured all the same.
    ///
    /// # Errors
    /// As [`Self::measure`].
    pub fn measure_timed(&mut self, frame: &Frame) -> Result<StageTimes, Failure> {
        let picture = &frame.picture;
        let size = (picture.width, picture.height);
        let mut clock = Instant::now();
        let mut lap = || {
            let now = Instant::now();
            now - std::mem::replace(&mut clock, now)
        };
        let (preset, shift) = match self.look(frame)? {
            View::Fit { preset, shift } => (preset, shift),
            _ => View::NOWHERE,
        };
        let scene = lap();
        self.detector.look_at(&self.parts[preset].of(size));
        self.found.clear();
        let mut times = StageTimes { scene, ..StageTimes::default() };
        for pass in 0..self.detector.passes() {
            self.detector.prepare(picture, pass);
            times.prepare += lap();
            let output = self.detector.infer()?;
            times.infer += lap();
            self.detector.read(picture, pass, &output, &mut self.found)?;
            times.read += lap();
        }
        self.presets.count(preset, &self.found, size, shift, frame.time)?;
        Ok(StageTimes { count: lap(), ..times })
    }

    /// Notes that at `time` there was no usable frame, and why.
    pub fn miss(&mut self, time: UtcMs, status: SampleZoneStatus) -> Closed {
        self.presets.miss(time, status)
    }

    /// From now on pictures come in this interval.
    pub fn set_interval(&mut self, interval: Duration) {
        self.presets.set_interval(interval);
    }

    /// Closes the windows that have ended at `time`.
    pub fn advance(&mut self, time: UtcMs) -> Closed {
        self.presets.advance(time)
    }

    /// Notes that the clock was set, and closes the windows that it leaps over the end of. To
    /// be called after [`Self::advance`] to `from`.
    pub fn set_clock(&mut self, from: UtcMs, to: UtcMs) -> Closed {
        self.presets.set_clock(from, to)
    }

    /// Closes what runs, at the end of a recording.
    pub fn finish(&mut self) -> Closed {
        self.presets.finish()
    }

    /// The table to which the windows belong that the latest call closed.
    pub fn reported(&self) -> &Description {
        self.presets.reported()
    }

    /// What judges the pictures, unless that is switched off.
    pub fn scene(&self) -> Option<&Scene> {
        self.scene.as_ref()
    }

    /// What was found in the latest frame.
    pub fn found(&self) -> &[Detection] {
        &self.found
    }

    /// How many vehicles the latest frame shows, and how many of them in the lanes.
    pub fn latest(&self) -> (usize, usize) {
        (self.found.len(), self.presets.active().located())
    }

    /// Where the first preset's pictures are searched.
    pub fn parts(&self) -> &Parts {
        &self.parts[0]
    }

    /// What computes which part of the net, with its share of the time, in words.
    ///
    /// # Errors
    /// [`Failure::Detect`] where inference fails.
    pub fn describe_net(&mut self) -> Result<String, Failure> {
        let one = |share: &Share| format!("{:.0} % {}", share.of_time * 100.0, share.by);
        Ok(self.detector.shares(5)?.iter().map(one).collect::<Vec<_>>().join("; "))
    }

    /// Model and table in a few words.
    pub fn describe(&self) -> (String, String) {
        let (model, table) = (self.detector.sidecar(), self.counting().table());
        let (id, lanes) = (&table.camera_id, table.lanes.len());
        let error = table
            .length_rel_err
            .map_or("not stated".to_owned(), |error| format!("{:.1} %", error * 100.0));
        (
            format!(
                "{} at {}x{} px, over {}",
                model.name,
                model.input.width_px,
                model.input.height_px,
                self.parts()
            ),
            format!("{lanes} lanes of {id}, {}, length error {error}", table.image_size),
        )
    }

    /// The part behind detection, at the preset where the camera looks.
    pub fn counting(&self) -> &Counting {
        self.presets.active()
    }

    /// Who measures, for messages from `site`.
    pub fn identity(&self, site: &str) -> Identity {
        Identity::new(site, self.counting().table(), self.detector.model())
    }
}
