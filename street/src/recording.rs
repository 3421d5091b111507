//! A recording on disk: frames, truth, the true calibration, the lanes, and what made it.
//!
//! Owns the layout of the folder, which is whole or absent. Layout:
//!
//! ```text
//! OUT/frames/20260105T080000.000Z.jpg ...   one JPEG per frame, named by its UTC time
//! OUT/truth.jsonl                           one line per frame, see `truth.rs`
//! OUT/calibration.json                      the camera as installed, in verge's format
//! OUT/lanes.json                            measured lanes as labelme polygons
//! OUT/recording.json                        scene, seed, interval, program version
//! ```

use std::fs;
use std::path::Path;

use serde_json::{Value, json};
use verge_desk::{Failure, WholeFolder};

use crate::error::Result;
use crate::faults::{Picture, View};
use crate::measured::labelme;
use crate::render::{Image, Renderer};
use crate::scene::{Light, Scene};
use crate::simulation::{Moved, Simulation, Snapshot};
use crate::truth::{self, FrameTruth, VehicleTruth};

/// A frame's time in the truth, UTC.
const RFC_3339: &str = "%Y-%m-%dT%H:%M:%S%.3fZ";
/// A frame's time as the stem of its name, UTC.
const FILE_STEM: &str = "%Y%m%dT%H%M%S%.3fZ";

/// One frame of a recording in memory.
#[derive(Debug, Clone)]
pub struct Frame {
    /// The picture before JPEG.
    pub picture: Image,
    /// Its true content.
    pub truth: FrameTruth,
}

/// Makes a scene's frames one after the other, without disk.
pub struct Recorder {
    street: Simulation,
    renderer: Renderer,
    seed: u64,
    next: usize,
    last_seen: Vec<VehicleTruth>,
    moved: Vec<Moved>,
}

impl Recorder {
    /// A recorder at the first frame.
    ///
    /// # Errors
    /// [`crate::error::Error::LaneNotVisible`].
    pub fn new(scene: &Scene, seed: u64) -> Result<Self> {
        let street = Simulation::new(scene, seed)?;
        let renderer = Renderer::new(&street, seed);
        let (last_seen, moved) = (Vec::new(), Vec::new());
        Ok(Recorder { street, renderer, seed, next: 0, last_seen, moved })
    }

    /// The street as it is at the last frame.
    pub fn street(&self) -> &Simulation {
        &self.street
    }

    /// Changes light and weather from the next frame on: a day in steps.
    pub fn set_light(&mut self, light: Light) {
        self.street.set_light(light);
        self.renderer = Renderer::new(&self.street, self.seed);
    }

    /// The next frame's truth alone: for long runs that need no pictures.
    pub fn next_truth(&mut self) -> FrameTruth {
        let (snapshot, view) = self.advance();
        self.tell(&snapshot, &view)
    }

    /// The next frame.
    pub fn next_frame(&mut self) -> Frame {
        let (snapshot, view) = self.advance();
        let truth = self.tell(&snapshot, &view);
        let picture = self.renderer.render(&self.street, &snapshot, &view);
        Frame { picture, truth }
    }

    fn advance(&mut self) -> (Snapshot, View) {
        if self.next > 0 {
            self.street.step(self.street.scene().interval_s);
        }
        self.next += 1;
        self.moved = self.street.take_moved();
        let snapshot = self.street.snapshot();
        let view = View::at(self.street.scene(), self.seed, snapshot.time_s);
        (snapshot, view)
    }

    fn tell(&mut self, snapshot: &Snapshot, view: &View) -> FrameTruth {
        let vehicles = match view.picture {
            Picture::Live => {
                let seen = truth::vehicles(&self.street, snapshot, &view.camera());
                if self.street.scene().faults.frozen_from_s.is_some() {
                    self.last_seen.clone_from(&seen);
                }
                seen
            }
            Picture::Frozen => self.last_seen.clone(),
            Picture::Black => Vec::new(),
        };
        let time = self.street.scene().frame_time(self.next - 1);
        FrameTruth {
            frame: format!("{}.jpg", time.strftime(FILE_STEM)),
            time: time.strftime(RFC_3339).to_string(),
            picture: view.picture,
            vehicles,
            lanes: truth::lanes(self.street.measured(), snapshot, &self.moved),
        }
    }
}

/// The camera as installed, as a verge calibration file's content.
pub fn calibration(scene: &Scene) -> Value {
    let camera = scene.camera();
    let (rvec, tvec) = (camera.rvec(), camera.translation);
    json!({
        "format": "verge-calibration",
        "version": 1,
        "method": "truth",
        "camera_id": scene.name,
        "image_size": [camera.width, camera.height],
        "f": camera.focal_px,
        "principal_point": [f64::from(camera.width) / 2.0, f64::from(camera.height) / 2.0],
        "k1": camera.k1,
        "rvec": [rvec.x, rvec.y, rvec.z],
        "tvec": [tvec.x, tvec.y, tvec.z],
        "loss": 0.0,
        "rel_err": 0.0,
    })
}

/// Writes a recording of `frames` frames into a new or empty folder.
///
/// # Errors
/// [`crate::error::Error`]; on every one of them the folder is left as it was.
pub fn write(scene: &Scene, frames: usize, seed: u64, out: &Path) -> Result<()> {
    let mut recorder = Recorder::new(scene, seed)?;
    let folder = WholeFolder::beside(out)?;
    let path = |name: &str| folder.path().join(name);
    let frames_folder = path("frames");
    fs::create_dir(&frames_folder).map_err(|source| Failure::writing(&frames_folder, source))?;
    let mut lines = String::new();
    let mut first = None;
    for _ in 0..frames {
        let frame = recorder.next_frame();
        let name = frame.truth.frame.clone();
        let bytes = frame.picture.jpeg(scene.imaging.jpeg_quality, &name)?;
        save(&frames_folder.join(&name), &bytes)?;
        lines.push_str(&line(&frame.truth));
        first.get_or_insert(name);
    }
    save(&path("truth.jsonl"), lines.as_bytes())?;
    save_json(&path("calibration.json"), &calibration(scene))?;
    let picture = format!("frames/{}", first.unwrap_or_default());
    let lanes = labelme(scene, recorder.street().measured(), &picture);
    save_json(&path("lanes.json"), &lanes)?;
    let about = json!({
        "format": "street-recording",
        "version": 1,
        "program": concat!("street ", env!("CARGO_PKG_VERSION")),
        "scene": scene.name,
        "seed": seed,
        "frames": frames,
        "interval_s": scene.interval_s,
        "start": scene.frame_time(0).strftime(RFC_3339).to_string(),
    });
    save_json(&path("recording.json"), &about)?;
    Ok(folder.publish()?)
}

fn line(truth: &FrameTruth) -> String {
    let mut text = serde_json::to_string(truth).expect("truth has no maps with odd keys");
    text.push('\n');
    text
}

fn save(path: &Path, bytes: &[u8]) -> Result<()> {
    Ok(fs::write(path, bytes).map_err(|source| Failure::writing(path, source))?)
}

fn save_json(path: &Path, value: &Value) -> Result<()> {
    let mut text = serde_json::to_string_pretty(value).expect("plain JSON values");
    text.push('\n');
    save(path, text.as_bytes())
}
