//! Fit to counted frames: the site's score, and the factors of its counts.
//!
//! Owns the estimate and which answers contradict what is seen. The factor of a load is the ratio of
//! what people count to what the line counts, drawn to 1 as strongly as cameras that were not
//! audited differ from each other: with few frames little is corrected and the interval stays wide,
//! with many the frames decide. The residuals of all frames tell how well a ratio is known, as
//! Cochran's "Sampling Techniques" (chapter 6, ratio estimators) has it, with Student's quantile for
//! the few of them.

use crate::density::{Counting, LOADS, LoadBias, SiteCorrection};

/// Fewest frames from which anything follows.
pub const LEAST_FRAMES: usize = 3;
/// Frames that a load needs.
const FRAMES_OF_A_LOAD: usize = 3;
/// Squared difference of a frame for each vehicle that is taken for granted, as one frame's worth:
/// two people differ by that much (`detector/data/audit/README.md`), and no few frames agree so well
/// that none is left.
const DOUBT: f32 = 0.1;
/// Standard deviations of counts by which an answer may be off the others'.
const ODD: f32 = 4.0;
/// Quantiles of Student's distribution at 0.95 over the normal one's, by degrees of freedom from 1.
const STUDENT: [f32; 12] = [3.84, 1.78, 1.43, 1.30, 1.23, 1.18, 1.15, 1.13, 1.11, 1.10, 1.09, 1.08];

/// One frame, counted twice.
#[derive(Clone, Debug, PartialEq)]
pub struct Counted {
    /// Its name.
    pub frame: String,
    /// Vehicles in each lane, by people.
    pub people: Vec<u32>,
    /// Vehicles in each lane that the line has no doubt of.
    pub sure: Vec<u32>,
    /// Vehicles in all lanes together, by the line with each of the scores.
    pub line: Vec<u32>,
    /// Whether it was taken by night.
    pub is_night: bool,
}

impl Counted {
    fn true_count(&self) -> f32 {
        self.people.iter().sum::<u32>() as f32
    }

    fn found(&self, score: usize) -> f32 {
        self.line.get(score).map_or(0.0, |&count| count as f32)
    }
}

/// Why no correction follows.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    /// Too little was counted.
    #[error("{0} frames are counted, {LEAST_FRAMES} are the fewest and 10 are better: count more")]
    TooFew(usize),
    /// An answer is less than what is beyond doubt.
    #[error(
        "frame {frame}, lane {lane}: {people} vehicles are answered and {sure} stand there beyond \
         doubt; count it again (are the lanes numbered as on the sheet?), or leave the frame's \
         counts empty"
    )]
    BelowSure {
        /// The frame.
        frame: String,
        /// The lane.
        lane: u8,
        /// Vehicles that people counted.
        people: u32,
        /// Vehicles that the line is sure of.
        sure: u32,
    },
    /// An answer is off what the other answers make of the line's count.
    #[error(
        "frame {frame}: {people} vehicles are answered, and by the other answers about {expected:.0} \
         stand there; count it again, or leave its counts empty"
    )]
    Odd {
        /// The frame.
        frame: String,
        /// Vehicles that people counted.
        people: u32,
        /// Vehicles expected from the other answers.
        expected: f32,
    },
}

/// The correction that follows from `frames`. `scores` are those with which the line counted,
/// `stated` is the number of the model's own; `lanes` name the lanes; `cameras` is how other
/// cameras differ.
///
/// # Errors
/// [`FitError`] names the answer that contradicts the others.
pub fn fit(
    frames: &[Counted],
    lanes: &[u8],
    scores: &[f32],
    stated: usize,
    cameras: &Counting,
) -> Result<SiteCorrection, FitError> {
    if frames.len() < LEAST_FRAMES {
        return Err(FitError::TooFew(frames.len()));
    }
    frames.iter().try_for_each(|frame| check_sure(frame, lanes))?;
    check_odd(frames, stated)?;
    let score = best_score(frames, scores.len(), stated);
    let nights = frames.iter().filter(|frame| frame.is_night).count() as f32;
    let night = nights / frames.len() as f32;
    let between = |day: f32, by_night: f32| day + night * (by_night - day);
    let relative = between(cameras.day.relative, cameras.night.relative);
    let vehicles = between(cameras.day.vehicles, cameras.night.vehicles);
    let loads = by_load(frames, score);
    let (dispersion, freedom) = dispersion(&loads, score);
    let wider = STUDENT.get(freedom.max(1) - 1).copied().unwrap_or(1.0 + 1.0 / freedom as f32);
    let biases = loads.iter().filter_map(|load| bias(load, score, dispersion, wider, relative));
    let counted_with = scores.get(score).copied();
    let mut correction = SiteCorrection {
        score: counted_with,
        by_load: heapless::Vec::new(),
        vehicles_se: vehicles,
    };
    for bias in biases {
        // Loads that the line counts alike are one.
        if correction.by_load.last().is_none_or(|last| last.counted < bias.counted) {
            let _ = correction.by_load.push(bias);
        }
    }
    let mean =
        frames.iter().map(|frame| frame.found(score) + 1.0).sum::<f32>() / frames.len() as f32;
    let known = frames.len() as f32 / (dispersion * mean * wider * wider);
    correction.vehicles_se = (1.0 / (1.0 / (vehicles * vehicles) + known)).sqrt();
    Ok(correction)
}

