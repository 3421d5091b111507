//! Track: the stage between locate and the windows, from places in pictures to motion on a lane.
//!
//! Owns the vehicles of a lane while they are on it, in metres along it: where each is, how fast,
//! and what it has covered since the picture before. Knows no picture, no clock and no window; a
//! track has no number and nothing to recognise a vehicle by, and is forgotten when it ends.
//!
//! A picture is one call of [`LaneTracker::observe`]: motion is predicted (`filter`), sightings are
//! given to tracks (`association`), and what the tracks have covered goes out as [`Moves`]. A track
//! counts once it was seen in [`CONFIRM`] pictures, from its first. Between two sightings a vehicle
//! moves evenly; where it is not seen for up to [`BRIDGE_S`], in the lane or at its ends, it is
//! where its speed takes it. A standing one is kept for [`HOLD_S`]: lost and found again it has
//! covered no distance twice and passes the section once.

mod association;
mod filter;
mod hidden;
mod lanes;
mod moves;
pub mod rate;
mod section;
mod vehicle;

pub use lanes::{LaneMoves, Tracker};
pub use moves::{Moves, Passages};
pub use vehicle::{BRIDGE_S, HOLD_IN_QUEUE_S, HOLD_S};

use crate::lane::Lane;
use crate::units::{Direction, VehicleClass};
use association::{align, match_cost};
use filter::place_variance;
use section::Section;
use vehicle::{Covered, STANDING_M_S, Track};

/// Most vehicles followed in one lane: 400 m at jam density.
pub const MAX_TRACKS: usize = 64;
/// Most sightings taken in one lane and picture.
pub const MAX_SIGHTINGS: usize = 64;
/// Pictures in which a vehicle must be seen before it counts.
pub const CONFIRM: u8 = 3;
/// Time after which it may count, s: second boxes on trailers last for a third of a second, and what
/// counts is then taken to drive on.
const CONFIRM_S: f32 = 0.5;
/// Standard deviations of two places by which a vehicle may seem to go back.
const BACKWARDS: f32 = 3.0;
/// Sightings nearer than this to a vehicle's are second boxes of it, m: nobody stands so close.
const SECOND_BOX_M: f32 = 3.5;
/// A vehicle that came into being on the lane passes the section only from at least so far before
/// it, m: one that was lost on the section and found again is not counted twice.
const BEFORE_SECTION_M: f32 = 2.0;
/// Speed up to which a vehicle joins a queue, and from which it has left it, m/s (5 and 10 km/h).
const QUEUES_M_S: [f32; 2] = [5.0 / 3.6, 10.0 / 3.6];
/// Longest distance from a queued vehicle to the next one of the same queue, m: a lorry and a gap.
const QUEUE_GAP_M: f32 = 20.0;
/// Prior speed of the first vehicle on a lane, and its standard deviation, m/s.
const ANY_SPEED_M_S: [f32; 2] = [8.0, 10.0];
/// Weight of a vehicle in the lane's usual speed.
const USUAL: f32 = 0.1;

/// A vehicle seen in a picture, in its lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Where it meets the road: along the lane from its upstream end, m.
    pub s_m: f32,
    /// Road length along the lane that one pixel spans there, m.
    pub span_m: f32,
    /// Kind of vehicle.
    pub class: VehicleClass,
}

/// Sightings of one lane in one picture.
pub type Sightings = heapless::Vec<Sighting, MAX_SIGHTINGS>;

/// The vehicles of one lane.
#[derive(Clone, Debug)]
pub struct LaneTracker {
    length_m: f32,
    section: Section,
    direction: Direction,
    /// By rising place.
    tracks: heapless::Vec<Track, MAX_TRACKS>,
    /// Speed at which vehicles usually pass, m/s.
    usual_m_s: Option<f32>,
    /// Whether no picture was taken yet.
    is_new: bool,
    /// Time since the latest passage of the section, s.
    since_passage_s: Option<f32>,
}

impl LaneTracker {
    /// An empty lane, whose section is in its middle.
    pub const fn new(lane: &Lane) -> Self {
        Self {
            length_m: lane.length_m,
            section: Section::of(lane),
            direction: lane.direction,
            tracks: heapless::Vec::new(),
            usual_m_s: None,
            is_new: true,
            since_passage_s: None,
        }
    }

    /// From now on vehicles are counted so far from the upstream end, m, where a pixel's road is
    /// `foreshortening` times as long as wide ([`crate::lane::LaneTable::foreshortening`]); false where
    /// that is not on the lane.
    #[must_use]
    pub fn set_section(&mut self, section_m: f32, foreshortening: Option<f32>) -> bool {
        self.section.set(section_m, foreshortening)
    }

    /// Where vehicles are counted, from the upstream end, m.
    pub const fn section_m(&self) -> f32 {
        self.section.at_m
    }

