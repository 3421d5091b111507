//! Picture health and the moved camera, on the simulated street and on the real one.
//! Longer runs of the same: `calib/examples/scene.rs`; results in docs/measured/health.md.

use mvcalib::files::calibration::Calibration;
use mvcalib::road::scene_reference::{pictures, reference};
use serde_json::Value;
use std::path::{Path, PathBuf};
use street::recording::{Recorder, write};
use street::scene::Scene;
use verge::alarm::Alarm;
use verge::daemon::capture::decode;
use verge::daemon::frame::Picture;
use verge::daemon::scene::{Aiming, Scene as Judge, View};
use verge::scene::Reference;
use verge::units::{ImagePoint, UtcMs};
use verge_desk::shared;
use verge_street_tests::{Extras, MODEL, STREET_FRAMES, at, scene, verge, write_table};

fn curve(changes: &[&str]) -> Scene {
    scene("curve", changes)
}

/// The reference of the recording that ships.
fn street_reference() -> Reference {
    let files = pictures(&at(STREET_FRAMES)).expect("it ships");
    let some: Vec<PathBuf> = files.into_iter().step_by(15).collect();
    reference(&some, &[]).expect("a clear scene").1
}

/// A camera on the street of that recording, a picture each ten seconds.
struct Camera {
    recorder: Recorder,
    number: i64,
}

impl Camera {
    fn new(changes: &[&str]) -> Self {
        let scene = curve(&[&["interval_s=10"], changes].concat());
        Self { recorder: Recorder::new(&scene, 3).expect("a street"), number: 0 }
    }

    /// The next picture, after JPEG, and its time.
    fn next(&mut self) -> (Picture, UtcMs) {
        self.number += 1;
        let frame = self.recorder.next_frame();
        let jpeg = frame.picture.jpeg(60, "frame").expect("encoding to memory");
        (decoded(&jpeg), UtcMs(self.number * 10_000))
    }
}

fn decoded(jpeg: &[u8]) -> Picture {
    let mut picture = Picture::default();
    decode(jpeg, &mut picture).expect("a whole picture");
    picture
}

#[test]
fn the_scene_is_found_by_night_and_in_rain_and_its_sway_is_measured() {
    let known = street_reference();
    for light in [&[][..], &["light.rain=0.8"], &["light.daylight=dusk"], &["light.daylight=night"]]
    {
        let mut camera = Camera::new(&[&["faults.shake_px=2"], light].concat());
        let scene = camera.recorder.street().scene().clone();
        let mut judge = Judge::new(vec![Some(known.clone())]);
        for number in 0..4 {
            let (picture, time) = camera.next();
            let View::Fit { preset: 0, shift } = judge.judge(&picture, time) else {
                panic!("{light:?}: frame {number} is not in place")
            };
            let time_s = f64::from(number) * 10.0;
            let sway = street::faults::View::at(&scene, 3, time_s).sway.scaled_axis();
            let (u, v) = (scene.camera.focal_px * sway.y, -scene.camera.focal_px * sway.x);
            let error = (f64::from(shift.u) - u).hypot(f64::from(shift.v) - v);
            assert!(error < 0.4, "{light:?}: {error:.2} px");
        }
        assert_eq!(judge.aiming(), Aiming::InPlace);
    }
}

#[test]
fn a_small_move_is_flagged_within_two_minutes_and_forgiven_when_undone() {
    let known = street_reference();
    for (kind, light) in
        [("pan_deg = 0.92", "day"), ("tilt_deg = -2.0", "night"), ("roll_deg = 2.0", "dusk")]
    {
        let ptz = format!("faults.ptz={{ at_s = 55.0, until_s = 155.0, {kind} }}");
        let light = format!("light.daylight={light}");
        let mut camera = Camera::new(&["faults.shake_px=1.5", &ptz, &light]);
        let mut judge = Judge::new(vec![Some(known.clone())]);
        let mut moved = Vec::new();
        for number in 0..22 {
            let (picture, time) = camera.next();
            match judge.judge(&picture, time) {
                View::Withheld(Alarm::CameraMoved) => moved.push(number),
                View::PassedOver => assert!((6..19).contains(&number), "{kind}: {number}"),
                View::Fit { .. } => {}
                other => panic!("{kind}: frame {number} is {other:?}"),
            }
        }
        // Moved from frame 6 to 15: flagged from the fourth on, back with the third again.
        assert_eq!(moved, (9..=17).collect::<Vec<_>>(), "{kind}");
        assert_eq!(judge.aiming(), Aiming::InPlace);
    }
}

