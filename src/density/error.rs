//! How well a density is known: sampling, calibration and counting in one interval.
//!
//! Owns what is known of the errors that more frames do not make smaller, and how they join the
//! sampling error of a window. Does not know where they were measured: the calibration's error is
//! in the lane table, the counting's beside the model or in the site's own file.
//!
//! The three are independent, so that their variances add. With N vehicles counted a frame in a
//! lane of length L (k = N/L, Hu et al., Eq. 1): sampling has the standard error of
//! [`super::counts`]; a length that is wrong by the part e makes k wrong by e k; and counting errs
//! by a part of N (vehicles hidden, or counted twice) and by a number that stands there
//! in an empty road too (a mark that passes for a car). Where vehicles of a queue are estimated that
//! nobody saw ([`crate::hidden`]), counting errs by a part of their number too. The interval is k plus and minus 1.645 of
//! the joint standard error, which holds 90 % of a normal error, and not below 0.

use crate::hidden::HIDDEN_REL_ERR;
use crate::report::DensityError;
use serde::{Deserialize, Serialize};

/// Standard errors to each side of the mean that hold 90 % of a normal distribution.
const Z90: f32 = 1.645;
/// Loads at which a site's count bias is known.
pub const LOADS: usize = 3;

/// One standard error of a camera's mean count, over cameras.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spread {
    /// Vehicles in the whole view, whatever the load.
    pub vehicles: f32,
    /// Part of the count.
    pub relative: f32,
}

/// The counting error: by light, unless the site has an audit of its own.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Counting {
    /// By daylight.
    pub day: Spread,
    /// By night.
    pub night: Spread,
}

/// How a site's count differs from what people count there, at one load.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LoadBias {
    /// Mean number of vehicles that the line counts in the view at this load.
    pub counted: f32,
    /// By what a count is multiplied.
    pub factor: f32,
    /// One standard error of the factor.
    pub factor_se: f32,
}

/// Result of a site's audit: its own score, and its count bias by load.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SiteCorrection {
    /// Least score that counts here; `None`: as the model has it.
    pub score: Option<f32>,
    /// Bias at light, middle and heavy traffic, by rising load; between two loads it is
    /// interpolated, beyond the outermost it stays. Empty: the count is not corrected.
    pub by_load: heapless::Vec<LoadBias, LOADS>,
    /// One standard error of a mean count that is left at any load, vehicles in the view.
    pub vehicles_se: f32,
}

impl SiteCorrection {
    /// Factor, and its standard error, for `counted` vehicles in the view.
    pub fn at(&self, counted: f32) -> Option<(f32, f32)> {
        let mut before: Option<&LoadBias> = None;
        for bias in &self.by_load {
            if counted <= bias.counted {
                return Some(before.map_or((bias.factor, bias.factor_se), |low| {
                    let span = bias.counted - low.counted;
                    let t = if span > 0.0 { (counted - low.counted) / span } else { 1.0 };
                    let between = |a: f32, b: f32| a + t * (b - a);
                    (between(low.factor, bias.factor), between(low.factor_se, bias.factor_se))
                }));
            }
            before = Some(bias);
        }
        before.map(|last| (last.factor, last.factor_se))
    }
}

/// Traffic and light behind a window's count.
#[derive(Clone, Copy, Debug)]
pub(super) struct Load {
    /// Mean number of vehicles that were counted in all lanes together.
    pub(super) vehicles: f32,
    /// Share of the frames that were taken by night, 0 to 1.
    pub(super) night: f32,
    /// The lane's share of the length of all lanes, 0 to 1.
    pub(super) share: f32,
}

/// The errors that are known of a sensor.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Errors {
    /// The model's counting error.
    pub counting: Option<Counting>,
    /// Result of this site's audit.
    pub site: Option<SiteCorrection>,
}

impl Errors {
    /// By what a window's counts are multiplied.
    pub(super) fn factor(&self, load: Load) -> f32 {
        self.site.as_ref().and_then(|site| site.at(load.vehicles)).map_or(1.0, |(factor, _)| factor)
    }

    /// One standard error of the mean count of a lane, from counting: `mean` vehicles after
    /// correction. What does not depend on the load spreads over the lanes as independent errors
    /// do, by the root of their share.
    fn counting(&self, mean: f32, load: Load) -> Option<f32> {
        let root = libm::sqrtf(load.share);
        if let Some(site) = &self.site
            && let Some((factor, factor_se)) = site.at(load.vehicles)
            && factor > 0.0
        {
            return Some(libm::hypotf(mean * factor_se / factor, site.vehicles_se * root));
        }
        let known = self.counting?;
        let of = |spread: Spread| libm::hypotf(mean * spread.relative, spread.vehicles * root);
        Some(of(known.day) * (1.0 - load.night) + of(known.night) * load.night)
    }

    /// One standard error of the vehicles that are missed or counted twice, as a part of those that
    /// drive: without what stands in an empty road too, which covers no distance. The larger of day
    /// and night; `None` where it is not known, or where the site's audit has it.
    pub fn of_those_that_drive(&self) -> Option<f32> {
        let is_corrected = self.site.as_ref().is_some_and(|site| !site.by_load.is_empty());
        let Counting { day, night } = self.counting.filter(|_| !is_corrected)?;
        Some(day.relative.max(night.relative))
    }

