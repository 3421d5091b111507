//! A row of the archive's density files.

/// One row: a lane, or a cell of it, in a window.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Length of the window, s.
    pub window_s: i32,
    /// Its beginning, ms since 1970.
    pub from_ms: i64,
    /// Lane, from 1.
    pub lane: i32,
    /// Cell of the lane, from 0 at its upstream end; none: the whole lane.
    pub cell: Option<i32>,
    /// Where the cell begins along the lane, m.
    pub position_m: Option<f32>,
    /// Length of lane or cell, m.
    pub length_m: f32,
    /// Density, veh/km.
    pub density: Option<f32>,
    /// One standard error of it from sampling, veh/km.
    pub se: Option<f32>,
    /// Mean number of vehicles.
    pub vehicles: Option<f32>,
    /// Share of the length that vehicles cover.
    pub occupancy: Option<f32>,
    /// Frames used.
    pub frames_used: i32,
    /// Frames expected.
    pub frames_expected: i32,
    /// Status, a number of NTCIP 1209.
    pub status: i32,
    /// Number of the message among the site's.
    pub seq: i64,
    /// Whether the box's clock was set.
    pub clock_synced: bool,
    /// One standard error of a length from calibration, as a fraction.
    pub rel_err: Option<f32>,
    /// Interval that holds the density with a probability of 90 %, veh/km.
    pub ci90: Option<[f32; 2]>,
    /// One standard error of the density from calibration, veh/km.
    pub calibration_se: Option<f32>,
    /// One standard error of the density from counting, veh/km.
    pub counting_se: Option<f32>,
    /// Flow and speed, of lanes whose vehicles are followed.
    pub traffic: Option<Moving>,
}

/// Flow and speed of a lane in a window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moving {
    /// How far they can be used, a number of NTCIP 1209.
    pub status: i32,
    /// Flow, veh/h.
    pub flow: Option<f32>,
    /// Interval that holds it with a probability of 90 %, veh/h.
    pub flow_ci90: Option<[f32; 2]>,
    /// Space-mean speed, km/h.
    pub speed: Option<f32>,
    /// Interval that holds it with a probability of 90 %, km/h.
    pub speed_ci90: Option<[f32; 2]>,
    /// Share of the time for which the section was covered.
    pub occupancy: Option<f32>,
    /// Mean length of the longest queue, m.
    pub queue_m: Option<f32>,
    /// Vehicles that passed the section.
    pub passed: Option<i32>,
}

impl Row {
    /// Its place in the file.
    pub fn key(&self) -> (bool, i32, i64, i32, i32) {
        let cell = self.cell.unwrap_or(-1);
        (self.cell.is_some(), self.window_s, self.from_ms, self.lane, cell)
    }
}
