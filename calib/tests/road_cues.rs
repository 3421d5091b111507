//! Cues of the road fit through `mvcalib calibrate`: rectangles, and national standards against the
//! other cues, on a made camera.

use mvcalib::camera::{Camera, Lens, Pose};
use nalgebra::{Rotation3, Vector3};
use serde_json::json;
use std::path::Path;
use std::process::Command;

/// A camera 10 m above the road, 17 degrees down, turned by a degree.
fn camera() -> Camera {
    let image_size = [320, 240];
    let level = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
    let tilt = Rotation3::from_axis_angle(&Vector3::x_axis(), 0.30);
    let roll = Rotation3::from_axis_angle(&Vector3::z_axis(), 0.02);
    let rotation = roll * tilt * level;
    let translation = rotation * Vector3::new(0.0, 0.0, -10.0);
    let lens = Lens::centred(380.0, image_size);
    Camera { image_size, lens, pose: Pose { rotation, translation }, crest_per_m: 0.0 }
}

/// Image points of points on the road, m.
fn seen(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let image = |[x, y]: &[f64; 2]| camera().project(&Vector3::new(*x, *y, 0.0)).unwrap().into();
    points.iter().map(image).collect()
}

fn shape(label: &str, kind: &str, points: &[[f64; 2]]) -> serde_json::Value {
    json!({"label": label, "shape_type": kind, "points": seen(points)})
}

fn rectangle(label: &str, [x, y]: [f64; 2], [along, across]: [f64; 2]) -> serde_json::Value {
    let corners = [[x, y], [x, y + along], [x + across, y + along], [x + across, y]];
    shape(label, "polygon", &corners)
}

/// Runs `calibrate --method road` on labelme shapes; its exit code, its messages and what it wrote.
fn road(
    lengths: &[serde_json::Value],
    lines: &[serde_json::Value],
    more: &[&str],
) -> (Option<i32>, String, serde_json::Value) {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, shapes: &[serde_json::Value]| {
        let text = json!({"imageWidth": 320, "imageHeight": 240, "shapes": shapes}).to_string();
        std::fs::write(folder.path().join(name), text).unwrap();
        folder.path().join(name)
    };
    let out = folder.path().join("k.json");
    let mut command = Command::new(env!("CARGO_BIN_EXE_mvcalib"));
    command.args(["calibrate", "--method", "road", "--image-size", "320x240", "--out"]).arg(&out);
    command.args(more).arg("--lengths").arg(file("lengths.json", lengths));
    if !lines.is_empty() {
        command.arg("--lane-lines").arg(file("lines.json", lines));
    }
    let ended = command.output().unwrap();
    let written = |path: &Path| serde_json::from_slice(&std::fs::read(path).ok()?).ok();
    let said = String::from_utf8_lossy(&ended.stderr).into_owned();
    (ended.status.code(), said, written(&out).unwrap_or_default())
}

/// Two lane lines, 3.5 m apart.
fn lines() -> Vec<serde_json::Value> {
    let along: Vec<f64> = (0..6).map(|k| 22.0 + 10.0 * f64::from(k)).collect();
    let line = |x: f64| {
        let points: Vec<_> = along.iter().map(|y| [x, *y]).collect();
        shape("line", "linestrip", &points)
    };
    vec![line(1.75), line(-1.75)]
}

#[test]
fn a_rectangle_of_known_sides_calibrates_and_is_reported() {
    let bays = [
        rectangle("rectangle 12 x 3.5 m", [-1.75, 22.0], [12.0, 3.5]),
        rectangle("rectangle 12 x 7 m", [-3.5, 46.0], [12.0, 7.0]),
    ];
    let (code, said, written) = road(&bays, &[], &[]);
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("rectangle 1 (rectangle 12 x 3.5 m): 12.00 x 3.50 m,"), "{said}");
    let f = written["f"].as_f64().unwrap();
    assert!((f / 380.0).ln().abs() < 0.1, "{f}");
    // Right angles alone give the perspective; the metres come from one length.
    let plain: Vec<_> = [[-1.75, 22.0], [-3.5, 46.0]]
        .map(|at| rectangle("rectangle", at, [12.0, 7.0]))
        .into_iter()
        .chain([shape("12 m", "line", &[[0.0, 22.0], [0.0, 34.0]])])
        .collect();
    let (_, without, _) = road(&plain[2..], &[], &[]);
    let (_, with, written) = road(&plain, &[], &[]);
    assert!(with.contains("rectangle 2: measured"), "{with}");
    let near = |text: &str| -> f64 {
        let line = text.lines().find(|l| l.starts_with("near")).unwrap_or_else(|| panic!("{text}"));
        line.split("+- ").nth(1).and_then(|t| t.split(' ').next()).unwrap().parse().unwrap()
    };
    assert!(near(&with) < 0.5 * near(&without), "{with}{without}");
    assert!(written["f"].is_number());
}

