//! Points from the archive: a site's own densities with its own flow and speed, or with a detector's,
//! joined by site and time.
//!
//! Owns the join. A detector's reading belongs to the window in which its time lies; several of one
//! window are averaged, speeds by their flow where it is known. A detector's table is CSV with
//! `time` (RFC 3339), `speed_kmh` or `flow_veh_h` (or both), and `site` and `lane` where it is of
//! several: without `site` all of it is of the site that was asked for, without `lane` it is the mean
//! lane's, and the density that of the mean over lanes.

use super::Readings;
use crate::csv::Table;
use crate::report::not_there;
use crate::store::{self, Row, Rows};
use std::collections::BTreeMap;
use std::path::Path;
use verge_desk::Failure;
use verge_messages::Status;

/// A question to the archive.
pub(super) struct Question<'a> {
    pub(super) archive: &'a Path,
    pub(super) site: &'a str,
    /// Length of the windows, s; none: the shortest.
    pub(super) window_s: Option<i32>,
    pub(super) detector: Option<&'a Path>,
}

/// Site, window's beginning (ms), lane (none: the mean lane).
type Key = (i64, Option<i32>);

/// Mean flow and speed of a detector in a window.
#[derive(Clone, Copy, Debug, Default)]
struct Passing {
    count: f64,
    flow: f64,
    flows: f64,
    /// Speeds by their weights.
    speed: f64,
    weight: f64,
}

impl Passing {
    fn add(&mut self, flow: Option<f64>, speed: Option<f64>) {
        self.count += 1.0;
        if let Some(flow) = flow {
            (self.flow, self.flows) = (self.flow + flow, self.flows + 1.0);
        }
        if let Some(speed) = speed {
            let weight = flow.unwrap_or(1.0);
            (self.speed, self.weight) = (self.speed + weight * speed, self.weight + weight);
        }
    }

    /// Speed, or what flow and density make of it (q = k v).
    fn speed(&self, density: f64) -> Option<f64> {
        if self.weight > 0.0 {
            return Some(self.speed / self.weight);
        }
        (self.flows > 0.0 && density > 0.0).then(|| self.flow / self.flows / density)
    }
}

/// Reads points.
///
/// # Errors
/// [`Failure`]: no such site, a detector's table that cannot be read.
pub(super) fn read(question: &Question<'_>) -> Result<Readings, Failure> {
    let Question { archive, site, detector, .. } = *question;
    if !store::sites(archive)?.iter().any(|known| known == site) {
        return Err(not_there(archive, site));
    }
    let lanes = lanes(question)?;
    let length_s = lanes.first().map_or(60, |row| row.window_s);
    let mut readings = Readings::default();
    let is_ok = |status: i32| status == i32::from(Status::Ok.number());
    let Some(path) = detector else {
        for row in &lanes {
            let traffic = row.traffic.filter(|it| is_ok(it.status) && is_ok(row.status));
            let Some(traffic) = traffic else {
                readings.invalid += 1;
                continue;
            };
            match (row.density, traffic.speed) {
                (Some(density), Some(speed)) => {
                    readings.add(site, &row.lane.to_string(), density.into(), speed.into());
                }
                _ => readings.empty += 1,
            }
        }
        if readings.kept.is_empty() {
            let reason = format!(
                "has no window of site {site} with flow and speed of its own: is it video? Otherwise \
                 give --detector-csv"
            );
            return Err(Failure::content(archive, 0, reason));
        }
        return Ok(readings);
    };
    let passing = detector_table(path, site, length_s)?;
    let mut mean = BTreeMap::<i64, Vec<f64>>::new();
    for row in lanes.iter().filter(|row| is_ok(row.status)) {
        let Some(density) = row.density.map(f64::from) else { continue };
        mean.entry(row.from_ms).or_default().push(density);
        let key = (row.from_ms, Some(row.lane));
        if let Some(speed) = passing.get(&key).and_then(|it| it.speed(density)) {
            readings.add(site, &row.lane.to_string(), density, speed);
        }
    }
    for (from_ms, densities) in mean {
        let density = densities.iter().sum::<f64>() / densities.len() as f64;
        if let Some(speed) = passing.get(&(from_ms, None)).and_then(|it| it.speed(density)) {
            readings.add(site, "", density, speed);
        }
    }
    let joined = readings.kept.len() + readings.empty + readings.implausible;
    readings.invalid += passing.len().saturating_sub(joined);
    if joined == 0 {
        let reason = format!(
            "no time of it lies in a window of site {site}; are its times in RFC 3339 with their \
             offset, and its lanes numbered as the site's?"
        );
        return Err(Failure::content(path, 0, reason));
    }
    Ok(readings)
}

/// The lanes in windows of the length that was asked for.
fn lanes(question: &Question<'_>) -> Result<Vec<Row>, Failure> {
    let Question { archive, site, window_s, .. } = *question;
    let mut lanes = Vec::new();
    for partition in store::site_partitions(archive, site)? {
        for row in Rows::open(&partition.path(archive))? {
            let row = row?;
            if row.cell.is_some() {
                // Lanes stand first.
                break;
            }
            lanes.push(row);
        }
    }
    let shortest = lanes.iter().map(|row| row.window_s).min().unwrap_or_default();
    let wanted = window_s.unwrap_or(shortest);
    lanes.retain(|row| row.window_s == wanted);
    if lanes.is_empty() {
        let reason = format!("has no window of {wanted} s of site {site}");
        return Err(Failure::content(archive, 0, reason));
    }
    Ok(lanes)
}

fn detector_table(
    path: &Path,
    site: &str,
    length_s: i32,
) -> Result<BTreeMap<Key, Passing>, Failure> {
    let table = Table::read(path)?;
    let time = table.column("time")?;
    let [sites, lanes, flows, speeds] =
        ["site", "lane", "flow_veh_h", "speed_kmh"].map(|name| table.find(name));
    if flows.is_none() && speeds.is_none() {
        let reason = "has neither a column speed_kmh nor flow_veh_h";
        return Err(Failure::content(path, 1, reason));
    }
    let length_ms = i64::from(length_s) * 1000;
    let mut found = BTreeMap::<Key, Passing>::new();
    for row in table.rows() {
        let row = row?;
        if sites.as_ref().is_some_and(|column| row.text(column) != site) {
            continue;
        }
        let at: jiff::Timestamp = row.text(&time).parse().map_err(|_| {
            row.wrong(&time, "is not a time in RFC 3339, such as 2026-01-05T08:00:00+08:00")
        })?;
        let lane = match &lanes {
            Some(column) if !row.text(column).is_empty() => {
                let number = row.text(column).parse::<i32>();
                Some(number.map_err(|_| row.wrong(column, "is not the number of a lane"))?)
            }
            _ => None,
        };
        let value = |column: &Option<crate::csv::Column>| match column {
            Some(column) if !row.text(column).is_empty() => row.quantity(column).map(Some),
            _ => Ok(None),
        };
        let begin = at.as_millisecond().div_euclid(length_ms) * length_ms;
        found.entry((begin, lane)).or_default().add(value(&flows)?, value(&speeds)?);
    }
    Ok(found)
}
