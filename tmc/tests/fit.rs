//! `verge-tmc fit` and `points`: known parameters come back, SciPy agrees, bad input is reported.

mod common;

use common::{Numbers, failure, json, succeed, text};
use serde_json::Value;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;
use verge_desk::{shared, skip};
use verge_tmc::fit::Model;

const NAMES: [&str; 3] = ["free_flow_speed_kmh", "jam_density_veh_km", "lambda"];

/// Points on a curve with normal noise (km/h) and a share of wild outliers.
fn made(
    folder: &Path,
    model: Model,
    truth: [f64; 4],
    seed: u64,
    noise: f64,
    outliers: f64,
) -> PathBuf {
    let mut numbers = Numbers(seed);
    let mut csv = String::from("speed_kmh,density_veh_km\n");
    for _ in 0..1500 {
        let k = truth[1] * (0.02 + 0.93 * numbers.uniform());
        let exact = model.speed(truth, k);
        let wild = numbers.uniform() < outliers;
        let v = if wild { 130.0 * numbers.uniform() } else { exact + noise * numbers.normal() };
        writeln!(csv, "{:.4},{k:.4}", v.max(0.0)).expect("a string takes it");
    }
    let path = folder.join(format!("{}-{seed}.csv", model.name()));
    std::fs::write(&path, csv).expect("writing a file");
    path
}

fn fitted(model: Model, points: &Path, more: &[&str]) -> Value {
    json(&[&["fit", "--json", "--model", model.name(), "--points", text(points)], more].concat())
}

#[test]
fn known_parameters_come_back_within_two_per_cent() {
    let folder = tempfile::tempdir().expect("a folder");
    let truths = [
        (Model::Greenshields, [88.0, 135.0, 0.0, 0.0]),
        (Model::Newell, [45.03, 239.86, 1396.43, 0.0]),
        (Model::Newell, [100.0, 140.0, 2200.0, 0.0]),
    ];
    for (index, (model, truth)) in truths.into_iter().enumerate() {
        // One deviation of the noise is 1 km/h; the robust fit also bears one outlier in ten.
        for (outliers, more) in [(0.0, &[][..]), (0.1, &["--robust"][..])] {
            let points = made(folder.path(), model, truth, 7 + index as u64, 1.0, outliers);
            let found = fitted(model, &points, more);
            let close = |name: &str, truth: f64| {
                let value = found[name].as_f64().expect("a number");
                assert!((value / truth - 1.0).abs() < 0.02, "{name} {value}, truth {truth}");
                let ends = &found["intervals"][name];
                let (low, high) = (ends[0].as_f64().expect("low"), ends[1].as_f64().expect("high"));
                assert!(low < value && value < high && high - low < 0.06 * value, "{name} {ends}");
            };
            for i in 0..model.count() {
                close(NAMES[i], truth[i]);
            }
            close("capacity_veh_h", model.capacity(truth).1);
            // Points scatter around the curve, also at its top.
            let warnings = found["warnings"].as_array().expect("a list");
            let is_scatter = |it: &Value| {
                it.as_str().is_some_and(|it| it.contains("beyond capacity's interval"))
            };
            assert!(warnings.iter().all(is_scatter), "{found:#}");
        }
    }
}

#[test]
fn the_model_that_made_the_points_is_found_to_be_best() {
    let folder = tempfile::tempdir().expect("a folder");
    for (model, truth) in [
        (Model::Greenshields, [88.0, 135.0, 0.0, 0.0]),
        (Model::Newell, [60.0, 150.0, 1400.0, 0.0]),
        (Model::Daganzo, [95.0, 140.0, 18.0, 0.0]),
        (Model::VanAerde, [105.0, 120.0, 85.0, 1900.0]),
    ] {
        let points = made(folder.path(), model, truth, 11, 1.5, 0.0);
        let found = json(&["fit", "--json", "--points", text(&points)]);
        assert_eq!(found["model"], model.name(), "{found:#}");
        assert_eq!(found["compared"].as_array().map(Vec::len), Some(4), "{found:#}");
        let near = |name: &str, truth: f64| {
            let value = found[name].as_f64().expect("a number");
            assert!((value / truth - 1.0).abs() < 0.02, "{} {name} {value}, {truth}", model.name());
        };
        near("free_flow_speed_kmh", truth[0]);
        near("capacity_veh_h", model.capacity(truth).1);
        let table = succeed(&["fit", "--points", text(&points)]);
        assert!(table.starts_with("model ") && table.contains("behind"), "{table}");
    }
}

