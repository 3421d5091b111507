//! What the page shows of a drawing that was measured.
//!
//! Owns the answer's values and their names (`page/types.js` has the same). Does not own how they
//! are measured (see `look`).

use super::drawing::Px;
use serde::Serialize;

/// Everything that the page shows of a drawing.
#[derive(Debug, Default, Serialize)]
pub struct Look {
    /// The camera, once the cues give one.
    pub camera: Option<CameraLook>,
    /// Why there is none, or what is wrong with what is drawn.
    pub problem: Option<String>,
    /// Each length in the order of the drawing.
    pub lengths: Vec<Option<LengthLook>>,
    /// Each rectangle in the order of the drawing.
    pub rectangles: Vec<RectangleLook>,
    /// The lanes between neighbouring lines.
    pub strips: Vec<StripLook>,
    /// Each vehicle in the order of the drawing.
    pub vehicles: Vec<VehicleLook>,
    /// Dots a metre apart: u, v in px, and the standard error of 6 m along the road there.
    pub dots: Vec<[f64; 3]>,
    /// Each lane in the order of the drawing.
    pub lanes: Vec<LaneLook>,
    /// Why the lanes as a whole cannot be used.
    pub lanes_problem: Option<String>,
    /// Time that the fit took, ms.
    pub fit_ms: f64,
}

/// The camera.
#[derive(Debug, Serialize)]
pub struct CameraLook {
    /// Focal length, px.
    pub f_px: f64,
    /// Height above the road, m.
    pub height_m: f64,
    /// Tilt below the horizontal, degrees.
    pub tilt_deg: f64,
    /// `ok`, or why it cannot be used.
    pub trust: String,
    /// Standard errors near, in the middle and far.
    pub errors: [ErrorLook; 3],
    /// The largest that is trusted.
    pub limits: Limits,
    /// Standard error of the whole stretch, as a part of it.
    pub whole: f64,
    /// How much longer cars are here than in most fleets, as a part, where traffic is a cue.
    pub traffic: Option<TrafficLook>,
}

/// The largest errors that are trusted, at the far end and across the road.
#[derive(Debug, Serialize)]
pub struct Limits {
    /// Along the road, as a part.
    pub along: f64,
    /// Across the road, as a part.
    pub across: f64,
}

/// Error of lengths at one distance.
#[derive(Debug, Serialize)]
pub struct ErrorLook {
    /// Where, px.
    pub at: Px,
    /// Along the road, as a part.
    pub along: f64,
    /// Across the road, as a part.
    pub across: f64,
}

/// What the traffic says.
#[derive(Debug, Serialize)]
pub struct TrafficLook {
    /// Boxes that count.
    pub used: usize,
    /// How much longer cars are here, as a part.
    pub longer: f64,
    /// Standard deviation of that among fleets.
    pub longer_sd: f64,
}

/// How a length fits.
#[derive(Debug, Serialize)]
pub struct LengthLook {
    /// Known length, m.
    pub known_m: f64,
    /// Mean measured length of its segments, m.
    pub measured_m: f64,
    /// Typical residual in its own standard deviations.
    pub in_sd: f64,
    /// What to look at, where everything else contradicts it, or nothing checks a standard.
    pub doubt: Option<String>,
    /// Whether everything else contradicts it.
    pub is_contradicted: bool,
}

/// How a rectangle fits.
#[derive(Debug, Serialize)]
pub struct RectangleLook {
    /// Its first side and its second, m.
    pub sides_m: [f64; 2],
    /// Its first angle, degrees.
    pub angle_deg: f64,
    /// Typical residual in its own standard deviations.
    pub in_sd: f64,
}

/// The road between two lines.
#[derive(Debug, Serialize)]
pub struct StripLook {
    /// The ids of its lines.
    pub lines: [u32; 2],
    /// Width at its near end, on average and at its far end, m.
    pub width_m: Option<[f64; 3]>,
    /// Standard errors of these as parts of them.
    pub width_err: Option<[f64; 3]>,
    /// The lane that it could be, px.
    pub outline: Vec<Px>,
}

/// How a vehicle's key points fit.
#[derive(Debug, Serialize)]
pub struct VehicleLook {
    /// Typical misfit, px.
    pub misfit_px: Option<f64>,
    /// Why it is not used, or what it is likelier than a car.
    pub problem: Option<String>,
}

/// A lane measured.
#[derive(Debug, Serialize)]
pub struct LaneLook {
    /// Why it cannot be used.
    pub problem: Option<String>,
    /// Its numbers, where it lies on the road.
    pub measured: Option<LaneMeasured>,
}

/// A lane's numbers.
#[derive(Debug, Serialize)]
pub struct LaneMeasured {
    /// Length, m.
    pub length_m: f64,
    /// Width near the camera, m.
    pub near_width_m: f64,
    /// Width far from it, m.
    pub far_width_m: f64,
    /// Metres along the lane that one px spans at its far end.
    pub far_span_m: f64,
    /// Standard error of its length, as a part.
    pub rel_err: Option<f64>,
    /// Its middle from the upstream end, px.
    pub middle: Vec<Px>,
}
