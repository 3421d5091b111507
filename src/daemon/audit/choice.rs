//! Choice of a recording's frames for people to count.
//!
//! Owns the choice: spread over light, load and time, and blind to how sure the line is of them, so
//! that the easy frames are not preferred. The same recording gives the same frames.

use crate::picture::Light;
use crate::units::UtcMs;

/// A frame that could be counted.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Its name.
    pub name: String,
    /// When it was taken.
    pub time: UtcMs,
    /// In which light.
    pub light: Light,
    /// Vehicles that the line counts in its lanes.
    pub load: u32,
}

/// The numbers of `most` of the candidates, or of all where there are fewer, in their order. Each
/// light gets frames by its share, two at least; of one light the loads lie evenly between the least
/// and the greatest, and of frames with one load the one farthest in time from all others is taken.
pub fn choose(candidates: &[Candidate], most: usize) -> Vec<usize> {
    if candidates.len() <= most {
        return (0..candidates.len()).collect();
    }
    let of = |light| (0..candidates.len()).filter(move |&n| candidates[n].light == light);
    let (day, night): (Vec<_>, Vec<_>) = (of(Light::Day).collect(), of(Light::Night).collect());
    let by_night = (most * night.len()).div_ceil(candidates.len());
    let least = |frames: &[usize]| frames.len().min(2).min(most / 2);
    let by_night = by_night.max(least(&night)).min(most - least(&day)).min(night.len());
    let by_day = (most - by_night).min(day.len());
    let mut chosen = Vec::new();
    for (frames, many) in [(day, by_day), (night, by_night)] {
        spread(candidates, &frames, many, &mut chosen);
    }
    chosen.sort_unstable();
    chosen
}

/// Adds `many` of these frames to the chosen ones.
fn spread(candidates: &[Candidate], frames: &[usize], many: usize, chosen: &mut Vec<usize>) {
    let loads = || frames.iter().map(|&n| f64::from(candidates[n].load));
    let (low, high) = (loads().fold(f64::MAX, f64::min), loads().fold(0.0, f64::max));
    for step in 0..many {
        let wanted = low + (high - low) * (step as f64 + 0.5) / many as f64;
        let away = |n: usize| {
            let off = |&other: &usize| (candidates[n].time.0 - candidates[other].time.0).abs();
            chosen.iter().map(off).min().unwrap_or(0)
        };
        let best = frames.iter().copied().filter(|n| !chosen.contains(n)).min_by(|&a, &b| {
            let off = |n: usize| (f64::from(candidates[n].load) - wanted).abs();
            off(a).total_cmp(&off(b)).then(away(b).cmp(&away(a))).then(a.cmp(&b))
        });
        chosen.extend(best);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(count: usize) -> Vec<Candidate> {
        let of = |n: usize| Candidate {
            name: format!("{n}.jpg"),
            time: UtcMs(n as i64 * 60_000),
            light: if n.is_multiple_of(5) { Light::Night } else { Light::Day },
            // Nearly always light traffic, as on real roads.
            load: if n % 10 == 3 { 20 + n as u32 / 10 } else { n as u32 % 3 },
        };
        (0..count).map(of).collect()
    }

    #[test]
    fn frames_are_spread_over_light_load_and_time() {
        let frames = frames(200);
        let chosen = choose(&frames, 10);
        assert_eq!(chosen.len(), 10);
        assert_eq!(chosen, choose(&frames, 10), "the same recording gives the same frames");
        let night = chosen.iter().filter(|&&n| frames[n].light == Light::Night).count();
        assert_eq!(night, 2);
        let heavy = chosen.iter().filter(|&&n| frames[n].load >= 20).count();
        assert!((3..=6).contains(&heavy), "{heavy} heavy of 10, where a tenth of all is");
        let span = frames[chosen[9]].time.0 - frames[chosen[0]].time.0;
        assert!(span > 100 * 60_000, "{span}");
        assert!(chosen.windows(2).all(|pair| pair[0] < pair[1]));
    }

    #[test]
    fn a_short_recording_is_counted_whole() {
        assert_eq!(choose(&frames(7), 10), [0, 1, 2, 3, 4, 5, 6]);
        assert_eq!(choose(&[], 10), [0; 0]);
    }
}
