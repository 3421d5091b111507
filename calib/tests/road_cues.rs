//! Cues of the road fit through `mvcalib calibrate`: rectangles, and national standards against the
//! other cues, on a made camera.

use mvcalib::camera::{Camera, Lens, Pose};
use mvcalib::road::dashes::{Dashes, NoDashes, Picture, find};
use nalgebra::{Rotation3, Vector2, Vector3};
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

/// Lengths along the road alone, near and far.
fn along_alone() -> [serde_json::Value; 3] {
    let along = |from: f64, to: f64| shape("length", "line", &[[0.0, from], [0.0, to]]);
    let mut all = [along(20.0, 32.0), along(40.0, 52.0), along(20.0, 68.0)];
    for (one, metres) in all.iter_mut().zip([12, 12, 48]) {
        one["label"] = format!("{metres} m").into();
    }
    all
}

#[test]
fn an_error_across_the_road_is_stated_judged_and_mended() {
    let (_, said, written) = road(&along_alone(), &[], &[]);
    let errors = &written["errors"];
    let of = |place: &str, way: &str| errors[place][way].as_f64().unwrap();
    assert!(of("far", "along") < 0.15 && of("far", "across") > 0.20, "{said}");
    let trust = written["trust"].as_str().unwrap();
    assert!(trust.starts_with("across the road lengths are uncertain by"), "{said}");
    assert!(trust.contains("limit 20 %") && trust.contains("the road, "), "{said}");
    assert!(trust.contains("; add one more length across the road"), "{said}");
    // What it asks for mends it.
    let mut more = along_alone().to_vec();
    more.push(shape("8 m", "line", &[[-4.0, 66.0], [4.0, 66.0]]));
    more.push(shape("8 m", "line", &[[-4.0, 24.0], [4.0, 24.0]]));
    let (_, said, written) = road(&more, &[], &[]);
    assert_eq!(written["trust"], "ok", "{said}");
    // Each lane's width has its error, and a stated width lowers it.
    let far = |more: &[&str]| {
        let (_, said, written) = road(&along_alone(), &lines(), more);
        assert!(said.contains("lane lines 1 and 2: width +- "), "{said}");
        let far = &written["errors"]["lanes"][0]["far"];
        assert!((far["width_m"].as_f64().unwrap() / 3.5).ln().abs() < 0.15, "{far}");
        far["rel_err"].as_f64().unwrap()
    };
    let (unknown, known) = (far(&[]), far(&["--lane-width", "3.5"]));
    assert!(known < 0.6 * unknown && unknown < 0.20, "{known} {unknown}");
}

#[test]
fn verify_states_the_error_across_the_road() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, shapes: &[serde_json::Value]| {
        let text = json!({"imageWidth": 320, "imageHeight": 240, "shapes": shapes}).to_string();
        std::fs::write(folder.path().join(name), text).unwrap();
        folder.path().join(name)
    };
    let (camera, marks) = (folder.path().join("k.json"), file("marks.json", &along_alone()));
    let run = |arguments: &[&str], path: &Path, more: &Path| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_mvcalib"));
        let ended = command.args(arguments).arg(path).arg(if arguments[0] == "verify" {
            "--calibration"
        } else {
            "--out"
        });
        ended.arg(more).output().unwrap()
    };
    let road = ["calibrate", "--method", "road", "--image-size", "320x240", "--lengths"];
    run(&road, &marks, &camera);
    let ended = run(&["verify", "--marks"], &marks, &camera);
    let said = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert!(said.contains("across the road the stated error is"), "{said}");
    assert!(said.contains("TOO MUCH (limit 20 %)"), "{said}");
    let json: serde_json::Value = serde_json::from_slice(&ended.stdout).unwrap();
    assert!(json["stated_across"][2].as_f64().unwrap() > 0.20, "{json}");
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

/// The freeway of `tests/data`: a picture, and its lanes' sides as lane lines.
fn freeway(folder: &Path) -> (std::path::PathBuf, std::path::PathBuf) {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/freeway");
    let text = std::fs::read_to_string(data.join("lanes.json")).unwrap();
    let file: serde_json::Value = serde_json::from_str(&text).unwrap();
    let side = |points: &[serde_json::Value]| json!({"label": "line", "shape_type": "linestrip", "points": points});
    let sides = |k: usize| {
        let points = file["shapes"][k]["points"].as_array().unwrap();
        let (one, other) = points.split_at(points.len() / 2);
        [side(one), side(other)]
    };
    let shapes: Vec<_> = [0, 1].into_iter().flat_map(sides).collect();
    let lines = json!({"imageWidth": 720, "imageHeight": 480, "shapes": shapes});
    std::fs::write(folder.join("lines.json"), lines.to_string()).unwrap();
    let mut frames: Vec<_> =
        std::fs::read_dir(data.join("frames")).unwrap().map(|e| e.unwrap().path()).collect();
    frames.sort();
    let backdrop = mvcalib::desk::backdrop::Backdrop::of(&frames).unwrap();
    std::fs::write(folder.join("empty.png"), &backdrop.png).unwrap();
    (folder.join("lines.json"), folder.join("empty.png"))
}

