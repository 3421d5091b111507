//! CSV (RFC 4180): one row a lane and window, an empty field for what is not known; the cells
//! of a lane stand in one field with `;` between them.

use crate::{Density, Lane, Passed, Traffic, rounded};
use std::borrow::Cow;

/// The first line: the last word of a name is its unit.
pub const HEADER: &str = "site,window_s,seq,from,to,clock_synced,lane,direction,density_veh_km,\
density_se_veh_km,vehicles_mean,vehicle,car,van,bus,truck,motorcycle,space_occupancy,length_m,\
frames_used,frames_expected,status,calibration,calibration_rel_err,model,cell_length_m,\
cells_density_veh_km,density_low90_veh_km,density_high90_veh_km,calibration_se_veh_km,\
counting_se_veh_km,traffic_status,flow_veh_h,flow_low90_veh_h,flow_high90_veh_h,speed_km_h,\
speed_low90_km_h,speed_high90_km_h,time_occupancy,time_occupancy_low90,time_occupancy_high90,\
passed_vehicles,section_flow_veh_h,speed_time_mean_km_h,headway_s,headway_sd_s,queue_m,queue_max_m";

/// The columns of the classes.
const CLASSES: [&str; 6] = ["vehicle", "car", "van", "bus", "truck", "motorcycle"];

/// The rows of one message, each but the last with its line end (CR LF; the last has its
/// CR).
pub fn rows(message: &Density) -> String {
    let rows: Vec<_> = message.lanes.iter().map(|lane| row(message, lane) + "\r").collect();
    rows.join("\n")
}

fn row(message: &Density, lane: &Lane) -> String {
    let mut fields = vec![
        quoted(&message.site).into_owned(),
        message.window_s.to_string(),
        message.seq.to_string(),
        message.from.to_string(),
        message.to.to_string(),
        message.clock_synced.to_string(),
        lane.lane.to_string(),
        lane.direction.name().to_owned(),
        number(lane.density_veh_km),
        number(lane.density_se),
        number(lane.vehicles_mean),
    ];
    match lane.by_class {
        Some(means) => fields.extend(means.named().map(|(_, mean)| number(Some(mean)))),
        None => fields.extend(CLASSES.map(|_| String::new())),
    }
    fields.extend([
        number(lane.space_occupancy),
        number(Some(lane.length_m)),
        lane.frames_used.to_string(),
        lane.frames_expected.to_string(),
        lane.status.name().to_owned(),
        quoted(&message.calibration.id).into_owned(),
        number(message.calibration.rel_err),
        quoted(&message.model.name).into_owned(),
        number(lane.cells.as_ref().map(|cells| cells.length_m)),
        cells(lane),
        number(lane.density_ci90.map(|[low, _]| low)),
        number(lane.density_ci90.map(|[_, high]| high)),
        number(lane.calibration_se),
        number(lane.counting_se),
    ]);
    fields.extend(moving(lane.traffic.as_ref()));
    fields.join(",")
}

/// The columns of flow and speed, empty where vehicles are not followed.
fn moving(traffic: Option<&Traffic>) -> [String; 17] {
    let of = |field: fn(&Traffic) -> Option<f32>| number(traffic.and_then(field));
    let passed = traffic.and_then(|traffic| traffic.passed.as_ref()).map(Passed::all);
    [
        traffic.map_or_else(String::new, |traffic| traffic.traffic_status.name().to_owned()),
        of(|traffic| traffic.flow_veh_h),
        of(|traffic| traffic.flow_ci90.map(|[low, _]| low)),
        of(|traffic| traffic.flow_ci90.map(|[_, high]| high)),
        of(|traffic| traffic.speed_kmh),
        of(|traffic| traffic.speed_ci90.map(|[low, _]| low)),
        of(|traffic| traffic.speed_ci90.map(|[_, high]| high)),
        of(|traffic| traffic.time_occupancy),
        of(|traffic| traffic.time_occupancy_ci90.map(|[low, _]| low)),
        of(|traffic| traffic.time_occupancy_ci90.map(|[_, high]| high)),
        passed.map_or_else(String::new, |count| count.to_string()),
        of(|traffic| traffic.section_flow_veh_h),
        of(|traffic| traffic.speed_time_mean_kmh),
        of(|traffic| traffic.headway_s),
        of(|traffic| traffic.headway_sd_s),
        of(|traffic| traffic.queue_m),
        of(|traffic| traffic.queue_max_m),
    ]
}

fn cells(lane: &Lane) -> String {
    let densities = lane.cells.iter().filter_map(|cells| cells.density_veh_km.as_ref()).flatten();
    densities.map(|&density| number(Some(density))).collect::<Vec<_>>().join(";")
}

fn number(value: Option<f32>) -> String {
    value.map_or_else(String::new, |value| rounded(value).to_string())
}

/// A text field: quoted where it holds a quote, comma or line end, its quotes doubled. One that
/// a spreadsheet would take for a formula has an apostrophe in front.
fn quoted(text: &str) -> Cow<'_, str> {
    if text.starts_with(['=', '+', '-', '@', '\t', '\r']) {
        return format!("\"'{}\"", text.replace('"', "\"\"")).into();
    }
    if text.contains(['"', ',', '\r', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\"")).into()
    } else {
        text.into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::tests::{followed, message};

    #[test]
    fn golden_rows() {
        let expected = "\"k109f \"\"<&>\"\", east\",60,7,2026-01-05T08:00:00.000Z,\
            2026-01-05T08:01:00.000Z,true,1,away,24.25,3.5,3,0,1,2,3,4,5,0.1234,123.7,57,60,oK,\
            c,0.02,m,61.85,32.5;16,16,32.5,0.5,3.5,,,,,,,,,,,,,,,,,\r\n\
            \"k109f \"\"<&>\"\", east\",60,7,2026-01-05T08:00:00.000Z,\
            2026-01-05T08:01:00.000Z,true,2,unknown,,,,,,,,,,,123.7,3,60,poorContrast,c,0.02,m,61.85,,,,,,,,,,,,,,,,,,,,,,\r";
        assert_eq!(rows(&message()), expected);
        let moving = ",0.5,3.5,oK,875.5,800,950,36.1,34,38.2,0.1,0.08,0.12,12,720,37,5,2,15,30\r\n";
        assert!(rows(&followed()).contains(moving), "{}", rows(&followed()));
    }

    #[test]
    fn a_name_is_no_formula() {
        for (text, field) in [
            ("=1+1", "\"'=1+1\""),
            ("@SUM(A1)", "\"'@SUM(A1)\""),
            ("-\"x\"", "\"'-\"\"x\"\"\""),
            ("a=1", "a=1"),
        ] {
            assert_eq!(quoted(text), field);
        }
    }

    #[test]
    fn every_row_has_the_headers_fields() {
        let mut plain = followed();
        plain.site = "k109f".into();
        let columns = HEADER.split(',').count();
        for row in rows(&plain).split("\r\n") {
            assert_eq!(row.split(',').count(), columns, "{row}");
        }
        let named = plain.lanes[0].by_class.expect("it has them").named().map(|(name, _)| name);
        assert_eq!(named, CLASSES);
        for class in CLASSES {
            assert!(HEADER.split(',').any(|column| column == class));
        }
    }
}
