//! Each mark against everything else: what the other cues make of its length.
//!
//! Owns leaving a mark out of a fit to first order (no second fit), finding a standard that another
//! would replace without a trace, and what to say where a length, above all a national standard's,
//! contradicts the rest. Does not own the fit's own residuals, which a strong mark keeps small by
//! bending the camera (see the chapter's `mod`).

use super::cues::{Cues, MarkCue};
use super::marks;
use super::problem::Problem;
use super::view::{CAMERA, STEP, Unknowns, View};
use crate::road::standards::{self, Standard};
use nalgebra::{DMatrix, DVector, SMatrix};
use std::fmt;

/// Beyond so many standard deviations, its own tolerance among them, a length contradicts the
/// others.
pub const DOUBTED: f64 = 3.0;
/// A standard within so many standard deviations of what the others make is named instead.
const LIKELY: f64 = 2.0;
/// Most standards that are named instead.
const NAMED: usize = 4;

/// A standard is unchecked where its pitch times one of these would fit as well.
const FACTORS: [f64; 2] = [0.5, 2.0];
/// A fit is as good as another up to this much more of the cost: three standard deviations.
const AS_GOOD: f64 = 0.5 * DOUBTED * DOUBTED;

/// A length that everything else contradicts, or a standard that nothing else checks.
#[derive(Clone, Debug)]
pub struct Doubt {
    /// What the mark is called.
    pub name: String,
    /// The standard that gave the length, by name.
    pub standard: Option<String>,
    /// The length as given, m.
    pub known_m: f64,
    /// What contradicts it; `None` where nothing checks it.
    pub others: Option<Others>,
}

/// A length as everything else makes it.
#[derive(Clone, Debug)]
pub struct Others {
    /// The length, m.
    pub metres: f64,
    /// Standard error of that as a part of it, the stated tolerance and the reading of the points
    /// among it.
    pub rel_sd: f64,
    /// Standards that would fit.
    pub instead: Vec<&'static Standard>,
}

impl fmt::Display for Doubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Doubt { name, known_m, standard, .. } = self;
        let Some(Others { metres, rel_sd, instead }) = &self.others else {
            return write!(
                f,
                "{name}: nothing else checks these {known_m:.2} m: half or twice as much would fit \
                 as well, with another camera; be sure that it is this road's standard, measure \
                 one length on the road, or add the traffic"
            );
        };
        write!(
            f,
            "{name} is given as {known_m:.2} m, and everything else makes it {metres:.2} m \
             (+- {:.0} %): ",
            100.0 * rel_sd
        )?;
        if standard.is_none() {
            return f.write_str("measure it again, or look at its points");
        }
        if !instead.is_empty() {
            let of = |s: &&Standard| format!("{} ({:.2} m)", s.name, s.pitch_m());
            let named: Vec<String> = instead.iter().map(of).collect();
            write!(f, "{} would fit; ", named.join(", "))?;
        }
        f.write_str(
            "check which line it is and that each point is the start of the next dash, measure one \
             length on the road, or leave the standard out",
        )
    }
}

/// The standards of these cues that half or twice their pitch would serve as well as they do.
/// Where there is traffic it checks them, and a fit takes long: none are looked for.
pub fn unchecked(cues: &Cues, image_size: [u32; 2], cost: f64) -> Vec<Doubt> {
    if !cues.boxes.is_empty() {
        return Vec::new();
    }
    let fits_with = |k: usize, factor: f64| {
        let mut other = cues.clone();
        other.marks[k].segment_m *= factor;
        let found = Problem::new(&other, image_size).and_then(|mut p| p.solve());
        found.is_some_and(|o| o.cost < cost + AS_GOOD)
    };
    let standard = |(_, m): &(usize, &MarkCue)| m.standard.is_some();
    let open = |(k, _): &(usize, &MarkCue)| FACTORS.iter().any(|f| fits_with(*k, *f));
    let doubt = |(_, m): (usize, &MarkCue)| Doubt {
        name: m.name.clone(),
        standard: m.standard.clone(),
        known_m: m.segment_m,
        others: None,
    };
    cues.marks.iter().enumerate().filter(standard).filter(open).map(doubt).collect()
}

/// What leaving a mark out needs of a fit.
pub struct Fitted<'a> {
    /// The camera at the optimum.
    pub camera: &'a Unknowns,
    /// Information on it, everything else integrated out.
    pub information: &'a SMatrix<f64, CAMERA, CAMERA>,
    /// Size of the pictures, px.
    pub image_size: [u32; 2],
    /// Weight of each mark in the fit.
    pub weights: &'a [f64],
}

impl Fitted<'_> {
    /// The marks that everything else contradicts.
    pub fn contradicted(&self, cues: &[MarkCue]) -> Vec<Doubt> {
        let of = |(k, mark): (usize, &MarkCue)| {
            let [log_ratio, rel_sd] = self.without(mark, self.weights[k])?;
            let metres = mark.segment_m * log_ratio.exp();
            (log_ratio.abs() > DOUBTED * rel_sd).then(|| Doubt {
                name: mark.name.clone(),
                standard: mark.standard.clone(),
                known_m: mark.segment_m,
                others: Some(Others { metres, rel_sd, instead: fitting(metres, rel_sd) }),
            })
        };
        cues.iter().enumerate().filter_map(of).collect()
    }

    /// Logarithm of a mark's length as the other cues make it over the known one, and its standard
    /// error; `None` where the others do not determine a camera.
    fn without(&self, mark: &MarkCue, weight: f64) -> Option<[f64; 2]> {
        let view = View::new(self.camera, self.image_size);
        let white = marks::whitening(mark, &view)?;
        let r = &white * marks::log_ratios(mark, &view)?;
        let mut slopes = DMatrix::zeros(r.len(), CAMERA);
        for (k, step) in STEP.into_iter().enumerate() {
            let mut at = *self.camera;
            at[k] += step;
            let moved = &white * marks::log_ratios(mark, &View::new(&at, self.image_size))?;
            slopes.set_column(k, &((moved - &r) / step));
        }
        let own: SMatrix<f64, CAMERA, CAMERA> = {
            let own = slopes.transpose() * &slopes * weight;
            own.fixed_view::<CAMERA, CAMERA>(0, 0).into_owned()
        };
        // At the optimum the others pull as hard as the mark does: one Newton step without it.
        let covariance = (self.information - own).cholesky()?.inverse();
        let spread = &slopes * covariance;
        let r = &r + &spread * (slopes.transpose() * &r) * weight;
        let n = r.len();
        let of_residuals = DMatrix::identity(n, n) + &spread * slopes.transpose();
        // The one factor on the known length that explains the residuals best.
        let all = white * DVector::repeat(n, 1.0);
        let weighed = of_residuals.cholesky()?.solve(&all);
        let information = weighed.dot(&all);
        (information > 0.0).then(|| [weighed.dot(&r) / information, information.powf(-0.5)])
    }
}

/// The standards whose pitch agrees with a length (m), the nearest first.
fn fitting(metres: f64, rel_sd: f64) -> Vec<&'static Standard> {
    let away = |s: &Standard| (s.pitch_m() / metres).ln().abs();
    let mut all: Vec<&Standard> =
        standards::all().iter().filter(|s| away(s) < LIKELY * rel_sd).collect();
    all.sort_by(|a, b| away(a).total_cmp(&away(b)));
    all.truncate(NAMED);
    all
}
