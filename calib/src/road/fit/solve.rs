//! The minimisation: Levenberg-Marquardt over all cues, from several focal lengths, with
//! the mixture of the traffic updated outside.
//!
//! Owns priors, starts, steps and the curvature at the optimum. Does not own the cues'
//! residuals nor what is made of the result (see the chapter's `mod`).

use super::cues::{CREST_SD, Cues, DISTORTION_SD, LANE_EACH_M, LANE_WIDTH_M, STATED_WIDTH_SD_M};
use super::lanes::{self, OnRoad};
use super::marks;
use super::traffic::{Mixture, SHARED, SHARED_SD, Shared, Traffic};
use super::view::{CAMERA, DISTORTION, LOG_F, LOG_HEIGHT, STEP, TILT, Unknowns, View};
use nalgebra::{DMatrix, DVector, SMatrix, SVector, Vector2};

/// All unknowns: the camera, and what boxes share.
pub const ALL: usize = CAMERA + SHARED;
/// All unknowns as one vector.
pub type Theta = SVector<f64, ALL>;
/// Square information on all unknowns.
pub type Information = SMatrix<f64, ALL, ALL>;

/// Focal length before any cue: 1.1 widths within a factor 1.8.
const FOCAL_WIDTHS: f64 = 1.1;
/// Standard deviation of the logarithms of focal length and height.
const FACTOR_SD: f64 = 0.6;
/// Height of the camera before any cue, m.
const HEIGHT_M: f64 = 12.0;
/// Standard deviation of a stated height, as a part of it: a mast on a bank, a sagging arm.
const STATED_HEIGHT_SD: f64 = 0.03;
/// Tilt before any cue, rad, and its standard deviation.
const TILT_PRIOR: [f64; 2] = [0.35, 0.5];
/// Standard deviation of the roll, rad.
const ROLL_SD: f64 = 3.0 * std::f64::consts::PI / 180.0;
/// Distortion before any cue: lenses of traffic cameras are a little barrel-shaped.
const DISTORTION_MEAN: f64 = -0.02;
/// Focal lengths to start from, widths.
const STARTS: [f64; 4] = [0.7, 1.1, 1.7, 2.6];
/// Most that one step may change each of the camera's unknowns.
const MOST: [f64; CAMERA] = [0.3, 0.1, 0.05, 0.3, 0.02, 1e-4];
/// Bounds of the tilt, rad, and of the distortion.
const TILT_RANGE: [f64; 2] = [0.005, 1.45];
const DISTORTION_RANGE: [f64; 2] = [-0.25, 0.15];
/// A whitened residual of a mark beyond this is taken for a mistake and pulls no harder.
const HUBER: f64 = 3.0;
/// A start needs the topmost cue this far below its horizon, rad.
const BELOW_HORIZON: f64 = 0.02;

/// Normal prior on the camera's unknowns.
#[derive(Clone, Debug)]
pub struct Prior {
    mean: Unknowns,
    /// Upper factor of the information: residuals are `root * (unknowns - mean)`.
    root: SMatrix<f64, CAMERA, CAMERA>,
}

impl Prior {
    /// What a camera over a road may be, and what the cues state of it.
    pub fn of(cues: &Cues, image_size: [u32; 2]) -> Option<Self> {
        let width = f64::from(image_size[0]);
        let height = cues.height_m.unwrap_or(HEIGHT_M);
        let mut mean = Unknowns::zeros();
        mean[LOG_F] = (FOCAL_WIDTHS * width).ln();
        mean[TILT] = TILT_PRIOR[0];
        mean[LOG_HEIGHT] = height.ln();
        mean[DISTORTION] = DISTORTION_MEAN;
        let height_sd = if cues.height_m.is_some() { STATED_HEIGHT_SD } else { FACTOR_SD };
        let sd = [FACTOR_SD, TILT_PRIOR[1], ROLL_SD, height_sd, DISTORTION_SD, CREST_SD];
        let own = SMatrix::from_diagonal(&Unknowns::from(sd).map(|s| 1.0 / s));
        let Some(labelled) = &cues.labelled else {
            return Some(Prior { mean, root: own });
        };
        // What labelled vehicles say takes the prior's place, but for a stated height.
        let mut information = labelled.covariance.try_inverse()?;
        let mut weighted = information * labelled.mean;
        if cues.height_m.is_some() {
            let stated = STATED_HEIGHT_SD.powi(-2);
            information[(LOG_HEIGHT, LOG_HEIGHT)] += stated;
            weighted[LOG_HEIGHT] += stated * height.ln();
        }
        let factor = information.cholesky()?;
        Some(Prior { mean: factor.solve(&weighted), root: factor.l().transpose() })
    }
}

