//! Measures how well a moved camera is noticed and a shaking one borne
//! (docs/explanation/health.md has the results and the command of each).
//!
//! ```text
//! scene moves SCENE [CASES [LIGHT]]  moves of 2 % or 2 degrees, by day, at night, in rain
//! scene day [FROM HOURS]   a day, or hours of it, with traffic, changing light, 2 px of shake
//! scene density            density with and without shake, and with it uncorrected
//! scene cameras DIR        pictures NAME-*.jpg of several fixed cameras, each against all
//! scene frames DIR [NAME]  one camera's pictures against the reference made of them
//! ```

use mvcalib::files::calibration::{Calibration, Sha256};
use mvcalib::files::labelme::LabelFile;
use mvcalib::road::lane_table::{lanes, table};
use mvcalib::road::scene_reference::{HeapEye, eye, picture, pictures, reference};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;
use street::random::Stream;
use street::recording::{Recorder, calibration};
use street::scene::{Daylight, Light, Ptz, Scene};
use verge::lane::LaneTable;
use verge::picture::Look;
use verge::scene::{Aim, Grid, Guard, Reference, Sighting, search};
use verge::units::ImagePoint;

/// Time between frames, s.
const INTERVAL_S: f64 = 10.0;
/// Frames before a move and after it: two minutes.
const BEFORE: usize = 6;
const AFTER: usize = 12;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number =
        |at, default| arguments.get(at).map_or(default, |n: &String| n.parse().expect("a number"));
    match arguments.first().map(String::as_str) {
        Some("moves") => {
            moves(&arguments[1], number(2, 51), arguments.get(3).map(String::as_str));
        }
        Some("day") => day(number(1, 0), number(2, 24)),
        Some("density") => density(),
        Some("cameras") => cameras(arguments[1].as_ref()),
        Some("frames") => frames(arguments[1].as_ref(), arguments.get(2).map(String::as_str)),
        _ => eprintln!("scene moves|day|density|cameras|frames"),
    }
}

fn scene(name: &str, changes: &[&str]) -> Scene {
    let path = format!("street/scenes/{name}.toml");
    let changes: Vec<String> = changes.iter().map(|c| (*c).to_owned()).collect();
    Scene::read(path.as_ref(), &changes).expect("a scene that ships")
}

/// The recording's next picture as a camera sends it: after JPEG.
fn next(recorder: &mut Recorder) -> Vec<u8> {
    let frame = recorder.next_frame();
    let quality = recorder.street().scene().imaging.jpeg_quality;
    let jpeg = frame.picture.jpeg(quality, "frame").expect("encoding to memory");
    image::load_from_memory(&jpeg).expect("a picture").into_rgb8().into_raw()
}

