//! The paper's table of methods, on made scenes with known truth.
//!
//! Owns running every method over many scenes and the medians. Does not own the scenes
//! (see `made_scene`) nor the methods.

use super::made_scene::{Kind, MadeScene, make};
use mvcalib::methods::{Method, Options, calibrate};
use mvcalib::model::VehicleModel;
use mvcalib::paper::loss::Form;
use mvcalib::road::marks::Accuracy;
use rayon::prelude::*;

/// A method, as a row of the table.
#[derive(Clone, Debug)]
pub struct Row {
    /// What the row is called.
    pub name: &'static str,
    /// The method and its settings.
    pub options: Options,
}

/// Every row: baselines, the paper's ablation, its method in both forms, and `joint`.
pub fn rows() -> Vec<Row> {
    let row = |name, method, form, alpha| Row {
        name,
        options: Options { form, alpha, ..Options::of(method) },
    };
    let (paper, authors) = (Form::Paper, Form::Authors);
    vec![
        row("UPnP", Method::Upnp, paper, 6.0),
        row("UPnP+GN", Method::UpnpGn, paper, 6.0),
        row("GPnP", Method::Gpnp, paper, 6.0),
        row("GPnP+GN", Method::GpnpGn, paper, 6.0),
        row("MVCalib CG (EPnP)", Method::Cg, paper, 6.0),
        row("MVCalib VM", Method::Vm, paper, 6.0),
        row("MVCalib, paper's form, alpha 1", Method::Mvcalib, paper, 1.0),
        row("MVCalib, paper's form, alpha 6", Method::Mvcalib, paper, 6.0),
        row("MVCalib, authors' form, alpha 1", Method::Mvcalib, authors, 1.0),
        row("MVCalib, authors' form, alpha 6", Method::Mvcalib, authors, 6.0),
        row("joint", Method::Joint, paper, 6.0),
    ]
}

/// What one method did over many scenes.
#[derive(Clone, Debug)]
pub struct Summary {
    /// Median over the scenes of the root mean square error, m.
    pub rmse_m: f64,
    /// Median over the scenes of the mean absolute error, m.
    pub mae_m: f64,
    /// Median over the scenes of the mean absolute percentage error.
    pub mape_pct: f64,
    /// Median over the scenes of the absolute bias, per cent.
    pub bias_pct: f64,
    /// Scenes in which the method gave no camera, or one that sees a mark in the sky.
    pub failures: usize,
}

/// Runs one row over the scenes with seeds `first..first + count`. A failed scene counts
/// as infinitely wrong.
pub fn run(row: &Row, kind: &Kind, models: &[VehicleModel], first: u64, count: u64) -> Summary {
    let results: Vec<Option<Accuracy>> = (first..first + count)
        .into_par_iter()
        .map(|seed| judge(&make(kind, models, seed), &row.options))
        .collect();
    let median_of = |f: fn(&Accuracy) -> f64| {
        let mut all: Vec<f64> =
            results.iter().map(|r| r.as_ref().map_or(f64::INFINITY, f)).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied().unwrap_or(f64::NAN)
    };
    Summary {
        rmse_m: median_of(|a| a.rmse_m),
        mae_m: median_of(|a| a.mae_m),
        mape_pct: median_of(|a| a.mape_pct),
        bias_pct: median_of(|a| a.bias_pct.abs()),
        failures: results.iter().filter(|r| r.is_none()).count(),
    }
}

/// How one method does on one scene.
fn judge(scene: &MadeScene, options: &Options) -> Option<Accuracy> {
    let calibration = calibrate(&scene.problem, options, &|_| ()).ok()?;
    scene.marks.verify(&calibration.camera()).ok()
}
