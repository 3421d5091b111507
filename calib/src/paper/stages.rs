//! MVCalib, the paper's method whole: candidates, model matching, fine tuning.
//!
//! Owns the order of the three stages and their settings. Does not own any stage.

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::paper::candidates::{self, Candidate, Strategy};
use crate::paper::fine_tuning;
use crate::paper::loss::{Form, Weights, pack};
use crate::paper::model_matching::{self, Bounds, Matched, Search};
use crate::problem::{FocalPrior, Problem};

/// Options of MVCalib.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// What is assumed about the focal length.
    pub focal: FocalPrior,
    /// Form and weights of the losses.
    pub weights: Weights,
    /// Most evaluations of each search of stage 2; the paper uses 4,000.
    pub matching_budget: usize,
    /// Most evaluations of each search of stage 3; the paper uses 20,000.
    pub tuning_budget: usize,
    /// What limits the searches.
    pub bounds: Bounds,
    /// Stop a search before its budget once converged.
    pub stop_early: bool,
    /// Seed of every random choice.
    pub seed: u64,
}

impl Settings {
    /// The paper's settings for a picture of this width (px): alpha 6, tau 0, budgets of
    /// 4,000 and 20,000.
    pub fn paper(width_px: f64) -> Self {
        Settings {
            focal: FocalPrior::of_width(width_px),
            weights: Weights { form: Form::Paper, alpha: 6.0, tau: 0.0 },
            matching_budget: 4_000,
            tuning_budget: 20_000,
            bounds: Bounds::Absolute,
            stop_early: true,
            seed: 0,
        }
    }

    /// The authors' program: its form of the losses and its bounds, with this alpha.
    pub fn authors(width_px: f64, alpha: f64) -> Self {
        let weights = Weights { form: Form::Authors, alpha, tau: 0.0 };
        Settings { weights, bounds: Bounds::Authors, ..Settings::paper(width_px) }
    }

    fn search(&self, focal: [f64; 2], budget: usize) -> Search {
        let Settings { bounds, stop_early, seed, .. } = *self;
        Search { bounds, focal, budget, stop_early, seed }
    }

    fn strategy(&self) -> Strategy {
        match self.weights.form {
            Form::Paper => Strategy::Ransac,
            Form::Authors => Strategy::Subsets,
        }
    }
}

/// A step of the work, for progress on a terminal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// The joint method has begun.
    Joint,
    /// Stage 1 has ended.
    Candidates,
    /// One more of so many searches of stage 2 has ended.
    Matching(usize),
    /// One more of so many searches of stage 3 has ended.
    Tuning(usize),
}

/// What the three stages gave.
#[derive(Clone, Debug)]
pub struct Stages {
    /// Stage 1: all vehicles under all models.
    pub candidates: Vec<Candidate>,
    /// Stage 2: the same, refined.
    pub refined: Vec<Matched>,
    /// Stage 2: the best model of each vehicle, by vehicle.
    pub matched: Vec<Matched>,
    /// Stage 3: the camera from each anchor, by vehicle.
    pub tuned: Vec<Matched>,
    /// Index into `tuned` of the result.
    pub best: usize,
}

impl Stages {
    /// Evaluations of both losses together.
    pub fn evaluations(&self) -> usize {
        self.refined.iter().chain(&self.tuned).map(|m| m.evaluations).sum()
    }

    /// The camera of the paper's ablation "CG": the candidate, among all, that scores best
    /// on the fine-tuning loss with the matched models.
    pub fn best_candidate(&self, problem: &Problem, weights: Weights) -> Option<Camera> {
        let loss = fine_tuning::loss_of(problem, &self.matched, weights);
        self.candidates
            .iter()
            .filter(|c| self.matched.iter().any(|m| (m.vehicle, m.model) == (c.vehicle, c.model)))
            .min_by(|a, b| {
                let score = |c: &Candidate| loss.evaluate(c.vehicle, &pack(&c.pose, c.f));
                score(a).total_cmp(&score(b))
            })
            .map(|c| camera(problem, c.f, c.pose))
    }

    /// The camera of the paper's ablation "VM": the matched vehicle that scores best on the
    /// fine-tuning loss.
    pub fn best_matched(&self, problem: &Problem, weights: Weights) -> Option<Camera> {
        let loss = fine_tuning::loss_of(problem, &self.matched, weights);
        self.matched
            .iter()
            .min_by(|a, b| {
                let score = |m: &Matched| loss.evaluate(m.vehicle, &pack(&m.pose, m.f));
                score(a).total_cmp(&score(b))
            })
            .map(|m| camera(problem, m.f, m.pose))
    }

    /// The camera of the whole method.
    pub fn camera(&self, problem: &Problem) -> Camera {
        let best = &self.tuned[self.best];
        camera(problem, best.f, best.pose)
    }
}

fn camera(problem: &Problem, f: f64, pose: crate::camera::Pose) -> Camera {
    Camera { image_size: problem.image_size, lens: problem.lens(f), pose, crest_per_m: 0.0 }
}

/// Runs the three stages.
pub fn calibrate(
    problem: &Problem,
    settings: &Settings,
    progress: &(dyn Fn(Step) + Sync),
) -> Result<Stages> {
    let Settings { focal, weights, seed, .. } = *settings;
    let candidates = candidates::generate(problem, focal.start, settings.strategy(), seed)?;
    progress(Step::Candidates);

    let search = settings.search(focal.matching, settings.matching_budget);
    let searches = candidates.len();
    let refined = model_matching::refine(problem, &candidates, weights.form, &search, &|| {
        progress(Step::Matching(searches));
    });
    let matched = model_matching::best_of_each(&refined);

    let tuned = tune(problem, &matched, settings, progress);
    let best = fine_tuning::best(&tuned).ok_or_else(|| Error::Solver {
        method: "fine tuning",
        detail: "no anchor keeps all key points below its horizon; check the labels \
                 or start at another focal length"
            .into(),
    })?;
    Ok(Stages { candidates, refined, matched, tuned, best })
}

/// Runs the third stage alone, from vehicles that are matched already.
pub fn tune(
    problem: &Problem,
    matched: &[Matched],
    settings: &Settings,
    progress: &(dyn Fn(Step) + Sync),
) -> Vec<Matched> {
    let search = settings.search(settings.focal.tuning, settings.tuning_budget);
    fine_tuning::tune(problem, matched, settings.weights, &search, &|| {
        progress(Step::Tuning(matched.len()));
    })
}

/// The camera of one tuned anchor.
pub fn camera_of(problem: &Problem, tuned: &Matched) -> Camera {
    camera(problem, tuned.f, tuned.pose)
}
