//! Lanes as drawn and as they lie on the road of a camera.
//!
//! Owns placing an outline on the road. Does not own reading outlines (see `outline`), nor what
//! they would measure (see `judge`) or become (see `lane_table`).

use super::lane_axis::LaneAxis;
use super::outline::{self, Outline};
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::files::labelme::LabelFile;
use nalgebra::Vector2;
use verge::lane::MAX_LANE_LENGTH_M;
use verge::units::{Direction, LaneId};

/// A lane as drawn and as it lies on the road.
#[derive(Clone, Debug)]
pub struct DrawnLane {
    /// Its number.
    pub id: LaneId,
    /// Which way its traffic moves.
    pub direction: Direction,
    /// Whether its file marks it as wider at one end.
    pub widens: bool,
    /// Its outline, px.
    pub polygon: Vec<Vector2<f64>>,
    /// Its centre line on the road.
    pub axis: LaneAxis,
}

/// The lanes of a labelme file on the road of a camera, by rising number, see
/// [`outline::read`].
pub fn lanes(file: &LabelFile, what: &str, camera: &Camera) -> Result<Vec<DrawnLane>> {
    if file.image_size() != camera.image_size {
        return Err(Error::ImageSize {
            what: what.to_owned(),
            actual: file.image_size(),
            expected: camera.image_size,
        });
    }
    let drawing = outline::read(file)?;
    if drawing.lanes.is_empty() {
        let problem = format!("{what} holds no lane; draw a polygon for each");
        return Err(Error::Lane { lane: "(none)".into(), problem });
    }
    drawing.lanes.into_iter().map(|outline| on_road(outline, camera)).collect()
}

/// An outline on the road of a camera.
pub fn on_road(outline: Outline, camera: &Camera) -> Result<DrawnLane> {
    let Outline { label, id, direction, widens, polygon } = outline;
    let axis = LaneAxis::of_polygon(&label, &polygon, direction, camera)?;
    let length = axis.length_m();
    if length > f64::from(MAX_LANE_LENGTH_M) {
        let problem = format!(
            "it would be {length:.0} m long, a table holds {MAX_LANE_LENGTH_M} m; \
             end the polygon further below the horizon"
        );
        return Err(Error::Lane { lane: label, problem });
    }
    Ok(DrawnLane { id, direction, widens, polygon, axis })
}
