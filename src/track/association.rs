//! Association of sightings with vehicles, keeping their order along a lane.
//!
//! Vehicles of one lane stay in their order (first in, first out), so that tracks and sightings,
//! both sorted along the lane, are two sequences to be aligned: the alignment of least cost by
//! dynamic programming (Needleman and Wunsch, J. Mol. Biol. 48, 1970), in which a track may be
//! missed and a sighting may be new. It is the global optimum among associations that keep the
//! order, in time proportional to tracks times sightings.
//!
//! Costs are -2 ln of likelihoods, as in the score of a track (Blackman and Popoli, Design and
//! Analysis of Modern Tracking Systems, 1999, section 6.2): a match costs d²/S + ln(2 pi S) for a
//! residual d of variance S, a miss what it says of the detector, a new sighting what it says of
//! how densely vehicles are.

use super::{MAX_SIGHTINGS, MAX_TRACKS};

/// -2 ln of the share of pictures in which a vehicle is not found, a fifth.
const MISS: f32 = 3.2;
/// -2 ln of the share in which it is.
const FOUND: f32 = 0.45;
/// -2 ln of new vehicles and false sightings a metre of lane and picture, 1 in 200 m.
const NEW: f32 = 10.6;
/// ln(2 pi).
const LN_TAU: f32 = 1.837_877;

/// The cost of a match of a residual (m) of that variance (m²).
pub(super) fn match_cost(residual: f32, variance: f32) -> f32 {
    FOUND + LN_TAU + libm::logf(variance) + residual * residual / variance
}

/// A step of the alignment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Step {
    #[default]
    Start,
    Match,
    Miss,
    New,
}

/// Aligns `tracks` tracks with `sightings` sightings, both sorted along the lane, of which
/// `cost(track, sighting)` says what a match costs. Returns for each track its sighting.
pub(super) fn align(
    tracks: usize,
    sightings: usize,
    cost: impl Fn(usize, usize) -> f32,
) -> [Option<u8>; MAX_TRACKS] {
    let (tracks, sightings) = (tracks.min(MAX_TRACKS), sightings.min(MAX_SIGHTINGS));
    let mut steps = [[Step::Start; MAX_SIGHTINGS + 1]; MAX_TRACKS + 1];
    let mut costs = [0.0_f32; MAX_SIGHTINGS + 1];
    for (track, row) in steps.iter_mut().enumerate().take(tracks + 1) {
        // Costs of the row before, and of its column before.
        let (mut diagonal, mut left) = (0.0, 0.0);
        for (sighting, (step, here)) in
            row.iter_mut().zip(costs.iter_mut()).enumerate().take(sightings + 1)
        {
            let above = *here;
            let mut best = (f32::INFINITY, Step::Start);
            if track == 0 && sighting == 0 {
                best = (0.0, Step::Start);
            }
            let mut try_step = |total: f32, step| {
                if total < best.0 {
                    best = (total, step);
                }
            };
            if track > 0 && sighting > 0 {
                try_step(diagonal + cost(track - 1, sighting - 1), Step::Match);
            }
            if track > 0 {
                try_step(above + MISS, Step::Miss);
            }
            if sighting > 0 {
                try_step(left + NEW, Step::New);
            }
            (*here, *step) = best;
            (diagonal, left) = (above, best.0);
        }
    }
    let mut matched = [None; MAX_TRACKS];
    let (mut track, mut sighting) = (tracks, sightings);
    while let Some(step) = steps.get(track).and_then(|row| row.get(sighting)) {
        match step {
            Step::Match => {
                (track, sighting) = (track.saturating_sub(1), sighting.saturating_sub(1));
                if let Some(place) = matched.get_mut(track) {
                    *place = u8::try_from(sighting).ok();
                }
            }
            Step::Miss => track = track.saturating_sub(1),
            Step::New => sighting = sighting.saturating_sub(1),
            Step::Start => break,
        }
    }
    matched
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn aligned(tracks: &[f32], sightings: &[f32], variance: f32) -> Vec<Option<u8>> {
        let cost = |t: usize, s: usize| match_cost(tracks[t] - sightings[s], variance);
        align(tracks.len(), sightings.len(), cost)[..tracks.len()].to_vec()
    }

    #[test]
    fn each_track_has_the_sighting_beside_it() {
        let found = aligned(&[10.0, 20.0, 30.0], &[10.5, 19.0, 31.0], 1.0);
        assert_eq!(found, [Some(0), Some(1), Some(2)]);
    }

    #[test]
    fn a_missed_vehicle_does_not_shift_the_others() {
        assert_eq!(aligned(&[10.0, 20.0, 30.0], &[10.5, 30.5], 1.0), [Some(0), None, Some(1)]);
        // All have moved on by nearly the distance between them: nearest neighbours would be
        // wrong, and what was expected is right.
        let found = aligned(&[15.0, 25.0, 35.0], &[14.0, 24.0], 1.0);
        assert_eq!(found, [Some(0), Some(1), None]);
    }

    #[test]
    fn a_second_box_and_a_far_one_are_left_over() {
        assert_eq!(aligned(&[10.0], &[7.0, 10.2], 1.0), [Some(1)]);
        assert_eq!(aligned(&[10.0], &[40.0], 1.0), [None]);
        assert_eq!(aligned(&[], &[40.0], 1.0), []);
        assert_eq!(aligned(&[3.0], &[], 1.0), [None]);
    }

    /// Every association that keeps the order, tried.
    fn least(costs: &[Vec<f32>], track: usize, sighting: usize, sightings: usize) -> f32 {
        if track == costs.len() {
            return NEW * (sightings - sighting) as f32;
        }
        let mut best = MISS + least(costs, track + 1, sighting, sightings);
        for at in sighting..sightings {
            let skipped = NEW * (at - sighting) as f32;
            let rest = least(costs, track + 1, at + 1, sightings);
            best = best.min(skipped + costs[track][at] + rest);
        }
        best
    }

    #[test]
    fn no_association_in_order_costs_less() {
        let mut state = 12345_u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 16_777_216.0
        };
        for _ in 0..200 {
            let (tracks, sightings) = ((random() * 5.0) as usize, (random() * 6.0) as usize);
            let costs: Vec<Vec<f32>> =
                (0..tracks).map(|_| (0..sightings).map(|_| random() * 25.0).collect()).collect();
            let matched = align(tracks, sightings, |t, s| costs[t][s]);
            let mut total = 0.0;
            let mut used = 0;
            for (track, sighting) in matched.iter().take(tracks).enumerate() {
                total += sighting.map_or(MISS, |at| costs[track][usize::from(at)]);
                used += usize::from(sighting.is_some());
            }
            total += NEW * (sightings - used) as f32;
            let best = least(&costs, 0, 0, sightings);
            assert!((total - best).abs() < 1e-3, "{total} against {best}: {costs:?}");
        }
    }
}
