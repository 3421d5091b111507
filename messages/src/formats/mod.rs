//! Density messages in the formats that traffic centres exchange.
//!
//! Owns the mapping from a [`Density`] to each format. Pure functions: no file, no clock, no
//! connection. What each field means, and what a format cannot express:
//! `docs/reference/formats.md`.

mod csv;
mod datex2;
mod datex2_sites;
mod fiware;
pub mod geojson;
mod ntcip;

use crate::{Density, Utc};

/// A format that messages are written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// FIWARE `TrafficFlowObserved`, NGSI-LD key values: one JSON array a message.
    Fiware,
    /// DATEX II v3 `MeasuredDataPublication`: one XML document.
    Datex2,
    /// DATEX II v3 `MeasurementSiteTablePublication`: one XML document over all sites.
    Datex2Sites,
    /// GeoJSON features, one a lane and window and line.
    Geojson,
    /// The values of NTCIP 1209: one JSON object a lane and window.
    Ntcip,
    /// One row a lane and window, RFC 4180.
    Csv,
    /// The daemon's own JSON: one object a message.
    Json,
}

impl Format {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Fiware,
        Self::Datex2,
        Self::Datex2Sites,
        Self::Geojson,
        Self::Ntcip,
        Self::Csv,
        Self::Json,
    ];

    /// Its name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Fiware => "fiware",
            Self::Datex2 => "datex2",
            Self::Datex2Sites => "datex2-sites",
            Self::Geojson => "geojson",
            Self::Ntcip => "ntcip",
            Self::Csv => "csv",
            Self::Json => "json",
        }
    }
}

/// Facts that a format asks for and no message holds.
#[derive(Clone, Debug, Default)]
pub struct Publisher {
    /// FIWARE `refRoadSegment`, an URN or address of the road segment.
    pub road_segment: Option<String>,
    /// DATEX II country of the publisher, ISO 3166-1 alpha-2.
    pub country: Option<String>,
}

/// Writes messages in one format.
#[derive(Clone, Debug)]
pub struct Exporter {
    format: Format,
    publisher: Publisher,
}

impl Exporter {
    /// An exporter to that format.
    pub const fn new(format: Format, publisher: Publisher) -> Self {
        Self { format, publisher }
    }

    /// Text before the first message, written at `time`.
    pub fn begin(&self, time: Utc) -> Option<String> {
        match self.format {
            Format::Datex2 => Some(datex2::begin(time, self.publisher.country.as_deref())),
            Format::Datex2Sites => {
                Some(datex2_sites::begin(time, self.publisher.country.as_deref()))
            }
            Format::Csv => Some(format!("{}\r", csv::HEADER)),
            Format::Fiware | Format::Geojson | Format::Ntcip | Format::Json => None,
        }
    }

    /// Whether a site stands once in the output, with its latest message, however many it has.
    pub fn is_of_sites(&self) -> bool {
        self.format == Format::Datex2Sites
    }

    /// One message, without the end of its last line.
    ///
    /// # Errors
    /// The part that the format asks for and the message lacks.
    pub fn message(&self, message: &Density) -> Result<String, String> {
        Ok(match self.format {
            Format::Fiware => fiware::entities(message, self.publisher.road_segment.as_deref()),
            Format::Datex2Sites => return datex2_sites::site(message),
            Format::Geojson => geojson::features(message),
            Format::Datex2 => datex2::site_measurements(message),
            Format::Ntcip => ntcip::zones(message),
            Format::Csv => csv::rows(message),
            Format::Json => String::from_utf8_lossy(&crate::json(message)).into_owned(),
        })
    }

