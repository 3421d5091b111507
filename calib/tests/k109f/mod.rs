//! Camera K109F as a fixture: our copy of its key points and the published parameters.

#![allow(dead_code, reason = "each test binary uses a part of the fixture")]

use mvcalib::files::labelme::read_vehicles;
use mvcalib::model::read_models;
use mvcalib::problem::Problem;
use std::path::{Path, PathBuf};

/// A file of `calib/data`.
pub fn data(relative: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data").join(relative)
}

/// The seven labelled vehicles with the five models.
pub fn problem() -> Problem {
    let (vehicles, size) = read_vehicles(&data("k109f/labels")).expect("shipped labels");
    let models = read_models(&data("vehicles.json")).expect("shipped models");
    Problem::new(size, vehicles, models).expect("shipped labels are valid")
}

#[derive(serde::Deserialize)]
pub struct Published {
    pub golden_loss: Golden,
    pub fine_tuned: Parameters,
    pub matched: Vec<Parameters>,
    pub candidates: Vec<Parameters>,
}

#[derive(serde::Deserialize)]
pub struct Golden {
    pub alpha_1: f64,
    pub alpha_6: f64,
}

#[derive(serde::Deserialize)]
pub struct Parameters {
    #[serde(default)]
    pub name: String,
    #[serde(default)]
    pub model: String,
    pub f: f64,
    pub rvec: [f64; 3],
    pub tvec: [f64; 3],
}

/// The authors' published results.
pub fn published() -> Published {
    let text = std::fs::read_to_string(data("k109f/published.json")).expect("shipped results");
    serde_json::from_str(&text).expect("shipped results parse")
}
