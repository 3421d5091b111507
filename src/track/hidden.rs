//! Where a vehicle is that is not seen: behind the one ahead of it.
//!
//! Owns how those move that a picture does not show. One on a free road keeps its speed. One that
//! others hide in a queue follows the vehicle ahead as drivers do by Newell's simplified theory
//! (Transportation Research Part B 36, 2002): its speed is at most that of the one ahead, or the
//! room that it has beyond the spacing of a jam by the time that a start takes to reach it. So it stops behind those
//! that stop, waits for as long as they do, and starts when they have gone.

use super::vehicle::{STANDING_M_S, Track};
use crate::units::Direction;

/// From bumper to bumper in a jam, m: what is left between nominal lengths.
const JAM_GAP_M: f32 = 1.5;
/// Time for which a vehicle that starts leaves the one behind it waiting, s: queues discharge by
/// waves of 15 to 20 km/h over spacings of 6 to 7 m.
const REACTION_S: f32 = 1.4;
/// Part of the room between the vehicles ahead and behind that one between them takes in a jam, with
/// which it may still be there: places are known to a metre.
const ROOM: f32 = 0.75;
/// Furthest ahead that a vehicle is followed, m.
const FOLLOWED_M: f32 = 30.0;

/// Lets `dt` seconds pass for those of `tracks`, by rising place, that are not seen, after each was
/// moved by itself.
pub(super) fn follow(tracks: &mut [Track], direction: Direction, dt: f32) {
    let mut ahead: Option<Track> = None;
    for track in tracks.iter_mut().rev().filter(|track| track.counts()) {
        let leader = ahead.filter(|leader| leader.motion.s_m - track.motion.s_m < FOLLOWED_M);
        // Hidden in a queue it stays of it, also when the one ahead has left the lane.
        track.is_behind = leader.is_some() || track.is_behind && track.is_hidden();
        if let Some(leader) = leader.filter(|_| track.is_hidden()) {
            behind(track, &leader, direction, dt);
        }
        ahead = Some(*track);
    }
    let mut follower: Option<Track> = None;
    for index in 0..tracks.len() {
        let leader = tracks.iter().skip(index + 1).find(|track| track.counts()).copied();
        let Some(track) = tracks.get_mut(index).filter(|track| track.counts()) else { continue };
        track.has_no_room = match (leader, follower) {
            (Some(leader), Some(follower)) if track.is_hidden() => {
                let takes_m = jam_spacing(&leader, track, direction)
                    + jam_spacing(track, &follower, direction);
                leader.motion.s_m - follower.motion.s_m < ROOM * takes_m
            }
            _ => false,
        };
        if track.missed > 0 && !track.stands() {
            track.unseen_moving_s += dt;
        }
        follower = Some(*track);
    }
}

/// Lets a hidden vehicle follow the one ahead.
fn behind(track: &mut Track, leader: &Track, direction: Direction, dt: f32) {
    let jam_m = leader.motion.s_m - jam_spacing(leader, track, direction);
    let motion = &mut track.motion;
    let was_m = motion.s_m - if motion.v_m_s >= STANDING_M_S { motion.v_m_s * dt } else { 0.0 };
    // One that stands in a queue starts with the one ahead when there is room; one that moves need
    // not be slower than the one ahead, as close as it may follow.
    let (wanted, room) = (motion.v_m_s, (jam_m - was_m).max(0.0) / REACTION_S);
    motion.v_m_s = if wanted < STANDING_M_S && track.is_queued {
        wanted.max(leader.motion.v_m_s).min(room)
    } else {
        wanted.min(room.max(leader.motion.v_m_s))
    };
    motion.s_m = (was_m + motion.v_m_s * dt).max(track.at_m);
}

/// From the place of a vehicle to that of the one ahead in a jam, m: places are those of fronts
/// where traffic comes, of rears where it goes.
fn jam_spacing(leader: &Track, follower: &Track, direction: Direction) -> f32 {
    let between = match direction {
        Direction::Toward | Direction::Unknown => leader.class(),
        Direction::Away => follower.class(),
    };
    between.nominal_length_m() + JAM_GAP_M
}