/// Everything that is held while the unknowns move.
pub struct Problem<'a> {
    cues: &'a Cues,
    image_size: [u32; 2],
    prior: Prior,
    traffic: Traffic,
    mark_white: Vec<DMatrix<f64>>,
    mark_weight: Vec<f64>,
    rectangle_white: Vec<DMatrix<f64>>,
    lane_held: Vec<Option<lanes::Held>>,
    width_white: DMatrix<f64>,
    /// Steps taken, evaluations of all residuals.
    pub evaluations: usize,
}

/// The unknowns at an optimum.
#[derive(Clone, Debug)]
pub struct Optimum {
    /// The unknowns.
    pub theta: Theta,
    /// Half the sum of the squared residuals, less the mixture's logarithm of likelihood.
    pub cost: f64,
    /// Information on the unknowns.
    pub information: Information,
    /// The mixture of the traffic, where there is any.
    pub mixture: Option<Mixture>,
}

fn camera_of(theta: &Theta) -> Unknowns {
    theta.fixed_rows::<CAMERA>(0).into_owned()
}

fn shared_of(theta: &Theta) -> Shared {
    theta.fixed_rows::<SHARED>(CAMERA).into_owned()
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
            lane_held: Vec::new(),
            width_white: DMatrix::zeros(0, 0),
            evaluations: 0,
        })
    }

    /// The boxes that are used.
    pub fn traffic(&self) -> &Traffic {
        &self.traffic
    }

    fn view(&self, camera: &Unknowns) -> View {
        View::new(camera, self.image_size)
    }

    fn lanes(&self, view: &View) -> Vec<Option<OnRoad>> {
        self.cues.lanes.iter().map(|l| OnRoad::of(l, view)).collect()
    }

    /// Takes the noise of marks and lanes at a camera; `None` where a cue is above its horizon.
    fn hold(&mut self, camera: &Unknowns) -> Option<()> {
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
    fn cue_residuals(&self, camera: &Unknowns, out: &mut Vec<f64>) -> Option<()> {
        let view = self.view(camera);
        for ((mark, white), weight) in
            self.cues.marks.iter().zip(&self.mark_white).zip(&self.mark_weight)
        {
            let r = white * marks::log_ratios(mark, &view)? * weight.sqrt();
            out.extend(r.iter());
        }
        for (corners, white) in self.cues.rectangles.iter().zip(&self.rectangle_white) {
            out.extend((white * marks::rectangle(corners, &view)?).iter());
        }
        let mean = self.cues.lane_width_m.unwrap_or(LANE_WIDTH_M[0]);
        let mut widths = Vec::new();
        for (lane, held) in self.cues.lanes.iter().zip(&self.lane_held) {
            let Some(held) = held else { continue };
            let (r, width) = held.residuals(&OnRoad::of(lane, &view)?);
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
    fn residuals(
        &mut self,
        theta: &Theta,
        mixture: Option<&Mixture>,
        out: &mut Vec<f64>,
    ) -> Option<()> {
        self.evaluations += 1;
        out.clear();
        let camera = camera_of(theta);
        self.cue_residuals(&camera, out)?;
        if let Some(mixture) = mixture {
            let shared = shared_of(theta);
            out.extend(shared.iter().zip(SHARED_SD).map(|(z, sd)| z / sd));
            let view = self.view(&camera);
            mixture.residuals(&self.traffic, &view, &self.lanes(&view), &shared, out);
        }
        Some(())
    }

    /// Information and gradient at a state with these residuals.
    fn normal(
        &mut self,
        theta: &Theta,
        mixture: Option<&Mixture>,
        r0: &[f64],
    ) -> Option<(Information, Theta)> {
        let mut columns: Vec<Vec<f64>> = Vec::with_capacity(CAMERA);
        let mut moved = Vec::with_capacity(r0.len());
        for (k, step) in STEP.into_iter().enumerate() {
            let mut at = *theta;
            at[k] += step;
            self.residuals(&at, mixture, &mut moved)?;
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
                    for b in 0..SHARED {
                        information[(CAMERA + a, CAMERA + b)] += row[a] * row[b];
                    }
                    for (b, column) in columns.iter().enumerate() {
                        let cross = row[a] * column[at];
                        information[(CAMERA + a, b)] += cross;
                        information[(b, CAMERA + a)] += cross;
                    }
                }
            }
        }
        Some((information, gradient))
    }

    /// Some steps with everything else held; gives the state and how far it moved.
    fn steps(
        &mut self,
        mut theta: Theta,
        mixture: Option<&Mixture>,
        free: &[bool; CAMERA],
        most: usize,
        damping: &mut f64,
    ) -> Option<(Theta, f64)> {
        let (mut r, mut trial) = (Vec::new(), Vec::new());
        self.residuals(&theta, mixture, &mut r)?;
        let mut cost: f64 = r.iter().map(|x| x * x).sum();
        let mut moved = 0.0;
        for _ in 0..most {
            let (mut information, mut gradient) = self.normal(&theta, mixture, &r)?;
            for (k, free) in free.iter().enumerate() {
                if !free {
                    gradient[k] = 0.0;
                    information.row_mut(k).fill(0.0);
                    information.column_mut(k).fill(0.0);
                    information[(k, k)] = 1.0;
                }
            }
            let mut better = None;
            for _ in 0..6 {
                let mut damped = information;
                for k in 0..ALL {
                    damped[(k, k)] *= 1.0 + *damping;
                }
                let Some(factor) = damped.cholesky() else {
                    *damping *= 5.0;
                    continue;
                };
                let mut step = -factor.solve(&gradient);
                for k in 0..CAMERA {
                    step[k] = step[k].clamp(-MOST[k], MOST[k]);
                }
                let mut at = theta + step;
                at[TILT] = at[TILT].clamp(TILT_RANGE[0], TILT_RANGE[1]);
                at[DISTORTION] = at[DISTORTION].clamp(DISTORTION_RANGE[0], DISTORTION_RANGE[1]);
                let possible = self.residuals(&at, mixture, &mut trial).is_some();
                let other: f64 = trial.iter().map(|x| x * x).sum();
                if possible && other < cost {
                    better = Some((at, step, other));
                    break;
                }
                *damping *= 5.0;
            }
            let Some((at, step, other)) = better else { break };
            *damping = (*damping / 5.0).max(1e-7);
            let scale = [0.05, 0.01, 0.01, 0.05];
            moved += (0..4).map(|k| (step[k] / scale[k]).abs()).fold(0.0, f64::max);
            theta = at;
            std::mem::swap(&mut r, &mut trial);
            let gained = cost - other;
            cost = other;
            if gained < 1e-3 {
                break;
            }
        }
        Some((theta, moved))
    }

    /// Weights of marks that do not fit (Huber): a slip of the pen must not bend the camera.
    fn reweigh(&mut self, camera: &Unknowns) -> Option<()> {
        let view = self.view(camera);
        for (k, (mark, white)) in self.cues.marks.iter().zip(&self.mark_white).enumerate() {
            let r = white * marks::log_ratios(mark, &view)?;
            let typical = (r.norm_squared() / r.len() as f64).sqrt();
            self.mark_weight[k] = (HUBER / typical.max(HUBER)).min(1.0);
        }
        Some(())
    }

    /// Alternates between what is held and the unknowns until they rest.
    fn alternate(
        &mut self,
        mut theta: Theta,
        mut mixture: Option<Mixture>,
        free: &[bool; CAMERA],
        rounds: usize,
        heats: &[f64],
    ) -> Option<(Theta, Option<Mixture>)> {
        let mut damping = 1e-3;
        for round in 0..rounds {
            let camera = camera_of(&theta);
            self.hold(&camera)?;
            self.reweigh(&camera)?;
            let heat = heats.get(round).copied().unwrap_or(1.0);
            if let Some(mixture) = &mut mixture {
                let view = self.view(&camera);
                let (lanes, shared) = (self.lanes(&view), shared_of(&theta));
                if round == 2 || round == 5 {
                    mixture.hold(&self.traffic, &view, &lanes, &shared);
                }
                mixture.expect(&self.traffic, &view, &lanes, &shared, heat, true);
            }
            let inner = if mixture.is_some() { 2 } else { 4 };
            let (next, moved) = self.steps(theta, mixture.as_ref(), free, inner, &mut damping)?;
            theta = next;
            if moved < 0.02 && round >= heats.len() {
                break;
            }
        }
        Some((theta, mixture))
    }

    /// A camera to start from at a focal length: tilt, roll and height from the cues, height
    /// from the widths of boxes.
    fn start(&mut self, f: f64) -> Option<Theta> {
        let [_, height] = self.image_size.map(f64::from);
        let mut theta = Theta::zeros();
        theta.fixed_rows_mut::<CAMERA>(0).copy_from(&self.prior.mean);
        theta[LOG_F] = f.ln();
        let top = self.cues.points().map(|p| p.y).fold(f64::INFINITY, f64::min);
        let top = top.min(self.traffic.top());
        let least = (0.5 * height - top).atan2(f) + BELOW_HORIZON;
        let free = [false, true, true, true, false, false];
        let mut best: Option<(f64, Theta)> = None;
        for tilt in [0.06, 0.2, 0.4] {
            let mut at = theta;
            at[TILT] = f64::max(tilt, least);
            let Some((found, _)) = self.alternate(at, None, &free, 6, &[]) else { continue };
            let mut r = Vec::new();
            if self.cue_residuals(&camera_of(&found), &mut r).is_none() {
                continue;
            }
            let cost: f64 = r.iter().map(|x| x * x).sum();
            if best.as_ref().is_none_or(|(c, _)| cost < *c) {
                best = Some((cost, found));
            }
        }
        let (_, mut theta) = best?;
        if !self.traffic.seen.is_empty()
            && self.cues.marks.is_empty()
            && self.cues.height_m.is_none()
        {
            for _ in 0..3 {
                let view = self.view(&camera_of(&theta));
                let lanes = self.lanes(&view);
                let excess = Mixture::width_excess(&self.traffic, &view, &lanes, &Shared::zeros());
                let Some(excess) = excess else { break };
                theta[LOG_HEIGHT] -= excess.clamp(-1.0, 1.0);
                theta[LOG_HEIGHT] = theta[LOG_HEIGHT].clamp(2f64.ln(), 80f64.ln());
            }
        }
        Some(theta)
    }

    /// The best camera from every start; `None` where none can hold the cues below its horizon.
    pub fn solve(&mut self) -> Option<Optimum> {
        let width = f64::from(self.image_size[0]);
        let whole = self.traffic.clone();
        self.traffic = whole.some();
        let all = [true; CAMERA];
        let mut found: Vec<(Theta, Option<Mixture>)> = Vec::new();
        for widths in STARTS {
            self.mark_weight.fill(1.0);
            let Some(theta) = self.start(widths * width) else { continue };
            if self.traffic.seen.is_empty() {
                found.extend(self.alternate(theta, None, &all, 12, &[]));
                continue;
            }
            // What the vehicles are is found at this focal length first; then it may move.
            let mixture = self.mixture(&theta);
            let held = [false, true, true, true, true, true];
            let Some((theta, mixture)) =
                self.alternate(theta, Some(mixture), &held, 3, &[16.0, 4.0, 1.0])
            else {
                continue;
            };
            found.extend(self.alternate(theta, mixture, &all, 5, &[]));
        }
        let best = self.best(&found)?;
        let (theta, _) = found.swap_remove(best);
        self.traffic = whole;
        let mixture = (!self.traffic.seen.is_empty()).then(|| self.mixture(&theta));
        let (theta, mixture) = self.alternate(theta, mixture, &all, 8, &[])?;
        self.optimum(theta, mixture)
    }

    /// A mixture that knows nothing yet but the noise at these unknowns.
    fn mixture(&self, theta: &Theta) -> Mixture {
        let view = self.view(&camera_of(theta));
        Mixture::new(&self.traffic, &view, &self.lanes(&view), &shared_of(theta))
    }

    /// Which candidate is best, each under every candidate's noise: a camera must not win by
    /// expecting more scatter, or other boxes.
    fn best(&mut self, found: &[(Theta, Option<Mixture>)]) -> Option<usize> {
        let mut total = vec![0.0; found.len()];
        for (theta, mixture) in found {
            let camera = camera_of(theta);
            self.hold(&camera)?;
            self.reweigh(&camera)?;
            for (k, (other, _)) in found.iter().enumerate() {
                total[k] += self.score(other, mixture.as_ref());
            }
        }
        (0..found.len()).min_by(|&a, &b| total[a].total_cmp(&total[b]))
    }

    fn score(&self, theta: &Theta, mixture: Option<&Mixture>) -> f64 {
        let mut r = Vec::new();
        if self.cue_residuals(&camera_of(theta), &mut r).is_none() {
            return f64::INFINITY;
        }
        let mut cost = 0.5 * r.iter().map(|x| x * x).sum::<f64>();
        if let Some(mixture) = mixture {
            let shared = shared_of(theta);
            cost += 0.5 * shared.iter().zip(SHARED_SD).map(|(z, sd)| (z / sd).powi(2)).sum::<f64>();
            let view = self.view(&camera_of(theta));
            let lanes = self.lanes(&view);
            cost -= mixture.clone().expect(&self.traffic, &view, &lanes, &shared, 1.0, false);
        }
        cost
    }

    fn optimum(&mut self, theta: Theta, mut mixture: Option<Mixture>) -> Option<Optimum> {
        let camera = camera_of(&theta);
        self.hold(&camera)?;
        self.reweigh(&camera)?;
        if let Some(mixture) = &mut mixture {
            let view = self.view(&camera);
            let (lanes, shared) = (self.lanes(&view), shared_of(&theta));
            mixture.expect(&self.traffic, &view, &lanes, &shared, 1.0, true);
        }
        let mut r = Vec::new();
        self.residuals(&theta, mixture.as_ref(), &mut r)?;
        let (information, _) = self.normal(&theta, mixture.as_ref(), &r)?;
        let cost = self.score(&theta, mixture.as_ref());
        Some(Optimum { theta, cost, information, mixture })
    }
}

impl Optimum {
    /// The camera's unknowns.
    pub fn camera(&self) -> Unknowns {
        camera_of(&self.theta)
    }

    /// Covariance of the camera's unknowns, everything else integrated out.
    pub fn covariance(&self) -> Option<SMatrix<f64, CAMERA, CAMERA>> {
        let inverse = self.information.cholesky()?.inverse();
        Some(inverse.fixed_view::<CAMERA, CAMERA>(0, 0).into_owned())
    }
}

impl Traffic {
    /// The topmost point that must lie on the road, px.
    fn top(&self) -> f64 {
        self.seen_feet().map(|p: Vector2<f64>| p.y).fold(f64::INFINITY, f64::min)
    }
}
