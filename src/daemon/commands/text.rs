//! Lines of text for people, and windows and boxes as lines of JSON for programs.

use crate::daemon::clock::rfc3339;
use crate::daemon::frame::{Detection, Frame};
use crate::daemon::publish::payload::{self, status_name};
use crate::daemon::publish::{Identity, window_name};
use crate::density::{LaneReport, WindowReport};
use crate::sensor::ClosedWindow;
use crate::units::Direction;
use crate::wire::ModelRef;
use serde_json::json;

/// One lane of one window, in columns under [`LANE_HEADING`].
pub fn lane(report: &WindowReport, lane: &LaneReport) -> String {
    let from = &rfc3339(report.from)[..19];
    let window = window_name(report.to.saturating_since(report.from));
    let number = |value: Option<f32>| value.map_or("-".to_owned(), |value| format!("{value:.1}"));
    let direction = match lane.direction {
        Direction::Unknown => "",
        Direction::Toward => "toward",
        Direction::Away => "away",
    };
    format!(
        "{from:<20} {window:>6} {:>5} {direction:<7} {:>8} {:>7} {:>9} {}",
        lane.lane.get(),
        number(lane.density_veh_km),
        number(lane.density_se),
        format!("{}/{}", lane.frames_used, lane.frames_expected),
        status_name(lane.status),
    )
}

/// Heading of [`lane`]'s columns.
pub const LANE_HEADING: &str =
    "from (UTC)           window  lane           veh/km      se    frames status";

/// Heading of [`lane`]'s columns, and of [`moving`]'s where vehicles are followed.
pub fn heading(is_moving: bool) -> String {
    let blank = LONGEST_STATUS - "status".len();
    if is_moving {
        format!("{LANE_HEADING}{:blank$} {:>7} {:>7} {:>7}", "", "veh/h", "km/h", "time %")
    } else {
        LANE_HEADING.to_owned()
    }
}

/// Flow, space-mean speed and time occupancy of a lane, in the columns behind [`lane`]'s; empty where
/// vehicles are not followed.
pub fn moving(lane: &LaneReport) -> String {
    let Some(traffic) = &lane.traffic else { return String::new() };
    let number = |value: Option<f32>| value.map_or("-".to_owned(), |value| format!("{value:.1}"));
    // As wide as the longest status before it.
    let blank = LONGEST_STATUS - status_name(lane.status).len().min(LONGEST_STATUS);
    format!(
        "{:blank$} {:>7} {:>7} {:>7}",
        "",
        number(traffic.flow_veh_h),
        number(traffic.speed_kmh),
        number(traffic.time_occupancy.map(|share| share * 100.0)),
    )
}

/// Letters of `detectionAutoSuspended`, the longest status.
const LONGEST_STATUS: usize = 22;

/// Windows as they would be published, one after the other.
pub struct Messages {
    identity: Identity,
    clock_synced: bool,
    seq: u64,
}

impl Messages {
    /// Messages of that site.
    pub fn new(site: &str, model: &ModelRef, clock_synced: bool) -> Self {
        Self { identity: Identity::new(site, model), clock_synced, seq: 0 }
    }

    /// The next one.
    pub fn next(&mut self, window: ClosedWindow<'_>) -> String {
        self.seq += 1;
        let message = self.identity.message(window, self.clock_synced, self.seq);
        String::from_utf8_lossy(&payload::density(&message, None)).into_owned()
    }
}

/// The boxes of one frame as a JSON line:
/// `{"frame":"name.jpg","boxes":[[x0,y0,x1,y1,score,"class"],...]}`, px of the frame.
pub fn boxes(frame: &Frame, found: &[Detection]) -> String {
    let pixel = |value: f32| (f64::from(value) * 100.0).round() / 100.0;
    let boxes: Vec<_> = found
        .iter()
        .map(|d| {
            let b = d.bounds;
            let score = (f64::from(d.score) * 1e4).round() / 1e4;
            json!([pixel(b.x0), pixel(b.y0), pixel(b.x1), pixel(b.y1), score, d.class.name()])
        })
        .collect();
    json!({"frame": frame.name, "boxes": boxes}).to_string()
}
