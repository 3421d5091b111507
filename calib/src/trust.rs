//! The verdict on a calibration: whether lengths measured with it may be used.
//!
//! Owns the verdict, its reasons, their limits, and the rules that need no vehicle. Does not own
//! the rules for labelled vehicles (see `methods::verdict`) nor what happens to a calibration that
//! fails them (`table` refuses it unless forced).

use crate::camera::Camera;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;

/// Fewest vehicles of a method that states no error: one or two leave the focal length open.
pub const MIN_VEHICLES: usize = 3;
/// Largest stated standard error of a length: beyond it a density is off by more than the
/// paper's own error of 8 to 16 %.
pub const MAX_REL_ERR: f64 = 0.15;
/// The same at the far end, where fewer vehicles are seen.
pub const MAX_FAR_REL_ERR: f64 = 0.25;
/// Largest stated standard error of a length across the road: beyond it the 90 % interval of a
/// lane's width reaches half way (a factor of the root of two) to that of two lanes, and a vehicle's
/// place in its lane to the next one.
pub const MAX_ACROSS_REL_ERR: f64 = 0.20;
/// A camera over a road stands between these heights, m.
pub const HEIGHT_RANGE_M: [f64; 2] = [2.0, 80.0];
/// Largest typical misfit of a key point as a part of the picture's width: 3.2 px of 320.
pub const MAX_MISFIT_WIDTH_FRACTION: f64 = 0.01;

/// Whether a calibration may be used.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Trust {
    /// It may.
    #[default]
    Ok,
    /// It must not, unless forced.
    Refused(Reason),
}

/// Why a calibration must not be used.
#[derive(Clone, Debug, PartialEq)]
pub enum Reason {
    /// Too few vehicles for a method that does not know its own error.
    FewVehicles {
        /// How many there are.
        actual: usize,
    },
    /// A method that looks at a single vehicle, whose focal length is a guess.
    SingleVehicle {
        /// The method.
        method: &'static str,
    },
    /// No camera over a road stands so high or so low.
    Height {
        /// Height of the camera, m.
        height_m: f64,
    },
    /// The search of the focal length ended at its bound.
    FocalBound {
        /// Focal length, px.
        f_px: f64,
    },
    /// The key points of a vehicle do not fit.
    Misfit {
        /// The vehicle.
        vehicle: String,
        /// Root mean square misfit, px.
        misfit_px: f64,
        /// The limit, px.
        limit_px: f64,
    },
    /// Vehicles are likelier another body than the cars that they are taken for.
    OtherBody {
        /// The vehicles.
        vehicles: Vec<String>,
        /// What they are likelier.
        body: &'static str,
        /// Odds of that.
        odds: f64,
    },
    /// A vehicle stands on no road of the others.
    Misplaced {
        /// The vehicle.
        vehicle: String,
        /// Height (m) and focal length (px) of the camera with it.
        with: [f64; 2],
        /// The same without it.
        without: [f64; 2],
        /// The label of a key point that lies above the horizon of the others.
        aloft: Option<u8>,
    },
    /// A length contradicts the other cues.
    Contradiction {
        /// The mark.
        name: String,
        /// Its length as given, m.
        known_m: f64,
        /// Its length as the others have it, m.
        measured_m: f64,
    },
    /// A rectangle is none on the road of the other cues.
    Crooked {
        /// The rectangle.
        name: String,
        /// Its first angle there, degrees.
        angle_deg: f64,
        /// Its sides there, m.
        sides_m: [f64; 2],
    },
    /// A lane has a width that no lane has, on the road of everything but the lanes.
    LaneWidth {
        /// The lane, or its lines.
        name: String,
        /// Its mean width there, m.
        width_m: f64,
        /// Width that was stated, or that lanes have on average, m.
        expected_m: f64,
    },
    /// The stated error of a length at the far end is too large.
    UncertainFar {
        /// Standard error of a length there as a part of it.
        rel_err: f64,
        /// What to add as a remedy, where that is known.
        add: Option<String>,
    },
    /// The stated error of a length is too large.
    Uncertain {
        /// Standard error of a length as a part of it.
        rel_err: f64,
        /// What to add as a remedy, where that is known.
        add: Option<String>,
    },
    /// The stated error of a length across the road is too large.
    UncertainAcross {
        /// Where, in words.
        place: String,
        /// The length there, m.
        length_m: f64,
        /// Its standard error as a part of it.
        rel_err: f64,
        /// What to add as a remedy, where that is known.
        add: Option<String>,
    },
    /// A key point lies at or above the horizon.
    AboveHorizon {
        /// The vehicle.
        vehicle: String,
        /// The key point's label.
        label: u8,
        /// Where it is, px.
        uv: [f64; 2],
    },
    /// As a file that was read states it.
    Stated(String),
}

impl Trust {
    /// The first reason that there is, or none.
    pub fn of(reason: Option<Reason>) -> Self {
        reason.map_or(Trust::Ok, Trust::Refused)
    }
}

/// Value of a trusted calibration in its file.
const TRUSTED: &str = "ok";