/// One vehicle may have two boxes, or stand over a line; two too many are a contradiction.
fn check_sure(frame: &Counted, lanes: &[u8]) -> Result<(), FitError> {
    let all = frame.people.iter().zip(&frame.sure).zip(lanes);
    match all.into_iter().find(|&((people, sure), _)| *sure > people + 1) {
        Some(((&people, &sure), &lane)) => {
            Err(FitError::BelowSure { frame: frame.frame.clone(), lane, people, sure })
        }
        None => Ok(()),
    }
}

fn check_odd(frames: &[Counted], stated: usize) -> Result<(), FitError> {
    for (number, frame) in frames.iter().enumerate() {
        let others = || frames.iter().enumerate().filter(|&(n, _)| n != number).map(|(_, f)| f);
        let (people, line): (f32, f32) =
            (others().map(Counted::true_count).sum(), others().map(|f| f.found(stated)).sum());
        let ratio = if line > 0.0 { (people / line).clamp(0.5, 2.0) } else { 1.0 };
        let expected = frame.found(stated) * ratio;
        let off = (frame.true_count() - expected).abs();
        if off > ODD * (frame.true_count().max(expected) + 1.0).sqrt() {
            let people = frame.people.iter().sum();
            return Err(FitError::Odd { frame: frame.frame.clone(), people, expected });
        }
    }
    Ok(())
}

/// The score whose counts differ least: another than the stated one must earn the number that it
/// costs (Schwarz's criterion).
fn best_score(frames: &[Counted], scores: usize, stated: usize) -> usize {
    let n = frames.len() as f32;
    let cost = |score: usize| {
        let off = |frame: &Counted| (frame.true_count() - frame.found(score)).powi(2);
        let squares: f32 = frames.iter().map(off).sum();
        n * (squares / n + 0.25).ln() + if score == stated { 0.0 } else { n.ln() }
    };
    (0..scores).min_by(|&a, &b| cost(a).total_cmp(&cost(b))).unwrap_or(stated)
}

/// The frames by rising load, in as many parts as are known apart.
fn by_load(frames: &[Counted], score: usize) -> Vec<Vec<&Counted>> {
    let mut rising: Vec<&Counted> = frames.iter().collect();
    rising.sort_by(|a, b| a.found(score).total_cmp(&b.found(score)).then(a.frame.cmp(&b.frame)));
    let parts = (frames.len() / FRAMES_OF_A_LOAD).clamp(1, LOADS);
    let cut = |part: usize| part * rising.len() / parts;
    (0..parts).map(|part| rising[cut(part)..cut(part + 1)].to_vec()).collect()
}

/// Squared residual for each vehicle, and the degrees of freedom that it has.
fn dispersion(loads: &[Vec<&Counted>], score: usize) -> (f32, usize) {
    let (mut sum, mut freedom) = (DOUBT, 1);
    for load in loads {
        let ratio = ratio(load, score).unwrap_or(1.0);
        let of = |frame: &&Counted| {
            let found = frame.found(score);
            (frame.true_count() - ratio * found).powi(2) / (found + 1.0)
        };
        sum += load.iter().map(of).sum::<f32>();
        freedom += load.len() - 1;
    }
    (sum / freedom as f32, freedom)
}

fn ratio(load: &[&Counted], score: usize) -> Option<f32> {
    let people: f32 = load.iter().map(|frame| frame.true_count()).sum();
    let line: f32 = load.iter().map(|frame| frame.found(score)).sum();
    (line > 0.0).then_some(people / line)
}

