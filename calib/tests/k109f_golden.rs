//! The paper's Hong Kong camera K109F: golden values of the published result, and what the
//! searches converge to from many seeds.

mod k109f;

use mvcalib::camera::Pose;
use mvcalib::paper::loss::{FineTuningLoss, Form, Weights, pack};
use mvcalib::paper::stages::{Settings, calibrate};

fn published_loss(form: Form, alpha: f64) -> f64 {
    let problem = k109f::problem();
    let published = k109f::published();
    let vehicles: Vec<_> = published
        .matched
        .iter()
        .enumerate()
        .map(|(i, m)| {
            let model = problem.models.iter().position(|x| x.name == m.model).unwrap();
            assert_eq!(problem.vehicles[i].name, m.name);
            problem.pairs(i, model)
        })
        .collect();
    let loss =
        FineTuningLoss::new(&vehicles, problem.lens(1.0).centre, Weights { form, alpha, tau: 0.0 });
    let best = &published.fine_tuned;
    let pose = Pose::from_vectors(best.rvec.into(), best.tvec.into());
    loss.evaluate(0, &pack(&pose, best.f))
}

#[test]
fn published_parameters_score_the_golden_values_in_the_authors_form() {
    let golden = k109f::published().golden_loss;
    // The authors store points as 32-bit floats, which moves the loss by 6e-7.
    let at_1 = published_loss(Form::Authors, 1.0);
    assert!((at_1 - golden.alpha_1).abs() < 1e-6, "{at_1}");
    let at_6 = published_loss(Form::Authors, 6.0);
    assert!((at_6 - golden.alpha_6).abs() < 1e-6, "{at_6}");
}

#[test]
fn the_papers_form_stands_beside_it() {
    // 21 pairs a vehicle summed instead of averaged, and lengths not squared.
    let at_1 = published_loss(Form::Paper, 1.0);
    assert!(at_1 > 21.0 * published_loss(Form::Authors, 1.0), "{at_1}");
}

/// Converged focal lengths over seeds in the authors' form, with their bounds. At their
/// budget of 4,000 the second stage has not converged and vehicle_01 wavers between two
/// models (0.5887 and 0.5885 px); 50,000 is where every search has stopped by itself.
fn focal_lengths(alpha: f64) -> Vec<f64> {
    let problem = k109f::problem();
    (0..10)
        .map(|seed| {
            let settings = Settings {
                matching_budget: 50_000,
                seed,
                ..Settings::authors(problem.width_px(), alpha)
            };
            calibrate(&problem, &settings, &|_| ()).unwrap().camera(&problem).lens.f
        })
        .collect()
}

#[test]
fn ten_seeds_converge_to_one_focal_length_at_alpha_1() {
    let f = focal_lengths(1.0);
    assert!(f.iter().all(|f| (f - 404.6).abs() < 1.0), "{f:?}");
}

#[test]
fn ten_seeds_converge_to_one_focal_length_at_alpha_6() {
    let f = focal_lengths(6.0);
    assert!(f.iter().all(|f| (f - 319.3).abs() < 1.0), "{f:?}");
}
