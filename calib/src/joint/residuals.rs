//! The vehicles' least-squares terms of the joint method and their derivatives.
//!
//! Owns the key-point residuals with their robust weights and the vehicles' priors. Does
//! not own the road cues (see `cues`) nor the solver.

use super::scene::{CAMERA, CameraState, CameraStep, FLEET_AT, VEHICLE, VehicleState, VehicleStep};
use super::shape::{Coefficients, FLEET, MODES, ShapePrior};
use crate::camera::Lens;
use crate::vehicle::Vehicle;
use nalgebra::{Matrix3, Rotation3, SMatrix, Vector2, Vector3};

/// Residuals beyond this many standard deviations count less than their square
/// (pseudo-Huber).
const ROBUST_SD: f64 = 3.0;

/// A decrease of a vehicle's cost, in nats, below which its state has settled.
const SETTLED: f64 = 1e-6;

/// Square information of one vehicle and its coupling with the camera.
#[derive(Clone, Debug)]
pub struct Block {
    /// Camera x camera.
    pub cc: SMatrix<f64, CAMERA, CAMERA>,
    /// Camera x vehicle.
    pub cv: SMatrix<f64, CAMERA, VEHICLE>,
    /// Vehicle x vehicle, priors included.
    pub vv: SMatrix<f64, VEHICLE, VEHICLE>,
    /// Gradient by the camera.
    pub gc: CameraStep,
    /// Gradient by the vehicle.
    pub gv: VehicleStep,
}

/// A vehicle's key points with the noise that each is taken to have, and what the vehicle
/// may be.
#[derive(Clone, Debug)]
pub struct Observed {
    /// What the vehicle may look like.
    pub shape: ShapePrior,
    /// Label and position (px) of each key point.
    pub points: Vec<(u8, Vector2<f64>)>,
    /// Standard deviation of each coordinate of each point, px.
    pub sd_px: Vec<f64>,
}

impl Observed {
    /// The points of a vehicle that the shape prior knows, all with the same noise (px).
    pub fn of(vehicle: &Vehicle, shape: ShapePrior, sd_px: f64) -> Self {
        let known = |p: &&crate::vehicle::KeyPoint| shape.point(p.label, &Default::default());
        let points: Vec<_> =
            vehicle.points.iter().filter(|p| known(p).is_some()).map(|p| (p.label, p.uv)).collect();
        let sd_px = vec![sd_px; points.len()];
        Observed { shape, points, sd_px }
    }

    /// Gives every point the label noise (px) and the scatter of a key point on the car, see
    /// [`Self::misfits`].
    pub fn set_noise(&mut self, label_sd_px: f64, misfits: &[(f64, f64)]) {
        for (slot, (_, own)) in self.sd_px.iter_mut().zip(misfits) {
            *slot = (label_sd_px * label_sd_px + own).sqrt();
        }
    }

    /// Logarithm of the noise's volume.
    pub fn log_noise(&self) -> f64 {
        self.sd_px.iter().map(|sd| 2.0 * sd.ln()).sum()
    }

    fn coefficients(&self, camera: &CameraState, vehicle: &VehicleState) -> Coefficients {
        if self.shape.in_fleet { camera.shape_of(vehicle) } else { vehicle.shape }
    }

    /// Cost of the vehicle: robust key-point terms and priors. `None` when a key point is
    /// behind the camera.
    pub fn cost(
        &self,
        camera: &CameraState,
        image_size: [u32; 2],
        vehicle: &VehicleState,
        shift_sd_px: f64,
    ) -> Option<f64> {
        let view = camera.camera(image_size);
        let turn = turn(vehicle.yaw);
        let off_road = heading_residual(camera, vehicle);
        let shape = self.coefficients(camera, vehicle);
        let mut cost = 0.5 * robust(off_road * off_road).0
            + 0.5 * vehicle.shape.norm_squared()
            + 0.5 * vehicle.shift.norm_squared() / (shift_sd_px * shift_sd_px);
        for (&(label, uv), sd) in self.points.iter().zip(&self.sd_px) {
            let p = on_road(&turn, vehicle, self.shape.point(label, &shape)?);
            let r = (view.project(&p)? + vehicle.shift - uv) / *sd;
            cost += 0.5 * robust(r.norm_squared()).0;
        }
        Some(cost)
    }

