//! Truth: boxes around key points, whole boxes on measured lanes, faults, and the projection
//! against OpenCV.

mod support;

use std::fmt::Write as _;
use std::io::Write as _;
use std::process::{Command, Stdio};

use street::faults::{Picture, View};
use street::recording::Recorder;
use street::scene::Scene;
use street::simulation::Simulation;
use street::truth;
use verge_desk::skip;

fn curve(changes: &[&str]) -> Scene {
    let changes: Vec<String> = changes.iter().map(|change| (*change).to_owned()).collect();
    let text = include_str!("../scenes/curve.toml");
    Scene::parse(text, "curve.toml", &changes).expect("the curve is valid")
}

#[test]
fn boxes_hold_their_key_points_and_are_whole_on_measured_lanes() {
    let scene = curve(&[]);
    let mut recorder = Recorder::new(&scene, 11).expect("a recorder");
    let (mut points, mut measured) = (0, 0);
    for _ in 0..40 {
        let frame = recorder.next_truth();
        for vehicle in &frame.vehicles {
            let [x0, y0, x1, y1] = vehicle.bounds;
            for point in vehicle.keypoints.values() {
                let inside = point[0] >= x0 - 0.001
                    && point[0] <= x1 + 0.001
                    && point[1] >= y0 - 0.001
                    && point[1] <= y1 + 0.001;
                assert!(inside, "{point:?} is outside {vehicle:?}");
                points += 1;
            }
            assert!((0.0..=1.0).contains(&vehicle.occlusion), "{vehicle:?}");
            let lane = &recorder.street().measured()[vehicle.lane - 1];
            if (0.0..lane.length_m()).contains(&vehicle.s_m) {
                let (w, h) = (f64::from(scene.camera.width), f64::from(scene.camera.height));
                assert!(x0 > 0.0 && y0 > 0.0 && x1 < w && y1 < h, "{vehicle:?} is cut");
                measured += 1;
            }
        }
        for lane in &frame.lanes {
            let inside = frame
                .vehicles
                .iter()
                .filter(|v| v.lane == lane.lane && (0.0..lane.length_m).contains(&v.s_m));
            assert_eq!(inside.count(), lane.vehicles, "lane {} of {}", lane.lane, frame.frame);
            let density = lane.vehicles as f64 / lane.length_m * 1000.0;
            assert!((density - lane.density_veh_km).abs() < 0.002);
            let flow = lane.density_veh_km * lane.speed_km_h.unwrap_or(0.0);
            assert!((flow - lane.flow_veh_h).abs() < 0.2, "{lane:?}");
        }
    }
    assert!(points > 2000 && measured > 300, "{points} key points, {measured} vehicles");
}

#[test]
fn a_frozen_picture_repeats_and_a_black_one_is_black() {
    let scene = support::tiny(&[
        "faults.frozen_from_s=2.0",
        "faults.black_from_s=4.0",
        "faults.until_s=5.0",
    ]);
    let mut recorder = Recorder::new(&scene, 2).expect("a recorder");
    let frames: Vec<_> = (0..6).map(|_| recorder.next_frame()).collect();
    let states: Vec<Picture> = frames.iter().map(|frame| frame.truth.picture).collect();
    use Picture::{Black, Frozen, Live};
    assert_eq!(states, [Live, Live, Frozen, Frozen, Black, Live]);
    assert_ne!(frames[0].picture, frames[1].picture);
    assert_eq!(frames[1].picture, frames[3].picture);
    let ids = |i: usize| frames[i].truth.vehicles.iter().map(|v| v.id).collect::<Vec<_>>();
    assert_eq!(ids(1), ids(3));
    assert!(frames[4].picture.data.iter().all(|level| *level == 0) && ids(4).is_empty());
}

#[test]
fn sway_stays_within_its_amplitude_and_a_ptz_move_is_for_good() {
    let scene = support::tiny(&[
        "faults.shake_px=2.0",
        "faults.ptz={ at_s = 50.0, pan_deg = 5.0, zoom = 1.2 }",
    ]);
    let far = nalgebra::Point3::new(0.0, 40.0, 0.0);
    let still = scene.camera().project(&far).expect("in front");
    let mut largest: f64 = 0.0;
    for i in 0..500 {
        let swayed =
            View::at(&scene, 3, f64::from(i) * 0.1).camera().project(&far).expect("in front");
        largest = largest.max((swayed[0] - still[0]).hypot(swayed[1] - still[1]));
    }
    assert!(largest > 1.0 && largest < 2.0 * 1.6, "{largest} px");
    let moved = View::at(&scene, 3, 50.0).aim;
    assert!((moved.focal_px - 1.2 * 170.0).abs() < 1e-9);
    assert!((moved.position() - scene.camera().position()).norm() < 1e-9, "PTZ turns in place");
    let shift = moved.project(&far).expect("in front")[0] - still[0];
    assert!(shift < -15.0, "a pan to the right moves the picture to the left: {shift}");
}

