//! Matching of detections to vehicles: the greedy matching of pycocotools `COCOeval`.
//!
//! The rules, from `COCOeval.evaluateImg`: detections by falling score; each takes the free
//! vehicle with the largest overlap of at least the threshold; a counted vehicle goes before an
//! ignored one; a crowd box may be taken many times and overlaps by the detection's own area.

use crate::light::Light;

/// x0 y0 x1 y1, px.
pub type Bounds = [f64; 4];

/// A labelled vehicle.
#[derive(Clone, Copy, Debug)]
pub struct Labelled {
    /// Its box.
    pub bounds: Bounds,
    /// A group of vehicles, or one that must not count: found or not, it changes nothing.
    pub crowd: bool,
}

/// A detection.
#[derive(Clone, Copy, Debug)]
pub struct Found {
    /// Its box.
    pub bounds: Bounds,
    /// How sure, 0..1.
    pub score: f64,
}

/// One frame: its labels, its detections, its regions without labels.
#[derive(Clone, Debug)]
pub struct Frame {
    /// File name.
    pub name: String,
    /// Day or night.
    pub light: Light,
    /// Pixels, columns and rows.
    pub size_px: [u32; 2],
    /// Labels.
    pub truth: Vec<Labelled>,
    /// Detections in the order of the file.
    pub found: Vec<Found>,
    /// Regions without labels.
    pub ignored: Vec<Bounds>,
}

/// A range of box areas, square px, both ends included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Size {
    /// As COCO calls it.
    pub name: &'static str,
    /// Least area.
    pub least: f64,
    /// Largest area.
    pub most: f64,
}

impl Size {
    /// Every size.
    pub const ALL: Self = Self { name: "all", least: 0.0, most: 1e10 };

    fn has(&self, bounds: &Bounds) -> bool {
        (self.least..=self.most).contains(&area(bounds))
    }
}

/// COCO's sizes: 32 and 96 px squared.
pub const SIZES: [Size; 3] = [
    Size { name: "small", least: 0.0, most: 1024.0 },
    Size { name: "medium", least: 1024.0, most: 9216.0 },
    Size { name: "large", least: 9216.0, most: 1e10 },
];

/// The outcome of one detection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Outcome {
    pub score: f64,
    pub hit: bool,
}

fn area(b: &Bounds) -> f64 {
    (b[2] - b[0]) * (b[3] - b[1])
}

fn overlap(found: &Bounds, truth: &Labelled) -> f64 {
    let t = &truth.bounds;
    let width = found[2].min(t[2]) - found[0].max(t[0]);
    let height = found[3].min(t[3]) - found[1].max(t[1]);
    if width <= 0.0 || height <= 0.0 {
        return 0.0;
    }
    let inter = width * height;
    let whole = if truth.crowd { area(found) } else { area(found) + area(t) - inter };
    inter / whole
}

/// One frame under all thresholds; overlaps are computed once.
pub(super) struct Prepared {
    overlaps: Vec<Vec<f64>>,
    scores: Vec<f64>,
    ignored_truth: Vec<bool>,
    crowd: Vec<bool>,
    /// Detections that do not count unless they hit.
    outside: Vec<bool>,
    /// Vehicles that count.
    pub counted: usize,
}

impl Prepared {
    pub fn new(frame: &Frame, size: Size, max_detections: usize) -> Self {
        let mut truth: Vec<(bool, Labelled)> =
            frame.truth.iter().map(|t| (t.crowd || !size.has(&t.bounds), *t)).collect();
        truth.sort_by_key(|(ignored, _)| *ignored);
        let mut found = frame.found.clone();
        found.sort_by(|a, b| b.score.total_cmp(&a.score));
        found.truncate(max_detections);
        let within = |bounds: &Bounds| {
            let (x, y) = ((bounds[0] + bounds[2]) / 2.0, (bounds[1] + bounds[3]) / 2.0);
            frame.ignored.iter().any(|r| x >= r[0] && x < r[2] && y >= r[1] && y < r[3])
        };
        Self {
            overlaps: found
                .iter()
                .map(|f| truth.iter().map(|(_, t)| overlap(&f.bounds, t)).collect())
                .collect(),
            scores: found.iter().map(|f| f.score).collect(),
            ignored_truth: truth.iter().map(|(ignored, _)| *ignored).collect(),
            crowd: truth.iter().map(|(_, t)| t.crowd).collect(),
            outside: found.iter().map(|f| !size.has(&f.bounds) || within(&f.bounds)).collect(),
            counted: truth.iter().filter(|(ignored, _)| !ignored).count(),
        }
    }

    /// The detections that count, by falling score.
    pub fn outcomes(&self, threshold: f64) -> Vec<Outcome> {
        let mut taken = vec![false; self.crowd.len()];
        let mut outcomes = Vec::new();
        for (row, overlaps) in self.overlaps.iter().enumerate() {
            let mut best = None;
            let mut least = threshold.min(1.0 - 1e-10);
            for (column, &overlap) in overlaps.iter().enumerate() {
                if taken[column] && !self.crowd[column] {
                    continue;
                }
                let settled = best.is_some_and(|b: usize| !self.ignored_truth[b]);
                if settled && self.ignored_truth[column] {
                    break;
                }
                if overlap >= least {
                    least = overlap;
                    best = Some(column);
                }
            }
            let counts = match best {
                Some(column) => {
                    taken[column] = true;
                    !self.ignored_truth[column]
                }
                None => !self.outside[row],
            };
            if counts {
                outcomes.push(Outcome { score: self.scores[row], hit: best.is_some() });
            }
        }
        outcomes
    }
}
