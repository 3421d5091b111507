//! What the road fit may use: each cue with its own stated uncertainty.
//!
//! Owns the cues' types and their defaults. Does not own reading them from files nor their
//! residuals (see `marks`, `lanes`, `traffic`).

use super::view::{CAMERA, CREST, DISTORTION, Unknowns};
use nalgebra::{SMatrix, Vector2};
use verge::units::Direction;

/// How well a person reads a point of the picture, px (standard deviation of a coordinate).
pub const READING_PX: f64 = 1.0;
/// How well a length measured on the road is known, as a part of it.
pub const MEASURED_REL_SD: f64 = 0.01;
/// How well single points of a drawn lane line are placed, px.
pub const TRACE_PX: f64 = 0.5;
/// How far a drawn lane line as a whole lies beside the true one, px: the same on both sides
/// of a point, so that more points do not average it out.
pub const TRACE_SHARED_PX: f64 = 0.5;
/// Mean width of the lanes of a road where nobody states it, m, and its standard deviation.
pub const LANE_WIDTH_M: [f64; 2] = [3.4, 0.25];
/// Standard deviation of a stated width of the lanes, m: paint and hand.
pub const STATED_WIDTH_SD_M: f64 = 0.06;
/// Standard deviation of a lane's width against the mean of its road, m.
pub const LANE_EACH_M: f64 = 0.10;

/// Standard deviation of a lens' distortion, as a part at half the picture's width.
pub const DISTORTION_SD: f64 = 0.025;
/// Standard deviation of the curvature of a road's profile, 1/m.
pub const CREST_SD: f64 = 1.0 / 8000.0;

/// Everything that a fit is given. All of it is optional.
#[derive(Clone, Debug, Default)]
pub struct Cues {
    /// Lengths on the road.
    pub marks: Vec<MarkCue>,
    /// Lanes, each drawn as its two lines.
    pub lanes: Vec<LaneCue>,
    /// Right angles on the road.
    pub rectangles: Vec<RectangleCue>,
    /// Width of the lanes where it is known, m.
    pub lane_width_m: Option<f64>,
    /// Height of the camera above the road where it is known, m.
    pub height_m: Option<f64>,
    /// Vehicles that a detector found, over many pictures.
    pub boxes: Vec<BoxCue>,
    /// What labelled vehicles say of the camera.
    pub labelled: Option<Labelled>,
}

/// A polyline on the road whose segments have known lengths.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkCue {
    /// What it is called in messages.
    pub name: String,
    /// Points, px; one segment between each two.
    pub points: Vec<Vector2<f64>>,
    /// Length of each segment, m.
    pub segment_m: f64,
    /// How well that is known, as a part of it, the same for all segments: a standard's
    /// tolerance, a tape's error.
    pub rel_sd: f64,
    /// How well the points are read, px.
    pub px_sd: f64,
    /// The national standard that gives the length, by name.
    pub standard: Option<String>,
}

impl MarkCue {
    /// A mark read by hand and measured on the road.
    pub fn measured(name: impl Into<String>, points: Vec<Vector2<f64>>, segment_m: f64) -> Self {
        let name = name.into();
        let (rel_sd, px_sd) = (MEASURED_REL_SD, READING_PX);
        MarkCue { name, points, segment_m, rel_sd, px_sd, standard: None }
    }
}

/// A rectangle on the road: a parking bay, a stop line's box, the ends of two dashes beside each
/// other.
#[derive(Clone, Debug, PartialEq)]
pub struct RectangleCue {
    /// What it is called in messages.
    pub name: String,
    /// Its corners in order, px.
    pub corners: [Vector2<f64>; 4],
    /// Length of its first side (from the first corner to the second) and of its second, m, where
    /// they are measured.
    pub sides_m: Option<[f64; 2]>,
}

/// A lane as its two lines, each from near to far.
#[derive(Clone, Debug, PartialEq)]
pub struct LaneCue {
    /// What it is called in messages.
    pub name: String,
    /// One side, px.
    pub right: Vec<Vector2<f64>>,
    /// The other side, px.
    pub left: Vec<Vector2<f64>>,
    /// Which way its traffic moves.
    pub direction: Direction,
    /// Whether its width is constant. Tapers and merges hold vehicles, but are not a cue.
    pub steady: bool,
}

/// A vehicle's box in one picture.
#[derive(Clone, Debug, PartialEq)]
pub struct BoxCue {
    /// Which picture: boxes of one picture may hide each other.
    pub frame: usize,
    /// Left, top, right, bottom, px.
    pub corners: [f64; 4],
    /// What the detector takes it for.
    pub class: Option<Class>,
}

/// What a detector takes a vehicle for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// A passenger car.
    Car,
    /// A van.
    Van,
    /// A bus.
    Bus,
    /// A lorry.
    Truck,
    /// A motorcycle.
    Motorcycle,
}

impl Class {
    /// The class of this name, as `verge` writes it.
    pub fn of_name(name: &str) -> Option<Self> {
        Some(match name {
            "car" => Class::Car,
            "van" => Class::Van,
            "bus" => Class::Bus,
            "truck" | "lorry" => Class::Truck,
            "motorcycle" => Class::Motorcycle,
            _ => return None,
        })
    }
}

/// What the joint method found from labelled vehicles, priors included: it takes the place
/// of the prior.
#[derive(Clone, Copy, Debug)]
pub struct Labelled {
    /// The camera.
    pub mean: Unknowns,
    /// Covariance of its unknowns.
    pub covariance: SMatrix<f64, CAMERA, CAMERA>,
}

impl Labelled {
    /// A camera over a road that is taken to be level, with the covariance of its unknowns: log f,
    /// tilt (rad), roll (rad), log height (m) and `k1` (see [`Lens::k1`]). The road fit's own priors
    /// stay for the crest and for the distortion, which labelled vehicles hardly show.
    ///
    /// [`Lens::k1`]: crate::camera::Lens::k1
    pub fn on_level_road(
        [log_f, tilt, roll, log_height, k1]: [f64; 5],
        image_size: [u32; 2],
        covariance: &SMatrix<f64, CAMERA, CAMERA>,
    ) -> Self {
        let half_widths = 0.5 * f64::from(image_size[0]) / log_f.exp();
        let distortion = k1 * half_widths * half_widths;
        let mean = Unknowns::from([log_f, tilt, roll, log_height, distortion, 0.0]);
        let mut own = *covariance;
        for k in [DISTORTION, CREST] {
            own.row_mut(k).fill(0.0);
            own.column_mut(k).fill(0.0);
        }
        own[(DISTORTION, DISTORTION)] = DISTORTION_SD.powi(2);
        own[(CREST, CREST)] = CREST_SD.powi(2);
        Labelled { mean, covariance: own }
    }
}

impl Cues {
    /// Every point that must lie on the road, px.
    pub fn points(&self) -> impl Iterator<Item = Vector2<f64>> + '_ {
        let marks = self.marks.iter().flat_map(|m| &m.points);
        let lanes = self.lanes.iter().flat_map(|l| l.right.iter().chain(&l.left));
        let corners = self.rectangles.iter().flat_map(|r| &r.corners);
        marks.chain(lanes).chain(corners).copied()
    }
}
