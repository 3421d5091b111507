//! `verge demo`: the whole line in one process, a broker and its subscriber included.
//!
//! The printed numbers have gone through everything: frames from files, the model, the lane
//! table, windows, MQTT over loopback, and JSON.

use super::playback::{Played, play};
use super::recording;
use crate::daemon::assemble::open_recording;
use crate::daemon::config::DEFAULT_MODEL;
use crate::daemon::exit::Failure;
use crate::daemon::line::LineSettings;
use crate::daemon::outlet::Outlet;
use crate::daemon::places;
use crate::daemon::presets::WindowSettings;
use crate::daemon::publish::loopback::{self, Subscriber};
use crate::daemon::publish::{Format, Identity, MqttSettings};
use crate::track::rate::DEFAULT_TOP_KMH;
use serde_json::Value;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

/// Longest wait for a message: one window's frames on a slow machine.
const PATIENCE: Duration = Duration::from_secs(50);
/// The recording fills three of them.
const WINDOW: Duration = Duration::from_secs(60);
const ROOT: &str = "verge/demo";

pub fn run() -> Result<(), Failure> {
    let started = Instant::now();
    let recording = recording::find("the demo", "run it in the project's folder")?;
    let model = places::find(Path::new(""), DEFAULT_MODEL.as_ref());
    let settings = LineSettings::recorded(recording.table.as_ref(), &model);
    let windows = WindowSettings::recorded(WINDOW);
    let (recorded, mut line, windows) = open_recording(
        &settings,
        &windows,
        recording.frames.as_ref(),
        None,
        (0, None),
        DEFAULT_TOP_KMH,
    )?;
    let port = loopback::start_broker().map_err(|e| Failure::Internal(e.to_string()))?;
    let subscriber = Subscriber::connect(port, &format!("{ROOT}/#"))
        .map_err(|e| Failure::Internal(e.to_string()))?;
    println!(
        "{} frames of {} -> {} -> {} -> mqtt://127.0.0.1:{port}/{ROOT}",
        recorded.frames(),
        recording.frames,
        DEFAULT_MODEL,
        recording.table,
    );
    let printer = thread::spawn(move || print_until_shutdown(subscriber));
    let frames = recorded.frames();
    let broker = MqttSettings::local(port, ROOT);
    let identity = Identity::new("demo", line.model());
    let mut outlet = Outlet::in_memory(broker, Format::Json, identity);
    let played = play(recorded, &mut line, windows, |played| {
        if let Played::Window(window) = played {
            outlet.density(window, false);
        }
        outlet.tend();
        Ok(())
    });
    outlet.stop();
    let lanes = printer.join().unwrap_or_default();
    played?;
    if lanes == 0 {
        return Err(Failure::Internal("no density arrived at the subscriber".into()));
    }
    println!("{frames} frames in {:.1} s", started.elapsed().as_secs_f64());
    Ok(())
}

/// Prints what arrives, until the sensor says that it shuts down; returns how many lanes.
fn print_until_shutdown(mut subscriber: Subscriber) -> usize {
    println!("from (UTC)            window  lane  veh/km/lane      se  frames  status");
    let mut lanes = 0;
    while let Some((topic, payload)) = subscriber.next(PATIENCE) {
        let topic = topic.strip_prefix(ROOT).unwrap_or(&topic);
        if topic == "/presence" && payload == b"shutdown" {
            break;
        }
        if let Some(window) = topic.strip_prefix("/density/") {
            lanes += print_density(window, &payload);
        }
    }
    lanes
}

/// Prints the lanes of one message; returns how many.
fn print_density(window: &str, payload: &[u8]) -> usize {
    let Ok(message) = serde_json::from_slice::<Value>(payload) else {
        println!("{window}: a message that is no JSON");
        return 0;
    };
    let number = |value: &Value| value.as_f64().map_or("-".into(), |n| format!("{n:.1}"));
    let lanes = message["lanes"].as_array().map(Vec::as_slice).unwrap_or_default();
    for lane in lanes {
        println!(
            "{:<20} {window:>7} {:>5} {:>12} {:>7} {:>7}  {}",
            message["from"].as_str().map_or("", |from| &from[..19.min(from.len())]),
            lane["lane"].to_string(),
            number(&lane["density_veh_km"]),
            number(&lane["density_se"]),
            format!("{}/{}", lane["frames_used"], lane["frames_expected"]),
            lane["status"].as_str().unwrap_or("-"),
        );
    }
    lanes.len()
}