#[test]
fn a_site_and_a_detector_make_points_together() {
    let folder = tempfile::tempdir().expect("a folder");
    let archive = folder.path().join("archive");
    common::made_day("north", 20_458, &archive);
    let base = ["points", "--from", "archive", "--input", text(&archive), "--site", "north"];
    // Lanes 1 and 2 have the hour and twice the hour as density; nothing was followed.
    let (code, error) = failure(&base);
    assert!(code == 65 && error.contains("give --detector-csv"), "{error}");
    let detector = folder.path().join("detector.csv");
    let csv = "time,lane,flow_veh_h,speed_kmh\n2026-01-05T08:00:20Z,1,600,70\n\
               2026-01-05T08:00:40Z,1,300,40\n2026-01-05T18:00:00+08:00,2,1000,\n\
               2026-01-05T09:00:00Z,,,50\n2027-01-01T00:00:00Z,1,9,9\n";
    std::fs::write(&detector, csv).expect("writing a file");
    let joined = succeed(&[&base[..], &["--detector-csv", text(&detector)]].concat());
    // Speeds weighted by flow; flow over density; the mean of both lanes.
    let expected = "density_veh_km,speed_kmh,detector,lane\n8.000000,60.000000,north,1\n\
                    20.000000,50.000000,north,2\n13.500000,50.000000,north,\n";
    assert_eq!(joined, expected);
    std::fs::write(&detector, "time,speed_kmh\nyesterday,50\n").expect("writing a file");
    let (code, error) = failure(&[&base[..], &["--detector-csv", text(&detector)]].concat());
    assert!(
        code == 65 && error.contains("line 2: column time: \"yesterday\" is not a time"),
        "{error}"
    );
}

#[test]
fn intervals_hold_the_truth_nineteen_times_in_twenty() {
    let truth = [60.0, 150.0, 1800.0, 0.0];
    for robust in [false, true] {
        let (mut held, rounds) = ([0; 4], 200);
        for seed in 1..=rounds {
            let mut numbers = Numbers(seed * 7919);
            let points: Vec<_> = (0..80)
                .map(|_| {
                    let k = 3.0 + 140.0 * numbers.uniform();
                    (k, Model::Newell.speed(truth, k) + 2.0 * numbers.normal())
                })
                .collect();
            let fit = verge_tmc::fit::fit(Model::Newell, &points, robust).expect("a fit");
            let truths = [truth[0], truth[1], truth[2], Model::Newell.capacity(truth).1];
            let estimates = fit.parameters.iter().take(3).chain([&fit.capacity]);
            for ((held, estimate), truth) in held.iter_mut().zip(estimates).zip(truths) {
                let [low, high] = estimate.interval.expect("determined");
                *held += usize::from(low < truth && truth < high);
            }
        }
        eprintln!("robust {robust}: {held:?} of {rounds}");
        // Binomial with 200 rounds at 0.95: 180 to 198 has probability 0.998.
        assert!(held.iter().all(|held| (180..=199).contains(held)), "{held:?}");
    }
}