impl fmt::Display for Trust {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Trust::Ok => f.write_str(TRUSTED),
            Trust::Refused(reason) => reason.fmt(f),
        }
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Reason::FewVehicles { actual } => write!(
                f,
                "{actual} vehicle(s) do not determine the focal length; label at least \
                 {MIN_VEHICLES}, or use joint"
            ),
            Reason::SingleVehicle { method } => {
                write!(f, "{method} looks at one vehicle; use joint or mvcalib")
            }
            Reason::Height { height_m } => {
                write!(f, "the camera would stand {height_m:.1} m above the road")
            }
            Reason::FocalBound { f_px } => {
                write!(f, "the focal length {f_px:.0} px ended at its bound")
            }
            Reason::Misfit { vehicle, misfit_px, limit_px } => write!(
                f,
                "the key points of {vehicle} miss their fit by {misfit_px:.1} px \
                 (limit {limit_px:.1} px)"
            ),
            Reason::OtherBody { vehicles, body, odds } => write!(
                f,
                "taken for a car and likelier a {body} ({:.0} to 1): {}; set the flag {body}, or \
                 leave it out: a {body} taken for a car makes every length wrong",
                odds.min(9999.0),
                vehicles.join(", "),
            ),
            Reason::Misplaced { vehicle, with, without, aloft } => {
                write!(
                    f,
                    "{vehicle} does not stand on the road of the others: with it the camera is \
                     {:.0} m high with f {:.0} px, without it {:.0} m and {:.0} px",
                    with[0], with[1], without[0], without[1],
                )?;
                match aloft {
                    Some(label) => {
                        write!(f, ", and its key point {label} lies above their horizon")
                    }
                    None => Ok(()),
                }
            }
            Reason::Uncertain { rel_err, add } => {
                let (percent, limit) = (100.0 * rel_err, 100.0 * MAX_REL_ERR);
                write!(f, "lengths are uncertain by {percent:.0} % (limit {limit:.0} %)")?;
                add.as_ref().map_or(Ok(()), |add| write!(f, "; add {add}"))
            }
            Reason::UncertainFar { rel_err, add } => {
                let (percent, limit) = (100.0 * rel_err, 100.0 * MAX_FAR_REL_ERR);
                write!(
                    f,
                    "lengths at the far end are uncertain by {percent:.0} % (limit {limit:.0} %)"
                )?;
                add.as_ref().map_or(Ok(()), |add| write!(f, "; add {add}"))
            }
            Reason::UncertainAcross { place, length_m, rel_err, add } => {
                let (percent, limit) = (100.0 * rel_err, 100.0 * MAX_ACROSS_REL_ERR);
                write!(
                    f,
                    "across the road lengths are uncertain by {percent:.0} % (limit {limit:.0} %; \
                     {place}: {:.1} of {length_m:.1} m): a vehicle could count in the wrong lane",
                    rel_err * length_m
                )?;
                add.as_ref().map_or(Ok(()), |add| write!(f, "; add {add}"))
            }
            Reason::Contradiction { name, known_m, measured_m } => write!(
                f,
                "{name} is given as {known_m:.2} m, and everything else makes it {measured_m:.2} m; \
                 look at its points and its length"
            ),
            Reason::Crooked { name, angle_deg, sides_m: [a, b] } => write!(
                f,
                "{name} is not right-angled, or not of its stated size, on the road of everything \
                 else ({angle_deg:.0} degrees, {a:.2} x {b:.2} m there); look at its corners"
            ),
            Reason::LaneWidth { name, width_m, expected_m } => write!(
                f,
                "{name}: everything else makes this lane {width_m:.1} m wide, where {expected_m:.1} m was \
                 expected; draw the missing line, mark where no lane lies, or give the width of \
                 the lanes"
            ),
            Reason::AboveHorizon { vehicle, label, uv: [u, v] } => write!(
                f,
                "{vehicle}, key point {label} at ({u:.1}, {v:.1}) px lies above the horizon"
            ),
            Reason::Stated(text) => f.write_str(text),
        }
    }
}

impl Serialize for Trust {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Trust {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        let text = String::deserialize(d)?;
        Ok(if text == TRUSTED { Trust::Ok } else { Trust::Refused(Reason::Stated(text)) })
    }
}

/// Whether a camera stands at no height over a road.
pub fn height(camera: &Camera) -> Option<Reason> {
    let height_m = camera.height_m();
    let [low, high] = HEIGHT_RANGE_M;
    (!(low..=high).contains(&height_m)).then_some(Reason::Height { height_m })
}

/// Whether the stated error of a length is too large, or not a number; `add` says what would
/// fix it.
pub fn uncertain(rel_err: Option<f64>, add: impl FnOnce() -> Option<String>) -> Option<Reason> {
    let rel_err = rel_err.filter(|e| e.is_nan() || *e > MAX_REL_ERR)?;
    Some(Reason::Uncertain { rel_err, add: add() })
}

/// The same at the far end of what is seen.
pub fn uncertain_far(rel_err: f64, add: impl FnOnce() -> Option<String>) -> Option<Reason> {
    let bad = rel_err.is_nan() || rel_err > MAX_FAR_REL_ERR;
    bad.then(|| Reason::UncertainFar { rel_err, add: add() })
}

/// The same of a length across the road.
pub fn uncertain_across(
    place: String,
    [length_m, rel_err]: [f64; 2],
    add: impl FnOnce() -> Option<String>,
) -> Option<Reason> {
    let bad = rel_err.is_nan() || rel_err > MAX_ACROSS_REL_ERR;
    bad.then(|| Reason::UncertainAcross { place, length_m, rel_err, add: add() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_verdict_is_a_text_in_files_and_comes_back() {
        let ok: Trust = serde_json::from_str("\"ok\"").unwrap();
        assert_eq!(ok, Trust::Ok);
        let refused = Trust::Refused(Reason::Height { height_m: 300.0 });
        let text = serde_json::to_string(&refused).unwrap();
        let back: Trust = serde_json::from_str(&text).unwrap();
        assert_ne!(back, Trust::Ok);
        assert_eq!(back.to_string(), refused.to_string());
    }
}