#[test]
fn dashes_are_found_along_the_lane_lines_of_a_picture_and_calibrate() {
    let folder = tempfile::tempdir().unwrap();
    let (lines, picture) = freeway(folder.path());
    let out = folder.path().join("k.json");
    let calibrate = |dashes: &str, picture: &Path| {
        let _ = std::fs::remove_file(&out);
        let mut command = Command::new(env!("CARGO_BIN_EXE_mvcalib"));
        command.args(["calibrate", "--method", "road", "--image-size", "720x480"]);
        command.args(["--dashes", dashes, "--picture"]).arg(picture);
        command.arg("--lane-lines").arg(&lines).arg("--out").arg(&out);
        let ended = command.output().unwrap();
        (ended.status.code(), String::from_utf8_lossy(&ended.stderr).into_owned())
    };
    // 12 ft and 36 ft: 14.64 m. The road's edge is solid.
    let (code, said) = calibrate("14.64", &picture);
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("dashes of lane line") && said.contains("it is solid"), "{said}");
    let written: serde_json::Value = serde_json::from_slice(&std::fs::read(&out).unwrap()).unwrap();
    let f = written["f"].as_f64().unwrap();
    assert!((f / 760.0).ln().abs() < 0.15 && written["trust"] == "ok", "{said}");
    // A picture without dashes, another size, and a pitch that is none.
    let blank = folder.path().join("blank.png");
    image::RgbImage::from_pixel(720, 480, image::Rgb([90; 3])).save(&blank).unwrap();
    let (code, said) = calibrate("14.64", &blank);
    assert!(code == Some(65) && said.contains("lane line 1: no paint is seen"), "{said}");
    let small = folder.path().join("small.png");
    image::RgbImage::new(320, 240).save(&small).unwrap();
    let (code, said) = calibrate("14.64", &small);
    assert!(code == Some(65) && said.contains("picture size"), "{said}");
    for (wrong, expected) in [("xx-lane", "known are"), ("0.1", "0.5 to 100 m")] {
        let (code, said) = calibrate(wrong, &picture);
        assert!(code == Some(64) && said.contains(expected) && !out.exists(), "{said}");
    }
}

/// A picture of the made camera's road, with one line of paint along X = 1: `is_paint` of metres
/// along it.
fn painted(is_paint: impl Fn(f64) -> bool) -> Vec<u8> {
    let camera = camera();
    let [width, height] = camera.image_size;
    let mut rgb = Vec::new();
    for (v, u) in (0..height).flat_map(|v| (0..width).map(move |u| (v, u))) {
        let share = (0..9).filter(|k| {
            let part = |k: u32| (f64::from(k) + 0.5) / 3.0;
            let at = Vector2::new(f64::from(u) + part(k % 3), f64::from(v) + part(k / 3));
            let p = camera.back_project(&at, 0.0);
            p.is_some_and(|p| (p.x - 1.0).abs() < 0.12 && is_paint(p.y))
        });
        let noise = (u * 7 + v * 13) % 5;
        rgb.extend([(90 + noise + 12 * share.count() as u32) as u8; 3]);
    }
    rgb
}

fn dashes(is_paint: impl Fn(f64) -> bool) -> Result<Dashes, NoDashes> {
    let camera = camera();
    let rgb = painted(is_paint);
    // Drawn a little beside the paint.
    let line: Vec<_> = (0..9).map(|k| [1.05, 20.0 + 5.0 * f64::from(k)]).collect();
    let line: Vec<_> = seen(&line).into_iter().map(Vector2::from).collect();
    find(&Picture { rgb: &rgb, size: camera.image_size }, &line, &camera)
}

#[test]
fn dashes_of_one_pitch_are_found_where_they_are() {
    let found = dashes(|y| y.rem_euclid(9.0) < 3.0).unwrap();
    assert!(found.middles.len() >= 3, "{found:?}");
    assert!((found.pitch_m / 9.0).ln().abs() < 0.03, "{found:?}");
    for p in &found.middles {
        let y = camera().back_project(p, 0.0).unwrap().y.rem_euclid(9.0);
        assert!((y - 1.5).abs() < 0.4, "{y}");
    }
}

#[test]
fn what_shows_no_dashes_is_refused() {
    assert_eq!(dashes(|_| true), Err(NoDashes::Solid));
    assert!(matches!(dashes(|_| false), Err(NoDashes::Unpainted { .. })));
    // Patches at no pitch, and two dashes alone.
    let between = |y: f64, all: &[(f64, f64)]| all.iter().any(|(a, b)| y > *a && y < *b);
    let patches = dashes(|y| between(y, &[(22.0, 25.0), (27.0, 30.0), (41.0, 44.0)]));
    assert!(matches!(patches, Err(NoDashes::Irregular { .. })), "{patches:?}");
    let two = dashes(|y| between(y, &[(22.0, 25.0), (31.0, 34.0)]));
    assert!(matches!(two, Err(NoDashes::Irregular { found: 2, in_a_row: 2 })), "{two:?}");
}