    /// Forgets the vehicles: what comes next is not connected with what was.
    pub fn forget(&mut self) {
        self.tracks.clear();
        self.is_new = true;
        self.since_passage_s = None;
    }

    /// Vehicles that are followed and count.
    pub fn followed(&self) -> usize {
        self.tracks.iter().filter(|track| track.counts()).count()
    }

    /// Takes the sightings of a picture, `dt` seconds after the one before it, and returns what
    /// the vehicles have covered. Sightings are sorted along the lane by it.
    pub fn observe(&mut self, dt: f32, sightings: &mut Sightings) -> Moves {
        sightings.sort_unstable_by(|a, b| a.s_m.total_cmp(&b.s_m));
        let mut moves = Moves { observed_s: dt, ..Moves::default() };
        self.since_passage_s = self.since_passage_s.map(|s| s + dt);
        for track in &mut self.tracks {
            track.was_m = track.motion.s_m;
            if track.missed > 0 && track.stands() {
                // It stays until it is seen to go.
                track.motion.stand(dt);
            } else {
                track.motion.predict(dt);
            }
            (track.age_s, track.unseen_s) = (track.age_s + dt, track.unseen_s + dt);
        }
        self.tracks.sort_unstable_by(|a, b| a.motion.s_m.total_cmp(&b.motion.s_m));
        hidden::follow(&mut self.tracks, self.direction, dt);
        let (tracks, seen) = (&self.tracks, &*sightings);
        let matched = align(tracks.len(), seen.len(), |track, sighting| {
            let (Some(track), Some(sighting)) = (tracks.get(track), seen.get(sighting)) else {
                return f32::INFINITY;
            };
            let place = place_variance(sighting.span_m);
            if sighting.s_m < track.at_m - BACKWARDS * libm::sqrtf(2.0 * place) {
                return f32::INFINITY;
            }
            match_cost(sighting.s_m - track.motion.s_m, track.motion.innovation_variance(place))
        });
        let mut is_taken = [false; MAX_SIGHTINGS];
        for (index, sighting) in matched.iter().enumerate().take(self.tracks.len()) {
            let sighting = sighting.map(usize::from);
            if let Some(taken) = sighting.and_then(|at| is_taken.get_mut(at)) {
                *taken = true;
            }
            self.step(index, sighting.and_then(|at| sightings.get(at)), dt, &mut moves);
        }
        let end_m = self.length_m;
        self.tracks.retain(|track| {
            let left = track.missed > 0 && track.motion.s_m >= end_m;
            let is_lost = !left && track.is_lost();
            if is_lost && track.counts() {
                moves.unseen_s += track.unseen_s;
            }
            !left && !is_lost
        });
        self.begin(sightings, &is_taken, &mut moves);
        self.is_new = false;
        moves.queue_m = self.queue();
        moves
    }

    /// A track that was seen, or not.
    fn step(&mut self, index: usize, sighting: Option<&Sighting>, dt: f32, moves: &mut Moves) {
        let (length_m, section) = (self.length_m, self.section);
        let Some(track) = self.tracks.get_mut(index) else { return };
        let (from_m, took_s) = (track.at_m, track.unseen_s);
        let class = track.class();
        // Where it is now, and how long ago it was there: now, or when it left the lane.
        let (to_m, ago_s) = if let Some(sighting) = sighting {
            track.motion.update(sighting.s_m, place_variance(sighting.span_m));
            track.note_class(sighting.class);
            let to_m = track.motion.s_m.clamp(0.0, length_m);
            let way_m = [track.was_m, to_m];
            track.unseen_occupied_s += section.covered(way_m, dt, class);
            (to_m, 0.0)
        } else {
            let way_m = [track.was_m, track.motion.s_m];
            track.unseen_occupied_s += section.covered(way_m, dt, class);
            track.missed = track.missed.saturating_add(1);
            if track.motion.s_m < length_m || !track.counts() {
                return;
            }
            let beyond_s = (track.motion.s_m - length_m) / track.motion.v_m_s.max(STANDING_M_S);
            moves.occupied_s += section.covered_after(track.motion.v_m_s, class);
            (length_m, beyond_s.min(took_s))
        };
        let time_s = took_s - ago_s;
        let occupied_s = if took_s > BRIDGE_S {
            // It stood for a part of that time: it did not move evenly.
            track.unseen_occupied_s.min(time_s)
        } else {
            section.covered([from_m, to_m], time_s, class)
        };
        let covered = Covered { distance_m: to_m - from_m, time_s, occupied_s };
        if track.missed > 1 {
            let bridged = covered.distance_m;
            moves.bridged_m2 += bridged * bridged;
            moves.unseen_s += covered.time_s;
        }
        if sighting.is_some() {
            track.seen_at(to_m);
        }
        if track.counts() {
            moves.add(covered.distance_m, covered.time_s, covered.occupied_s);
        } else {
            track.pending.distance_m += covered.distance_m;
            track.pending.time_s += covered.time_s;
            track.pending.occupied_s += covered.occupied_s;
            track.seen = track.seen.saturating_add(1);
            if track.seen < CONFIRM || track.age_s < CONFIRM_S {
                return;
            }
            track.is_confirmed = true;
            Self::confirm(track, section, moves);
        }
        let speed = track.motion.v_m_s;
        track.is_queued = speed < QUEUES_M_S[usize::from(track.is_queued)];
        moves.place_m2 += if sighting.is_some() { 0.0 } else { track.motion.variance() };
        let section_m = section.at_m;
        let is_from_before = track.from_m <= (section_m - BEFORE_SECTION_M).max(0.0);
        if track.has_passed || to_m < section_m {
            return;
        }
        track.has_passed = true;
        if is_from_before {
            let class = track.class();
            let ago_s = ago_s + ((to_m - section_m) / speed.max(STANDING_M_S)).min(time_s);
            let headway_s = self.since_passage_s.map(|since| (since - ago_s).max(0.0));
            self.since_passage_s = Some(ago_s);
            moves.passages.add(class, speed.max(0.0), headway_s);
            let usual = self.usual_m_s.unwrap_or(speed);
            self.usual_m_s = Some(usual + USUAL * (speed - usual));
        }
    }

