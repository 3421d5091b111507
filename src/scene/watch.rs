//! Whether the camera counts as moved: single sightings become a state.
//!
//! Owns the tolerances and how many pictures a change of state takes. Reads no clock.
//!
//! A picture is one of four things: the scene is in place at a preset, it is
//! displaced, another scene is seen, or nothing is known. Only the first three are
//! evidence; in fog or in the dark the state stays what it was. Evidence is taken at most
//! each [`SPACING`], so that a gust does not pass for a move on a fast camera, and a change
//! of state needs [`TO_MOVE`] of the last [`RECENT`] pieces of it.

use super::field::Grid;
use super::search::{Pose, Sighting};
use core::time::Duration;

/// Largest shift at which the scene counts as in place, as a part of the longer side: 4 px
/// of 320. Wind sways a pole by 2 px to each side; the least move to notice is 2 %.
pub const TOLERANCE: f32 = 1.0 / 80.0;
/// Largest turn at which the scene counts as in place, rad (1.1 degrees; 2 are to be noticed).
pub const TURN_TOLERANCE: f32 = 0.0192;
/// Largest change of focal length at which it does, parts: 2 % moves the edge by 1 % of the
/// width.
pub const ZOOM_TOLERANCE: f32 = 0.02;
/// Pieces of evidence that are remembered.
pub const RECENT: usize = 6;
/// So many of them must speak against the present state to leave it.
pub const TO_MOVE: usize = 4;
/// Consecutive sightings in place that bring the state back.
pub const TO_RETURN: usize = 3;
/// Least time between two pieces of evidence.
pub const SPACING: Duration = Duration::from_secs(5);
/// Weight of a new shift in the resting shift, which replaces that of a picture that cannot
/// tell its own.
const RESTING: f32 = 0.2;

/// Evidence of one picture for the camera's aim.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Evidence {
    /// The scene of that preset is in place, shifted by so many cells.
    InPlace {
        /// Number of the preset, from 0.
        preset: usize,
        /// To the right, cells.
        dx: f32,
        /// Down, cells.
        dy: f32,
    },
    /// A preset's scene is seen, but not where it was calibrated.
    Displaced,
    /// Another scene than any preset's is seen.
    Elsewhere,
    /// Too dark, too blurred or too empty to tell.
    Unclear,
}

impl Evidence {
    /// The evidence in a sighting of a preset's reference.
    pub fn of(preset: usize, sighting: &Sighting, grid: Grid) -> Self {
        if !sighting.is_sure() {
            return Self::Unclear;
        }
        let Pose { dx, dy, .. } = sighting.pose;
        if is_in_place(sighting.pose, grid) {
            Self::InPlace { preset, dx, dy }
        } else {
            Self::Displaced
        }
    }

    const fn preset(self) -> Option<usize> {
        match self {
            Self::InPlace { preset, .. } => Some(preset),
            _ => None,
        }
    }
}

/// Whether a scene that stands thus counts as in place.
pub fn is_in_place(Pose { dx, dy, turn, zoom }: Pose, grid: Grid) -> bool {
    let reach = grid.width.max(grid.height) as f32 * TOLERANCE;
    dx * dx + dy * dy <= reach * reach
        && turn.abs() <= TURN_TOLERANCE
        && (zoom - 1.0).abs() <= ZOOM_TOLERANCE
}

/// Where the camera looks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Aim {
    /// Not seen yet.
    #[default]
    Unknown,
    /// At a preset, by its number.
    Preset(usize),
    /// Elsewhere: moved.
    Moved,
}

/// The verdict on a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judgement {
    /// Where the camera looks.
    pub aim: Aim,
    /// Shift by which the look-up is corrected, cells; `None` where the picture must not be
    /// measured.
    pub shift: Option<(f32, f32)>,
}

/// The state of the camera's aim.
#[derive(Clone, Debug)]
pub struct Watch {
    presets: usize,
    aim: Aim,
    recent: heapless::Deque<Evidence, RECENT>,
    last: Option<Duration>,
    resting: (f32, f32),
}

impl Watch {
    /// A camera with so many presets, none of them seen yet.
    pub const fn new(presets: usize) -> Self {
        Self {
            presets,
            aim: Aim::Unknown,
            recent: heapless::Deque::new(),
            last: None,
            resting: (0.0, 0.0),
        }
    }

    /// Where the camera looks.
    pub const fn aim(&self) -> Aim {
        self.aim
    }

    /// Takes what a picture says at `now` (time since start) and returns what follows for it.
    pub fn on(&mut self, evidence: Evidence, now: Duration) -> Judgement {
        let spaced = self.last.is_none_or(|last| now.saturating_sub(last) >= SPACING);
        if evidence != Evidence::Unclear && spaced {
            self.last = Some(now);
            if self.recent.is_full() {
                self.recent.pop_front();
            }
            // There is room: a full queue has just lost one.
            let _ = self.recent.push_back(evidence);
            self.decide();
        }
        Judgement { aim: self.aim, shift: self.shift(evidence) }
    }