#[test]
fn another_scene_is_a_move_and_fog_is_none() {
    let mut judge = Judge::new(vec![Some(street_reference())]);
    let mut camera = Camera::new(&["faults.ptz={ at_s = 35.0, pan_deg = 25.0 }"]);
    let views: Vec<View> = (0..12)
        .map(|_| {
            let (picture, time) = camera.next();
            judge.judge(&picture, time)
        })
        .collect();
    assert!(views[..4].iter().all(|view| matches!(view, View::Fit { .. })), "{views:?}");
    assert_eq!(views[11], View::Withheld(Alarm::CameraMoved), "{views:?}");

    let mut judge = Judge::new(vec![Some(street_reference())]);
    let mut camera = Camera::new(&[]);
    for number in 0..12 {
        let (mut picture, time) = camera.next();
        if number >= 3 {
            picture.rgb.iter_mut().for_each(|level| *level = 150 + *level / 7);
        }
        let view = judge.judge(&picture, time);
        let blinded = view == View::Withheld(Alarm::BlindedPicture);
        assert_eq!(blinded, number >= 3, "{view:?}");
    }
    assert_eq!(judge.aiming(), Aiming::InPlace, "the state is kept");
}

#[test]
fn blank_and_blurred_pictures_are_told_from_good_ones() {
    let (picture, time) = Camera::new(&[]).next();
    let (width, height) = (picture.width as u32, picture.height as u32);
    let judged = |rgb: Vec<u8>| {
        let picture = Picture { width: width as usize, height: height as usize, rgb };
        Judge::new(vec![None]).judge(&picture, time)
    };
    let image = image::RgbImage::from_raw(width, height, picture.rgb).expect("a whole picture");
    assert_eq!(judged(image.to_vec()), View::UNJUDGED);
    for level in [0, 128, 255] {
        let blank = vec![level; image.len()];
        assert_eq!(judged(blank), View::Withheld(Alarm::BlankPicture), "{level}");
    }
    let blurred = image::imageops::blur(&image, 4.0).into_vec();
    assert_eq!(judged(blurred), View::Withheld(Alarm::BlurredPicture));
    let glare = image.iter().map(|&level| level.saturating_mul(4)).collect();
    assert_eq!(judged(glare), View::Withheld(Alarm::BlindedPicture));
}

#[test]
fn a_frozen_picture_with_a_running_clock_is_unchanged_and_an_empty_street_is_not() {
    let clock = |picture: &mut Picture, second: usize| {
        for (digit, v) in (0..8).flat_map(|digit| (225..235).map(move |v| (digit, v))) {
            for u in 0..6 {
                let at = (v * picture.width + 220 + 8 * digit + u) * 3;
                let level = if (second >> (digit % 5)).is_multiple_of(2) { 240 } else { 20 };
                picture.rgb[at..at + 3].fill(level);
            }
        }
    };
    let recoded = |picture: &Picture| {
        let image = image::RgbImage::from_raw(320, 240, picture.rgb.clone()).expect("whole");
        let mut jpeg = Vec::new();
        image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 75)
            .encode_image(&image)
            .expect("encoding to memory");
        decoded(&jpeg)
    };
    let (still, _) = Camera::new(&[]).next();
    let mut judge = Judge::new(vec![None]);
    for second in 0..8 {
        let mut shown = Picture { rgb: still.rgb.clone(), ..still };
        clock(&mut shown, second);
        let view = judge.judge(&recoded(&shown), UtcMs(second as i64 * 1000));
        let expected = if second == 0 { View::UNJUDGED } else { View::Unchanged };
        assert_eq!(view, expected, "second {second}");
    }

    let mut empty = curve(&["light.daylight=night", "interval_s=1"]);
    empty.lanes.iter_mut().for_each(|lane| lane.inflow_veh_h = 0.0);
    let mut recorder = Recorder::new(&empty, 1).expect("a street");
    let mut judge = Judge::new(vec![None]);
    for second in 0..6 {
        let jpeg = recorder.next_frame().picture.jpeg(60, "frame").expect("encoding");
        let view = judge.judge(&decoded(&jpeg), UtcMs(second * 1000));
        assert_eq!(view, View::UNJUDGED, "second {second}");
    }
}

