//! The residuals of all cues at a state of the unknowns, and their information.
//!
//! Owns what is held of the cues' noise while the unknowns move, and the derivatives. Does not own
//! the cues' own residuals (see `marks`, `lanes`, `mixture`) nor the steps (see `solve`).

use super::cues::{Cues, LANE_EACH_M, LANE_WIDTH_M, STATED_WIDTH_SD_M};
use super::lanes::{self, Middle, OnRoad};
use super::marks;
use super::mixture::{Bounding, Mixture};
use super::prior::Prior;
use super::traffic::{SHARED, SHARED_SD, Shared, Traffic};
use super::view::{CAMERA, STEP, Unknowns, View};
use nalgebra::{DMatrix, DVector, SMatrix, SVector};

/// All unknowns: the camera, and what boxes share.
pub const ALL: usize = CAMERA + SHARED;
/// All unknowns as one vector.
pub type Theta = SVector<f64, ALL>;
/// Square information on all unknowns.
pub type Information = SMatrix<f64, ALL, ALL>;

/// Everything that is held while the unknowns move.
pub struct Problem<'a> {
    pub(super) cues: &'a Cues,
    pub(super) image_size: [u32; 2],
    pub(super) prior: Prior,
    pub(super) traffic: Traffic,
    pub(super) mark_white: Vec<DMatrix<f64>>,
    pub(super) mark_weight: Vec<f64>,
    pub(super) rectangle_white: Vec<DMatrix<f64>>,
    pub(super) rectangle_weight: Vec<f64>,
    lane_held: Vec<Option<lanes::Held>>,
    width_white: DMatrix<f64>,
    /// Steps taken, evaluations of all residuals.
    pub evaluations: usize,
    /// The points that bound the boxes' bodies at the latest state.
    pub(super) bounding: Bounding,
}

/// The camera of a state.
pub fn camera_of(theta: &Theta) -> Unknowns {
    theta.fixed_rows::<CAMERA>(0).into_owned()
}

/// What boxes share of a state.
pub fn shared_of(theta: &Theta) -> Shared {
    theta.fixed_rows::<SHARED>(CAMERA).into_owned()
}

fn middles(lanes: &[Option<OnRoad>]) -> Vec<Option<Middle>> {
    lanes.iter().map(|lane| lane.as_ref().map(OnRoad::middle)).collect()
}

impl<'a> Problem<'a> {
    /// The cues over pictures of this size; `None` where labelled vehicles leave the camera
    /// open.
    pub fn new(cues: &'a Cues, image_size: [u32; 2]) -> Option<Self> {
        Some(Problem {
            prior: Prior::of(cues, image_size)?,
            traffic: Traffic::choose(&cues.boxes, &cues.lanes, image_size),
            cues,
            image_size,
            mark_white: Vec::new(),
            mark_weight: vec![1.0; cues.marks.len()],
            rectangle_white: Vec::new(),
            rectangle_weight: vec![1.0; cues.rectangles.len()],
            lane_held: Vec::new(),
            width_white: DMatrix::zeros(0, 0),
            evaluations: 0,
            bounding: Bounding::default(),
        })
    }

    /// The boxes that are used.
    pub fn traffic(&self) -> &Traffic {
        &self.traffic
    }

    pub(super) fn view(&self, camera: &Unknowns) -> View {
        View::new(camera, self.image_size)
    }

    fn lanes(&self, view: &View) -> Vec<Option<OnRoad>> {
        self.cues.lanes.iter().map(|l| OnRoad::of(l, view)).collect()
    }

    /// The lanes' middles, on which the boxes stand.
    pub(super) fn middles(&self, view: &View) -> Vec<Option<Middle>> {
        middles(&self.lanes(view))
    }

    /// Takes the noise of marks and lanes at a camera; `None` where a cue is above its horizon.
    pub(super) fn hold(&mut self, camera: &Unknowns) -> Option<()> {
        let view = self.view(camera);
        let marks = &self.cues.marks;
        self.mark_white =
            marks.iter().map(|m| marks::whitening(m, &view)).collect::<Option<_>>()?;
        let rectangles = &self.cues.rectangles;
        self.rectangle_white = rectangles
            .iter()
            .map(|r| marks::rectangle_whitening(r, &view))
            .collect::<Option<_>>()?;
        let held = |l: &super::cues::LaneCue| l.steady.then(|| lanes::hold(l, &view));
        self.lane_held = self.cues.lanes.iter().map(|l| held(l).flatten()).collect();
        let n = self.lane_held.iter().flatten().count();
        let (mean_sd, each) = match self.cues.lane_width_m {
            Some(_) => (STATED_WIDTH_SD_M, STATED_WIDTH_SD_M),
            None => (LANE_WIDTH_M[1], LANE_EACH_M),
        };
        let mut covariance = DMatrix::from_element(n, n, mean_sd * mean_sd);
        (0..n).for_each(|k| covariance[(k, k)] += each * each);
        self.width_white = covariance.cholesky()?.l().try_inverse()?;
        Some(())
    }