#[test]
fn what_is_no_rectangle_is_refused_or_named() {
    let measured = [
        shape("12 m", "line", &[[0.0, 22.0], [0.0, 34.0]]),
        shape("12 m", "line", &[[0.0, 52.0], [0.0, 64.0]]),
        shape("7 m", "line", &[[-3.5, 24.0], [3.5, 24.0]]),
        shape("7 m", "line", &[[-3.5, 60.0], [3.5, 60.0]]),
    ];
    let with = |one: serde_json::Value| {
        let all: Vec<_> = measured.iter().cloned().chain([one]).collect();
        road(&all, &[], &[])
    };
    // A parallelogram, 12 m aside over 12 m.
    let askew = [[-6.0, 30.0], [6.0, 42.0], [13.0, 42.0], [1.0, 30.0]];
    let (code, said, _) = with(shape("bay", "polygon", &askew));
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("NOT TRUSTED: rectangle 1 (bay) is not right-angled"), "{said}");
    let crossed = [[-1.75, 24.0], [1.75, 36.0], [1.75, 24.0], [-1.75, 36.0]];
    for (label, kind, points, expected) in [
        ("rectangle", "polygon", &crossed[..], "do not go round"),
        ("rectangle", "polygon", &crossed[..3], "polygon of four corners"),
        ("rectangle", "rectangle", &crossed[..2], "upright in the picture"),
        ("rectangle 12", "polygon", &crossed[..], "has both sides"),
        ("rectangle 0 x 3", "polygon", &askew[..], "metres above 0"),
    ] {
        let (code, said, written) = with(shape(label, kind, points));
        assert_eq!(code, Some(65), "{said}");
        assert!(said.contains(expected) && written.is_null(), "{said}");
    }
}

#[test]
fn a_standard_that_the_other_cues_contradict_or_leave_open_is_named() {
    let dashes: Vec<_> = (0..4).map(|k| [1.75, 24.0 + 12.0 * f64::from(k)]).collect();
    let told = |label: &str, measured: &[serde_json::Value]| {
        let lengths = [&[shape(label, "linestrip", &dashes)][..], measured].concat();
        let (_, said, written) = road(&lengths, &lines(), &["--camera-height", "10"]);
        let warnings = written["warnings"].as_array().cloned().unwrap_or_default();
        (said, warnings.iter().map(|w| w.as_str().unwrap().to_owned()).collect::<Vec<_>>())
    };
    let measured = [
        shape("12 m", "line", &[[-1.75, 22.0], [-1.75, 34.0]]),
        shape("24 m", "line", &[[-1.75, 40.0], [-1.75, 64.0]]),
    ];
    for right in ["au-lane", "us-lane"] {
        let (said, warnings) = told(right, &measured);
        assert!(warnings.is_empty(), "{said}");
    }
    let (said, warnings) = told("hk-lane", &measured);
    assert!(said.contains("WARNING: mark 1 (hk-lane) is given as 6.00 m"), "{said}");
    assert!(said.contains("au-lane (12.00 m)") && said.contains("measure one length"), "{said}");
    assert!(!warnings.is_empty(), "{said}");
    // A tape's length is named in the same way, without a standard in its place.
    let (said, _) = told("6 m", &measured);
    assert!(said.contains("WARNING: mark 1 (6 m)") && said.contains("measure it again"), "{said}");
    // Two lane lines alone fit half the pitch as well, with another focal length: it says so.
    let (said, warnings) = told("hk-lane", &[]);
    let first = warnings.first().map_or("", String::as_str);
    assert!(first.contains("(hk-lane): nothing else checks these 6.00 m"), "{said}");
}
