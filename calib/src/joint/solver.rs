//! Levenberg-Marquardt on all unknowns of the joint method at once, the vehicles eliminated
//! by their Schur complement.
//!
//! Owns the objective (key points, cues, priors), its minimisation and the information that
//! it leaves on the camera. Does not own starts nor the noise model (see `mod`).

use super::cues::{CueNoise, RoadCues};
use super::residuals::{Block, Observed};
use super::scene::{CAMERA, CameraState, CameraStep, VEHICLE, VehicleState, VehicleStep};
use nalgebra::SMatrix;

/// Square information of the camera.
pub type CameraInformation = SMatrix<f64, CAMERA, CAMERA>;

/// What the data say at an optimum, in Laplace's approximation.
#[derive(Clone, Copy, Debug)]
pub struct Information {
    /// Square information on the camera's unknowns, the vehicles integrated out.
    pub camera: CameraInformation,
    /// How many parameters the data determine (the trace of the hat matrix).
    pub determined: f64,
    /// Logarithm of the probability of the data under this objective, but for a constant
    /// that all objectives on the same data share.
    pub log_evidence: f64,
}

/// Independent normal priors on the camera's unknowns.
#[derive(Clone, Copy, Debug)]
pub struct CameraPrior {
    /// Means of (log f, tilt, roll, log height, k1).
    pub mean: CameraStep,
    /// Standard deviations of the same.
    pub sd: CameraStep,
}

/// Everything that is held while the unknowns move.
#[derive(Clone, Debug)]
pub struct Objective {
    /// Width and height of the pictures, px.
    pub image_size: [u32; 2],
    /// The key points with their noise and what their vehicles may be.
    pub observed: Vec<Observed>,
    /// What a camera over a road may be.
    pub prior: CameraPrior,
    /// Standard deviation of a vehicle's picture from the camera's sway, px.
    pub shift_sd_px: f64,
    /// Lines and marks.
    pub cues: RoadCues,
    /// Their noise.
    pub cue_noise: CueNoise,
}

/// All unknowns and their cost.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// The camera.
    pub camera: CameraState,
    /// The vehicles, in the observations' order.
    pub vehicles: Vec<VehicleState>,
    /// The objective: negative logarithm of the posterior but for a constant.
    pub cost: f64,
    /// Steps taken.
    pub steps: usize,
}

/// Relative decrease of the cost below which the solver has converged.
const COST_TOLERANCE: f64 = 1e-9;
const INITIAL_DAMPING: f64 = 1e-3;
const MAX_DAMPING: f64 = 1e8;

/// One vehicle's share of a step, kept for the back-substitution.
pub(super) struct Eliminated {
    /// (damped vv)^-1 cv^T.
    pub gain: SMatrix<f64, VEHICLE, CAMERA>,
    /// (damped vv)^-1 gv.
    pub own: VehicleStep,
    /// Logarithm of the determinant of the damped vv.
    pub log_determinant: f64,
}

impl Objective {
    /// The cost of a state, or `None` where a point is behind the camera or a cue above
    /// its horizon.
    pub fn cost(&self, camera: &CameraState, vehicles: &[VehicleState]) -> Option<f64> {
        let off = (camera.vector() - self.prior.mean).component_div(&self.prior.sd);
        let mut cost = 0.5 * off.norm_squared();
        if !self.cues.is_empty() {
            cost += self.cues.cost(camera, self.image_size, &self.cue_noise)?;
        }
        for (observed, vehicle) in self.observed.iter().zip(vehicles) {
            let (size, shift) = (self.image_size, self.shift_sd_px);
            cost += observed.cost(camera, size, vehicle, shift)?;
        }
        Some(cost)
    }

    fn blocks(&self, camera: &CameraState, vehicles: &[VehicleState]) -> Vec<Block> {
        let (size, shift) = (self.image_size, self.shift_sd_px);
        self.observed
            .iter()
            .zip(vehicles)
            .map(|(o, v)| o.linearise(camera, size, v, shift))
            .collect()
    }

    /// Information and gradient on the camera from the prior and the cues.
    pub(super) fn camera_terms(&self, camera: &CameraState) -> (CameraInformation, CameraStep) {
        let precision = self.prior.sd.map(|sd| 1.0 / (sd * sd));
        let mut information = CameraInformation::from_diagonal(&precision);
        let mut gradient = (camera.vector() - self.prior.mean).component_mul(&precision);
        if self.cues.is_empty() {
            return (information, gradient);
        }
        if let Some(terms) = self.cues.linearise(camera, self.image_size, &self.cue_noise) {
            let j = &terms.jacobian;
            let jtj = j.tr_mul(j);
            let jtr = j.tr_mul(&terms.residual);
            for a in 0..CAMERA {
                gradient[a] += jtr[a];
                for b in 0..CAMERA {
                    information[(a, b)] += jtj[(a, b)];
                }
            }
        }
        (information, gradient)
    }

