//! Score of a measured recording against its truth: flow, speed and occupancy of each lane.
//!
//! Owns the reading of `truth.jsonl` and of the windows that `verge replay --json` prints, the
//! table, and how many intervals hold the truth. The truth of a window is summed over its frames
//! (see `truth.rs`).

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::Path;

use jiff::Timestamp;
use serde::{Deserialize, Deserializer};
use verge_desk::Failure;

use crate::error::Result;

#[derive(Deserialize)]
struct Frame {
    #[serde(deserialize_with = "instant")]
    time: Timestamp,
    lanes: Vec<Lane>,
}

#[derive(Deserialize)]
struct Lane {
    lane: u8,
    length_m: f64,
    distance_m: f64,
    time_s: f64,
    occupied_s: f64,
    passed: u32,
}

#[derive(Deserialize)]
struct Window {
    #[serde(deserialize_with = "instant")]
    from: Timestamp,
    #[serde(deserialize_with = "instant")]
    to: Timestamp,
    lanes: Vec<Measured>,
}

#[derive(Deserialize)]
struct Measured {
    lane: u8,
    frames_used: Option<usize>,
    density_veh_km: Option<f64>,
    density_ci90: Option<[f64; 2]>,
    flow_veh_h: Option<f64>,
    flow_ci90: Option<[f64; 2]>,
    speed_kmh: Option<f64>,
    speed_ci90: Option<[f64; 2]>,
    time_occupancy: Option<f64>,
    time_occupancy_ci90: Option<[f64; 2]>,
    passed: Option<BTreeMap<String, u32>>,
    density_difference: Option<f64>,
}

/// Sums of a lane over a window.
#[derive(Default)]
struct Sums {
    length_m: f64,
    distance_m: f64,
    time_s: f64,
    occupied_s: f64,
    passed: u32,
}

/// How many intervals of one quantity there were, and how many of them hold the truth.
#[derive(Default)]
struct Held {
    all: u32,
    held: u32,
}

impl Held {
    fn add(&mut self, truth: f64, interval: Option<[f64; 2]>) {
        let Some([low, high]) = interval else { return };
        self.all += 1;
        self.held += u32::from((low..=high).contains(&truth));
    }
}

/// A table with a row a lane and window: truth, what was measured, and the difference; below it
/// how many intervals hold the truth, where there are any.
///
/// # Errors
/// [`Failure`] for a file that cannot be read or is not what it should be.
pub fn table(truth: &Path, windows: &Path) -> Result<String> {
    let frames: Vec<Frame> = lines(truth)?;
    let mut text = String::from(
        "| window | lane | flow, veh/h | speed, km/h | density, veh/km | time occupancy, % | passed | \
         q - k v, % | by pictures less Edie, veh/km |\n|---|---|---|---|---|---|---|---|---|\n",
    );
    let mut held: [(&str, Held); 4] =
        ["flow", "speed", "density", "time occupancy"].map(|name| (name, Held::default()));
    let header = text.len();
    let wrong = |reason: String| Failure::Content { path: windows.to_owned(), line: 0, reason };
    let mut scored = BTreeSet::new();
    for window in lines::<Window>(windows)? {
        let at = window.from.strftime("%H:%M:%S").to_string();
        if !scored.insert((window.from, window.to)) {
            return Err(wrong(format!("the window of {at} is in it twice")).into());
        }
        let within = |frame: &&Frame| (window.from..window.to).contains(&frame.time);
        let known = frames.iter().filter(within).count();
        let mut seconds = 0.0;
        let mut sums: BTreeMap<u8, Sums> = BTreeMap::new();
        // A frame's sums are of the time since the one before it, and count where it lies.
        for pair in frames.windows(2) {
            let [before, frame] = pair else { continue };
            if !(window.from..window.to).contains(&frame.time) {
                continue;
            }
            seconds += frame.time.duration_since(before.time).as_secs_f64();
            for lane in &frame.lanes {
                let sum = sums.entry(lane.lane).or_default();
                sum.length_m = lane.length_m;
                sum.distance_m += lane.distance_m;
                sum.time_s += lane.time_s;
                sum.occupied_s += lane.occupied_s;
                sum.passed += lane.passed;
            }
        }
        for lane in &window.lanes {
            let Some(sum) = sums.get(&lane.lane) else { continue };
            if let Some(used) = lane.frames_used.filter(|used| *used > known) {
                return Err(wrong(format!(
                    "the window of {at} was measured over {used} frames, of which {} has {known}; give \
                     the truth of this recording",
                    truth.display()
                ))
                .into());
            }
            let area = sum.length_m * seconds;
            let (flow, density) = (sum.distance_m / area * 3600.0, sum.time_s / area * 1000.0);
            let (speed, occupancy) = (sum.distance_m / sum.time_s * 3.6, sum.occupied_s / seconds);
            let intervals = [
                (flow, lane.flow_ci90),
                (speed, lane.speed_ci90),
                (density, lane.density_ci90),
                (occupancy, lane.time_occupancy_ci90),
            ];
            for ((_, held), (truth, interval)) in held.iter_mut().zip(intervals) {
                held.add(truth, interval);
            }
            let part = |truth: f64, found: Option<f64>| {
                found.map_or_else(
                    || format!("{truth:.1}: -"),
                    |found| {
                        format!("{truth:.1}: {found:.1} ({:+.1} %)", (found / truth - 1.0) * 100.0)
                    },
                )
            };
            let number = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.1}"));
            let apart = lane.flow_veh_h.zip(lane.speed_kmh).zip(lane.density_veh_km);
            let apart = apart.map(|((q, v), k)| (q - k * v) / q * 100.0);
            let passed = lane.passed.as_ref().map(|by_class| by_class.values().sum::<u32>());
            // A string takes what is written to it.
            let _ = writeln!(
                text,
                "| {} | {} | {} | {} | {} | {:.1}: {} | {}: {} | {} | {} |",
                window.from.strftime("%H:%M:%S"),
                lane.lane,
                part(flow, lane.flow_veh_h),
                part(speed, lane.speed_kmh),
                part(density, lane.density_veh_km),
                occupancy * 100.0,
                number(lane.time_occupancy.map(|share| share * 100.0)),
                sum.passed,
                passed.map_or("-".to_owned(), |count| count.to_string()),
                number(apart),
                number(lane.density_difference),
            );
        }
    }
    if text.len() == header {
        return Err(wrong(format!(
            "no window in it has a lane and a time of {}; give what `verge replay --json` printed of \
             this recording",
            truth.display()
        ))
        .into());
    }
    let known = held.iter().filter(|(_, held)| held.all > 0);
    let known: Vec<_> =
        known.map(|(name, Held { all, held })| format!("{name} {held} of {all}")).collect();
    if !known.is_empty() {
        let _ = writeln!(text, "\n90 % intervals that hold the truth: {}.", known.join(", "));
    }
    Ok(text)
}

fn instant<'de, D: Deserializer<'de>>(given: D) -> std::result::Result<Timestamp, D::Error> {
    String::deserialize(given)?.parse().map_err(serde::de::Error::custom)
}

fn lines<T: for<'de> Deserialize<'de>>(path: &Path) -> Result<Vec<T>> {
    let text = verge_desk::read_text(path)?;
    let parsed = text.lines().enumerate().map(|(index, line)| {
        serde_json::from_str(line).map_err(|error| Failure::Content {
            path: path.to_owned(),
            line: index + 1,
            reason: error.to_string(),
        })
    });
    Ok(parsed.collect::<std::result::Result<_, _>>()?)
}