    /// The best state under a held camera and its cost; `None` from an impossible start.
    pub fn settle(
        &self,
        camera: &CameraState,
        image_size: [u32; 2],
        start: VehicleState,
        shift_sd_px: f64,
        max_steps: usize,
    ) -> Option<(VehicleState, f64)> {
        let mut now = (start, self.cost(camera, image_size, &start, shift_sd_px)?);
        let mut damping = 1e-3;
        for _ in 0..max_steps {
            let block = self.linearise(camera, image_size, &now.0, shift_sd_px);
            let Some(part) = block.eliminate(damping) else { break };
            let trial = now.0.moved(&-part.own);
            match self.cost(camera, image_size, &trial, shift_sd_px) {
                Some(cost) if cost < now.1 => {
                    let converged = now.1 - cost < SETTLED;
                    (now, damping) = ((trial, cost), damping * 0.1);
                    if converged {
                        break;
                    }
                }
                _ => damping *= 10.0,
            }
        }
        Some(now)
    }

    /// The normal equations of the vehicle's terms at a state.
    pub fn linearise(
        &self,
        camera: &CameraState,
        image_size: [u32; 2],
        vehicle: &VehicleState,
        shift_sd_px: f64,
    ) -> Block {
        let lens = Lens { k1: camera.k1, ..Lens::centred(camera.log_f.exp(), image_size) };
        let orientation = camera.orientation();
        let height = camera.height_m();
        let turn = turn(vehicle.yaw);
        let coefficients = self.coefficients(camera, vehicle);
        let mut block = Block::of_priors(vehicle, shift_sd_px);
        block.add_heading(camera, vehicle);
        for (&(label, uv), sd) in self.points.iter().zip(&self.sd_px) {
            let Some(shape) = self.shape.point(label, &coefficients) else { continue };
            let p = on_road(&turn, vehicle, shape);
            let from_camera = p - Vector3::new(0.0, 0.0, height);
            let p_cam = orientation.rotation * from_camera;
            let Some(projected) = lens.project(&p_cam) else { continue };
            let by_point = lens.jacobian(&p_cam);
            let by_world = by_point * orientation.rotation;

            let mut jc = SMatrix::<f64, 2, CAMERA>::zeros();
            jc.set_column(0, &(projected - lens.centre));
            jc.set_column(1, &(by_point * (orientation.by_tilt * from_camera)));
            jc.set_column(2, &(by_point * (orientation.by_roll * from_camera)));
            jc.set_column(3, &(by_world * Vector3::new(0.0, 0.0, -height)));
            let xy = p_cam.xy() / p_cam.z;
            jc.set_column(4, &(xy * (lens.f * xy.norm_squared())));

            let mut jv = SMatrix::<f64, 2, VEHICLE>::zeros();
            jv.fixed_columns_mut::<2>(0).copy_from(&by_world.fixed_columns::<2>(0));
            let turned = turn * shape;
            jv.set_column(2, &(by_world * Vector3::new(-turned.y, turned.x, 0.0)));
            for (k, mode) in self.shape.modes(label).iter().enumerate() {
                jv.set_column(3 + k, &(by_world * (turn * mode)));
            }
            if self.shape.in_fleet {
                let fleet = jv.fixed_columns::<FLEET>(3 + MODES - FLEET).into_owned();
                jc.fixed_columns_mut::<FLEET>(FLEET_AT).copy_from(&fleet);
            }
            jv[(0, 3 + MODES)] = 1.0;
            jv[(1, 4 + MODES)] = 1.0;

            let r = (projected + vehicle.shift - uv) / *sd;
            let weight = robust(r.norm_squared()).1;
            let (jc, jv) = (jc / *sd, jv / *sd);
            block.cc += jc.tr_mul(&jc) * weight;
            block.cv += jc.tr_mul(&jv) * weight;
            block.vv += jv.tr_mul(&jv) * weight;
            block.gc += jc.tr_mul(&r) * weight;
            block.gv += jv.tr_mul(&r) * weight;
        }
        block
    }

