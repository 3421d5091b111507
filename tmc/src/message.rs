//! The density message as it arrives: JSON (`docs/reference/schemas/density.schema.json`) or the
//! compact form (`verge::wire`).
//!
//! Owns which form it is, and what the archive asks of a message beyond the check that all
//! readers share (`verge_messages`). Both forms of a message give the same window.

use verge::wire;
use verge_messages::Density;

/// Reads a message and checks it.
///
/// # Errors
/// What is wrong with it.
pub fn read(bytes: &[u8]) -> Result<Density, String> {
    // The compact form begins with its version.
    let message = if matches!(bytes, [1..=wire::VERSION, ..]) {
        let message = wire::decode(bytes).map_err(|error| error.to_string())?;
        let density = verge::messages::density(&message, None);
        density.check().map_err(|wrong| wrong.to_string())?;
        density
    } else {
        verge_messages::read(bytes).map_err(|error| error.to_string())?
    };
    // A folder of the archive has the site's name.
    let site = &message.site;
    if !is_site(site) {
        return Err(format!("site {site:?}: letters, digits, '-', '_' and '.' make a name"));
    }
    Ok(message)
}

/// Rows of the archive that a message becomes: its lanes and their cells.
pub fn rows(message: &Density) -> usize {
    let cells = |lane: &verge_messages::Lane| {
        lane.cells.as_ref().map_or(0, |cells| cells.count(lane.length_m))
    };
    message.lanes.iter().map(|lane| 1 + cells(lane)).sum()
}

/// Whether this names a site: a folder of the archive has its name.
pub fn is_site(name: &str) -> bool {
    let plain = name.bytes().all(|b| b.is_ascii_alphanumeric() || b"-_.".contains(&b));
    (1..=verge_messages::LONGEST_NAME).contains(&name.len()) && plain && !name.starts_with('.')
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A message as a box writes it: two lanes, of two and four cells, the second lane without a
    /// density. `from` is in the first half of its minute.
    pub(crate) fn message(site: &str, seq: u64, from: &str) -> String {
        let begin: jiff::Timestamp = from.parse().unwrap();
        let to = verge_messages::rfc3339(begin.as_millisecond() + 60_000);
        let sha256 = "0".repeat(64);
        format!(
            r#"{{"schema":1,"site":"{site}","seq":{seq},"window_s":60,"from":"{from}","to":"{to}",
            "clock_synced":true,"lanes":[{{"lane":1,"direction":"away","density_veh_km":12.5,
            "density_se":1.0,"vehicles_mean":1.25,"by_class":null,"space_occupancy":0.05,
            "length_m":100.0,"frames_used":30,"frames_expected":30,"status":"oK",
            "cells":{{"length_m":50.0,"density_veh_km":[20.0,5.0]}}}},
            {{"lane":2,"direction":"away","density_veh_km":null,
            "density_se":null,"vehicles_mean":null,"by_class":null,"space_occupancy":null,
            "length_m":100.0,"frames_used":0,"frames_expected":30,"status":"sensorFailure",
            "cells":{{"length_m":25.0,"density_veh_km":null}}}}],
            "calibration":{{"id":"a","sha256":"{sha256}","rel_err":0.02}},
            "model":{{"name":"m","sha256":"{sha256}"}}}}"#
        )
    }

    #[test]
    fn what_is_wrong_is_said() {
        let right = message("k109f", 7, "2026-01-05T08:00:00.000Z");
        let window = read(right.as_bytes()).unwrap();
        assert_eq!((window.seq, window.from.0), (7, 1_767_600_000_000));
        for (from, to, said) in [
            ("\"schema\":1", "\"schema\":2", "schema version 2"),
            ("k109f", "../etc", "make a name"),
            ("k109f", "", "make a name"),
            ("k109f", ".hidden", "make a name"),
            ("\"seq\":7", "\"seq\":-7", "seq: invalid value"),
            ("{\"schema", "{{", "key must be a string"),
        ] {
            let error = read(right.replacen(from, to, 1).as_bytes()).unwrap_err();
            assert!(error.contains(said), "{to}: {error}");
        }
    }

    #[test]
    fn both_forms_of_a_message_give_the_same_window() {
        use verge::density::{Cells, LaneReport, SampleZoneStatus, WindowReport};
        use verge::units::{Direction, LaneId, UtcMs};
        let lane = |number, status, densities: Option<&[f32]>| LaneReport {
            lane: LaneId::new(number).unwrap(),
            direction: Direction::Away,
            density_veh_km: densities.map(|_| 12.500_01),
            density_se: densities.map(|_| 1.0),
            vehicles_mean: densities.map(|_| 1.25),
            by_class: None,
            space_occupancy: densities.map(|_| 0.05),
            length_m: 100.0,
            frames_used: if densities.is_some() { 30 } else { 0 },
            frames_expected: 30,
            status,
            cells: Some(Cells {
                length_m: if densities.is_some() { 50.0 } else { 25.0 },
                density_veh_km: densities.map(|all| all.iter().copied().collect()),
            }),
            error: None,
            traffic: None,
        };
        let name = |text: &str| text.try_into().unwrap();
        let mut message = wire::DensityMessage {
            site: name("k109f"),
            seq: 7,
            clock_synced: true,
            report: WindowReport {
                from: UtcMs(1_767_600_000_000),
                to: UtcMs(1_767_600_060_000),
                lanes: [
                    lane(1, SampleZoneStatus::Ok, Some(&[20.0, 5.0])),
                    lane(2, SampleZoneStatus::SensorFailure, None),
                ]
                .into_iter()
                .collect(),
            },
            calibration: wire::CalibrationRef {
                id: name("a"),
                sha256: [0; 32],
                rel_err: Some(0.02),
            },
            model: wire::ModelRef { name: name("m"), sha256: [0; 32] },
        };
        let parse = |message: &wire::DensityMessage| {
            let mut buffer = [0; wire::MAX_MESSAGE];
            read(wire::encode(message, &mut buffer).unwrap())
        };
        let json = self::message("k109f", 7, "2026-01-05T08:00:00.000Z");
        assert_eq!(parse(&message), read(json.as_bytes()));
        let mut buffer = [0; wire::MAX_MESSAGE];
        let bytes = wire::encode(&message, &mut buffer).unwrap();
        for cut in 1..bytes.len() {
            assert!(read(&bytes[..cut]).is_err(), "{cut}");
        }
        message.report.lanes[0].density_se = Some(f32::NAN);
        assert!(parse(&message).unwrap_err().contains("lanes[0].density_se: NaN"));
        message.report.lanes[0].density_se = None;
        message.report.from = UtcMs(1_767_600_000_001);
        assert!(parse(&message).unwrap_err().contains("window_s: 59 s"));
    }
}
