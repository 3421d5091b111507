//! Every method by its name, from a checked problem to a calibration.
//!
//! Owns the list of methods, and what turns a solver's result into a calibration with a verdict.
//! Does not own any solver.

mod single_vehicle;
mod verdict;

use crate::baselines::gpnp;
use crate::baselines::upnp;
use crate::bodies::Body;
use crate::camera::{Camera, Pose};
use crate::error::{Error, Result};
use crate::files::calibration::{Calibration, StageLoss, StageLosses, VehicleMatch};
use crate::joint::untold::{Untold, untold};
use crate::joint::{self, cues::RoadCues};
use crate::paper::fine_tuning;
use crate::paper::loss::{Form, Weights, pack};
use crate::paper::model_matching::{Bounds, Matched};
use crate::paper::stages::{self, Settings, Stages, Step};
use crate::problem::{FocalPrior, Problem};
use crate::road::fit::{self, Cues};
use crate::trust::{MIN_VEHICLES, Reason, Trust};
use single_vehicle::Solver;
use std::time::Instant;
use verdict::{Evidence, verdict};

/// A calibration method by its name on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Method {
    /// The paper's three stages.
    Mvcalib,
    /// Only the paper's first stage, which is EPnP (its ablation "CG").
    Cg,
    /// The paper's first two stages (its ablation "VM").
    Vm,
    /// One camera over one road, all vehicles at once; states its own error.
    Joint,
    /// Lengths, lane lines and traffic on the road, labelled vehicles where there are some;
    /// states its own error.
    Road,
    /// EPnP at the default focal length; the same as `cg`.
    Epnp,
    /// Focal length and pose of single vehicles, Penate-Sanchez et al. 2013.
    Upnp,
    /// The same with Gauss-Newton.
    UpnpGn,
    /// Focal length and pose of single vehicles, Zheng et al. 2014.
    Gpnp,
    /// The same with Gauss-Newton.
    GpnpGn,
}

impl Method {
    /// The name as written on the command line and in calibration files.
    pub fn name(self) -> &'static str {
        match self {
            Method::Mvcalib => "mvcalib",
            Method::Cg => "cg",
            Method::Vm => "vm",
            Method::Joint => "joint",
            Method::Road => fit::METHOD,
            Method::Epnp => "epnp",
            Method::Upnp => "upnp",
            Method::UpnpGn => "upnp-gn",
            Method::Gpnp => "gpnp",
            Method::GpnpGn => "gpnp-gn",
        }
    }
}

/// Options of a calibration beside its problem.
#[derive(Clone, Debug)]
pub struct Options {
    /// The method.
    pub method: Method,
    /// Paper's or authors' losses.
    pub form: Form,
    /// Weight of the angle in the fine-tuning loss.
    pub alpha: f64,
    /// Temperature of the vehicles' weights.
    pub tau: f64,
    /// Focal length to start from, px; `None` for the paper's 350 px of 320.
    pub f0: Option<f64>,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Estimate radial distortion (joint only).
    pub distortion: bool,
    /// Standard deviation of the camera's sway between pictures, px (joint only).
    pub sway_px: f64,
    /// Lines and marks on the road (joint only).
    pub cues: RoadCues,
    /// What the road shows (road only).
    pub road: Cues,
}

impl Options {
    /// The paper's settings of a method.
    pub fn of(method: Method) -> Self {
        Options {
            method,
            form: Form::Paper,
            alpha: 6.0,
            tau: 0.0,
            f0: None,
            seed: 0,
            distortion: false,
            sway_px: 0.0,
            cues: RoadCues::default(),
            road: Cues::default(),
        }
    }

    fn settings(&self, problem: &Problem) -> Settings {
        let width = problem.width_px();
        let Options { form, alpha, tau, seed, .. } = *self;
        let bounds = match form {
            Form::Paper => Bounds::Absolute,
            Form::Authors => Bounds::Authors,
        };
        let focal = self.f0.map_or(FocalPrior::of_width(width), |f0| FocalPrior::around(f0, width));
        let weights = Weights { form, alpha, tau };
        Settings { focal, weights, bounds, seed, ..Settings::paper(width) }
    }
}

/// Calibrates. `progress` hears of every finished step.
///
/// # Errors
/// Names the vehicle that no solver can pose, or the stage that found nothing.
pub fn calibrate(
    problem: &Problem,
    options: &Options,
    progress: &(dyn Fn(Step) + Sync),
) -> Result<Calibration> {
    let start = Instant::now();
    if !matches!(options.method, Method::Joint | Method::Road) {
        only_cars(problem, options.method)?;
    }
    let mut calibration = match options.method {
        Method::Joint => of_joint(problem, options, progress)?,
        Method::Road => of_road(problem, options, progress)?,
        Method::Upnp => of_single(problem, options, upnp::solve, false)?,
        Method::UpnpGn => of_single(problem, options, upnp::solve, true)?,
        Method::Gpnp => of_single(problem, options, gpnp::solve, false)?,
        Method::GpnpGn => of_single(problem, options, gpnp::solve, true)?,
        _ => of_stages(problem, options, &options.settings(problem), progress)?,
    };
    calibration.seed = options.seed;
    calibration.wall_time_s = start.elapsed().as_secs_f64();
    Ok(calibration)
}