    fn decide(&mut self) {
        let newest = self.recent.back().and_then(|e| e.preset());
        let agreeing = self.recent.iter().rev().take_while(|e| e.preset() == newest).count();
        let next = match (newest, self.aim) {
            (Some(preset), Aim::Unknown) => Aim::Preset(preset),
            (Some(preset), _) if agreeing >= TO_RETURN => Aim::Preset(preset),
            (_, aim) => {
                let here = match aim {
                    Aim::Preset(preset) => Some(preset),
                    Aim::Unknown | Aim::Moved => None,
                };
                let against = self.recent.iter().filter(|e| e.preset().is_none());
                let stays = here.is_none() && aim == Aim::Moved;
                if !stays && against.count() >= TO_MOVE { Aim::Moved } else { aim }
            }
        };
        if next != self.aim {
            self.aim = next;
            self.resting = (0.0, 0.0);
        }
    }

    fn shift(&mut self, evidence: Evidence) -> Option<(f32, f32)> {
        match (evidence, self.aim) {
            (Evidence::InPlace { preset, dx, dy }, Aim::Preset(here)) if preset == here => {
                let (x, y) = self.resting;
                self.resting = (x + RESTING * (dx - x), y + RESTING * (dy - y));
                Some((dx, dy))
            }
            (Evidence::Unclear, Aim::Preset(_)) => Some(self.resting),
            // With one preset the camera is taken to look at it until it is seen that it does
            // not; with several there is nothing to go by.
            (Evidence::Unclear, Aim::Unknown) if self.presets == 1 => Some((0.0, 0.0)),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HERE: Evidence = Evidence::InPlace { preset: 0, dx: 1.0, dy: 0.0 };
    const THERE: Evidence = Evidence::InPlace { preset: 1, dx: 0.0, dy: 0.5 };

    /// The aims after each piece of evidence, ten seconds apart.
    fn aims(watch: &mut Watch, from: u64, evidence: &[Evidence]) -> std::vec::Vec<Aim> {
        let at = |i: usize| Duration::from_secs(10 * (from + i as u64));
        evidence.iter().enumerate().map(|(i, &e)| watch.on(e, at(i)).aim).collect()
    }

    #[test]
    fn the_first_sighting_settles_and_four_against_it_move() {
        let mut watch = Watch::new(1);
        assert_eq!(watch.on(Evidence::Unclear, Duration::ZERO).shift, Some((0.0, 0.0)));
        assert_eq!(aims(&mut watch, 1, &[HERE; 6]), [Aim::Preset(0); 6]);
        let moved = aims(&mut watch, 7, &[Evidence::Displaced; 5]);
        assert_eq!(moved[2..], [Aim::Preset(0), Aim::Moved, Aim::Moved]);
        let back = aims(&mut watch, 12, &[HERE; 4]);
        assert_eq!(back, [Aim::Moved, Aim::Moved, Aim::Preset(0), Aim::Preset(0)]);
    }

    #[test]
    fn a_gust_is_left_out_and_moves_nothing() {
        let mut watch = Watch::new(1);
        aims(&mut watch, 0, &[HERE; 6]);
        for round in 0..20 {
            let from = 6 + 4 * round;
            let gust = watch.on(Evidence::Displaced, Duration::from_secs(10 * from));
            assert_eq!((gust.aim, gust.shift), (Aim::Preset(0), None));
            aims(&mut watch, from + 1, &[HERE; 3]);
        }
        // On a camera of 25 pictures a second a gust of two seconds is one piece of evidence.
        let begin = Duration::from_secs(2000);
        for frame in 0..50 {
            watch.on(Evidence::Displaced, begin + Duration::from_millis(40 * frame));
        }
        assert_eq!(watch.aim(), Aim::Preset(0));
    }

    #[test]
    fn fog_keeps_the_state_and_the_resting_shift() {
        let mut watch = Watch::new(1);
        aims(&mut watch, 0, &[HERE; 30]);
        let fog = watch.on(Evidence::Unclear, Duration::from_secs(1000));
        let (dx, _) = fog.shift.expect("the state is kept");
        assert!(fog.aim == Aim::Preset(0) && (dx - 1.0).abs() < 0.05, "{dx}");
        aims(&mut watch, 101, &[Evidence::Elsewhere; 6]);
        let fog = watch.on(Evidence::Unclear, Duration::from_secs(2000));
        assert_eq!((fog.aim, fog.shift), (Aim::Moved, None));
    }

    #[test]
    fn another_preset_is_taken_after_three_sightings_and_none_is_mixed() {
        let mut watch = Watch::new(2);
        assert_eq!(watch.on(Evidence::Unclear, Duration::ZERO).shift, None, "which one?");
        aims(&mut watch, 1, &[HERE; 3]);
        for (i, aim) in [Aim::Preset(0), Aim::Preset(0), Aim::Preset(1)].into_iter().enumerate() {
            let seen = watch.on(THERE, Duration::from_secs(100 + 10 * i as u64));
            assert_eq!(seen.aim, aim);
            assert_eq!(seen.shift, (aim == Aim::Preset(1)).then_some((0.0, 0.5)));
        }
    }
}