#[test]
fn projected_key_points_agree_with_opencv() {
    let scene = curve(&["camera.k1=-0.08", "camera.roll_deg=3.0"]);
    let street = Simulation::new(&scene, 4).expect("a street");
    let camera = scene.camera();
    let (rvec, tvec) = (camera.rvec(), camera.translation);
    let mut input = format!(
        "{} {} {} {} {} {} {} {} {} {}\n",
        camera.focal_px,
        f64::from(camera.width) / 2.0,
        f64::from(camera.height) / 2.0,
        camera.k1,
        rvec.x,
        rvec.y,
        rvec.z,
        tvec.x,
        tvec.y,
        tvec.z
    );
    let mut ours = Vec::new();
    for vehicle in &street.snapshot().vehicles {
        for (point, image) in
            vehicle.model().key_points.iter().zip(truth::key_points(vehicle, &camera))
        {
            let Some(image) = image else { continue };
            // Beyond the picture the one-term lens model folds over; nobody looks there.
            if image[0].abs() > 2000.0 || image[1].abs() > 2000.0 {
                continue;
            }
            let world = vehicle.world(*point);
            writeln!(input, "{} {} {}", world.x, world.y, world.z).expect("a string");
            ours.push(image);
        }
    }
    assert!(ours.len() > 100, "{} key points", ours.len());
    let program = "
import sys
try:
    import cv2, numpy as np
except ImportError:
    sys.exit(69)
rows = [list(map(float, line.split())) for line in sys.stdin]
f, cx, cy, k1 = rows[0][:4]
K = np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]])
rvec, tvec = np.array(rows[0][4:7]), np.array(rows[0][7:10])
image, _ = cv2.projectPoints(np.array(rows[1:]), rvec, tvec, K, np.array([k1, 0, 0, 0.0]))
for u, v in image.reshape(-1, 2):
    print(repr(float(u)), repr(float(v)))
";
    let child = Command::new("python3")
        .args(["-c", program])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn();
    let Ok(mut child) = child else { return skip("python3 is not here") };
    let sent = child.stdin.take().expect("a pipe").write_all(input.as_bytes());
    let output = child.wait_with_output().expect("python3 ends");
    if output.status.code() == Some(69) {
        return skip("python3 has no cv2 (pip install opencv-python-headless)");
    }
    assert!(sent.is_ok() && output.status.success(), "{:?}", output.status);
    let text = String::from_utf8(output.stdout).expect("numbers");
    let mut worst: f64 = 0.0;
    for (line, image) in text.lines().zip(&ours) {
        let (u, v) = line.split_once(' ').expect("two numbers");
        let (u, v): (f64, f64) = (u.parse().expect("a number"), v.parse().expect("a number"));
        worst = worst.max((u - image[0]).hypot(v - image[1]));
    }
    assert_eq!(text.lines().count(), ours.len());
    assert!(worst < 0.01, "{worst} px from OpenCV");
}

#[test]
fn the_committed_recordings_are_what_the_program_makes() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    for name in ["curve", "freeway"] {
        let folder = root.join("tests/data").join(name);
        let about = std::fs::read_to_string(folder.join("recording.json")).expect("committed");
        let about: serde_json::Value = serde_json::from_str(&about).expect("JSON");
        let scene = root.join(format!("street/scenes/{name}.toml"));
        let scene = Scene::read(&scene, &[]).expect("a shipped scene");
        let seed = about["seed"].as_u64().expect("a seed");
        let mut recorder = Recorder::new(&scene, seed).expect("a recorder");
        let truth = std::fs::read_to_string(folder.join("truth.jsonl")).expect("committed");
        assert_eq!(truth.lines().count() as u64, about["frames"].as_u64().expect("a count"));
        for line in truth.lines().take(2) {
            let made = serde_json::to_string(&recorder.next_truth()).expect("JSON");
            assert!(
                made == line,
                "{name}: record it again, the program has changed\n{made}\n{line}"
            );
        }
    }
}