#[test]
fn presets_are_chosen_by_what_is_seen_and_windows_are_not_mixed() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name);
    // From the third minute on the operator looks elsewhere.
    let ptz = "faults.ptz={ at_s = 115.0, pan_deg = 1.5, tilt_deg = 1.5 }";
    let recorded = curve(&["interval_s=20", ptz]);
    write(&recorded, 12, 3, &path("recording")).expect("a recording");
    let table = |scene: &Scene, file: &str, hash: u8| {
        write_table(scene, folder.path(), file, Extras { reference: 6, hash })
    };
    let a = table(&curve(&[]), "a.lut", 0xa);
    let b = table(&curve(&["camera.pan_deg=-0.5", "camera.tilt_deg=20.5"]), "b.lut", 0xb);
    let frames = path("recording/frames");
    let text = |path: &PathBuf| path.to_str().expect("UTF-8").to_owned();
    let replay = |tables: &[&PathBuf]| -> Option<Vec<Value>> {
        let tables: Vec<String> =
            tables.iter().flat_map(|t| ["--table".to_owned(), text(t)]).collect();
        let frames = text(&frames);
        let mut args = vec!["replay", "--frames", &frames, "--json", "--window", "60"];
        args.extend(tables.iter().map(String::as_str));
        let output = verge(&args)?;
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let lines = String::from_utf8(output.stdout).expect("UTF-8");
        Some(lines.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect())
    };
    let used = |windows: &[Value]| -> Vec<(String, u64)> {
        let one = |w: &Value| {
            let calibration = w["calibration"]["sha256"].as_str().expect("a hash")[..2].to_owned();
            (calibration, w["lanes"][0]["frames_used"].as_u64().expect("a number"))
        };
        windows.iter().map(one).collect()
    };
    // Two frames of the third minute pass until the other preset is believed.
    let expected = [("0a", 3), ("0a", 3), ("0b", 1), ("0b", 3)];
    let expected = expected.map(|(hash, used)| (hash.to_owned(), used));
    let Some(windows) = replay(&[&a, &b]) else { return };
    assert_eq!(used(&windows), expected);
    // With one preset alone density is suspended from the move on.
    let Some(windows) = replay(&[&a]) else { return };
    assert_eq!(used(&windows)[..2], expected[..2]);
    for window in &windows[2..] {
        assert_eq!(window["lanes"][0]["status"], "detectionAutoSuspended");
        assert!(window["lanes"][0]["density_veh_km"].is_null());
    }
}

