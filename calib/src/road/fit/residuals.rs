//! How each cue fits a camera.
//!
//! Owns the residuals that a fit reports, in metres and standard deviations. Does not own those that
//! are minimised (see `problem`) nor the stated errors (see `errors`).

use super::bodies::ALL as BODIES;
use super::cues::{Cues, LaneCue, MarkCue, RectangleCue};
use super::lanes::OnRoad;
use super::marks;
use super::solve::Optimum;
use super::traffic::SHARED_SD;
use super::view::{CAMERA, View};
use nalgebra::Vector2;

/// How a mark fits.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkResidual {
    /// What it is called.
    pub name: String,
    /// Known length of a segment, m.
    pub known_m: f64,
    /// Measured length of each segment, m.
    pub measured_m: Vec<f64>,
    /// Typical residual in its own standard deviations.
    pub in_sd: f64,
}

/// How a lane fits.
#[derive(Clone, Debug, PartialEq)]
pub struct LaneResidual {
    /// What it is called.
    pub name: String,
    /// Width at its near end, on average and at its far end, m.
    pub width_m: [f64; 3],
}

/// How a rectangle fits.
#[derive(Clone, Debug, PartialEq)]
pub struct RectangleResidual {
    /// What it is called.
    pub name: String,
    /// Mean length of its first side and the one opposite, and of the other two, m.
    pub sides_m: [f64; 2],
    /// The same as stated.
    pub known_m: Option<[f64; 2]>,
    /// Angle at its first corner, degrees.
    pub angle_deg: f64,
    /// Typical residual in its own standard deviations.
    pub in_sd: f64,
}

/// What the traffic says.
#[derive(Clone, Debug, PartialEq)]
pub struct TrafficResidual {
    /// Boxes that count.
    pub used: usize,
    /// Each body's name and its share of them.
    pub shares: Vec<(&'static str, f64)>,
    /// How much longer this camera makes the fleet's cars than fleets are, as a part, and the
    /// standard deviation of fleets: beyond two of these a length is wrong, not the fleet.
    pub car_length: [f64; 2],
}

/// Each mark at a camera.
pub(super) fn marks(cues: &Cues, view: &View) -> Vec<MarkResidual> {
    let of = |mark: &MarkCue| {
        let logs = marks::log_ratios(mark, view)?;
        let white = marks::whitening(mark, view)? * &logs;
        Some(MarkResidual {
            name: mark.name.clone(),
            known_m: mark.segment_m,
            measured_m: logs.iter().map(|l| mark.segment_m * l.exp()).collect(),
            in_sd: marks::typical(&white),
        })
    };
    cues.marks.iter().filter_map(of).collect()
}

/// Each rectangle at a camera.
pub(super) fn rectangles(cues: &Cues, view: &View) -> Vec<RectangleResidual> {
    let of = |cue: &RectangleCue| {
        let white = marks::rectangle_whitening(cue, view)? * marks::rectangle(cue, view)?;
        let mut g = [Vector2::zeros(); 4];
        for (g, uv) in g.iter_mut().zip(&cue.corners) {
            *g = view.ground(*uv)?;
        }
        let side = |k: usize| g[(k + 1) % 4] - g[k];
        let mean = |k: usize| 0.5 * (side(k).norm() + side(k + 2).norm());
        Some(RectangleResidual {
            name: cue.name.clone(),
            sides_m: [mean(0), mean(1)],
            known_m: cue.sides_m,
            angle_deg: side(0).angle(&-side(3)).to_degrees(),
            in_sd: marks::typical(&white),
        })
    };
    cues.rectangles.iter().filter_map(of).collect()
}

/// Each steady lane at a camera.
pub(super) fn lanes(cues: &Cues, view: &View) -> Vec<LaneResidual> {
    let of = |lane: &LaneCue| {
        let on_road = OnRoad::of(lane, view)?;
        let (mean, widths) = on_road.usable();
        let name = lane.name.clone();
        Some(LaneResidual { name, width_m: [*widths.first()?, mean, *widths.last()?] })
    };
    cues.lanes.iter().filter(|l| l.steady).filter_map(of).collect()
}

/// What the traffic says at an optimum.
pub(super) fn traffic(optimum: &Optimum) -> Option<TrafficResidual> {
    let mixture = optimum.mixture.as_ref()?;
    let shares = mixture.shares();
    Some(TrafficResidual {
        used: mixture.used(),
        shares: BODIES.iter().zip(shares).map(|(b, s)| (b.name, s)).collect(),
        car_length: [optimum.theta[CAMERA + 1], SHARED_SD[1]],
    })
}