/// SciPy's parameters and errors, or a skip where it is missing.
fn scipy(model: Model, points: &Path, start: &str) -> Option<Value> {
    static INSTALLED: LazyLock<bool> = LazyLock::new(|| {
        let has = Command::new("python3").args(["-c", "import scipy"]).output();
        has.is_ok_and(|output| output.status.success())
    });
    if !*INSTALLED {
        skip("python3 with scipy is not installed");
        return None;
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/curve_fit.py");
    let output = Command::new("python3")
        .args([script, model.name(), text(points), start])
        .output()
        .expect("python3 runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).expect("JSON"))
}

/// Parameters and their errors within 1 % of SciPy's on the same points.
fn agrees(model: Model, points: &Path, start: &str) {
    let Some(expected) = scipy(model, points, start) else { return };
    let found = fitted(model, points, &[]);
    for (i, name) in NAMES.iter().enumerate().take(model.count()) {
        for (found, expected) in [
            (&found[name], &expected["parameters"][i]),
            (&found["standard_errors"][name], &expected["errors"][i]),
        ] {
            let (found, expected) =
                (found.as_f64().expect("a number"), expected.as_f64().expect("a number"));
            eprintln!("| {} | {name} | {found:.6} | {expected:.6} |", model.name());
            assert!((found / expected - 1.0).abs() < 0.01, "{name}: {found}, SciPy {expected}");
        }
    }
}

#[test]
fn made_points_fit_as_scipys() {
    let folder = tempfile::tempdir().expect("a folder");
    for seed in 1..=2 {
        let truth = [70.0, 160.0, 1500.0, 0.0];
        let points = made(folder.path(), Model::Newell, truth, seed, 6.0, 0.05);
        agrees(Model::Newell, &points, "70,160,1500");
        agrees(Model::Greenshields, &points, "70,160");
    }
}

#[test]
fn ngsim_fits_as_scipys() {
    let Some(data) = shared("data/ngsim_i80_4pm") else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let points = folder.path().join("points.csv");
    succeed(&[
        "points",
        "--from",
        "ngsim",
        "--input",
        text(&data),
        "--lanes",
        "6",
        "--out",
        text(&points),
    ]);
    agrees(Model::Newell, &points, "80,150,2000");
    agrees(Model::Greenshields, &points, "80,150");
}

#[test]
fn hong_kongs_detectors_fit_as_scipys() {
    let Some(data) = shared("data/hk_detectors/hk_hourly_20230901-04.csv.gz") else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let points = folder.path().join("points.csv");
    succeed(&["points", "--from", "hk", "--input", text(&data), "--out", text(&points)]);
    agrees(Model::Greenshields, &points, "80,100");
    agrees(Model::Newell, &points, "80,100,1500");
    // Fast lanes that were congested in those four days.
    for detector in ["AID01110", "AID05110", "AID07118"] {
        let one = ["--detector", detector, "--lane", "Fast Lane", "--out", text(&points)];
        succeed(&[&["points", "--from", "hk", "--input", text(&data)][..], &one].concat());
        agrees(Model::Newell, &points, "80,100,1500");
    }
}

#[test]
fn the_raw_feed_of_hong_kong_is_read() {
    let Some(data) = shared("data/hk_detectors/rawSpeedVol-all_20240406T2127.xml.gz") else {
        return;
    };
    let csv = succeed(&["points", "--from", "hk-raw", "--input", text(&data)]);
    // The first lane: 3 vehicles in 30 s at 66 km/h.
    assert!(
        csv.starts_with("density_veh_km,speed_kmh,detector,lane\n5.454545,66.000000,AID01101,")
    );
    assert!(csv.lines().count() > 2000, "{}", csv.lines().count());
    let one = ["--detector", "AID01101", "--lane", "Fast Lane"];
    let csv =
        succeed(&[&["points", "--from", "hk-raw", "--input", text(&data)][..], &one].concat());
    // In the second of its two periods no vehicle passed.
    assert_eq!(csv.lines().count(), 2);
}

#[test]
fn bad_points_are_said_with_line_and_column() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("points.csv");
    let head = "density_veh_km,speed_kmh\n";
    for (content, model, said) in [
        (String::new(), "newell", "line 1: is empty"),
        ("density,speed\n1,2\n".into(), "newell", "has no column density_veh_km"),
        (head.into(), "newell", "has no points"),
        (
            format!("{head}1,50\nNaN,50\n"),
            "newell",
            "line 3: column density_veh_km: \"NaN\" is not",
        ),
        (format!("{head}1,-5\n"), "newell", "line 2: column speed_kmh: \"-5\" is negative"),
        (format!("{head}1,fast\n"), "newell", "line 2: column speed_kmh: \"fast\" is not a number"),
        (format!("{head}1,inf\n"), "newell", "\"inf\" is infinite"),
        (format!("{head}1\n"), "newell", "line 2: has 1 columns, the header has 2"),
        (format!("{head}1,50\n2,40\n3,30\n"), "newell", "has 3 points; newell needs at least 4"),
        (format!("{head}1,50\n2,40\n"), "greenshields", "has 2 points; greenshields needs at"),
        (format!("{head}{}", "5,50\n".repeat(9)), "newell", "all points have density 5 veh/km"),
        (format!("{head}1,10\n2,20\n3,31\n"), "greenshields", "speed does not fall with density"),
    ] {
        std::fs::write(&path, content).expect("writing a file");
        let (code, error) = failure(&["fit", "--model", model, "--points", text(&path)]);
        assert_eq!(code, 65, "{error}");
        assert!(error.contains(said), "{error}");
    }
    let (code, error) = failure(&["fit", "--model", "newell", "--points", "no/such.csv"]);
    assert_eq!(code, 66, "{error}");
    assert_eq!(failure(&["fit", "--model", "parabola", "--points", "a.csv"]).0, 64);
    assert_eq!(failure(&["points", "--from", "ngsim", "--input", "a"]).0, 64);
}

#[test]
fn what_the_data_do_not_determine_is_said() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("points.csv");
    // Light traffic only, at most 12 veh/km of 140.
    let mut numbers = Numbers(3);
    let mut csv = String::from("density_veh_km,speed_kmh\n");
    for _ in 0..200 {
        let k = 1.0 + 11.0 * numbers.uniform();
        let v = 80.0 * (1.0 - k / 140.0) + 4.0 * numbers.normal();
        writeln!(csv, "{k:.3},{v:.3}").expect("a string takes it");
    }
    std::fs::write(&path, csv).expect("writing a file");
    for model in [Model::Greenshields, Model::Newell] {
        let found = fitted(model, &path, &[]);
        let said = found["warnings"].to_string();
        assert!(said.contains("extrapolated") || said.contains("not determine"), "{found:#}");
    }
}