/// The paper knows cars only, and a van taken for a car is a wrong scale.
fn only_cars(problem: &Problem, method: Method) -> Result<()> {
    match problem.vehicles.iter().find(|v| v.body != Body::Car) {
        None => Ok(()),
        Some(v) => Err(Error::Usage(format!(
            "{} is a {}; --method {} knows cars only: leave its file out, or use joint",
            v.name,
            v.body.name(),
            method.name(),
        ))),
    }
}

fn of_joint(
    problem: &Problem,
    options: &Options,
    progress: &(dyn Fn(Step) + Sync),
) -> Result<Calibration> {
    progress(Step::Joint);
    let Options { f0, distortion, sway_px, .. } = *options;
    let cues = options.cues.clone();
    let settings = joint::Settings { f0, distortion, sway_px, cues, ..Default::default() };
    let joint = joint::calibrate(problem, &settings)?;
    let camera = joint.camera();
    let mut calibration = Calibration::of_camera(&camera, options.method.name());
    calibration.loss = Some(joint.estimate.cost);
    calibration.rel_err = joint.rel_err();
    calibration.evaluations = joint.evaluations;
    let named = || problem.vehicles.iter().map(|v| v.name.as_str()).zip(&joint.misfit_px);
    calibration.vehicles = residuals(problem, &joint);
    calibration.uncertainty = Some(joint.uncertainty());
    let worst = named().max_by(|a, b| a.1.total_cmp(b.1)).map(|(name, misfit)| (name, *misfit));
    // A length without a stated error is as bad as a very uncertain one.
    let rel_err = Some(calibration.rel_err.unwrap_or(f64::NAN));
    let far_rel_err = Some(joint.known().far_ahead().map_or(f64::NAN, |e| e.rel_sd));
    let evidence = Evidence { rel_err, far_rel_err, worst, focal_bounds: None };
    let reason = misfit_vehicle(problem, &settings, &joint)
        .or_else(|| other_body(problem, &settings, &joint));
    calibration.trust = match reason {
        Some(reason) => Trust::Refused(reason),
        None => verdict(problem, &camera, &evidence),
    };
    Ok(calibration)
}

/// What labelled vehicles say takes the place of the road fit's prior.
fn of_road(
    problem: &Problem,
    options: &Options,
    progress: &(dyn Fn(Step) + Sync),
) -> Result<Calibration> {
    progress(Step::Joint);
    let settings =
        joint::Settings { f0: options.f0, sway_px: options.sway_px, ..Default::default() };
    let joint = joint::calibrate(problem, &settings)?;
    let cues = Cues { labelled: Some(joint.labelled()), ..options.road.clone() };
    let mut calibration = fit::fit(&cues, problem.image_size)?.calibration();
    calibration.vehicles = residuals(problem, &joint);
    if let Some(reason) = other_body(problem, &settings, &joint) {
        calibration.trust = Trust::Refused(reason);
    }
    Ok(calibration)
}

/// The vehicles that are likelier another body than the cars that they are taken for, of the
/// likeliest body.
fn other_body(
    problem: &Problem,
    settings: &joint::Settings,
    joint: &joint::Joint,
) -> Option<Reason> {
    let named = untold(problem, settings, &joint.estimate);
    let first = named.first()?;
    let name = |u: &Untold| problem.vehicles[u.vehicle].name.clone();
    Some(Reason::OtherBody {
        vehicles: named.iter().filter(|u| u.body == first.body).map(name).collect(),
        body: first.body.name(),
        odds: first.log_odds.exp(),
    })
}

/// Each vehicle with the misfit of its key points.
fn residuals(problem: &Problem, joint: &joint::Joint) -> Vec<VehicleMatch> {
    let of = |(vehicle, misfit): (&crate::vehicle::Vehicle, &f64)| VehicleMatch {
        name: vehicle.name.clone(),
        model: None,
        rms_px: Some(*misfit),
    };
    problem.vehicles.iter().zip(&joint.misfit_px).map(of).collect()
}

/// One camera over a road in a thousand is this strange (chi squared of two).
const STRANGE: f64 = 13.8;

/// Why a strange camera came out: the vehicle without which it would be an ordinary one,
/// and the key point that lies above the horizon of the others, if one does. A vehicle in
/// the sky bends the whole camera and still fits; only leaving it out shows it.
fn misfit_vehicle(
    problem: &Problem,
    settings: &joint::Settings,
    joint: &joint::Joint,
) -> Option<Reason> {
    if joint.strangeness() < STRANGE || problem.vehicles.len() <= MIN_VEHICLES {
        return None;
    }
    let without = |index: usize| {
        let mut rest = problem.clone();
        rest.vehicles.remove(index);
        Some((index, joint::calibrate(&rest, settings).ok()?))
    };
    let (index, other) = (0..problem.vehicles.len())
        .filter_map(without)
        .min_by(|a, b| a.1.strangeness().total_cmp(&b.1.strangeness()))
        .filter(|(_, other)| other.strangeness() < STRANGE)?;
    let (vehicle, with, camera) = (&problem.vehicles[index], joint.camera(), other.camera());
    let aloft = vehicle.points.iter().find(|p| camera.back_project(&p.uv, 0.0).is_none());
    Some(Reason::Misplaced {
        vehicle: vehicle.name.clone(),
        with: [with.height_m(), with.lens.f],
        without: [camera.height_m(), camera.lens.f],
        aloft: aloft.map(|p| p.label),
    })
}