#[test]
fn a_check_says_that_a_picture_would_be_withheld() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name);
    write_table(&curve(&[]), folder.path(), "a.lut", Extras { reference: 6, hash: 0xa });
    let model = at(MODEL);
    let checked = |name: &str, frames: &[Vec<u8>]| -> Option<(String, bool)> {
        std::fs::create_dir(path(name)).expect("a folder");
        for (number, frame) in frames.iter().enumerate() {
            std::fs::write(path(name).join(format!("{number}.jpg")), frame).expect("a frame");
        }
        let config = format!(
            "site = \"s\"\n[camera]\nid = \"curve\"\nsource = \"{name}\"\ninterval_s = 1\n\
             [model]\nfile = {model:?}\n[lane_table]\nfile = \"a.lut\"\n\
             [mqtt]\nport = 1\n"
        );
        let config_file = path(&format!("{name}.toml"));
        std::fs::write(&config_file, config).expect("writing the configuration");
        let utf8 = |path: &Path| path.to_str().expect("UTF-8").to_owned();
        let drawn = path(&format!("{name}.png"));
        let command = ["check", "--config", &utf8(&config_file), "--overlay", &utf8(&drawn)];
        let output = verge(&command)?;
        let drawing = image::open(&drawn).expect("a picture is drawn whatever is wrong with it");
        assert_eq!(drawing.width(), 960, "{name}");
        let said = String::from_utf8(output.stdout).expect("UTF-8");
        let line = said.lines().find(|line| line.contains("measurement")).unwrap_or_default();
        // Nothing listens at the broker's port: 69 where that alone has failed.
        Some((line.to_owned(), output.status.code() == Some(69)))
    };
    let street = |changes: &[&str]| -> Vec<Vec<u8>> {
        let mut recorder = Recorder::new(&curve(changes), 3).expect("a street");
        (0..2).map(|_| recorder.next_frame().picture.jpeg(60, "f").expect("encoding")).collect()
    };
    let good = street(&[]);
    let Some((said, passed)) = checked("good", &good) else { return };
    assert!(said.starts_with("ok ") && said.ends_with("aim: in_place") && passed, "{said}");
    let black = image::RgbImage::new(320, 240);
    let mut dark = Vec::new();
    image::codecs::jpeg::JpegEncoder::new(&mut dark).encode_image(&black).expect("encoding");
    for (name, frames, expected) in [
        (
            "moved",
            street(&["faults.ptz={ at_s = 0.0, pan_deg = 2.0 }"]),
            "camera_moved (detectionAutoSuspended)",
        ),
        (
            "elsewhere",
            street(&["faults.ptz={ at_s = 0.0, pan_deg = 25.0 }"]),
            "camera_moved (detectionAutoSuspended)",
        ),
        ("frozen", vec![good[0].clone(); 2], "frozen_picture (inputDataIntegrity)"),
        ("dark", vec![dark; 2], "blank_picture (sensorFailure)"),
    ] {
        let Some((said, passed)) = checked(name, &frames) else { return };
        assert!(said.starts_with("FAIL") && said.contains(expected) && !passed, "{name}: {said}");
    }
}

#[test]
fn k109fs_wander_is_found_and_puts_vehicles_into_their_lanes() {
    let Some(frames) = shared("data/k109f/camera_calibration/K109F/images") else { return };
    let text = |name: &str| std::fs::read_to_string(at(name)).expect("it ships");
    let json = |name: &str| -> Value { serde_json::from_str(&text(name)).expect("JSON") };
    let told = json("tests/data/k109f/frames.json");
    let mut files = pictures(&frames).expect("frames");
    files.retain(|file| file.file_name().is_some_and(|name| name != "vehicle_03.jpg"));
    let pose = files.iter().position(|f| f.ends_with("vehicle_06.jpg")).expect("the pose's frame");
    files[..=pose].rotate_right(1);
    let (_, known) = reference(&files, &[]).expect("one scene");
    let table = std::fs::read(at("tests/data/k109f.lut")).expect("it ships");
    let table = verge::lane::LaneTable::parse(table).expect("a right table");
    let labels = json("tests/data/k109f/vehicles.json");
    let (mut right, mut all, mut worst) = (0, 0, 0.0_f64);
    for frame in labels["frames"].as_array().expect("frames") {
        let name = frame["frame"].as_str().expect("a name");
        let picture = decoded(&std::fs::read(frames.join(name)).expect("the frame"));
        let view = Judge::new(vec![Some(known.clone())]).judge(&picture, UtcMs(0));
        let View::Fit { shift, .. } = view else { panic!("{name}: {view:?}") };
        let by_lines = &told["shifts"][name];
        let by_lines = [0, 1].map(|i| by_lines[i].as_f64().expect("px"));
        let difference = (f64::from(shift.u) - by_lines[0]).hypot(f64::from(shift.v) - by_lines[1]);
        eprintln!("{name}: {:+.2} {:+.2}, by the lane lines {by_lines:?}", shift.u, shift.v);
        worst = worst.max(difference);
        for vehicle in frame["vehicles"].as_array().expect("vehicles") {
            let side = |i: usize| vehicle["box"][i].as_f64().expect("px") as f32;
            let (u, v) = ((side(0) + side(2)) / 2.0, side(3));
            let point = ImagePoint { u: u - shift.u, v: v - shift.v };
            let Some(place) = table.place(point) else { continue };
            all += 1;
            right += usize::from(u64::from(place.lane.get()) == vehicle["lane"].as_u64().unwrap());
        }
    }
    eprintln!("{right} of {all} in their lane; largest difference {worst:.2} px");
    assert!(worst <= 0.5, "{worst} px");
    assert!(all >= 60 && right + 2 >= all, "{right} of {all}");
}