    /// Minimises from a start; `None` when the start itself is impossible.
    pub fn minimise(
        &self,
        camera: CameraState,
        vehicles: Vec<VehicleState>,
        max_steps: usize,
    ) -> Option<Estimate> {
        let cost = self.cost(&camera, &vehicles)?;
        let mut now = Estimate { camera, vehicles, cost, steps: 0 };
        let mut damping = INITIAL_DAMPING;
        while now.steps < max_steps && damping < MAX_DAMPING {
            now.steps += 1;
            let blocks = self.blocks(&now.camera, &now.vehicles);
            let terms = self.camera_terms(&now.camera);
            // Trials from one linearisation until one is better.
            let mut accepted = false;
            while !accepted && damping < MAX_DAMPING {
                let trial = self.trial(&now, &blocks, terms, damping);
                match trial {
                    Some((camera, vehicles, cost)) if cost < now.cost => {
                        let converged = now.cost - cost <= COST_TOLERANCE * now.cost.abs();
                        now = Estimate { camera, vehicles, cost, steps: now.steps };
                        damping = (damping * 0.1).max(1e-9);
                        accepted = true;
                        if converged {
                            return Some(now);
                        }
                    }
                    _ => damping *= 10.0,
                }
            }
        }
        Some(now)
    }

    fn trial(
        &self,
        now: &Estimate,
        blocks: &[Block],
        (mut information, mut gradient): (CameraInformation, CameraStep),
        damping: f64,
    ) -> Option<(CameraState, Vec<VehicleState>, f64)> {
        let mut eliminated = Vec::with_capacity(blocks.len());
        for block in blocks {
            let part = block.eliminate(damping)?;
            information += block.cc - block.cv * part.gain;
            gradient += block.gc - block.cv * part.own;
            eliminated.push(part);
        }
        for k in 0..CAMERA {
            information[(k, k)] *= 1.0 + damping;
        }
        let step = -information.cholesky()?.solve(&gradient);
        let camera = CameraState::of_vector(&(now.camera.vector() + step));
        let vehicles: Vec<VehicleState> = now
            .vehicles
            .iter()
            .zip(&eliminated)
            .map(|(v, part)| v.moved(&-(part.own + part.gain * step)))
            .collect();
        let cost = self.cost(&camera, &vehicles)?;
        Some((camera, vehicles, cost))
    }

    /// What the data say at an estimate.
    pub fn information(&self, at: &Estimate) -> Option<Information> {
        let (mut information, _) = self.camera_terms(&at.camera);
        let blocks = self.blocks(&at.camera, &at.vehicles);
        let mut parts = Vec::with_capacity(blocks.len());
        for block in &blocks {
            let part = block.eliminate(0.0)?;
            information += block.cc - block.cv * part.gain;
            parts.push(part);
        }
        let factor = information.cholesky()?;
        let covariance = factor.inverse();
        let mut log_determinant = 2.0 * factor.l().diagonal().map(f64::ln).sum();
        let prior = self.prior.sd.map(|sd| 1.0 / (sd * sd));
        let mut determined = CAMERA as f64 - covariance.diagonal().component_mul(&prior).sum();
        for (block, part) in blocks.iter().zip(&parts) {
            let factor = block.vv.cholesky()?;
            log_determinant += part.log_determinant;
            let own = factor.inverse();
            let full = own + part.gain * covariance * part.gain.transpose();
            let prior = super::residuals::vehicle_prior(self.shift_sd_px);
            determined += VEHICLE as f64 - full.diagonal().component_mul(&prior).sum();
        }
        let noise: f64 = self.observed.iter().map(Observed::log_noise).sum();
        let prior_volume: f64 = self.prior.sd.map(f64::ln).sum();
        Some(Information {
            camera: information,
            determined,
            log_evidence: -at.cost - 0.5 * log_determinant - noise - prior_volume,
        })
    }
}

impl Block {
    pub(super) fn eliminate(&self, damping: f64) -> Option<Eliminated> {
        let mut damped = self.vv;
        for k in 0..VEHICLE {
            damped[(k, k)] *= 1.0 + damping;
        }
        let factor = damped.cholesky()?;
        Some(Eliminated {
            gain: factor.solve(&self.cv.transpose()),
            own: factor.solve(&self.gv),
            log_determinant: 2.0 * factor.l().diagonal().map(f64::ln).sum(),
        })
    }
}
