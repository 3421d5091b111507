//! A day of one camera in changing light.

use super::{INTERVAL_S, eye_of, next, reference_of, scene};
use std::time::Duration;
use street::random::Stream;
use street::recording::Recorder;
use street::scene::{Daylight, Light, Scene};
use verge::picture::Look;
use verge::scene::{Aim, Guard, search};

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
pub fn day(from: usize, hours: usize) {
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
