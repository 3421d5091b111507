//! The JSON messages. Their schemas stand in `docs/schemas/`, and a test holds what is
//! published against them.

use crate::daemon::clock::rfc3339;
use crate::density::{LaneReport, SampleZoneStatus};
use crate::units::VehicleClass;
use crate::wire::{DensityMessage, hex};
use serde::{Serialize, Serializer, ser::SerializeMap};

/// Version of every JSON message; a reader refuses one that it does not know.
pub const SCHEMA: u32 = 1;

/// The name of a status in messages: its label in NTCIP 1209.
pub const fn status_name(status: SampleZoneStatus) -> &'static str {
    match status {
        SampleZoneStatus::Ok => "oK",
        SampleZoneStatus::SensorFailure => "sensorFailure",
        SampleZoneStatus::InputDataIntegrity => "inputDataIntegrity",
        SampleZoneStatus::PoorContrast => "poorContrast",
        SampleZoneStatus::DetectionAutoSuspended => "detectionAutoSuspended",
    }
}

#[derive(Serialize)]
struct Density<'a> {
    schema: u32,
    site: &'a str,
    seq: u64,
    window_s: u64,
    from: String,
    to: String,
    clock_synced: bool,
    lanes: Vec<Lane<'a>>,
    calibration: Calibration<'a>,
    model: Model<'a>,
    #[serde(skip_serializing_if = "Option::is_none")]
    done: Option<bool>,
}

#[derive(Serialize)]
struct Lane<'a> {
    lane: u8,
    direction: crate::units::Direction,
    density_veh_km: Option<f32>,
    density_se: Option<f32>,
    vehicles_mean: Option<f32>,
    by_class: Option<ByClass<'a>>,
    space_occupancy: Option<f32>,
    length_m: f32,
    frames_used: u32,
    frames_expected: u32,
    status: &'static str,
    cells: Option<Cells>,
}

#[derive(Serialize)]
struct Cells {
    length_m: f32,
    density_veh_km: Option<Vec<f32>>,
}

#[derive(Serialize)]
struct Calibration<'a> {
    id: &'a str,
    sha256: heapless::String<64>,
    rel_err: Option<f32>,
}

#[derive(Serialize)]
struct Model<'a> {
    name: &'a str,
    sha256: heapless::String<64>,
}

/// Mean vehicles by class name, in the classes' order.
struct ByClass<'a>(&'a [f32; VehicleClass::COUNT]);

impl Serialize for ByClass<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(VehicleClass::COUNT))?;
        for (class, mean) in VehicleClass::ALL.iter().zip(self.0) {
            map.serialize_entry(class.name(), &round(*mean))?;
        }
        map.end()
    }
}

impl<'a> From<&'a LaneReport> for Lane<'a> {
    fn from(report: &'a LaneReport) -> Self {
        Self {
            lane: report.lane.get(),
            direction: report.direction,
            density_veh_km: report.density_veh_km.map(round),
            density_se: report.density_se.map(round),
            vehicles_mean: report.vehicles_mean.map(round),
            by_class: report.by_class.as_ref().map(ByClass),
            space_occupancy: report.space_occupancy.map(round),
            length_m: round(report.length_m),
            frames_used: report.frames_used,
            frames_expected: report.frames_expected,
            status: status_name(report.status),
            cells: report.cells.as_ref().map(|cells| Cells {
                length_m: round(cells.length_m),
                density_veh_km: cells
                    .density_veh_km
                    .as_ref()
                    .map(|densities| densities.iter().copied().map(round).collect()),
            }),
        }
    }
}

/// Four decimals: finer than any of these quantities is known. A number that is too large for
/// them stays as it is.
pub fn round(value: f32) -> f32 {
    let rounded = (value * 1e4).round() / 1e4;
    if rounded.is_finite() { rounded } else { value }
}

/// One window of one site. `done` stands in replayed windows alone: whether it is the last
/// of its length that was waiting.
pub fn density(message: &DensityMessage, done: Option<bool>) -> Vec<u8> {
    let report = &message.report;
    json(&Density {
        schema: SCHEMA,
        site: &message.site,
        seq: message.seq,
        window_s: report.to.saturating_since(report.from).as_secs(),
        from: rfc3339(report.from),
        to: rfc3339(report.to),
        clock_synced: message.clock_synced,
        lanes: report.lanes.iter().map(Lane::from).collect(),
        calibration: Calibration {
            id: &message.calibration.id,
            sha256: hex(&message.calibration.sha256),
            rel_err: message.calibration.rel_err,
        },
        model: Model { name: &message.model.name, sha256: hex(&message.model.sha256) },
        done,
    })
}