    /// The error of a density of `mean` vehicles (after correction), of which nobody saw the part
    /// `hidden`, in a lane of `length_km`, whose sampling error is `sampling` veh/km; `None` where a
    /// part of it is not known.
    pub(super) fn of(
        &self,
        (mean, hidden): (f32, f32),
        sampling: f32,
        (length_km, length_rel_err): (f32, Option<f32>),
        load: Load,
    ) -> Option<DensityError> {
        let density = mean / length_km;
        let calibration = density * length_rel_err?;
        let unseen = HIDDEN_REL_ERR * mean * hidden;
        let counting = libm::hypotf(self.counting(mean, load)?, unseen) / length_km;
        let joint = libm::hypotf(libm::hypotf(sampling, calibration), counting);
        let low = density - Z90 * joint;
        let ci90 = [if low > 0.0 { low } else { 0.0 }, density + Z90 * joint];
        Some(DensityError { calibration, counting, ci90 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COUNTING: Counting = Counting {
        day: Spread { vehicles: 0.4, relative: 0.1 },
        night: Spread { vehicles: 0.8, relative: 0.2 },
    };
    const LOAD: Load = Load { vehicles: 8.0, night: 0.0, share: 0.25 };

    fn site(by_load: &[(f32, f32, f32)]) -> SiteCorrection {
        let bias = |&(counted, factor, factor_se): &(f32, f32, f32)| LoadBias {
            counted,
            factor,
            factor_se,
        };
        SiteCorrection {
            score: None,
            by_load: by_load.iter().map(bias).collect(),
            vehicles_se: 0.1,
        }
    }

    #[test]
    fn variances_add_and_the_interval_is_not_below_zero() {
        let errors = Errors { counting: Some(COUNTING), site: None };
        let error = errors.of((2.0, 0.0), 3.0, (0.1, Some(0.05)), LOAD).expect("all is known");
        // Of 20 veh/km: 5 % of length; 0.1 of 2 vehicles and half of 0.4 in 0.1 km.
        assert!((error.calibration - 1.0).abs() < 1e-5);
        assert!((error.counting - libm::sqrtf(8.0)).abs() < 1e-5, "{error:?}");
        let joint = libm::sqrtf(9.0 + 1.0 + 8.0);
        let [low, high] = error.ci90;
        assert!((high - 20.0 - 1.645 * joint).abs() < 1e-4 && (low + high - 40.0).abs() < 1e-4);
        let empty = errors.of((0.0, 0.0), 1.0, (0.1, Some(0.05)), LOAD).expect("all is known");
        assert!(empty.ci90[0] == 0.0 && empty.ci90[1] > 3.0 && empty.calibration == 0.0);
    }

    #[test]
    fn vehicles_that_nobody_saw_are_known_to_a_part() {
        let errors = Errors { counting: Some(COUNTING), site: None };
        let of = |hidden| errors.of((8.0, hidden), 0.0, (0.1, Some(0.0)), LOAD).expect("known");
        let (none, quarter) = (of(0.0).counting, of(0.25).counting);
        assert!((quarter - libm::hypotf(none, 10.0 * HIDDEN_REL_ERR * 2.0)).abs() < 1e-4);
    }

    #[test]
    fn an_interval_needs_every_part() {
        let errors = Errors { counting: Some(COUNTING), site: None };
        assert_eq!(errors.of((2.0, 0.0), 3.0, (0.1, None), LOAD), None, "no error of the length");
        let errors = Errors::default();
        assert_eq!(
            errors.of((2.0, 0.0), 3.0, (0.1, Some(0.05)), LOAD),
            None,
            "no error of counting"
        );
    }

    #[test]
    fn a_window_at_dusk_lies_between_day_and_night() {
        let errors = Errors { counting: Some(COUNTING), site: None };
        let at = |night| {
            let load = Load { night, ..LOAD };
            errors.of((2.0, 0.0), 0.0, (0.1, Some(0.0)), load).expect("all is known").counting
        };
        assert!((at(1.0) - 2.0 * at(0.0)).abs() < 1e-4);
        assert!((at(0.5) - 1.5 * at(0.0)).abs() < 1e-4);
    }

    #[test]
    fn a_sites_own_bias_takes_the_place_of_the_spread_over_cameras() {
        let site = site(&[(2.0, 0.8, 0.10), (10.0, 1.0, 0.02), (20.0, 1.2, 0.04)]);
        let near = |counted, factor: f32, se: f32| {
            let (f, s) = site.at(counted).expect("three loads");
            assert!((f - factor).abs() < 1e-5 && (s - se).abs() < 1e-5, "{counted}: {f} {s}");
        };
        near(0.0, 0.8, 0.10);
        near(6.0, 0.9, 0.06);
        near(15.0, 1.1, 0.03);
        near(99.0, 1.2, 0.04);
        let errors = Errors { counting: Some(COUNTING), site: Some(site) };
        assert!((errors.factor(LOAD) - 0.95).abs() < 1e-5);
        let error = errors.of((1.9, 0.0), 0.0, (0.1, Some(0.0)), LOAD).expect("all is known");
        let expected = libm::hypotf(1.9 * 0.04 / 0.95, 0.1 * 0.5) / 0.1;
        assert!((error.counting - expected).abs() < 1e-4, "{error:?}");
    }

    #[test]
    fn an_audit_without_a_bias_leaves_the_count_and_its_spread() {
        let errors = Errors { counting: Some(COUNTING), site: Some(site(&[])) };
        assert_eq!(errors.factor(LOAD), 1.0);
        let without = Errors { counting: Some(COUNTING), site: None };
        let of = |errors: &Errors| errors.of((2.0, 0.0), 3.0, (0.1, Some(0.05)), LOAD);
        assert_eq!(of(&errors), of(&without));
        assert_eq!(errors.of_those_that_drive(), Some(0.2), "by night");
        let corrected = Errors { site: Some(site(&[(2.0, 0.8, 0.1)])), ..errors };
        assert_eq!(corrected.of_those_that_drive(), None);
    }
}
