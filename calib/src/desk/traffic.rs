//! Vehicles of the pictures, found by the program `verge`, in the drawn lanes.
//!
//! Owns running `verge detect` beside this program, its boxes, and counting them by lane with
//! the very table that the sensor would use. Does not own a detector, nor which boxes still are
//! of these pictures (see `searched`).

mod searched;

use super::backdrop::{Backdrop, name_of, spread};
use super::drawing::Drawing;
use super::look;
use super::program::{Detector, Progress, Task};
use super::site::Site;
use crate::error::{Error, Result};
use crate::files::calibration::Sha256;
use crate::road::cue_files;
use crate::road::fit::{BoxCue, Class};
use crate::road::lane_table::table;
use searched::{Note, Searched, pictures_of};
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::process::Command;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use verge::lane::{DEFAULT_CELL_LENGTH_M, LaneTable};
use verge::units::ImagePoint;

/// The file of boxes in the site's folder.
pub const DETECTIONS: &str = "detections.jsonl";
/// Least score of a box that counts, as the sensor's own default.
const COUNTS: f64 = 0.5;
/// A box that ends so near to the picture's lower edge, px, is cut off by it, as in the sensor.
const EDGE_PX: f64 = 0.5;
/// Most pictures that are counted, spread over all: each is brought over the backdrop first.
const MOST_COUNTED: usize = 200;

/// The boxes of one picture.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FrameBoxes {
    /// The picture's name.
    pub frame: String,
    /// x0, y0, x1, y1 in px, score, class.
    pub boxes: Vec<(f64, f64, f64, f64, f64, String)>,
}

impl FrameBoxes {
    /// The file's name of the picture.
    fn name(&self) -> String {
        name_of(Path::new(&self.frame))
    }
}

/// The search of this desk.
#[derive(Debug)]
pub struct Traffic {
    detector: Option<Detector>,
    task: Task<Searched>,
    /// The boxes of the search before: they hold until the next has found others.
    last: Mutex<Option<Arc<Searched>>>,
    /// Of the boxes that were at hand at the start.
    note: Mutex<Note>,
}

/// How far the search is, for the page.
#[derive(Debug, Serialize)]
pub struct TrafficState {
    /// Whether there is a detector.
    pub detector: bool,
    /// `idle`, `running`, `done` or `failed`.
    pub state: &'static str,
    /// Time since it began, s.
    pub running_s: f64,
    /// Pictures that are searched so far.
    pub searched: usize,
    /// Why it failed, or what is wrong with boxes of an earlier search.
    pub problem: Option<String>,
    /// Pictures whose boxes were dropped at the start: they are gone or others now.
    pub stale: usize,
    /// Pictures that were searched, once all are.
    pub frames: usize,
    /// Boxes that were found.
    pub boxes: usize,
}

impl Traffic {
    /// A search by that detector. Boxes of a `given` file are taken, else those of an earlier search
    /// of these very pictures; the state's `problem` tells which were not.
    ///
    /// # Errors
    /// Where the given file cannot be read.
    pub fn new(detector: Option<Detector>, site: &Site, given: Option<&Path>) -> Result<Self> {
        let (searched, note) = match given {
            Some(path) => Searched::given(path, site)?,
            None => Searched::saved(site),
        };
        let progress = match searched.frames.is_empty() {
            true => Progress::Idle,
            false => Progress::Done(Arc::new(searched)),
        };
        let (task, last) = (Task::new(progress), Mutex::default());
        Ok(Traffic { detector, task, last, note: Mutex::new(note) })
    }

    fn note(&self) -> MutexGuard<'_, Note> {
        self.note.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The boxes, once there are some.
    fn found(&self) -> Option<Arc<Searched>> {
        match self.task.now() {
            Progress::Done(searched) => Some(searched),
            _ => self.last.lock().unwrap_or_else(PoisonError::into_inner).clone(),
        }
    }

    /// The boxes as a cue of the road fit, where the backdrop is.
    pub fn cue(&self) -> Vec<BoxCue> {
        let Some(found) = self.found() else { return Vec::new() };
        let of = |(frame, all): (usize, &FrameBoxes)| -> Vec<BoxCue> {
            let strong = all.boxes.iter().filter(|b| b.4 >= cue_files::MIN_SCORE);
            strong
                .map(|b| BoxCue {
                    frame,
                    corners: [b.0, b.1, b.2, b.3],
                    class: Class::of_name(&b.5),
                })
                .collect()
        };
        found.frames.iter().enumerate().flat_map(of).collect()
    }

    /// For the page.
    pub fn state(&self) -> TrafficState {
        let now = self.task.now();
        let (searched, frames, boxes) = match &now {
            Progress::Running { lines, .. } => (lines.len(), 0, 0),
            Progress::Done(searched) => {
                let frames = &searched.frames;
                (frames.len(), frames.len(), frames.iter().map(|f| f.boxes.len()).sum())
            }
            _ => (0, 0, 0),
        };
        let note = self.note();
        TrafficState {
            detector: self.detector.is_some(),
            state: now.name(),
            running_s: now.running_s(),
            searched,
            problem: now.problem().or_else(|| note.said.clone()),
            stale: note.stale,
            frames,
            boxes,
        }
    }

