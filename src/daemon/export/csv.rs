//! CSV (RFC 4180): one row a lane and window, an empty field for what is not known; the cells
//! of a lane stand in one field with `;` between them.

use super::window_s;
use crate::daemon::clock::rfc3339;
use crate::daemon::publish::payload::{round, status_name};
use crate::density::LaneReport;
use crate::units::{Direction, VehicleClass};
use crate::wire::DensityMessage;
use std::borrow::Cow;

/// The first line: units stand in the last word of a name.
pub const HEADER: &str = "site,window_s,seq,from,to,clock_synced,lane,direction,density_veh_km,\
density_se_veh_km,vehicles_mean,vehicle,car,van,bus,truck,motorcycle,space_occupancy,length_m,\
frames_used,frames_expected,status,calibration,calibration_rel_err,model,cell_length_m,\
cells_density_veh_km";

/// The rows of one message, each but the last with its line end (CR LF; the last has its
/// CR).
pub fn rows(message: &DensityMessage) -> String {
    let rows: Vec<_> = message.report.lanes.iter().map(|lane| row(message, lane) + "\r").collect();
    rows.join("\n")
}

fn row(message: &DensityMessage, lane: &LaneReport) -> String {
    let direction = match lane.direction {
        Direction::Unknown => "unknown",
        Direction::Toward => "toward",
        Direction::Away => "away",
    };
    let mut fields = vec![
        quoted(&message.site).into_owned(),
        window_s(message).to_string(),
        message.seq.to_string(),
        rfc3339(message.report.from),
        rfc3339(message.report.to),
        message.clock_synced.to_string(),
        lane.lane.get().to_string(),
        direction.to_owned(),
        number(lane.density_veh_km),
        number(lane.density_se),
        number(lane.vehicles_mean),
    ];
    for class in VehicleClass::ALL {
        fields.push(number(lane.by_class.and_then(|means| means.get(class.index()).copied())));
    }
    fields.extend([
        number(lane.space_occupancy),
        number(Some(lane.length_m)),
        lane.frames_used.to_string(),
        lane.frames_expected.to_string(),
        status_name(lane.status).to_owned(),
        quoted(&message.calibration.id).into_owned(),
        number(message.calibration.rel_err),
        quoted(&message.model.name).into_owned(),
        number(lane.cells.as_ref().map(|cells| cells.length_m)),
        cells(lane),
    ]);
    fields.join(",")
}

fn cells(lane: &LaneReport) -> String {
    let densities = lane.cells.iter().filter_map(|cells| cells.density_veh_km.as_ref()).flatten();
    densities.map(|&density| number(Some(density))).collect::<Vec<_>>().join(";")
}

fn number(value: Option<f32>) -> String {
    value.map_or_else(String::new, |value| round(value).to_string())
}

/// A text field: quoted where it holds a quote, comma or line end, its quotes doubled.
fn quoted(text: &str) -> Cow<'_, str> {
    if text.contains(['"', ',', '\r', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\"")).into()
    } else {
        text.into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::export::tests::message;

    #[test]
    fn golden_rows() {
        let expected = "\"k109f \"\"<&>\"\", east\",60,7,2026-01-05T08:00:00.000Z,\
            2026-01-05T08:01:00.000Z,true,1,away,24.25,3.5,3,0,1,2,3,4,5,0.1234,123.7,57,60,oK,\
            c,0.02,m,61.85,32.5;16\r\n\
            \"k109f \"\"<&>\"\", east\",60,7,2026-01-05T08:00:00.000Z,\
            2026-01-05T08:01:00.000Z,true,2,unknown,,,,,,,,,,,123.7,3,60,poorContrast,c,0.02,m,61.85,\r";
        assert_eq!(rows(&message()), expected);
    }

    #[test]
    fn every_row_has_the_headers_fields() {
        let mut plain = message();
        plain.site = crate::lane::Name::try_from("k109f").expect("short");
        let columns = HEADER.split(',').count();
        for row in rows(&plain).split("\r\n") {
            assert_eq!(row.split(',').count(), columns, "{row}");
        }
        for class in VehicleClass::ALL {
            assert!(HEADER.split(',').any(|column| column == class.name()));
        }
    }
}