#[test]
fn the_plot_is_a_picture_and_nothing_half_written_stays() {
    let folder = tempfile::tempdir().expect("a folder");
    let points = made(folder.path(), Model::Newell, [70.0, 160.0, 1500.0, 0.0], 5, 5.0, 0.0);
    let plot = folder.path().join("plots/fit.png");
    let table =
        succeed(&["fit", "--model", "newell", "--points", text(&points), "--plot", text(&plot)]);
    assert!(table.contains("capacity_veh_h") && table.contains("95 %"), "{table}");
    let picture = resvg::tiny_skia::Pixmap::load_png(&plot).expect("a PNG");
    assert_eq!((picture.width(), picture.height()), (1120, 539));
    // The fit is red, the points are blue, both are there.
    let count = |is: fn(u8, u8, u8) -> bool| {
        picture.pixels().iter().filter(|p| is(p.red(), p.green(), p.blue())).count()
    };
    assert!(count(|r, g, b| r > 180 && g < 60 && b < 60) > 300);
    assert!(count(|r, g, b| b > r.saturating_add(40) && b > g) > 1000);
    for (ending, begin) in [("svg", &b"<svg"[..]), ("pdf", b"%PDF-1.4")] {
        let path = folder.path().join(format!("fit.{ending}"));
        let more = ["--plot", text(&path), "--title", "Siu Lam", "--units", "imperial"];
        succeed(&[&["fit", "--points", text(&points)][..], &more].concat());
        let bytes = std::fs::read(&path).expect("a plot");
        assert!(bytes.starts_with(begin), "{ending}");
        let shown = String::from_utf8_lossy(&bytes);
        assert!(shown.contains("Siu Lam") && shown.contains("veh/mi/lane"), "{ending}");
    }
    let other = folder.path().join("fit.gif");
    assert_eq!(failure(&["fit", "--points", text(&points), "--plot", text(&other)]).0, 64);
    let taken = folder.path().join("taken.png");
    std::fs::create_dir(&taken).expect("a folder");
    let (code, error) =
        failure(&["fit", "--model", "newell", "--points", text(&points), "--plot", text(&taken)]);
    assert_eq!(code, 73, "{error}");
    assert!(!folder.path().join("taken.png.partial").exists());
}