    /// Begins the search, also once more; one at a time.
    ///
    /// # Errors
    /// Where there is no detector, or its program cannot be started.
    pub fn start(&self, site: &Site) -> Result<()> {
        let detector = self.detector.as_ref().ok_or_else(|| {
            Error::Usage(
                "there is no detector: start `mvcalib desk` with --model, and with the program \
                 `verge` beside it"
                    .into(),
            )
        })?;
        let out = site.file(DETECTIONS);
        verge_desk::make_parent(&out)?;
        let mut command = Command::new(&detector.program);
        command.args(["detect", "--names", "--frames"]).arg(&site.frames);
        command.arg("--detections").arg(&out).arg("--model").arg(&detector.model);
        let (pictures, of, found) = (pictures_of(site), site.clone(), self.found());
        self.task.start(command, "", move |_| Searched::bound(&of, pictures))?;
        *self.last.lock().unwrap_or_else(PoisonError::into_inner) = found;
        *self.note() = Note::default();
        Ok(())
    }
}

/// A box in its lane.
#[derive(Debug, PartialEq, Serialize)]
pub struct Counted {
    /// x0, y0, x1, y1 in px of the frame.
    pub corners: [f64; 4],
    /// Score of the detector.
    pub score: f64,
    /// Class.
    pub class: String,
    /// Number of its lane; `None` beside all lanes, and where it does not count.
    pub lane: Option<u8>,
    /// Distance along its lane, m.
    pub s_m: Option<f64>,
}

/// The boxes of one picture in the lanes.
#[derive(Debug, Serialize)]
pub struct CountedFrame {
    /// The picture's name.
    pub frame: String,
    /// Its boxes.
    pub boxes: Vec<Counted>,
}

/// A lane's mean.
#[derive(Debug, Serialize)]
pub struct LaneMean {
    /// Number of the lane.
    pub lane: u8,
    /// Its length, m.
    pub length_m: f64,
    /// Mean vehicles in a picture.
    pub vehicles: f64,
}

/// Everything counted.
#[derive(Debug, Serialize)]
pub struct Counts {
    /// Picture by picture.
    pub frames: Vec<CountedFrame>,
    /// Lane by lane.
    pub lanes: Vec<LaneMean>,
}

/// Counts the boxes of every picture in the lanes of a drawing. Pictures that are gone, others now,
/// or left out of the backdrop do not count.
///
/// # Errors
/// What is wrong with the drawing's camera or lanes, or that no picture is left.
pub fn count(
    drawing: &Drawing,
    traffic: &Traffic,
    backdrop: &Backdrop,
    site: &Site,
) -> Result<Counts> {
    let found =
        traffic.found().ok_or_else(|| Error::Usage("no picture was searched yet".into()))?;
    let calibration = look::calibration(drawing, &traffic.cue())?;
    let lanes = look::lanes(drawing, &calibration)?;
    let sha256 = Sha256::of(calibration.to_json().as_bytes());
    let bytes = table(&calibration, &lanes, sha256, "desk", None, DEFAULT_CELL_LENGTH_M)?;
    let table = LaneTable::parse(&bytes[..])
        .map_err(|e| Error::Solver { method: "lane table", detail: e.to_string() })?;
    let height = f64::from(drawing.image_size[1]);
    let mut totals = vec![0.0; 256];
    let mut counted = Vec::new();
    for frame in spread(&found.frames, MOST_COUNTED) {
        let name = frame.name();
        let is_out = backdrop.left_out.iter().any(|(out, _)| *out == name);
        let picture = site.picture(&name).filter(|path| !is_out && found.holds(&name, path));
        let Some(shift) = picture.and_then(|path| backdrop.shift(&path).ok()) else { continue };
        let [du, dv] = if shift.sure { shift.by } else { [0.0; 2] };
        let place = |b: &(f64, f64, f64, f64, f64, String)| {
            if b.4 < COUNTS || b.3 >= height - EDGE_PX {
                return None;
            }
            let (u, v) = (0.5 * (b.0 + b.2) - du, b.3 - dv);
            table.place(ImagePoint { u: u as f32, v: v as f32 })
        };
        let boxes: Vec<Counted> = frame
            .boxes
            .iter()
            .map(|b| {
                let place = place(b);
                Counted {
                    corners: [b.0, b.1, b.2, b.3],
                    score: b.4,
                    class: b.5.clone(),
                    lane: place.map(|p| p.lane.get()),
                    s_m: place.map(|p| f64::from(p.s_m)),
                }
            })
            .collect();
        for lane in boxes.iter().filter_map(|b| b.lane) {
            totals[usize::from(lane)] += 1.0;
        }
        counted.push(CountedFrame { frame: name, boxes });
    }
    if counted.is_empty() && !found.frames.is_empty() {
        return Err(Error::Usage(
            "the pictures that were searched are gone or others now: find the vehicles again"
                .into(),
        ));
    }
    let n = (counted.len() as f64).max(1.0);
    let mean = |lane: &crate::road::drawn_lane::DrawnLane| LaneMean {
        lane: lane.id.get(),
        length_m: lane.axis.length_m(),
        vehicles: totals[usize::from(lane.id.get())] / n,
    };
    Ok(Counts { frames: counted, lanes: lanes.iter().map(mean).collect() })
}
