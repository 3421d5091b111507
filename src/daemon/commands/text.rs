//! Lines of text for people, and boxes for programs.

use crate::daemon::flow::{Detection, Frame};
use crate::daemon::publish::payload::status_name;
use crate::density::LaneReport;
use crate::units::Direction;
use serde_json::json;

/// One lane of one window, in columns under [`LANE_HEADING`].
pub fn lane(window: &str, from: &str, report: &LaneReport) -> String {
    let number = |value: Option<f32>| value.map_or("-".to_owned(), |value| format!("{value:.1}"));
    let direction = match report.direction {
        Direction::Unknown => "",
        Direction::Toward => "toward",
        Direction::Away => "away",
    };
    format!(
        "{from:<20} {window:>6} {:>5} {direction:<7} {:>8} {:>7} {:>9} {}",
        report.lane.get(),
        number(report.density_veh_km),
        number(report.density_se),
        format!("{}/{}", report.frames_used, report.frames_expected),
        status_name(report.status),
    )
}

/// Heading of [`lane`]'s columns.
pub const LANE_HEADING: &str =
    "from (UTC)           window  lane           veh/km      se    frames status";

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
