//! Whether a drawn lane is one lane, by everything but the lanes.
//!
//! Owns the second fit, without lanes, and the comparison of a lane's width there with what lanes
//! are. In the fit itself a lane that is two bends the camera until it has the width of one, and
//! lengths beside it seem to be wrong. Does not own the lanes of a table (see `road::judge`).

use super::cues::{Cues, LANE_EACH_M, LANE_WIDTH_M, LaneCue, STATED_WIDTH_SD_M};
use super::doubt::DOUBTED;
use super::lanes::OnRoad;
use super::view::View;
use super::{Fit, fit_of};
use crate::trust::{Reason, Trust};

/// Drawing, as a part of a lane's width.
const DRAWN_REL_SD: f64 = 0.03;

/// The lane whose width contradicts everything else most, if one does.
pub(super) fn contradicted(cues: &Cues, image_size: [u32; 2]) -> Option<Reason> {
    if cues.lanes.iter().all(|lane| !lane.steady) {
        return None;
    }
    let bare = Cues { lanes: Vec::new(), boxes: Vec::new(), lane_width_m: None, ..cues.clone() };
    let (found, view) =
        fit_of(&bare, image_size, false).ok().filter(|(f, _)| is_usable(&f.trust))?;
    let [expected_m, sd_m] = match cues.lane_width_m {
        Some(stated) => [stated, STATED_WIDTH_SD_M.hypot(LANE_EACH_M)],
        None => [LANE_WIDTH_M[0], LANE_WIDTH_M[1].hypot(LANE_EACH_M)],
    };
    let off = |lane: &LaneCue| {
        let (width_m, rel_sd) = width(lane, &found, &view)?;
        let sd = (sd_m / expected_m).hypot(rel_sd).hypot(DRAWN_REL_SD);
        let in_sd = (width_m / expected_m).ln().abs() / sd;
        (in_sd > DOUBTED).then(|| (in_sd, lane.name.clone(), width_m))
    };
    let steady = cues.lanes.iter().filter(|lane| lane.steady);
    let (_, name, width_m) = steady.filter_map(off).max_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(Reason::LaneWidth { name, width_m, expected_m })
}

/// A camera that is not known well contradicts nothing, by its own error; one that does not fit its
/// cues says nothing.
fn is_usable(trust: &Trust) -> bool {
    use Reason::{Uncertain, UncertainAcross, UncertainFar};
    match trust {
        Trust::Ok => true,
        Trust::Refused(reason) => {
            matches!(reason, Uncertain { .. } | UncertainAcross { .. } | UncertainFar { .. })
        }
    }
}

/// Mean width of a lane, m, and how well the camera knows it there, as a part of it.
fn width(lane: &LaneCue, found: &Fit, view: &View) -> Option<(f64, f64)> {
    let on_road = OnRoad::of(lane, view)?;
    let (width_m, _) = on_road.usable();
    let (place, along) = on_road.middle().places()[1];
    let half = 0.5 * width_m * nalgebra::Vector2::new(along.y, -along.x);
    Some((width_m, found.known.between(place - half, place + half)?.rel_sd))
}
