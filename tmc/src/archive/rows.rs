//! The rows of the archive that a window becomes.

use crate::store::{Moving, Row};
use verge_messages::{Density, Passed, Traffic};

/// The rows of a window: its lanes, then their cells.
pub fn of_window(window: &Density) -> Vec<Row> {
    let mut rows = Vec::new();
    for lane in &window.lanes {
        let row = Row {
            window_s: window.window_s as i32,
            from_ms: window.from.0,
            lane: i32::from(lane.lane),
            cell: None,
            position_m: None,
            length_m: lane.length_m,
            density: lane.density_veh_km,
            se: lane.density_se,
            vehicles: lane.vehicles_mean,
            occupancy: lane.space_occupancy,
            frames_used: lane.frames_used as i32,
            frames_expected: lane.frames_expected as i32,
            status: lane.status.number().into(),
            seq: window.seq as i64,
            clock_synced: window.clock_synced,
            rel_err: window.calibration.rel_err,
            ci90: lane.density_ci90,
            calibration_se: lane.calibration_se,
            counting_se: lane.counting_se,
            traffic: lane.traffic.as_ref().map(moving),
        };
        rows.push(row.clone());
        let Some(cells) = &lane.cells else { continue };
        // A list that is not known is a cell of which nothing is known, as often as there are.
        let densities = cells.density_veh_km.as_deref();
        for cell in 0..cells.count(lane.length_m) {
            let density = densities.and_then(|all| all.get(cell)).copied();
            let begin = cell as f32 * cells.length_m;
            let length_m = cells.length_m.min(lane.length_m - begin).max(0.0);
            rows.push(Row {
                cell: Some(cell as i32),
                position_m: Some(begin),
                length_m,
                density,
                se: None,
                vehicles: density.map(|density| density * length_m / 1000.0),
                occupancy: None,
                ci90: None,
                calibration_se: None,
                counting_se: None,
                traffic: None,
                ..row.clone()
            });
        }
    }
    rows.sort_by_key(Row::key);
    rows
}

/// Flow and speed of a lane.
fn moving(traffic: &Traffic) -> Moving {
    Moving {
        status: traffic.traffic_status.number().into(),
        flow: traffic.flow_veh_h,
        flow_ci90: traffic.flow_ci90,
        speed: traffic.speed_kmh,
        speed_ci90: traffic.speed_ci90,
        occupancy: traffic.time_occupancy,
        queue_m: traffic.queue_m,
        passed: traffic.passed.as_ref().map(|passed| {
            // Checked: a window has no more than fit.
            i32::try_from(Passed::all(passed)).unwrap_or(i32::MAX)
        }),
    }
}
