//! PeMS station files of 5 minutes: CSV without a header, 12 columns of the station and 5 a
//! lane (samples, flow in vehicles per 5 minutes, occupancy, speed in mph, share observed).
//!
//! Density is k = q / v lane by lane; lanes without flow or speed are left out.

use super::Readings;
use crate::csv::{Column, row};
use crate::gzip::read_text;
use std::path::Path;
use verge_desk::Failure;

const STATION_COLUMNS: usize = 12;
const LANE_COLUMNS: usize = 5;
/// From 5 minutes to an hour.
const PER_HOUR: f64 = 12.0;
const KMH_PER_MPH: f64 = 1.609_344;

/// Readings of every station, lane and 5 minutes.
pub(super) fn read(path: &Path) -> Result<Readings, Failure> {
    let text = read_text(path)?;
    let station = Column::numbered(1, "2 (station)");
    let mut readings = Readings::default();
    for (index, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let row = row(path, index + 1, line)?;
        let rest = row.len().checked_sub(STATION_COLUMNS);
        let Some(rest) = rest.filter(|rest| *rest > 0 && rest % LANE_COLUMNS == 0) else {
            let reason = format!(
                "has {} columns; a PeMS station file has {STATION_COLUMNS} and {LANE_COLUMNS} \
                 for each lane",
                row.len()
            );
            return Err(Failure::content(path, index + 1, reason));
        };
        for lane in 0..rest / LANE_COLUMNS {
            let first = STATION_COLUMNS + lane * LANE_COLUMNS;
            let column = |offset: usize, what: &str| {
                let at = first + offset;
                Column::numbered(at, &format!("{} (lane {} {what})", at + 1, lane + 1))
            };
            let flow = row.maybe_quantity(&column(1, "flow"))?;
            let speed = row.maybe_quantity(&column(3, "speed"))?;
            match (flow, speed) {
                (Some(q), Some(v)) => {
                    let name = (lane + 1).to_string();
                    let (q, v) = (q * PER_HOUR, v * KMH_PER_MPH);
                    readings.add_flow(row.text(&station), &name, q, v);
                }
                _ => readings.invalid += 1,
            }
        }
    }
    Ok(readings)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lanes_become_readings() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("station.txt");
        let line = "12/06/2020 14:00:00,314899,3,50,W,ML,.5,20,100,130,.06,61.0,\
                    10,70,.05,65.0,100,10,60,.07,56.0,100,0,,,,0\n";
        std::fs::write(&path, line).unwrap();
        let readings = read(&path).unwrap();
        assert_eq!((readings.kept.len(), readings.invalid), (2, 1));
        let first = &readings.kept[0];
        assert_eq!((first.detector.as_str(), first.lane.as_str()), ("314899", "1"));
        assert!((first.speed - 104.607).abs() < 1e-3, "{first:?}");
        assert!((first.density - 840.0 / 104.607).abs() < 1e-3, "{first:?}");
        std::fs::write(&path, line.replace("65.0", "-65")).unwrap();
        let error = read(&path).unwrap_err().to_string();
        assert!(error.contains("line 1: column 16 (lane 1 speed)"), "{error}");
        std::fs::write(&path, "a,b\n").unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("12 and 5 for each lane"));
    }
}
