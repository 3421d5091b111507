//! What any estimator can reach on a made scene: an oracle, and the Cramer-Rao bound.
//!
//! The oracle knows what no calibration does: each vehicle's model (known cars) or the
//! model it is like and how such cars scatter (other cars), the label noise and the road's
//! heading; it starts at the truth. The bound is the error of cameras drawn from the normal
//! distribution that the Jacobian of the same problem gives at the truth.

use crate::made_scene::{Fleet, Kind, MadeScene};
use mvcalib::joint::cues::{CueNoise, RoadCues};
use mvcalib::joint::residuals::Observed;
use mvcalib::joint::scene::{CameraState, CameraStep, VehicleState};
use mvcalib::joint::shape::{ShapePrior, Spread};
use mvcalib::joint::solver::{Estimate, Objective};
use mvcalib::joint::{self, Settings};
use mvcalib::model::VehicleModel;
use nalgebra::Vector2;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Cameras drawn from the bound's covariance in each scene.
const DRAWS: usize = 5;
const STEPS: usize = 100;

/// MAPE (%) of the oracle and of the bound (mean of draws).
pub fn errors(scene: &MadeScene, kind: &Kind, models: &[VehicleModel], seed: u64) -> [f64; 2] {
    let mape = |camera: &CameraState| {
        let camera = camera.camera(kind.image_size);
        scene.marks.verify(&camera).map_or(f64::INFINITY, |a| a.mape_pct)
    };
    let objective = objective(scene, kind, models);
    let (camera, vehicles) = truth(scene);
    let found = objective.minimise(camera, vehicles.clone(), STEPS);
    let oracle = found.map_or(f64::INFINITY, |e| mape(&e.camera));
    let at = Estimate { camera, vehicles, cost: 0.0, steps: 0 };
    let covariance = objective
        .information(&at)
        .and_then(|i| i.camera.try_inverse())
        .and_then(|c| c.cholesky())
        .expect("seven vehicles determine a camera");
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let drawn = (0..DRAWS).map(|_| {
        let z = CameraStep::from_fn(|_, _| StandardNormal.sample(&mut rng));
        mape(&CameraState::of_vector(&(camera.vector() + covariance.l() * z)))
    });
    [oracle, drawn.sum::<f64>() / DRAWS as f64]
}

fn objective(scene: &MadeScene, kind: &Kind, models: &[VehicleModel]) -> Objective {
    let spread = match kind.fleet {
        Fleet::Known => Spread { scale: 0.0, axis: 0.0, point_m: 0.0 },
        _ => Spread { scale: 0.04, axis: 0.03, point_m: 0.05 },
    };
    let observed = scene.problem.vehicles.iter().zip(&scene.standing).map(|(v, standing)| {
        let shape = ShapePrior::of_models(&models[standing.model..=standing.model], spread);
        let mut observed = Observed::of(v, shape, kind.noise_px);
        let state = VehicleState {
            position: standing.position,
            yaw: standing.yaw,
            shape: Default::default(),
            shift: Vector2::zeros(),
        };
        let (camera, _) = truth(scene);
        let own = observed.misfits(&camera, kind.image_size, &state);
        for (sd, (_, own)) in observed.sd_px.iter_mut().zip(own) {
            *sd = (*sd * *sd + own).sqrt();
        }
        observed
    });
    let settings = Settings { fleet: 0.0, ..Settings::default() };
    let mut prior = joint::prior(f64::from(kind.image_size[0]), &settings);
    // A straight road along the camera.
    prior.sd[5] = 1e-6;
    prior.sd[6] = 1e-9;
    Objective {
        image_size: kind.image_size,
        observed: observed.collect(),
        prior,
        shift_sd_px: 1e-3,
        cues: RoadCues::default(),
        cue_noise: CueNoise::default(),
    }
}

/// The true state in the joint method's terms.
fn truth(scene: &MadeScene) -> (CameraState, Vec<VehicleState>) {
    let vehicles = scene.standing.iter().map(|s| VehicleState {
        position: s.position,
        yaw: s.yaw,
        shape: Default::default(),
        shift: Vector2::zeros(),
    });
    (scene.state, vehicles.collect())
}
