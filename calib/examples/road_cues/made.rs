//! Made cameras over made roads: random scenes of the street.
//!
//! Owns the distribution of cameras and roads. Does not own traffic nor pictures (the crate
//! `street` does).

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::fmt::Write;
use std::path::Path;
use street::recording::{self, Recorder};
use street::scene::Scene;

/// Records the camera of this seed as `WIDTHxHEIGHT-SEED`.
pub fn record(folder: &Path, size: [u32; 2], seed: u64, frames: usize, truth_only: bool) {
    let out = folder.join(format!("{}x{}-{seed}", size[0], size[1]));
    if out.exists() {
        return;
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed * 2 + u64::from(size[0] > 500));
    loop {
        let text = scene(size, &mut rng);
        let Ok(scene) = Scene::parse(&text, "made", &[]) else { continue };
        // Roads that are not seen over a useful length are drawn again.
        let Ok(mut recorder) = Recorder::new(&scene, seed) else { continue };
        let lanes = recorder.street().measured();
        if lanes.iter().any(|l| l.length_m() < 30.0) {
            continue;
        }
        if !truth_only {
            std::fs::create_dir_all(folder).expect("a folder that can be made");
            recording::write(&scene, frames, seed, &out).expect("a new folder");
            return;
        }
        std::fs::create_dir_all(&out).expect("a new folder");
        let lanes = street::measured::labelme(&scene, lanes, "none.jpg");
        std::fs::write(out.join("lanes.json"), lanes.to_string()).expect("writable");
        let camera = recording::calibration(&scene).to_string();
        std::fs::write(out.join("calibration.json"), camera).expect("writable");
        let mut text = String::new();
        for _ in 0..frames {
            let truth = serde_json::to_string(&recorder.next_truth()).expect("plain numbers");
            writeln!(text, "{truth}").expect("a string grows");
        }
        std::fs::write(out.join("truth.jsonl"), text).expect("writable");
        return;
    }
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// A scene: focal length 0.8 to 1.9 widths, height 6 to 16 m, the picture's lower edge 0.9 to
/// 1.8 heights away, two to five lanes.
fn scene([width, height]: [u32; 2], rng: &mut ChaCha8Rng) -> String {
    let (w, h) = (f64::from(width), f64::from(height));
    let f = w * rng.random_range(0.8f64.ln()..1.9f64.ln()).exp();
    let mast_m: f64 = rng.random_range(6.0..16.0);
    let near_m = mast_m * rng.random_range(0.9..1.8);
    let tilt = (mast_m / near_m).atan() - (0.5 * h / f).atan();
    let distortion: f64 = (-0.02 + 0.02 * normal(rng)).clamp(-0.07, 0.03);
    let k1 = distortion * (f / (0.5 * w)).powi(2);
    let lanes = rng.random_range(2..=5);
    let road_width_m = 3.4 + 0.2 * normal(rng);
    let widths: Vec<f64> =
        (0..lanes).map(|_| (road_width_m + 0.07 * normal(rng)).clamp(2.8, 4.0)).collect();
    let total: f64 = widths.iter().sum();
    let aside: f64 = rng.random_range(-7.0..7.0);
    let (far_px, interval) = if width < 500 { (8.0, 5.0) } else { (11.0, 5.0) };
    let mut text = format!(
        "name = \"made\"\nstart = \"2026-01-05T08:00:00Z\"\ninterval_s = {interval}\nwarmup_s = 200.0\n\
         [camera]\nwidth = {width}\nheight = {height}\nfocal_px = {f}\nheight_m = {mast_m}\n\
         tilt_deg = {}\npan_deg = 0.0\nroll_deg = {}\nk1 = {k1}\n\
         [light]\ncloud = {}\n\
         [road]\nstart_x_m = {aside}\nstart_y_m = {}\nheading_deg = {}\nleft_edge_m = {}\n\
         right_edge_m = {}\nasphalt = 0.2\npiece = [{{ length_m = 400.0, curvature_per_m = {} }}]\n\
         [measure]\nmin_car_height_px = {far_px}\nfar_m = 130.0\n",
        tilt.to_degrees(),
        (1.5 * normal(rng)).clamp(-4.0, 4.0),
        rng.random_range(0.1..0.9),
        0.5 * near_m,
        -aside.atan2(40.0).to_degrees() + 6.0 * normal(rng),
        -0.5 * total - 1.0,
        0.5 * total + 1.0,
        if rng.random_bool(0.5) { 0.0 } else { 0.003 * normal(rng) },
    );
    let turn = rng.random_range(0..=lanes);
    let mut left = -0.5 * total;
    for (k, lane) in widths.iter().enumerate() {
        let direction = if k < turn { "toward" } else { "away" };
        let _ = write!(
            text,
            "[[lane]]\noffset_m = {}\nwidth_m = {lane}\ndirection = \"{direction}\"\n\
             inflow_veh_h = {}\nspeed_km_h = {}\n[[marking]]\noffset_m = {left}\ndash_m = 3.0\ngap_m = 9.0\n",
            left + 0.5 * lane,
            rng.random_range(500.0..1300.0),
            rng.random_range(35.0..70.0),
        );
        left += lane;
    }
    let _ = write!(text, "[[marking]]\noffset_m = {left}\n");
    text
}