/// The state of the sensor.
#[derive(Clone, Debug, Serialize)]
pub struct Health<'a> {
    /// Who.
    pub site: &'a str,
    /// When, RFC 3339.
    pub time: String,
    /// Version of the program.
    pub version: &'a str,
    /// Status of the sensor as a whole, a name of NTCIP 1209.
    pub status: &'a str,
    /// The alarm that is on.
    pub alarm: Option<&'a str>,
    /// Time since start, s.
    pub uptime_s: u64,
    /// Whether the clock is set from a time source.
    pub clock_synced: bool,
    /// Where the camera looks; null where pictures are not judged.
    pub camera: Option<Camera<'a>>,
    /// What became of the pictures since start.
    pub frames: Frames,
    /// What became of the frames of the camera's stream since start.
    pub stream: Stream,
    /// What became of the messages since start.
    pub messages: Messages,
    /// The box around the camera.
    pub board: Board<'a>,
    /// Faults of the program that the line survived since start.
    pub stage_faults: u64,
    /// The latest fault, for people.
    pub last_fault: Option<&'a str>,
}

/// What became of the pictures since start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Frames {
    /// Measured.
    pub measured: u64,
    /// The same picture as before.
    pub unchanged: u64,
    /// Came, but could not be read or measured.
    pub damaged: u64,
    /// Did not come.
    pub missing: u64,
    /// Came, but were not fit to be measured: blank, blinded, blurred, displaced.
    pub withheld: u64,
}

/// Where the camera looks, and in what light.
#[derive(Clone, Debug, Serialize)]
pub struct Camera<'a> {
    /// `in_place`, `moved`, `unverified` (not seen yet) or `unchecked` (no reference).
    pub aim: &'a str,
    /// Name of the calibration in use, which tells the preset.
    pub preset: &'a str,
    /// Shift of the latest picture against the calibration, px; null where not measured.
    pub shift_px: Option<[f32; 2]>,
    /// `day` or `night` by the latest picture's mean level; null before the first.
    pub light: Option<&'a str>,
}

/// What became of a stream's frames since start, beside those that are pictures; all 0
/// where the camera gives no stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Stream {
    /// Marked as damaged on the way, and passed over.
    pub flagged: u64,
    /// Missing between two sequence numbers.
    pub lost: u64,
    /// Times that the stream was given up and opened again.
    pub reopened: u64,
}

/// The box around the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Board<'a> {
    /// Temperature in the enclosure, degrees Celsius.
    pub enclosure_c: Option<f32>,
    /// How fast the line may run: `full`, `half` or `stopped` by heat.
    pub pace: &'a str,
    /// Failures since start.
    pub faults: BoardFaults,
    /// The latest failure while a part does not work, for people.
    pub last_fault: Option<&'a str>,
}

/// Failures of a board's parts since start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct BoardFaults {
    /// The status lamp.
    pub status_led: u64,
    /// The camera's relay.
    pub camera_power: u64,
    /// The hardware watchdog.
    pub watchdog: u64,
    /// The thermometer.
    pub thermometer: u64,
}

/// What became of the messages since start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Messages {
    /// Taken over by the broker.
    pub delivered: u64,
    /// Refused by the broker.
    pub refused: u64,
    /// Windows waiting for the broker.
    pub waiting: u64,
    /// Of these, windows that only the memory holds because the disk refuses them.
    pub in_memory: u64,
    /// Windows dropped because too many waited.
    pub dropped: u64,
    /// Records of the spool that could not be read.
    pub damaged: u64,
}

/// An alarm that is raised or cleared.
#[derive(Clone, Debug, Serialize)]
pub struct Alarm<'a> {
    /// Who.
    pub site: &'a str,
    /// Since when, RFC 3339.
    pub time: String,
    /// Which.
    pub name: &'a str,
    /// Raised, or cleared.
    pub active: bool,
}

/// A message with the schema's version in front.
#[derive(Serialize)]
struct Versioned<'a, T> {
    schema: u32,
    #[serde(flatten)]
    message: &'a T,
}

/// The state of the sensor.
pub fn health(health: &Health<'_>) -> Vec<u8> {
    json(&Versioned { schema: SCHEMA, message: health })
}

/// An alarm.
pub fn alarm(alarm: &Alarm<'_>) -> Vec<u8> {
    json(&Versioned { schema: SCHEMA, message: alarm })
}

fn json(message: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec(message).expect("these types have string keys and no failing parts")
}
