//! One vehicle of a lane: where it is, since when it is known, and what it was seen as.
//!
//! Owns what is kept of a vehicle and when it is given up. Does not move it (`filter`, `hidden`) and
//! does not choose its sightings (`association`).

use super::Sighting;
use super::filter::{Motion, place_variance};
use crate::units::VehicleClass;

/// Longest time for which a moving vehicle that is not seen is where its speed takes it, s.
pub const BRIDGE_S: f32 = 2.5;
/// The same where another is close ahead of it, which it follows, s.
const BRIDGE_BEHIND_S: f32 = 6.0;
/// Longest time for which a standing vehicle that is not seen stays, s, where none stands ahead.
pub const HOLD_S: f32 = 30.0;
/// The same in a queue, s: the longest red. It cannot vanish between two that stand.
pub const HOLD_IN_QUEUE_S: f32 = 180.0;
/// Distance that a vehicle must have been seen to cover to be held in a queue, m.
const COME_M: f32 = 5.0;
/// Time after which one that is not seen, and for which there is no room, is given up, s.
const SQUEEZED_S: f32 = 1.0;
/// Pictures in a row that may miss a vehicle that does not count yet.
const YOUNG_MISSES: u16 = 1;
/// Speed below which a vehicle stands, m/s.
pub(super) const STANDING_M_S: f32 = 1.0;

/// Motion of a track that is not counted yet.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Covered {
    pub(super) distance_m: f32,
    pub(super) time_s: f32,
    pub(super) occupied_s: f32,
}

/// One vehicle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Track {
    pub(super) motion: Motion,
    /// Pictures in which it was seen before it counted.
    pub(super) seen: u8,
    /// Time since the first, s.
    pub(super) age_s: f32,
    /// Place at which it was seen last, m: up to there it is counted.
    pub(super) at_m: f32,
    /// Time since then, the part of it in which it moved, and the pictures in it that missed it.
    pub(super) unseen_s: f32,
    pub(super) unseen_moving_s: f32,
    pub(super) missed: u16,
    /// Time in it for which the section was covered, as it is taken to have moved, s.
    pub(super) unseen_occupied_s: f32,
    /// Place in the picture before, m.
    pub(super) was_m: f32,
    /// From where it is known, m: 0 where it came in at the upstream end.
    pub(super) from_m: f32,
    pub(super) pending: Covered,
    classes: [u8; VehicleClass::COUNT],
    /// Whether it was there when following began: it did not come in then.
    pub(super) was_there: bool,
    pub(super) is_confirmed: bool,
    pub(super) has_passed: bool,
    pub(super) is_queued: bool,
    /// Whether another vehicle that counts is close ahead of it.
    pub(super) is_behind: bool,
    /// Whether those ahead of it and behind it leave it no room.
    pub(super) has_no_room: bool,
}

impl Track {
    pub(super) fn new(sighting: &Sighting, [v, v_sd]: [f32; 2], was_there: bool) -> Self {
        let motion = Motion::first(sighting.s_m, place_variance(sighting.span_m), v, v_sd);
        let mut track = Self {
            motion,
            seen: 1,
            age_s: 0.0,
            at_m: sighting.s_m,
            unseen_s: 0.0,
            unseen_moving_s: 0.0,
            missed: 0,
            unseen_occupied_s: 0.0,
            was_m: sighting.s_m,
            from_m: sighting.s_m,
            pending: Covered::default(),
            classes: [0; VehicleClass::COUNT],
            was_there,
            is_confirmed: false,
            has_passed: false,
            is_queued: false,
            is_behind: false,
            has_no_room: false,
        };
        track.note_class(sighting.class);
        track
    }

    pub(super) fn note_class(&mut self, class: VehicleClass) {
        if let Some(votes) = self.classes.get_mut(class.index()) {
            *votes = votes.saturating_add(1);
        }
    }

    /// The class that it was seen as most often.
    pub(super) fn class(&self) -> VehicleClass {
        let votes = |class: &VehicleClass| self.classes.get(class.index()).copied();
        VehicleClass::ALL.into_iter().max_by_key(votes).unwrap_or(VehicleClass::Vehicle)
    }

    pub(super) const fn counts(&self) -> bool {
        self.is_confirmed
    }

    /// Whether it counts and the latest picture did not show it.
    pub(super) const fn is_hidden(&self) -> bool {
        self.is_confirmed && self.missed > 0
    }

    pub(super) fn stands(&self) -> bool {
        self.motion.v_m_s < STANDING_M_S
    }

    /// Takes it as seen now, at that place.
    pub(super) const fn seen_at(&mut self, s_m: f32) {
        (self.at_m, self.missed) = (s_m, 0);
        (self.unseen_s, self.unseen_moving_s, self.unseen_occupied_s) = (0.0, 0.0, 0.0);
    }

    /// Whether it has come from elsewhere: a second box or a false one in a queue never moves.
    fn has_come(&self) -> bool {
        self.at_m - self.from_m >= COME_M
    }

    /// Whether it is unseen for so long that it is given up.
    pub(super) fn is_lost(&self) -> bool {
        if !self.counts() {
            return self.missed > YOUNG_MISSES;
        }
        let [bridge_s, hold_s] = if self.is_behind && self.has_come() {
            [BRIDGE_BEHIND_S, HOLD_IN_QUEUE_S]
        } else {
            [BRIDGE_S, HOLD_S]
        };
        let is_squeezed = self.has_no_room && self.unseen_s > SQUEEZED_S;
        is_squeezed || self.unseen_moving_s > bridge_s || self.unseen_s > hold_s
    }
}