    /// Whitened residuals of all cues but the boxes; `None` where one is above the horizon.
    pub(super) fn cue_residuals(&self, camera: &Unknowns, out: &mut Vec<f64>) -> Option<()> {
        let view = self.view(camera);
        self.cue_residuals_on(&view, &self.lanes(&view), camera, out)
    }

    fn cue_residuals_on(
        &self,
        view: &View,
        lanes: &[Option<OnRoad>],
        camera: &Unknowns,
        out: &mut Vec<f64>,
    ) -> Option<()> {
        for ((mark, white), weight) in
            self.cues.marks.iter().zip(&self.mark_white).zip(&self.mark_weight)
        {
            let r = white * marks::log_ratios(mark, view)? * weight.sqrt();
            out.extend(r.iter());
        }
        for ((cue, white), weight) in
            self.cues.rectangles.iter().zip(&self.rectangle_white).zip(&self.rectangle_weight)
        {
            out.extend((white * marks::rectangle(cue, view)? * weight.sqrt()).iter());
        }
        let mean = self.cues.lane_width_m.unwrap_or(LANE_WIDTH_M[0]);
        let mut widths = Vec::new();
        for (lane, held) in lanes.iter().zip(&self.lane_held) {
            let Some(held) = held else { continue };
            let (r, width) = held.residuals(lane.as_ref()?);
            out.extend(r.iter());
            widths.push(mean * (width / mean).ln());
        }
        if !widths.is_empty() {
            out.extend((&self.width_white * DVector::from_vec(widths)).iter());
        }
        out.extend((self.prior.root * (camera - self.prior.mean)).iter());
        Some(())
    }

    /// All residuals.
    pub(super) fn residuals(
        &mut self,
        theta: &Theta,
        mixture: Option<&Mixture>,
        out: &mut Vec<f64>,
    ) -> Option<()> {
        self.evaluations += 1;
        out.clear();
        let camera = camera_of(theta);
        let view = self.view(&camera);
        let lanes = self.lanes(&view);
        self.cue_residuals_on(&view, &lanes, &camera, out)?;
        if let Some(mixture) = mixture {
            let shared = shared_of(theta);
            out.extend(shared.iter().zip(SHARED_SD).map(|(z, sd)| z / sd));
            let lanes = middles(&lanes);
            mixture.residuals(&self.traffic, &view, &lanes, &shared, &mut self.bounding, out);
        }
        Some(())
    }

    /// Information and gradient at the state whose residuals were asked for last; none for the
    /// camera's unknowns that are not free.
    pub(super) fn normal(
        &mut self,
        theta: &Theta,
        mixture: Option<&Mixture>,
        r0: &[f64],
        free: &[bool; CAMERA],
    ) -> Option<(Information, Theta)> {
        let mut columns: Vec<Vec<f64>> = Vec::with_capacity(CAMERA);
        let mut moved = Vec::with_capacity(r0.len());
        for (k, step) in STEP.into_iter().enumerate() {
            if !free[k] {
                columns.push(vec![0.0; r0.len()]);
                continue;
            }
            let mut at = *theta;
            at[k] += step;
            self.bounding.is_held = true;
            let is_on_road = self.residuals(&at, mixture, &mut moved);
            self.bounding.is_held = false;
            is_on_road?;
            columns.push(moved.iter().zip(r0).map(|(a, b)| (a - b) / step).collect());
        }
        let mut information = Information::zeros();
        let mut gradient = Theta::zeros();
        for a in 0..CAMERA {
            gradient[a] = columns[a].iter().zip(r0).map(|(j, r)| j * r).sum();
            for b in 0..=a {
                let sum = columns[a].iter().zip(&columns[b]).map(|(x, y)| x * y).sum();
                information[(a, b)] = sum;
                information[(b, a)] = sum;
            }
        }
        let Some(mixture) = mixture else {
            for k in 0..SHARED {
                information[(CAMERA + k, CAMERA + k)] = SHARED_SD[k].powi(-2);
            }
            return Some((information, gradient));
        };
        for (k, sd) in SHARED_SD.into_iter().enumerate() {
            information[(CAMERA + k, CAMERA + k)] += sd.powi(-2);
            gradient[CAMERA + k] += theta[CAMERA + k] * sd.powi(-2);
        }
        let first = r0.len() - 2 * mixture.pairs();
        for (pair, rows) in mixture.shared_rows().enumerate() {
            for (half, row) in rows.iter().enumerate() {
                let at = first + 2 * pair + half;
                for a in 0..SHARED {
                    gradient[CAMERA + a] += row[a] * r0[at];
                    for (b, column) in columns.iter().enumerate() {
                        information[(CAMERA + a, b)] += row[a] * column[at];
                    }
                    for b in 0..=a {
                        information[(CAMERA + a, CAMERA + b)] += row[a] * row[b];
                    }
                }
            }
        }
        information.fill_upper_triangle_with_lower_triangle();
        Some((information, gradient))
    }
}