    /// Counts what a track has covered before it counted, from the lane's beginning where it came
    /// in there.
    fn confirm(track: &mut Track, section: Section, moves: &mut Moves) {
        let Covered { distance_m, time_s, occupied_s } = track.pending;
        moves.add(distance_m, time_s, occupied_s);
        let speed = track.motion.v_m_s;
        // The whole way at that speed, less what was seen of it.
        let before_s = track.motion.s_m / speed.max(f32::EPSILON) - track.age_s;
        if speed > STANDING_M_S && before_s <= BRIDGE_S && !track.was_there {
            let (born_m, before_s) = (track.from_m, before_s.max(0.0));
            let class = track.class();
            let occupied_s = section.covered([0.0, born_m], before_s, class);
            moves.add(born_m, before_s, occupied_s + section.covered_before(speed, class));
            track.from_m = 0.0;
        }
        moves.place_m2 += track.motion.variance();
    }

    /// Sightings that belong to no vehicle begin one, unless they are second boxes.
    fn begin(
        &mut self,
        sightings: &Sightings,
        is_taken: &[bool; MAX_SIGHTINGS],
        moves: &mut Moves,
    ) {
        for (sighting, _) in sightings.iter().zip(is_taken).filter(|(_, taken)| !**taken) {
            let apart = SECOND_BOX_M.max(2.0 * sighting.span_m);
            let is_second = |track: &Track| (track.motion.s_m - sighting.s_m).abs() < apart;
            if self.tracks.iter().any(is_second) {
                continue;
            }
            let track = Track::new(sighting, self.speed_near(sighting.s_m), self.is_new);
            if self.tracks.push(track).is_err() {
                moves.lost = moves.lost.saturating_add(1);
            }
        }
    }

    /// Speed to expect at a place, and its standard deviation, m/s: as the vehicle ahead, else as
    /// the one behind, else as usual here.
    fn speed_near(&self, s_m: f32) -> [f32; 2] {
        let known = || self.tracks.iter().filter(|track| track.counts());
        let nearest = |a: &&Track, b: &&Track| a.motion.s_m.total_cmp(&b.motion.s_m);
        let ahead = known().filter(|track| track.motion.s_m > s_m).min_by(nearest);
        let near = ahead.or_else(|| known().max_by(nearest));
        match (near, self.usual_m_s) {
            (Some(track), _) => {
                let apart_m = (track.motion.s_m - s_m).abs();
                let v = track.motion.v_m_s.max(0.0);
                [v, 2.0 + 0.15 * v + 0.1 * apart_m]
            }
            (None, Some(usual)) => [usual, 3.0 + 0.3 * usual],
            (None, None) => ANY_SPEED_M_S,
        }
    }

    /// Length of the longest queue, m: queued vehicles one behind the other, at least two, with
    /// their own lengths.
    fn queue(&self) -> f32 {
        let (mut longest, mut from, mut last): (f32, Option<f32>, f32) = (0.0, None, 0.0);
        // They were sorted as they were expected to be: what they changed since is small.
        for track in self.tracks.iter().filter(|track| track.counts() && track.is_queued) {
            let s_m = track.motion.s_m.clamp(0.0, self.length_m);
            match from {
                Some(start) if s_m - last <= QUEUE_GAP_M => {
                    longest = longest.max(s_m - start + track.class().nominal_length_m());
                }
                _ => from = Some(s_m),
            }
            last = s_m;
        }
        longest.min(self.length_m)
    }
}

#[cfg(test)]
mod tests;