    /// Squared residual and variance from the scatter of the key point on the car, px^2 each,
    /// of each point: what the noise is estimated from.
    pub fn misfits(
        &self,
        camera: &CameraState,
        image_size: [u32; 2],
        vehicle: &VehicleState,
    ) -> Vec<(f64, f64)> {
        let view = camera.camera(image_size);
        let shape = self.coefficients(camera, vehicle);
        let turn = turn(vehicle.yaw);
        self.points
            .iter()
            .filter_map(|&(label, uv)| {
                let p = on_road(&turn, vehicle, self.shape.point(label, &shape)?);
                let p_cam = view.pose.transform(&p);
                let r = view.lens.project(&p_cam)? + vehicle.shift - uv;
                Some((r.norm_squared(), (view.lens.f / p_cam.z * self.shape.point_sd_m).powi(2)))
            })
            .collect()
    }
}

/// Information that the priors give on a vehicle's unknowns, without position and yaw.
pub(super) fn vehicle_prior(shift_sd_px: f64) -> VehicleStep {
    let shift = 1.0 / (shift_sd_px * shift_sd_px);
    VehicleStep::from_fn(|k, _| match k {
        0..3 => 0.0,
        k if k < 3 + MODES => 1.0,
        _ => shift,
    })
}

impl Block {
    /// The term that keeps a vehicle along the road.
    fn add_heading(&mut self, camera: &CameraState, vehicle: &VehicleState) {
        let r = heading_residual(camera, vehicle);
        let weight = robust(r * r).1;
        let mut jc = CameraStep::zeros();
        jc[5] = -1.0 / HEADING_SD;
        jc[6] = -vehicle.position.y / HEADING_SD;
        let mut jv = VehicleStep::zeros();
        jv[1] = -camera.curvature / HEADING_SD;
        jv[2] = 1.0 / HEADING_SD;
        self.cc += jc * jc.transpose() * weight;
        self.cv += jc * jv.transpose() * weight;
        self.vv += jv * jv.transpose() * weight;
        self.gc += jc * (r * weight);
        self.gv += jv * (r * weight);
    }

    fn of_priors(vehicle: &VehicleState, shift_sd_px: f64) -> Self {
        let information = vehicle_prior(shift_sd_px);
        let mut state = VehicleStep::zeros();
        state.fixed_rows_mut::<MODES>(3).copy_from(&vehicle.shape);
        state.fixed_rows_mut::<2>(3 + MODES).copy_from(&vehicle.shift);
        Block {
            cc: SMatrix::zeros(),
            cv: SMatrix::zeros(),
            vv: SMatrix::from_diagonal(&information),
            gc: SMatrix::zeros(),
            gv: information.component_mul(&state),
        }
    }
}

/// Standard deviation of a vehicle's heading against the road's, rad: 6 degrees, a lane
/// change in town.
const HEADING_SD: f64 = 0.105;

/// How far a vehicle's heading is from the road's where it stands, in standard deviations.
/// Traffic in the opposite direction counts as along the road.
fn heading_residual(camera: &CameraState, vehicle: &VehicleState) -> f64 {
    let road = camera.heading + camera.curvature * vehicle.position.y;
    let off = vehicle.yaw - road;
    let half_turn = std::f64::consts::PI;
    (off - half_turn * (off / half_turn).round()) / HEADING_SD
}

fn turn(yaw: f64) -> Matrix3<f64> {
    Rotation3::from_axis_angle(&Vector3::z_axis(), yaw).into_inner()
}

fn on_road(turn: &Matrix3<f64>, vehicle: &VehicleState, shape: Vector3<f64>) -> Vector3<f64> {
    turn * shape + Vector3::new(vehicle.position.x, vehicle.position.y, 0.0)
}

/// Pseudo-Huber: cost and weight of a squared, whitened residual.
fn robust(squared: f64) -> (f64, f64) {
    let d2 = ROBUST_SD * ROBUST_SD;
    let root = (1.0 + squared / d2).sqrt();
    (2.0 * d2 * (root - 1.0), 1.0 / root)
}
