//! How far a camera stands off its place, in words that say which way to turn it.
//!
//! Owns the words. The search for the calibrated scene is the core's ([`crate::scene`]).

use crate::scene::{Grid, Pose, is_in_place};
use std::fmt;

/// How the calibrated scene stands in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Offset {
    /// To the right, px.
    right_px: f32,
    /// Down, px.
    down_px: f32,
    /// Clockwise, degrees.
    turn_deg: f32,
    /// Factor of its size.
    zoom: f32,
    in_place: bool,
}

/// Least turn (degrees) and zoom (percent) that are worth reporting.
const WORTH_DEG: f32 = 0.5;
const WORTH_PERCENT: f32 = 1.0;

impl Offset {
    /// A pose on the grid of a picture.
    pub fn of(pose: Pose, grid: Grid) -> Self {
        let px = grid.cell_px();
        Self {
            right_px: pose.dx * px,
            down_px: pose.dy * px,
            turn_deg: pose.turn.to_degrees(),
            zoom: pose.zoom,
            in_place: is_in_place(pose, grid),
        }
    }

    /// Whether it counts as in place.
    pub const fn is_in_place(&self) -> bool {
        self.in_place
    }

    /// The offset in words, also where the scene is not found.
    pub fn words(offset: Option<&Self>) -> String {
        offset.map_or_else(
            || {
                "The calibrated scene is not in the picture: the camera looks elsewhere, by more than \
                 half a picture, or it is too dark to tell"
                    .to_owned()
            },
            Self::to_string,
        )
    }
}

impl fmt::Display for Offset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { right_px, down_px, turn_deg, zoom, in_place } = *self;
        let side = if right_px < 0.0 { "left" } else { "right" };
        let height = if down_px < 0.0 { "up" } else { "down" };
        write!(
            f,
            "The scene stands {:.0} px to the {side} and {:.0} px {height}",
            right_px.abs(),
            down_px.abs()
        )?;
        let turn = turn_deg.abs() >= WORTH_DEG;
        let way = if turn_deg < 0.0 { "anticlockwise" } else { "clockwise" };
        if turn {
            write!(f, ", turned by {:.1} degrees {way}", turn_deg.abs())?;
        }
        let percent = (zoom - 1.0) * 100.0;
        let zoomed = percent.abs() >= WORTH_PERCENT;
        if zoomed {
            let size = if percent < 0.0 { "smaller" } else { "larger" };
            write!(f, ", {:.0} % {size}", percent.abs())?;
        }
        if in_place {
            return write!(f, ": in place");
        }
        // A scene that stands too far to the right is brought back by a camera that looks further
        // to the right, and so on.
        let mut moves = Vec::new();
        if right_px.abs() >= 1.0 {
            moves.push(format!("turn the camera to the {side}"));
        }
        if down_px.abs() >= 1.0 {
            moves.push(format!("tilt it {height}"));
        }
        if turn {
            moves.push(format!("roll it {way}"));
        }
        if zoomed {
            moves.push(format!("zoom {}", if percent < 0.0 { "in" } else { "out" }));
        }
        write!(f, ": {}", moves.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_says_how_far_and_which_way_to_turn_the_camera() {
        let grid = Grid::of(640, 480);
        let said = |dx, dy, turn, zoom| Offset::of(Pose { dx, dy, turn, zoom }, grid).to_string();
        let px = grid.cell_px();
        let moved = said(20.0 / px, -10.0 / px, 0.0, 1.0);
        assert_eq!(
            moved,
            "The scene stands 20 px to the right and 10 px up: turn the camera to the right, tilt it up"
        );
        let turned = said(0.0, 0.0, -0.05, 1.05);
        assert!(turned.contains("2.9 degrees anticlockwise, 5 % larger: roll it anti"), "{turned}");
        assert!(turned.ends_with("zoom out"), "{turned}");
        let still = said(1.0 / px, 0.0, 0.0, 1.0);
        assert!(still.ends_with(": in place"), "{still}");
        assert!(Offset::words(None).contains("not in the picture"));
    }
}
