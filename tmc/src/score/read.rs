//! Both sides of a score: density by beginning of the window and lane.

use crate::csv::Table;
use crate::gzip::read_text;
use crate::message;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;
use verge_desk::Failure;
use verge_messages::Utc;

/// Beginning of the window, ms since 1970, and lane.
pub(super) type Key = (i64, u8);

/// An estimate; `None` where the box said that it knows nothing.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entry {
    pub(super) density: Option<f64>,
    /// Length of its window, ms, where the file tells it.
    length_ms: Option<i64>,
}

/// The frames of a simulated recording, as `street record` writes them.
#[derive(Deserialize)]
struct Frame {
    time: Utc,
    lanes: Vec<FrameLane>,
}

#[derive(Deserialize)]
struct FrameLane {
    lane: u8,
    density_veh_km: f64,
}

fn is_json(path: &Path) -> Result<bool, Failure> {
    Ok(read_text(path)?.trim_start().starts_with('{'))
}

/// Reads estimates: messages, one a line, or CSV.
pub(super) fn estimates(path: &Path) -> Result<BTreeMap<Key, Entry>, Failure> {
    if !is_json(path)? {
        let read = csv(path)?;
        let entry = |(key, density)| (key, Entry { density, length_ms: None });
        return Ok(read.into_iter().map(entry).collect());
    }
    let mut found = BTreeMap::new();
    let mut site: Option<String> = None;
    let text = read_text(path)?;
    for (index, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let wrong = |reason: String| Failure::content(path, index + 1, reason);
        let window = message::read(line.as_bytes()).map_err(wrong)?;
        let known = site.get_or_insert_with(|| window.site.clone());
        if *known != window.site {
            let reason = format!("is of site {}, those before of {known}", window.site);
            return Err(wrong(format!("{reason}; score one site at a time")));
        }
        let length_ms = Some(i64::from(window.window_s) * 1000);
        for lane in &window.lanes {
            let density = lane.density_veh_km.map(f64::from);
            let key = (window.from.0, lane.lane);
            if found.insert(key, Entry { density, length_ms }).is_some() {
                let reason = "is a second message of this window; score one window length";
                return Err(wrong(reason.into()));
            }
        }
    }
    Ok(found)
}

/// Reads truth: CSV, or a recording's frames averaged over the windows of the estimates.
pub(super) fn truth(
    path: &Path,
    estimates: &BTreeMap<Key, Entry>,
) -> Result<BTreeMap<Key, f64>, Failure> {
    if !is_json(path)? {
        let known = csv(path)?.into_iter();
        return Ok(known.filter_map(|(key, density)| Some((key, density?))).collect());
    }
    let length_ms = estimates.values().find_map(|entry| entry.length_ms);
    let Some(length_ms) = length_ms else {
        let reason = "is frame by frame, and the estimates do not tell how long a window is: \
                      give the messages of `verge replay --json`";
        return Err(Failure::content(path, 0, reason));
    };
    let mut sums: BTreeMap<Key, (f64, f64)> = BTreeMap::new();
    let text = read_text(path)?;
    for (index, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let frame: Frame = serde_json::from_str(line)
            .map_err(|error| Failure::content(path, index + 1, error.to_string()))?;
        let time = frame.time.0;
        for lane in frame.lanes {
            let key = (time - time.rem_euclid(length_ms), lane.lane);
            let sum = sums.entry(key).or_default();
            *sum = (sum.0 + lane.density_veh_km, sum.1 + 1.0);
        }
    }
    Ok(sums.into_iter().map(|(key, (sum, n))| (key, sum / n)).collect())
}

fn csv(path: &Path) -> Result<BTreeMap<Key, Option<f64>>, Failure> {
    let table = Table::read(path)?;
    let (from, lane) = (table.column("from")?, table.column("lane")?);
    let density = table.column("density_veh_km")?;
    let mut found = BTreeMap::new();
    for row in table.rows() {
        let row = row?;
        let time: Option<jiff::Timestamp> = row.text(&from).parse().ok();
        let expected = "is not a time in UTC; give one as 2026-01-05T08:00:00Z";
        let time = time.ok_or_else(|| row.wrong(&from, expected))?;
        let number: Option<u8> = row.text(&lane).parse().ok();
        let number = number.ok_or_else(|| row.wrong(&lane, "is not a lane; give its number"))?;
        let key = (time.as_millisecond(), number);
        if found.insert(key, row.maybe_quantity(&density)?).is_some() {
            return Err(row.wrong(&from, "and this lane are there twice"));
        }
    }
    Ok(found)
}
