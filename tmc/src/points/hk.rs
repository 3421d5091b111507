//! Hong Kong's lane detectors by the hour: CSV with mean speed and volume.
//!
//! Density is k = q / v with q the hour's volume. The speed is the unweighted mean of 120
//! half-minutes, those without vehicles included (they count with the speed limit), so that
//! it lies above the space-mean speed and k below the true one.

use super::Readings;
use crate::csv::Table;
use std::path::Path;
use verge_desk::Failure;

/// Readings of every detector, lane and hour.
pub(super) fn read(path: &Path) -> Result<Readings, Failure> {
    let table = Table::read(path)?;
    let (detector, lane) = (table.column("detector")?, table.column("lane")?);
    let (speed, volume) = (table.column("mean_speed_kmh")?, table.column("volume_veh")?);
    let mut readings = Readings::default();
    for row in table.rows() {
        let row = row?;
        match (row.maybe_quantity(&speed)?, row.maybe_quantity(&volume)?) {
            (Some(v), Some(q)) => readings.add_flow(row.text(&detector), row.text(&lane), q, v),
            _ => readings.invalid += 1,
        }
    }
    Ok(readings)
}