#[test]
fn a_site_saved_at_the_desk_passes_every_check() {
    use mvcalib::desk::{backdrop::Backdrop, drawing::Drawing, save, site::Site, traffic::Traffic};
    let folder = tempfile::tempdir().expect("a temporary folder");
    let street = &at("tests/data/freeway");
    let read = |name: &str| -> Value {
        let text = std::fs::read_to_string(street.join(name)).expect("the street's own");
        serde_json::from_str(&text).expect("JSON")
    };
    let site = Site::of(street, Some(&folder.path().join("site"))).expect("pictures");
    let backdrop = Backdrop::of(&site.pictures().expect("a list")[..9]).expect("a backdrop");
    let lanes = read("lanes.json");
    let corner = |lane: usize, k: usize| lanes["shapes"][lane]["points"][k].clone();
    // An outline runs up one side, 23 vertices, and down the other.
    let side = |lane: usize, end: usize, up: &[usize]| -> Vec<Value> {
        up.iter().map(|k| corner(lane, if end == 0 { *k } else { 45 - k })).collect()
    };
    let known = Calibration::read(&street.join("calibration.json"), None);
    let camera = known.expect("the street's camera").camera();
    let on_road = |p: &Value| {
        let axis = |k: usize| p[k].as_f64().expect("a coordinate");
        camera.back_project(&[axis(0), axis(1)].into(), 0.0).expect("on the road")
    };
    let length = |a: Value, b: Value| {
        let metres = (on_road(&a) - on_road(&b)).norm();
        serde_json::json!({"points": [a, b], "metres": metres})
    };
    let steps = [1, 4, 8, 13];
    let polygon: Vec<Value> = side(0, 0, &[1, 8]).into_iter().chain(side(0, 1, &[8, 1])).collect();
    let drawing = serde_json::json!({
        "format": "verge-desk", "version": 1, "image_size": backdrop.image_size,
        "backdrop": backdrop.sha256, "site": "bridge 7", "camera_id": "freeway",
        "lane_width_m": 3.66,
        "lengths": [length(corner(0, 1), corner(0, 3)), length(corner(0, 9), corner(0, 14))],
        "lines": [{"id": 1, "points": side(0, 0, &steps)}, {"id": 2, "points": side(0, 1, &steps)}],
        "lanes": [{"number": 1, "direction": "away", "polygon": polygon}],
    });
    let drawing = Drawing::parse(drawing.to_string().as_bytes()).expect("a drawing");
    let traffic = Traffic::new(None, &site, None).expect("no file");
    let model = at(MODEL);
    save::save(&drawing, &site, &backdrop, &traffic, Some(&model)).expect("a good site");
    let config = site.file("verge.toml");
    let Some(output) = verge(&["check", "--config", config.to_str().expect("UTF-8")]) else {
        return;
    };
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    // No broker need listen here.
    let failed: Vec<&str> =
        said.lines().filter(|l| !l.starts_with("ok ") && !l.contains("broker")).collect();
    assert!(failed.is_empty() && said.contains("measurement"), "{said}");
}
