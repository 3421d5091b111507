//! MVCalib on made scenes: the errors of its stages and forms, kept in a file.
//!
//! Owns the kept file, so that a table which takes hours can be interrupted and go on.

use crate::made_scene::{Kind, MadeScene};
use mvcalib::camera::Camera;
use mvcalib::paper::fine_tuning;
use mvcalib::paper::loss::{Form, Weights};
use mvcalib::paper::stages::{self, Settings};
use std::collections::HashMap;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::sync::Mutex;

/// What is compared, in the order of the columns.
pub const NAMES: [&str; 6] = ["CG", "VM", "paper a1", "paper a6", "authors a1", "authors a6"];

/// MAPE (%) of each of [`NAMES`] on one scene.
pub type Errors = [f64; NAMES.len()];

/// The errors known so far, by cell and seed, and where further ones are written.
pub struct Kept {
    known: HashMap<String, Errors>,
    file: Mutex<File>,
}

impl Kept {
    /// Opens or begins the file: a line for each scene, its key and its errors.
    pub fn open(path: &str) -> std::io::Result<Self> {
        let text = std::fs::read_to_string(path).unwrap_or_default();
        let known = text.lines().filter_map(|line| {
            let (key, values) = line.split_once('\t')?;
            let values: Vec<f64> = values.split('\t').filter_map(|v| v.parse().ok()).collect();
            Some((key.to_owned(), values.try_into().ok()?))
        });
        let file = OpenOptions::new().create(true).append(true).open(path)?;
        Ok(Kept { known: known.collect(), file: Mutex::new(file) })
    }

    /// The errors on a scene, from the file where it has them.
    pub fn errors(&self, scene: &MadeScene, kind: &Kind, seed: u64) -> Errors {
        let Kind { image_size: [width, _], noise_px, fleet, .. } = kind;
        let key = format!("{width} {noise_px} {fleet:?} {seed}");
        if let Some(errors) = self.known.get(&key) {
            return *errors;
        }
        let errors = errors(scene);
        let line = errors.iter().fold(key, |line, e| format!("{line}\t{e:.4}"));
        let mut file = self.file.lock().expect("no writer panics");
        writeln!(file, "{line}").expect("the file of kept errors can be written");
        errors
    }
}

/// CG and VM in the paper's form, then both forms with alpha 1 and 6; each form runs its
/// first two stages once.
fn errors(scene: &MadeScene) -> Errors {
    let mape = |camera: Option<Camera>| {
        camera.and_then(|c| scene.marks.verify(&c).ok()).map_or(f64::INFINITY, |a| a.mape_pct)
    };
    let problem = &scene.problem;
    let width = problem.width_px();
    let mut errors = [f64::INFINITY; NAMES.len()];
    let forms = [Settings::paper(width), Settings::authors(width, 6.0)];
    for (settings, column) in forms.into_iter().zip([2, 4]) {
        let Ok(stages) = stages::calibrate(problem, &settings, &|_| ()) else { continue };
        if settings.weights.form == Form::Paper {
            errors[0] = mape(stages.best_candidate(problem, settings.weights));
            errors[1] = mape(stages.best_matched(problem, settings.weights));
        }
        let at_1 = Settings { weights: Weights { alpha: 1.0, ..settings.weights }, ..settings };
        let tuned = stages::tune(problem, &stages.matched, &at_1, &|_| ());
        let best = fine_tuning::best(&tuned).map(|k| stages::camera_of(problem, &tuned[k]));
        errors[column] = mape(best);
        errors[column + 1] = mape(Some(stages.camera(problem)));
    }
    errors
}
