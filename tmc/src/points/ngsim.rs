//! Matrices of density and velocity from NGSIM trajectories: Edie's definitions over bins of
//! space (rows) and time (columns), veh/ft over all lanes and ft/s.

use super::{Reading, Readings};
use crate::gzip::read_text;
use std::path::{Path, PathBuf};
use verge_desk::Failure;

const FEET_PER_KM: f64 = 1000.0 / 0.3048;
const KMH_PER_FT_S: f64 = 0.3048 * 3.6;

/// Readings of the mean lane, bin by bin. A bin without vehicles has no speed.
pub(super) fn read(folder: &Path, lanes: u32) -> Result<Readings, Failure> {
    let density_file = find(folder, "Density_Data.txt")?;
    let velocity_file = find(folder, "Velocity_Data.txt")?;
    let (density, velocity) = (matrix(&density_file)?, matrix(&velocity_file)?);
    let shape = |matrix: &[Vec<f64>]| (matrix.len(), matrix.first().map_or(0, Vec::len));
    if shape(&density) != shape(&velocity) {
        let (found, expected) = (shape(&velocity), shape(&density));
        let reason = format!("is {found:?} rows and columns, the density is {expected:?}");
        return Err(Failure::content(&velocity_file, 0, reason));
    }
    let mut readings = Readings::default();
    for (per_foot, feet_per_s) in density.iter().flatten().zip(velocity.iter().flatten()) {
        if *per_foot <= 0.0 {
            readings.empty += 1;
            continue;
        }
        readings.kept.push(Reading {
            density: per_foot * FEET_PER_KM / f64::from(lanes),
            speed: feet_per_s * KMH_PER_FT_S,
            detector: String::new(),
            lane: String::new(),
        });
    }
    Ok(readings)
}

/// The only file in the folder whose name ends so.
fn find(folder: &Path, ending: &str) -> Result<PathBuf, Failure> {
    let entries = std::fs::read_dir(folder).map_err(|source| Failure::reading(folder, source))?;
    let mut found = Vec::new();
    for entry in entries {
        let path = entry.map_err(|source| Failure::reading(folder, source))?.path();
        if path.file_name().is_some_and(|name| name.to_string_lossy().ends_with(ending)) {
            found.push(path);
        }
    }
    match (found.pop(), found.pop()) {
        (Some(path), None) => Ok(path),
        (None, _) => Err(Failure::content(folder, 0, format!("has no file *{ending}"))),
        _ => Err(Failure::content(folder, 0, format!("has several files *{ending}; keep one"))),
    }
}

fn matrix(path: &Path) -> Result<Vec<Vec<f64>>, Failure> {
    let text = read_text(path)?;
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for (index, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let mut row = Vec::new();
        for (column, field) in line.split_whitespace().enumerate() {
            let value = field.parse::<f64>().ok().filter(|v| v.is_finite() && *v >= 0.0);
            let reason = format!("column {}: {field:?} is not a number from 0", column + 1);
            row.push(value.ok_or_else(|| Failure::content(path, index + 1, reason))?);
        }
        if rows.first().is_some_and(|first| first.len() != row.len()) {
            let reason = format!("has {} columns, the first line has {}", row.len(), rows[0].len());
            return Err(Failure::content(path, index + 1, reason));
        }
        rows.push(row);
    }
    Ok(rows)
}
