//! Density with and without shake, and with it uncorrected.

use super::{eye_of, reference_of, scene};
use mvcalib::files::calibration::{Calibration, Sha256};
use mvcalib::files::labelme::LabelFile;
use mvcalib::road::drawn_lane::lanes;
use mvcalib::road::lane_table::table;
use std::time::Duration;
use street::recording::{Recorder, calibration};
use street::scene::Scene;
use verge::lane::LaneTable;
use verge::scene::{Guard, Reference};
use verge::units::ImagePoint;

/// Density of 15 minutes per lane by true boxes: still, shaken and corrected, shaken.
pub fn density() {
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