    /// Text behind the last message.
    pub fn end(&self) -> Option<String> {
        match self.format {
            Format::Datex2 => Some(datex2::END.to_owned()),
            Format::Datex2Sites => Some(datex2_sites::END.to_owned()),
            Format::Fiware | Format::Geojson | Format::Ntcip | Format::Csv | Format::Json => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Traffic;
    use crate::{
        ByClass, Calibration, Cells, Direction, Lane, Model, Passed, Schema, Status, read,
    };

    /// A minute with one measured lane and one that nothing is known of.
    pub(super) fn message() -> Density {
        let measured = Lane {
            lane: 1,
            lane_name: None,
            lane_order: None,
            direction: Direction::Away,
            density_veh_km: Some(24.25),
            density_se: Some(3.5),
            vehicles_mean: Some(3.0),
            by_class: Some(ByClass {
                vehicle: 0.0,
                car: 1.0,
                van: 2.0,
                bus: 3.0,
                truck: 4.0,
                motorcycle: 5.0,
            }),
            space_occupancy: Some(0.1234),
            length_m: 123.7,
            frames_used: 57,
            frames_expected: 60,
            status: Status::Ok,
            cells: Some(Cells { length_m: 61.85, density_veh_km: Some(vec![32.5, 16.0]) }),
            density_ci90: Some([16.0, 32.5]),
            calibration_se: Some(0.5),
            counting_se: Some(3.5),
            traffic: None,
        };
        let missing = Lane {
            lane: 2,
            direction: Direction::Unknown,
            density_veh_km: None,
            density_se: None,
            vehicles_mean: None,
            by_class: None,
            space_occupancy: None,
            frames_used: 3,
            status: Status::PoorContrast,
            cells: Some(Cells { length_m: 61.85, density_veh_km: None }),
            density_ci90: None,
            calibration_se: None,
            counting_se: None,
            ..measured.clone()
        };
        Density {
            schema: Schema::default(),
            site: "k109f \"<&>\", east".into(),
            place: None,
            seq: 7,
            window_s: 60,
            from: Utc(1_767_600_000_000),
            to: Utc(1_767_600_060_000),
            clock_synced: true,
            lanes: vec![measured, missing],
            calibration: Calibration {
                id: "c".into(),
                sha256: "01".repeat(32),
                rel_err: Some(0.02),
            },
            model: Model { name: "m".into(), sha256: "02".repeat(32) },
            done: None,
        }
    }

    /// The same with flow and speed, of which nothing is known in the second lane.
    pub(super) fn followed() -> Density {
        let known = Traffic {
            traffic_status: Status::Ok,
            flow_veh_h: Some(875.5),
            flow_ci90: Some([800.0, 950.0]),
            speed_kmh: Some(36.1),
            speed_ci90: Some([34.0, 38.2]),
            time_occupancy: Some(0.1),
            time_occupancy_ci90: Some([0.08, 0.12]),
            passed: Some(Passed { vehicle: 0, car: 10, van: 1, bus: 0, truck: 1, motorcycle: 0 }),
            section_flow_veh_h: Some(720.0),
            speed_time_mean_kmh: Some(37.0),
            headway_s: Some(5.0),
            headway_sd_s: Some(2.0),
            queue_m: Some(15.0),
            queue_max_m: Some(30.0),
            density_difference: Some(-0.5),
        };
        let unknown = Traffic {
            traffic_status: Status::PoorContrast,
            flow_veh_h: None,
            flow_ci90: None,
            speed_kmh: None,
            speed_ci90: None,
            time_occupancy: None,
            time_occupancy_ci90: None,
            passed: None,
            section_flow_veh_h: None,
            speed_time_mean_kmh: None,
            headway_s: None,
            headway_sd_s: None,
            queue_m: None,
            queue_max_m: None,
            density_difference: None,
        };
        let mut message = message();
        message.lanes[0].traffic = Some(known);
        message.lanes[1].traffic = Some(unknown);
        message
    }

    /// The same from a site that says where it is.
    pub(super) fn placed(message: Density) -> Density {
        let place = crate::Place {
            name: Some("Siu Lam".into()),
            road: Some("Tuen Mun Road".into()),
            direction: Some("to Kowloon".into()),
            latitude: Some(22.362_51),
            longitude: Some(114.012_5),
            bearing: Some(120.0),
        };
        let fast = crate::LaneName { lane: 2, name: Some("fast lane".into()), order: Some(2) };
        message.at(&place, &[fast])
    }

    #[test]
    fn flow_and_speed_come_back_as_they_were_written() {
        let exporter = Exporter::new(Format::Json, Publisher::default());
        let json = exporter.message(&followed()).expect("JSON");
        assert!(
            json.contains("\"counting_se\":3.5,\"traffic_status\":\"oK\",\"flow_veh_h\":875.5")
        );
        assert_eq!(read(json.as_bytes()), Ok(followed()));
        for (from, to, expected) in [
            ("875.5", "-875.5", "lanes[0].flow_veh_h: -875.5: 0 to 36000 is right"),
            ("36.1", "1e4", "lanes[0].speed_kmh: 10000: 0 to 1000"),
            ("[34.0,", "[39.0,", "lanes[0].speed_ci90[1]: 38.2: 39 to"),
            ("\"car\":10,", "", "car is missing"),
            ("875.5", "\"many\"", "must be a number, not the text"),
            ("\"traffic_status\":\"oK\"", "\"traffic_status\":\"fine\"", "\"fine\" is not known"),
        ] {
            assert!(json.contains(from), "{from}");
            let wrong = read(json.replacen(from, to, 1).as_bytes());
            let error = wrong.map(|read| read.lanes[0].clone()).expect_err(to).to_string();
            assert!(error.contains(expected), "{to}: {error}");
        }
    }

    #[test]
    fn json_comes_back_as_the_daemon_wrote_it() {
        let exporter = Exporter::new(Format::Json, Publisher::default());
        let json = exporter.message(&message()).expect("JSON");
        let read = read(json.as_bytes()).expect("our own message");
        assert_eq!(read, message());
        assert_eq!(exporter.message(&read), Ok(json));
        assert_eq!((exporter.begin(Utc(0)), exporter.end()), (None, None));
    }
}