fn bias(
    load: &[&Counted],
    score: usize,
    dispersion: f32,
    wider: f32,
    relative: f32,
) -> Option<LoadBias> {
    let ratio = ratio(load, score)?;
    let line: f32 = load.iter().map(|frame| frame.found(score)).sum();
    let se = (dispersion * (line + load.len() as f32)).sqrt() / line * wider;
    let (frames, cameras) = (1.0 / (se * se), 1.0 / (relative * relative));
    Some(LoadBias {
        counted: line / load.len() as f32,
        factor: (frames * ratio + cameras) / (frames + cameras),
        factor_se: (1.0 / (frames + cameras)).sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::density::Spread;

    const CAMERAS: Counting = Counting {
        day: Spread { vehicles: 0.4, relative: 0.14 },
        night: Spread { vehicles: 0.3, relative: 0.1 },
    };
    const SCORES: [f32; 3] = [0.3, 0.5, 0.7];

    /// A frame where people count so many, and the line with each score.
    fn frame(number: usize, people: u32, line: [u32; 3]) -> Counted {
        Counted {
            frame: format!("{number:02}.jpg"),
            people: vec![people / 2, people - people / 2],
            sure: vec![0, 0],
            line: line.to_vec(),
            is_night: false,
        }
    }

    fn fitted(frames: &[Counted]) -> Result<SiteCorrection, FitError> {
        fit(frames, &[1, 2], &SCORES, 1, &CAMERAS)
    }

    /// Frames of 4 to 40 vehicles of which the line misses every fifth.
    fn missing_a_fifth(count: usize) -> Vec<Counted> {
        let of = |n: usize| {
            let people = 4 + (n as u32 * 7) % 37;
            let line = people - people / 5;
            frame(n, people, [line, line, line])
        };
        (0..count).map(of).collect()
    }

    #[test]
    fn what_is_missed_is_made_up_for_and_more_frames_tell_more() {
        let few = fitted(&missing_a_fifth(4)).expect("a correction");
        let many = fitted(&missing_a_fifth(30)).expect("a correction");
        assert_eq!((few.by_load.len(), many.by_load.len(), many.score), (1, LOADS, Some(0.5)));
        let heaviest = many.by_load.last().expect("loads");
        assert!((heaviest.factor - 1.25).abs() < 0.03, "{heaviest:?}");
        let (_, few_se) = few.at(20.0).expect("known");
        let (_, many_se) = many.at(20.0).expect("known");
        assert!(many_se < 0.5 * few_se, "{many_se} {few_se}");
        assert!(few_se < CAMERAS.day.relative && few.vehicles_se < CAMERAS.day.vehicles);
        assert!(many.vehicles_se < few.vehicles_se);
    }

    #[test]
    fn the_score_that_counts_right_becomes_the_sites() {
        let low: Vec<_> =
            (0..10).map(|n| frame(n, 10 + n as u32, [10 + n as u32, 7 + n as u32, 4])).collect();
        assert_eq!(fitted(&low).expect("a correction").score, Some(0.3));
        // A little better is not enough for another score.
        let mut close = missing_a_fifth(6);
        close[0].line[0] += 1;
        assert_eq!(fitted(&close).expect("a correction").score, Some(0.5));
    }

    #[test]
    fn an_empty_road_has_no_factor() {
        let frames: Vec<_> = (0..5).map(|n| frame(n, 0, [0, 0, 0])).collect();
        let correction = fitted(&frames).expect("a correction");
        assert!(correction.by_load.is_empty() && correction.vehicles_se < CAMERAS.day.vehicles);
    }

    #[test]
    fn contradictions_are_named() {
        assert_eq!(fitted(&missing_a_fifth(2)), Err(FitError::TooFew(2)));
        let mut frames = missing_a_fifth(8);
        frames[3].sure[1] = frames[3].people[1] + 2;
        let error = fitted(&frames).expect_err("less than what is sure").to_string();
        assert!(error.contains("frame 03.jpg, lane 2"), "{error}");
        let mut frames = missing_a_fifth(8);
        frames[5].people = vec![60, 60];
        let error = fitted(&frames).expect_err("ten times as many").to_string();
        assert!(error.contains("frame 05.jpg: 120 vehicles"), "{error}");
    }
}
