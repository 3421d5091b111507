//! The minimisation: Levenberg-Marquardt over all cues, from several focal lengths, with
//! the mixture of the traffic updated outside.
//!
//! Owns starts and steps. Does not own priors and residuals (see `prior`, `problem`), what the boxes
//! tell less at the optimum (see `observed`) nor what is made of the result (see the chapter's `mod`).

use super::marks::{self, typical};
use super::mixture::Mixture;
use super::problem::{ALL, Information, Problem, Theta, camera_of, shared_of};
use super::traffic::{SHARED_SD, Shared, Traffic};
use super::view::{CAMERA, DISTORTION, LOG_F, LOG_HEIGHT, TILT, Unknowns};
use nalgebra::{DVector, SMatrix, Vector2};

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

impl Problem<'_> {
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
            let (mut information, mut gradient) = self.normal(&theta, mixture, &r, free)?;
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

    /// Weights of marks and rectangles that do not fit (Huber): a slip of the pen must not bend the
    /// camera.
    fn reweigh(&mut self, camera: &Unknowns) -> Option<()> {
        let view = self.view(camera);
        let weight = |r: DVector<f64>| HUBER / typical(&r).max(HUBER);
        for (k, (mark, white)) in self.cues.marks.iter().zip(&self.mark_white).enumerate() {
            self.mark_weight[k] = weight(white * marks::log_ratios(mark, &view)?);
        }
        for (k, (cue, white)) in self.cues.rectangles.iter().zip(&self.rectangle_white).enumerate()
        {
            self.rectangle_weight[k] = weight(white * marks::rectangle(cue, &view)?);
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
                let (lanes, shared) = (self.middles(&view), shared_of(&theta));
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
            let Some((found, _)) = self.alternate(at, None, &free, 1, &[]) else { continue };
            let mut r = Vec::new();
            if self.cue_residuals(&camera_of(&found), &mut r).is_none() {
                continue;
            }
            let cost: f64 = r.iter().map(|x| x * x).sum();
            if best.as_ref().is_none_or(|(c, _)| cost < *c) {
                best = Some((cost, found));
            }
        }
        let (mut theta, _) = self.alternate(best?.1, None, &free, 5, &[])?;
        if !self.traffic.seen.is_empty()
            && self.cues.marks.is_empty()
            && self.cues.height_m.is_none()
        {
            for _ in 0..3 {
                let view = self.view(&camera_of(&theta));
                let lanes = self.middles(&view);
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
            self.rectangle_weight.fill(1.0);
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
        Mixture::new(&self.traffic, &view, &self.middles(&view), &shared_of(theta))
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
            let lanes = self.middles(&view);
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
            let (lanes, shared) = (self.middles(&view), shared_of(&theta));
            mixture.expect(&self.traffic, &view, &lanes, &shared, 1.0, true);
        }
        let mut r = Vec::new();
        self.residuals(&theta, mixture.as_ref(), &mut r)?;
        let all = [true; CAMERA];
        let (mut information, _) = self.normal(&theta, mixture.as_ref(), &r, &all)?;
        if let Some(mixture) = &mixture {
            information = self.observed(&theta, mixture, &information)?;
        }
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
