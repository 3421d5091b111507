//! Export: density messages in the formats that traffic centres exchange.
//!
//! Owns the mapping from a [`DensityMessage`] to each format and back from its two wire
//! forms. Pure functions: no file, no clock, no connection. What each field means, and
//! what a format cannot say, stands in `docs/formats.md`.

mod csv;
mod datex2;
mod fiware;
mod ntcip;
mod read;

pub use read::{MessageForm, ReadError, read};

use crate::daemon::publish::payload;
use crate::units::UtcMs;
use crate::wire::DensityMessage;

/// A format that messages are written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Target {
    /// FIWARE `TrafficFlowObserved`, NGSI-LD key values: one JSON array a message.
    Fiware,
    /// DATEX II v3 `MeasuredDataPublication`: one XML document.
    Datex2,
    /// The values of NTCIP 1209: one JSON object a lane and window.
    Ntcip,
    /// One row a lane and window, RFC 4180.
    Csv,
    /// The daemon's own JSON: one object a message.
    Json,
}

/// What a format asks for that no message holds.
#[derive(Clone, Debug, Default)]
pub struct Place {
    /// FIWARE `refRoadSegment`, an URN or address of the road segment.
    pub road_segment: Option<String>,
    /// DATEX II country of the publisher, ISO 3166-1 alpha-2.
    pub country: Option<String>,
}

/// Writes messages in one format.
#[derive(Clone, Debug)]
pub struct Exporter {
    target: Target,
    place: Place,
}

impl Exporter {
    /// An exporter to that format.
    pub fn new(target: Target, place: Place) -> Self {
        Self { target, place }
    }

    /// What stands before the first message, made at `time`.
    pub fn begin(&self, time: UtcMs) -> Option<String> {
        match self.target {
            Target::Datex2 => Some(datex2::begin(time, self.place.country.as_deref())),
            Target::Csv => Some(format!("{}\r", csv::HEADER)),
            Target::Fiware | Target::Ntcip | Target::Json => None,
        }
    }

    /// One message, without the end of its last line.
    pub fn message(&self, message: &DensityMessage) -> String {
        match self.target {
            Target::Fiware => fiware::entities(message, self.place.road_segment.as_deref()),
            Target::Datex2 => datex2::site_measurements(message),
            Target::Ntcip => ntcip::zones(message),
            Target::Csv => csv::rows(message),
            Target::Json => String::from_utf8_lossy(&payload::density(message, None)).into_owned(),
        }
    }

    /// What stands behind the last message.
    pub fn end(&self) -> Option<String> {
        (self.target == Target::Datex2).then(|| datex2::END.to_owned())
    }
}

/// The window's length, s.
fn window_s(message: &DensityMessage) -> u64 {
    message.report.to.saturating_since(message.report.from).as_secs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::density::{Cells, LaneReport, SampleZoneStatus, WindowReport};
    use crate::lane::Name;
    use crate::units::{Direction, LaneId, VehicleClass};
    use crate::wire::{CalibrationRef, ModelRef};

    /// A minute with one measured lane and one that nothing is known of.
    pub(super) fn message() -> DensityMessage {
        let name = |text: &str| Name::try_from(text).expect("short");
        let measured = LaneReport {
            lane: LaneId::new(1).expect("in range"),
            direction: Direction::Away,
            density_veh_km: Some(24.25),
            density_se: Some(3.5),
            vehicles_mean: Some(3.0),
            by_class: Some(std::array::from_fn::<_, { VehicleClass::COUNT }, _>(|n| n as f32)),
            space_occupancy: Some(0.1234),
            length_m: 123.7,
            frames_used: 57,
            frames_expected: 60,
            status: SampleZoneStatus::Ok,
            cells: Some(Cells {
                length_m: 61.85,
                density_veh_km: Some([32.5, 16.0].into_iter().collect()),
            }),
        };
        let missing = LaneReport {
            lane: LaneId::new(2).expect("in range"),
            direction: Direction::Unknown,
            density_veh_km: None,
            density_se: None,
            vehicles_mean: None,
            by_class: None,
            space_occupancy: None,
            frames_used: 3,
            status: SampleZoneStatus::PoorContrast,
            cells: Some(Cells { length_m: 61.85, density_veh_km: None }),
            ..measured.clone()
        };
        DensityMessage {
            site: name("k109f \"<&>\", east"),
            seq: 7,
            clock_synced: true,
            report: WindowReport {
                from: UtcMs(1_767_600_000_000),
                to: UtcMs(1_767_600_060_000),
                lanes: [measured, missing].into_iter().collect(),
            },
            calibration: CalibrationRef { id: name("c"), sha256: [1; 32], rel_err: Some(0.02) },
            model: ModelRef { name: name("m"), sha256: [2; 32] },
        }
    }

    #[test]
    fn json_comes_back_as_the_daemon_wrote_it() {
        let exporter = Exporter::new(Target::Json, Place::default());
        let json = exporter.message(&message());
        let read = read(MessageForm::Json, json.as_bytes()).expect("our own message");
        assert_eq!(read, message());
        assert_eq!(exporter.message(&read), json);
        assert_eq!((exporter.begin(UtcMs(0)), exporter.end()), (None, None));
    }
}