/// The reference as `mvcalib table --reference` makes it, of eight frames of a calm day.
fn reference_of(name: &str, seed: u64) -> Reference {
    let calm = scene(name, &["interval_s=20"]);
    let mut recorder = Recorder::new(&calm, seed).expect("a street");
    let folder = std::env::temp_dir().join(format!("verge-scene-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a temporary folder");
    let size = (calm.camera.width, calm.camera.height);
    for number in 0..8 {
        let rgb = next(&mut recorder);
        let image = image::RgbImage::from_raw(size.0, size.1, rgb).expect("a whole picture");
        image.save(folder.join(format!("{number}.png"))).expect("writing a frame");
    }
    let made = reference(&pictures(&folder).expect("frames"), &[]).expect("a clear scene").1;
    std::fs::remove_dir_all(&folder).expect("removing the frames");
    made
}

fn eye_of(scene: &Scene) -> HeapEye {
    eye(scene.camera.width, scene.camera.height)
}

/// Moves of random direction: of three kinds, 2 % of the width or 2 degrees; in every light or
/// in the named one.
fn moves(name: &str, cases: usize, only: Option<&str>) {
    println!("| scene | light | move | cases | flagged within 2 min | slowest, s |");
    println!("|---|---|---|---|---|---|");
    let lights = [
        ("day", vec![]),
        ("night", vec!["light.daylight=night"]),
        ("rain", vec!["light.rain=0.8"]),
        ("rain at night", vec!["light.daylight=night", "light.rain=0.8"]),
    ];
    let kinds = ["2 % of the width", "2 degrees of pan or tilt", "2 degrees of roll"];
    let (mut total, mut flagged) = (0, 0);
    let known: Vec<Reference> = (0..4).map(|seed| reference_of(name, 500 + seed)).collect();
    for (light, changes) in lights.iter().filter(|(light, _)| only.is_none_or(|o| o == *light)) {
        for (kind, said) in kinds.iter().enumerate() {
            let share = cases / kinds.len();
            let (mut hits, mut slowest) = (0, 0.0_f64);
            for case in 0..share {
                let seed = 500 + case as u64 % 4;
                let mut scene = scene(name, changes);
                let after = one_move(&mut scene, &known[case % 4], seed, kind, case as u64);
                if let Some(after) = after {
                    hits += 1;
                    slowest = slowest.max(after);
                }
            }
            (total, flagged) = (total + share, flagged + hits);
            println!("| {name} | {light} | {said} | {share} | {hits} | {slowest:.0} |");
        }
    }
    println!("all: {flagged} of {total}");
}

/// Seconds from a move until it is flagged.
fn one_move(
    scene: &mut Scene,
    known: &Reference,
    seed: u64,
    kind: usize,
    case: u64,
) -> Option<f64> {
    let mut random = Stream::new(case, "moves");
    let (sin, cos) = random.range(0.0, std::f64::consts::TAU).sin_cos();
    let two_percent = 0.02 * f64::from(scene.camera.width) / scene.camera.focal_px;
    let (pan_deg, tilt_deg, roll_deg) = match kind {
        0 => (two_percent.to_degrees() * cos, two_percent.to_degrees() * sin, 0.0),
        1 => (2.0 * cos, 2.0 * sin, 0.0),
        _ => (0.0, 0.0, 2.0 * cos.signum()),
    };
    scene.interval_s = INTERVAL_S;
    // Another stretch of traffic for every case, on the street of the seed.
    scene.warmup_s += 30.0 * case as f64;
    scene.faults.shake_px = 2.0 * f64::from(scene.camera.width) / 320.0;
    let at_s = BEFORE as f64 * INTERVAL_S - 1.0;
    scene.faults.ptz = Some(Ptz { at_s, pan_deg, tilt_deg, roll_deg, until_s: None, zoom: 1.0 });
    let mut recorder = Recorder::new(scene, seed).expect("a street");
    let (mut guard, mut eye) = (Guard::new(1), eye_of(scene));
    for number in 0..BEFORE + AFTER {
        eye.look(&next(&mut recorder));
        let now = Duration::from_secs_f64(number as f64 * INTERVAL_S);
        let aim = guard.judge(std::slice::from_ref(known), &eye, now).aim;
        if number < BEFORE {
            assert_eq!(aim, Aim::Preset(0), "before the move, frame {number}");
        } else if aim == Aim::Moved {
            return Some((number - BEFORE) as f64 * INTERVAL_S + 1.0);
        }
    }
    None
}

/// The light at an hour of the day: sun, clouds that come and go, showers by day and night.
fn light_at(hour: f64, random: &mut Stream) -> Light {
    let daylight = match hour {
        h if !(6.0..20.0).contains(&h) => Daylight::Night,
        h if !(7.0..19.0).contains(&h) => Daylight::Dusk,
        _ => Daylight::Day,
    };
    let shower = (4.0..5.0).contains(&hour)
        || (11.0..12.5).contains(&hour)
        || (18.5..19.5).contains(&hour)
        || (22.0..23.0).contains(&hour);
    let up = ((hour - 6.0) / 14.0 * std::f64::consts::PI).sin().max(0.0);
    Light {
        daylight,
        cloud: random.unit(),
        sun_azimuth_deg: 90.0 + (hour - 6.0) / 14.0 * 180.0,
        sun_elevation_deg: 8.0 + 55.0 * up,
        rain: if shower { random.range(0.3, 1.0) } else { 0.0 },
    }
}

/// A day: every frame of the reference's camera in place, however the light changes.
fn day(from: usize, hours: usize) {
    let known = reference_of("curve", 7);
    let mut scene = scene("curve", &["interval_s=10", "faults.shake_px=2"]);
    let mut random = Stream::new(from as u64, "light");
    scene.light = light_at(from as f64, &mut random);
    let mut recorder = Recorder::new(&scene, 7).expect("a street");
    let (mut guard, mut eye) = (Guard::new(1), eye_of(&scene));
    let frames = hours * 360;
    println!("| hour | least significance | left out | flawed | largest error of the shift, px |");
    println!("|---|---|---|---|---|");
    let (mut alarms, mut left_out, mut flawed) = (0, 0, 0);
    let (mut least, mut worst) = (f32::MAX, 0.0_f64);
    let mut hour_left_out = 0;
    for number in 0..frames {
        let time_s = number as f64 * INTERVAL_S;
        if number > 0 && number % 60 == 0 {
            recorder.set_light(light_at(from as f64 + time_s / 3600.0, &mut random));
        }
        eye.look(&next(&mut recorder));
        flawed += usize::from(Look::at(eye.luma(), eye.grid().width).flaw().is_some());
        let was = guard.aim();
        let now = Duration::from_secs_f64(time_s);
        let judged = guard.judge(std::slice::from_ref(&known), &eye, now);
        alarms += usize::from(judged.aim == Aim::Moved && was != Aim::Moved);
        if number % 12 == 0 {
            least = least.min(search(&known, &eye).significance);
        }
        match judged.shift {
            None => (left_out, hour_left_out) = (left_out + 1, hour_left_out + 1),
            Some((dx, dy)) => {
                let [tx, ty] = sway(&scene, 7, time_s);
                worst = worst.max((f64::from(dx) - tx).hypot(f64::from(dy) - ty));
            }
        }
        if number % 360 == 359 {
            println!(
                "| {} | {least:.1} | {hour_left_out} | {flawed} | {worst:.2} |",
                from + number / 360
            );
            (least, worst, hour_left_out) = (f32::MAX, 0.0, 0);
        }
    }
    println!("{frames} frames: {alarms} alarms, {left_out} frames left out, {flawed} flawed");
}

/// Where the sway moves the middle of the picture, px.
fn sway(scene: &Scene, seed: u64, time_s: f64) -> [f64; 2] {
    let turn = street::faults::View::at(scene, seed, time_s).sway.scaled_axis();
    [scene.camera.focal_px * turn.y, -scene.camera.focal_px * turn.x]
}

/// Density of 15 minutes per lane by true boxes: still, shaken and corrected, shaken.
fn density() {
    println!("| scene | lane | still, veh/km | shaken, corrected | shaken, not corrected |");
    println!("|---|---|---|---|---|");
    let mut worst = [0.0_f64; 2];
    for (name, light) in [("curve", "day"), ("curve", "night"), ("freeway", "day")] {
        let changes = ["interval_s=4".to_owned(), format!("light.daylight={light}")];
        let changes: Vec<&str> = changes.iter().map(String::as_str).collect();
        let known = reference_of(name, 3);
        let mut scene = scene(name, &changes);
        let still = counts(&scene, None);
        scene.faults.shake_px = 2.0 * f64::from(scene.camera.width) / 320.0;
        let [corrected, shaken] = [Some(&known), None].map(|known| counts(&scene, known));
        for (lane, still) in still.iter().enumerate() {
            let error = |k: usize, shaken: f64| (k, (shaken / still - 1.0) * 100.0);
            let errors = [error(0, corrected[lane]), error(1, shaken[lane])];
            for (k, error) in errors {
                worst[k] = worst[k].max(error.abs());
            }
            let [(_, a), (_, b)] = errors;
            let lane = lane + 1;
            println!("| {name}, {light} | {lane} | {still:.2} | {a:+.2} % | {b:+.2} % |");
        }
    }
    println!("largest difference: {:.2} % corrected, {:.2} % not", worst[0], worst[1]);
}

/// Mean density per lane, veh/km, the boxes' lower middles looked up in the lane table.
fn counts(scene: &Scene, known: Option<&Reference>) -> Vec<f64> {
    let mut recorder = Recorder::new(scene, 3).expect("a street");
    let table = lane_table(scene, &recorder);
    let (mut guard, mut eye) = (Guard::new(1), eye_of(scene));
    let mut sums = vec![0.0; scene.lanes.len()];
    let frames = (900.0 / scene.interval_s) as usize;
    for number in 0..frames {
        let mut shift = (0.0, 0.0);
        let truth = match known {
            None => recorder.next_truth(),
            Some(known) => {
                let frame = recorder.next_frame();
                let quality = scene.imaging.jpeg_quality;
                let jpeg = frame.picture.jpeg(quality, "frame").expect("encoding to memory");
                let rgb = image::load_from_memory(&jpeg).expect("a picture").into_rgb8();
                eye.look(rgb.as_raw());
                let now = Duration::from_secs_f64(number as f64 * scene.interval_s);
                let judged = guard.judge(std::slice::from_ref(known), &eye, now);
                let px = eye.grid().cell_px();
                let (dx, dy) = judged.shift.expect("in place");
                shift = (dx * px, dy * px);
                frame.truth
            }
        };
        for vehicle in &truth.vehicles {
            let [x0, _, x1, y1] = vehicle.bounds.map(|side| side as f32);
            let cut_off = y1 >= scene.camera.height as f32 - 0.5;
            let point = ImagePoint { u: (x0 + x1) / 2.0 - shift.0, v: y1 - shift.1 };
            if let Some(place) = table.place(point).filter(|_| !cut_off) {
                let lane = usize::from(place.lane.get()) - 1;
                let length_km = f64::from(table.description().lanes[lane].length_m) / 1000.0;
                sums[lane] += 1.0 / (frames as f64 * length_km);
            }
        }
    }
    sums
}

fn lane_table(scene: &Scene, recorder: &Recorder) -> LaneTable<Vec<u8>> {
    let drawn = street::measured::labelme(scene, recorder.street().measured(), "a.jpg");
    let drawn: LabelFile = serde_json::from_value(drawn).expect("labelme");
    let path = std::env::temp_dir().join(format!("verge-camera-{}.json", std::process::id()));
    std::fs::write(&path, calibration(scene).to_string()).expect("writing a file");
    let camera = Calibration::read(&path, None).expect("a right calibration");
    std::fs::remove_file(&path).expect("removing it");
    let drawn = lanes(&drawn, "lanes", &camera.camera()).expect("lanes on the road");
    let bytes =
        table(&camera, &drawn, Sha256([0; 32]), "street", None, 10.0).expect("a right table");
    LaneTable::parse(bytes).expect("a right table")
}

/// The camera of a file `NAME-time.jpg`.
fn camera_of(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.split('-').next().unwrap_or_default().to_owned()
}

/// Each camera's later pictures against the reference of its first three, and those of the
/// other cameras of the same picture size.
fn cameras(folder: &Path) {
    let mut by_camera: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    for path in pictures(folder).expect("pictures") {
        by_camera.entry(camera_of(&path)).or_default().push(path);
    }
    let mut known: BTreeMap<&str, (Grid, Reference)> = BTreeMap::new();
    for (name, files) in by_camera.iter().filter(|(_, files)| files.len() >= 20) {
        let size = picture(&files[0]).map(|(_, w, h)| (w, h)).ok();
        match reference(&files[..3], &[]) {
            Ok(made) => {
                known.insert(name.as_str(), made);
            }
            Err(error) => println!("{name} {size:?}: {error}"),
        }
    }
    println!(
        "| camera | pictures | in place | least significance | alarms | foreign sequences | flagged | most significance |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let mut sums = [0; 6];
    for (name, (grid, reference)) in &known {
        let own = watch(&by_camera[*name][3..], *grid, reference);
        let mut foreign = (0, 0, f32::MIN);
        for (other, files) in by_camera.iter().filter(|(other, _)| other != name) {
            if known.get(other.as_str()).is_none_or(|(other_grid, _)| other_grid != grid) {
                continue;
            }
            let seen = watch(&files[..files.len().min(13)], *grid, reference);
            foreign.0 += 1;
            foreign.1 += usize::from(seen.moved_within.is_some());
            foreign.2 = foreign.2.max(seen.most);
        }
        println!(
            "| {name} | {} | {} | {:.1} | {} | {} | {} | {:.1} |",
            own.frames, own.in_place, own.least, own.alarms, foreign.0, foreign.1, foreign.2
        );
        let row = [own.frames, own.in_place, own.alarms, foreign.0, foreign.1, 0];
        for (sum, value) in sums.iter_mut().zip(row) {
            *sum += value;
        }
    }
    println!(
        "{} pictures, {} in place, {} alarms; {} foreign sequences, {} flagged",
        sums[0], sums[1], sums[2], sums[3], sums[4]
    );
}

struct Watched {
    frames: usize,
    in_place: usize,
    least: f32,
    most: f32,
    alarms: usize,
    moved_within: Option<usize>,
}

/// A camera's pictures, ten seconds apart, against a reference.
fn watch(files: &[PathBuf], grid: Grid, reference: &Reference) -> Watched {
    let mut guard = Guard::new(1);
    let mut watched = Watched {
        frames: 0,
        in_place: 0,
        least: f32::MAX,
        most: f32::MIN,
        alarms: 0,
        moved_within: None,
    };
    for path in files {
        let (rgb, width, height) = picture(path).expect("a picture");
        let mut eye = eye(width, height);
        if eye.grid() != grid {
            continue;
        }
        eye.look(&rgb);
        let sighting = search(reference, &eye);
        watched.least = watched.least.min(sighting.significance);
        watched.most = watched.most.max(sighting.significance);
        let was = guard.aim();
        let now = Duration::from_secs(10 * watched.frames as u64);
        let judged = guard.judge(std::slice::from_ref(reference), &eye, now);
        watched.frames += 1;
        watched.in_place += usize::from(judged.shift.is_some());
        if judged.aim == Aim::Moved && was != Aim::Moved {
            watched.alarms += 1;
            watched.moved_within.get_or_insert(watched.frames);
        }
    }
    watched
}

/// One camera's pictures against the reference made of them all; `pose` is the one that
/// shows the pose of the calibration.
fn frames(folder: &Path, pose: Option<&str>) {
    let mut files = pictures(folder).expect("pictures");
    if let Some(pose) = pose {
        let at = files.iter().position(|f| f.file_name().is_some_and(|n| n == pose));
        files[..=at.expect("the named frame")].rotate_right(1);
    }
    let (_, reference) = reference(&files, &[]).expect("one scene");
    println!("| picture | shift, px | turn, degrees | zoom | significance | support | agreement |");
    println!("|---|---|---|---|---|---|---|");
    for file in &files {
        let (rgb, width, height) = picture(file).expect("a picture");
        let mut eye = eye(width, height);
        eye.look(&rgb);
        let Sighting { pose, significance, support, agreement } = search(&reference, &eye);
        let px = eye.grid().cell_px();
        println!(
            "| {} | {:+.2} {:+.2} | {:+.2} | {:.3} | {significance:.1} | {support:.2} | {agreement:.2} |",
            file.file_name().unwrap_or_default().to_string_lossy(),
            pose.dx * px,
            pose.dy * px,
            pose.turn.to_degrees(),
            pose.zoom
        );
    }
}