fn of_single(
    problem: &Problem,
    options: &Options,
    solver: Solver,
    gauss_newton: bool,
) -> Result<Calibration> {
    let weights = options.settings(problem).weights;
    let name = options.method.name();
    let (matched, best) = single_vehicle::solve(problem, name, solver, gauss_newton, weights)?;
    let Matched { f, pose, .. } = matched[best];
    let camera =
        Camera { image_size: problem.image_size, lens: problem.lens(f), pose, crest_per_m: 0.0 };
    let mut calibration = Calibration::of_camera(&camera, name);
    calibration.loss = fine_tuning_loss(problem, &matched, weights, &camera);
    calibration.vehicles = matches(problem, &matched);
    calibration.evaluations = problem.vehicles.len() * problem.models.len();
    // A single distant car fits nearly any focal length, whichever the solver.
    calibration.trust = Trust::Refused(Reason::SingleVehicle { method: name });
    Ok(calibration)
}

fn of_stages(
    problem: &Problem,
    options: &Options,
    settings: &Settings,
    progress: &(dyn Fn(Step) + Sync),
) -> Result<Calibration> {
    let stages = stages::calibrate(problem, settings, progress)?;
    let weights = settings.weights;
    let none = || Error::Solver { method: "mvcalib", detail: "no vehicle gives a camera".into() };
    let (camera, bounds) = match options.method {
        Method::Mvcalib => (stages.camera(problem), Some(settings.focal.tuning)),
        Method::Vm => {
            (stages.best_matched(problem, weights).ok_or_else(none)?, Some(settings.focal.matching))
        }
        _ => (stages.best_candidate(problem, weights).ok_or_else(none)?, None),
    };
    let mut calibration = Calibration::of_camera(&camera, options.method.name());
    calibration.loss = fine_tuning_loss(problem, &stages.matched, weights, &camera);
    calibration.vehicles = matches(problem, &stages.matched);
    calibration.evaluations = stages.evaluations();
    calibration.stages = Some(losses(problem, &stages, weights));
    let evidence = Evidence { rel_err: None, far_rel_err: None, worst: None, focal_bounds: bounds };
    calibration.trust = verdict(problem, &camera, &evidence);
    Ok(calibration)
}

fn fine_tuning_loss(
    problem: &Problem,
    matched: &[Matched],
    weights: Weights,
    camera: &Camera,
) -> Option<f64> {
    let loss = fine_tuning::loss_of(problem, matched, weights);
    let loss = loss.evaluate(0, &pack(&camera.pose, camera.lens.f));
    loss.is_finite().then_some(loss)
}

fn matches(problem: &Problem, matched: &[Matched]) -> Vec<VehicleMatch> {
    matched
        .iter()
        .map(|m| VehicleMatch {
            name: problem.vehicles[m.vehicle].name.clone(),
            model: Some(problem.models[m.model].name.clone()),
            rms_px: None,
        })
        .collect()
}

/// The fine-tuning losses that the paper's figure of the three stages plots: each camera
/// scored on all vehicles, the vehicle under the camera's own model, the others matched.
fn losses(problem: &Problem, stages: &Stages, weights: Weights) -> StageLosses {
    let score = |vehicle: usize, model: usize, pose: &Pose, f: f64| {
        let mut assumed = stages.matched.clone();
        if let Some(own) = assumed.iter_mut().find(|m| m.vehicle == vehicle) {
            own.model = model;
        }
        let anchor = assumed.iter().position(|m| m.vehicle == vehicle).unwrap_or(0);
        let loss =
            fine_tuning::loss_of(problem, &assumed, weights).evaluate(anchor, &pack(pose, f));
        loss.is_finite().then_some(loss)
    };
    let row = |vehicle: usize, model: usize, pose: &Pose, f: f64, stopped| StageLoss {
        vehicle: problem.vehicles[vehicle].name.clone(),
        model: problem.models[model].name.clone(),
        f,
        loss: score(vehicle, model, pose, f),
        stopped,
    };
    let of_matched = |m: &Matched| {
        let reason = serde_json::to_value(m.termination).ok();
        let reason = reason.and_then(|v| v.as_str().map(str::to_owned));
        row(m.vehicle, m.model, &m.pose, m.f, reason)
    };
    StageLosses {
        candidates: stages
            .candidates
            .iter()
            .map(|c| row(c.vehicle, c.model, &c.pose, c.f, None))
            .collect(),
        refined: stages.refined.iter().map(of_matched).collect(),
        tuned: stages.tuned.iter().map(of_matched).collect(),
    }
}
