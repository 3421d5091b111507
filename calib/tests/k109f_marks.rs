//! Camera K109F against road marks that no calibration has seen.
//!
//! Holds the table of `docs/measured/calibration.md` to what the methods give (`--nocapture`
//! prints it).

mod k109f;

use k109f::data;
use mvcalib::camera::{Camera, Lens, Pose};
use mvcalib::files::labelme::LabelFile;
use mvcalib::files::registration::FrameShifts;
use mvcalib::joint::{self, Settings};
use mvcalib::methods::{Method, Options, calibrate};
use mvcalib::paper::loss::Form;
use mvcalib::problem::Problem;
use mvcalib::road::marks::Marks;
use std::path::Path;

/// Midpoints of the dashes 6 m apart, read from the registered frames.
fn marks() -> Marks {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/k109f/marks.json");
    Marks::read(&path).expect("shipped marks")
}

fn registered() -> Problem {
    let mut problem = k109f::problem();
    let shifts = FrameShifts::read(&data("k109f/frames.json")).expect("shipped shifts");
    shifts.register(&mut problem.vehicles).expect("a shift for each picture");
    problem
}

fn joint(with_lines: bool) -> joint::Joint {
    let mut settings = Settings::default();
    if with_lines {
        let lines = LabelFile::read(&data("k109f/lane_lines.json")).expect("shipped lines");
        settings.cues.line_pairs = lines.line_pairs().expect("two lines");
    }
    joint::calibrate(&registered(), &settings).expect("seven vehicles")
}

fn published() -> Camera {
    let best = k109f::published().fine_tuned;
    Camera {
        image_size: [320, 240],
        lens: Lens::centred(best.f, [320, 240]),
        pose: Pose::from_vectors(best.rvec.into(), best.tvec.into()),
        crest_per_m: 0.0,
    }
}

fn row(name: &str, camera: &Camera) -> String {
    let a = marks().verify(camera).expect("all marks are on the road");
    format!(
        "| {name} | {:.1} | {:.2} | {:.2} | {:.1} % | {:+.1} % |",
        camera.lens.f, a.rmse_m, a.mae_m, a.mape_pct, a.bias_pct
    )
}

/// Whether two rows of the table say the same: numbers of another processor's mathematical
/// library may differ in the last digit.
fn agree(a: &str, b: &str) -> bool {
    let number = |cell: &str| cell.trim().trim_end_matches(" %").parse::<f64>().ok();
    let same = |(a, b): (&str, &str)| match (number(a), number(b)) {
        (Some(a), Some(b)) => (a - b).abs() < 0.11_f64.min(0.011 + 0.02 * b.abs()),
        _ => a.trim() == b.trim(),
    };
    a.split('|').count() == b.split('|').count() && a.split('|').zip(b.split('|')).all(same)
}

#[test]
fn the_documents_table_is_what_the_methods_give() {
    let problem = k109f::problem();
    let mut rows = Vec::new();
    let methods = [Method::Upnp, Method::UpnpGn, Method::Gpnp, Method::GpnpGn];
    for method in methods.into_iter().chain([Method::Cg, Method::Vm]) {
        let found = calibrate(&problem, &Options::of(method), &|_| ()).expect("a camera");
        rows.push(row(method.name(), &found.camera()));
    }
    for (form, name) in [(Form::Paper, "paper's"), (Form::Authors, "authors'")] {
        for alpha in [1.0, 6.0] {
            let options = Options { form, alpha, ..Options::of(Method::Mvcalib) };
            let found = calibrate(&problem, &options, &|_| ()).expect("seven vehicles");
            rows.push(row(&format!("mvcalib, {name} form, alpha {alpha}"), &found.camera()));
        }
    }
    rows.push(row("published by the authors", &published()));
    rows.push(row("joint, vehicles only", &joint(false).camera()));
    rows.push(row("joint, two lane lines", &joint(true).camera()));
    println!("{}", rows.join("\n"));
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/measured/calibration.md");
    let text = std::fs::read_to_string(path).expect("the document");
    for row in &rows {
        let name = row.split('|').nth(1).expect("a name").trim();
        let stated = text.lines().find(|l| l.starts_with(&format!("| {name} |")));
        let stated = stated.unwrap_or_else(|| panic!("{name} is missing"));
        assert!(agree(row, stated), "the document says\n{stated}\nthe method gives\n{row}");
    }
}

#[test]
fn joint_with_lane_lines_at_least_matches_the_published_result() {
    let ours = marks().verify(&joint(true).camera()).unwrap();
    let theirs = marks().verify(&published()).unwrap();
    assert!(ours.mape_pct <= theirs.mape_pct, "{ours:?} {theirs:?}");
    assert!(ours.bias_pct.abs() <= theirs.bias_pct.abs(), "{ours:?} {theirs:?}");
}

#[test]
fn the_stated_interval_contains_the_truth() {
    let stretches: Vec<_> = marks().segments().map(|s| s.ends).collect();
    for with_lines in [false, true] {
        let found = joint(with_lines);
        let bias = marks().verify(&found.camera()).unwrap().bias_pct / 100.0;
        let state = &found.estimate.camera;
        let sd = found.covariance.relative_sd(state, [320, 240], &stretches).unwrap();
        println!("lines {with_lines}: bias {:.1} %, sd {:.1} %", 100.0 * bias, 100.0 * sd);
        assert!((1.0 + bias).ln().abs() < 1.645 * sd, "{bias} {sd}");
        assert!(sd < 0.15, "an interval that says nothing contains everything: {sd}");
    }
}

#[test]
fn the_start_changes_nothing() {
    let f = |f0| {
        let settings = Settings { f0, ..Settings::default() };
        joint::calibrate(&registered(), &settings).unwrap().camera().lens.f
    };
    let free = f(None);
    for part in [0.5, 2.0] {
        let moved = f(Some(part * free));
        assert!((moved / free - 1.0).abs() < 1e-3, "{free} {moved}");
    }
}
