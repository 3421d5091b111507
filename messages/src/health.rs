//! The state of the sensor: `<root>/health`.

use crate::wrong::{count, name, number, time, words};
use crate::{Alarm, Schema, Status, Utc, Wrong};
use serde::{Deserialize, Serialize};

/// Longest words on a fault, bytes.
const LONGEST_FAULT: usize = 4096;
/// Largest counter: a message a microsecond for 280 years.
const MOST_COUNT: u64 = 1 << 53;
/// Largest shift of a picture, px.
const MOST_SHIFT_PX: f32 = 100_000.0;
/// Warmest enclosure, degrees Celsius, and with a minus the coldest.
const MOST_C: f32 = 300.0;
/// Longest interval between pictures, s.
const LONGEST_INTERVAL_S: f32 = 86_400.0;
/// Most days since a certificate has ended.
const LEAST_DAYS: f32 = -100_000.0;
/// Most days until it does: those without an end have the last day of 9999 (RFC 5280, 4.1.2.5).
const MOST_DAYS: f32 = 3_000_000.0;
/// Largest difference of two densities, veh/km.
const MOST_VEH_KM: f32 = 10_000.0;

/// Published on `<root>/health`, QoS 1, retained: at start, each minute, and when the status
/// changes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(title = "verge health"))]
pub struct Health {
    /// Version of the message.
    pub schema: Schema,
    /// The site.
    #[cfg_attr(feature = "schema", schemars(length(max = crate::LONGEST_NAME)))]
    pub site: String,
    /// Time of the message.
    pub time: Utc,
    /// Version of the program.
    pub version: String,
    /// Status of the sensor as a whole.
    pub status: Status,
    /// The alarm that is on.
    pub alarm: Option<Alarm>,
    /// Time since start, s.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub uptime_s: u64,
    /// Whether the clock is set from a time source.
    pub clock_synced: bool,
    /// Where the camera looks; null where pictures are not judged.
    #[cfg_attr(feature = "schema", schemars(extend("x-since" = "0.1")))]
    pub camera: Option<Camera>,
    /// Counts of the pictures since start, by outcome.
    pub frames: Frames,
    /// Counts of the frames of the camera's stream since start, beside those that are pictures;
    /// all 0 where the camera gives no stream.
    pub stream: Stream,
    /// Counts of the messages since start, by outcome.
    pub messages: Messages,
    /// How vehicles are followed; null where they are not.
    #[cfg_attr(feature = "schema", schemars(extend("x-since" = "0.2")))]
    pub traffic: Option<Following>,
    /// The box around the camera.
    pub board: Board,
    /// Faults of the program that the line survived since start.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub stage_faults: u64,
    /// Whole days until the first certificate that is in use ends, negative when it has; null
    /// where none is known.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(range(min = LEAST_DAYS, max = MOST_DAYS)))]
    pub certificate_days: Option<i64>,
    /// Windows that did not leave for the I/O node since start; null where none is connected.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT), extend("x-since" = "0.2")))]
    pub node_windows_lost: Option<u64>,
    /// The latest fault, for people; null while all is well.
    pub last_fault: Option<String>,
}

impl Health {
    /// Refuses what no box publishes.
    ///
    /// # Errors
    /// The first [`Wrong`] field.
    pub fn check(&self) -> Result<(), Wrong> {
        let Self { schema: _, site, time: at, version, status: _, alarm: _, uptime_s, .. } = self;
        let Self { clock_synced: _, camera, frames, stream, messages, traffic, board, .. } = self;
        let Self { stage_faults, certificate_days, node_windows_lost, last_fault, .. } = self;
        name("site", site)?;
        time("time", *at)?;
        name("version", version)?;
        for (field, given) in [("uptime_s", *uptime_s), ("stage_faults", *stage_faults)] {
            count(field, given, 0, MOST_COUNT)?;
        }
        counts([("node_windows_lost", node_windows_lost.unwrap_or(0))])?;
        if let Some(days) = *certificate_days {
            // In so many days a float has no more than a day's error.
            number("certificate_days", days as f32, LEAST_DAYS, MOST_DAYS)?;
        }
        words("last_fault", last_fault.as_deref(), LONGEST_FAULT)?;
        frames.check().map_err(|wrong| wrong.inside("frames"))?;
        stream.check().map_err(|wrong| wrong.inside("stream"))?;
        messages.check().map_err(|wrong| wrong.inside("messages"))?;
        board.check().map_err(|wrong| wrong.inside("board"))?;
        if let Some(camera) = camera {
            camera.check().map_err(|wrong| wrong.inside("camera"))?;
        }
        let Some(Following { longest_interval_s, density_difference_veh_km }) = traffic else {
            return Ok(());
        };
        let field = "traffic.longest_interval_s";
        number(field, *longest_interval_s, 0.0, LONGEST_INTERVAL_S)?;
        let field = "traffic.density_difference_veh_km";
        let difference = *density_difference_veh_km;
        difference.map_or(Ok(()), |given| number(field, given, -MOST_VEH_KM, MOST_VEH_KM))
    }
}

/// Counters that a box may have.
fn counts<const N: usize>(all: [(&str, u64); N]) -> Result<(), Wrong> {
    all.into_iter().try_for_each(|(field, given)| count(field, given, 0, MOST_COUNT))
}

impl Frames {
    fn check(&self) -> Result<(), Wrong> {
        let Self { measured, unchanged, damaged, missing, withheld } = *self;
        counts([
            ("measured", measured),
            ("unchanged", unchanged),
            ("damaged", damaged),
            ("missing", missing),
            ("withheld", withheld),
        ])
    }
}

impl Stream {
    fn check(&self) -> Result<(), Wrong> {
        let Self { flagged, lost, reopened } = *self;
        counts([("flagged", flagged), ("lost", lost), ("reopened", reopened)])
    }
}

impl Messages {
    fn check(&self) -> Result<(), Wrong> {
        let Self { delivered, refused, waiting, in_memory, dropped, damaged } = *self;
        counts([
            ("delivered", delivered),
            ("refused", refused),
            ("waiting", waiting),
            ("in_memory", in_memory),
            ("dropped", dropped),
            ("damaged", damaged),
        ])
    }
}

impl Board {
    fn check(&self) -> Result<(), Wrong> {
        let Self { enclosure_c, pace: _, faults, last_fault } = self;
        if let Some(celsius) = *enclosure_c {
            number("enclosure_c", celsius, -MOST_C, MOST_C)?;
        }
        let BoardFaults { status_led, camera_power, watchdog, thermometer } = *faults;
        counts([
            ("faults.status_led", status_led),
            ("faults.camera_power", camera_power),
            ("faults.watchdog", watchdog),
            ("faults.thermometer", thermometer),
        ])?;
        words("last_fault", last_fault.as_deref(), LONGEST_FAULT)
    }
}

impl Camera {
    fn check(&self) -> Result<(), Wrong> {
        let Self { aim: _, preset, shift_px, light: _, road_age_s } = self;
        name("preset", preset)?;
        for shift in shift_px.iter().flatten() {
            number("shift_px", *shift, -MOST_SHIFT_PX, MOST_SHIFT_PX)?;
        }
        road_age_s.map_or(Ok(()), |age| count("road_age_s", age, 0, MOST_COUNT))
    }
}

/// Counts of the pictures since start, by outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "frames"))]
pub struct Frames {
    /// Measured.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub measured: u64,
    /// The same picture as before.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub unchanged: u64,
    /// Came, but could not be read or measured.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub damaged: u64,
    /// Did not come.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub missing: u64,
    /// Came, but were not fit to be measured: blank, blinded, blurred, displaced.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT), extend("x-since" = "0.1")))]
    pub withheld: u64,
}

/// Where the camera looks, and in what light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "camera"))]
pub struct Camera {
    /// Whether it looks where it was calibrated.
    pub aim: Aim,
    /// Name of the calibration in use, which tells the preset.
    #[cfg_attr(feature = "schema", schemars(length(max = crate::LONGEST_NAME)))]
    pub preset: String,
    /// Shift of the latest picture against the calibration, px to the right and down; null
    /// where it was not measured.
    #[cfg_attr(feature = "schema", schemars(inner(range(min = -MOST_SHIFT_PX, max = MOST_SHIFT_PX))))]
    pub shift_px: Option<[f32; 2]>,
    /// By the mean level of the latest picture; null before the first.
    pub light: Option<Light>,
    /// Time since the empty road was last learned in this light, s; null where it never was.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT), extend("x-since" = "0.2")))]
    pub road_age_s: Option<u64>,
}

/// Whether the camera looks where it was calibrated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(inline))]
#[serde(rename_all = "snake_case")]
pub enum Aim {
    /// At the active preset.
    InPlace,
    /// Moved.
    Moved,
    /// Not seen since start: taken on trust.
    Unverified,
    /// The lane table has no reference of the scene.
    Unchecked,
}

/// Light at the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(inline))]
#[serde(rename_all = "lowercase")]
pub enum Light {
    /// Bright.
    Day,
    /// Dark.
    Night,
}

/// How vehicles are followed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "traffic"))]
pub struct Following {
    /// The longest time between two pictures with which they can be, s
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = LONGEST_INTERVAL_S)))]
    pub longest_interval_s: f32,
    /// The largest difference of a lane between its density by the mean of pictures and by Edie's
    /// definition, in the latest of the shortest windows, veh/km, with its sign; null where no
    /// lane has one. They are the same where both are right.
    #[cfg_attr(feature = "schema", schemars(range(min = -MOST_VEH_KM, max = MOST_VEH_KM)))]
    pub density_difference_veh_km: Option<f32>,
}

/// Counts of a stream's frames since start, by outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "stream"))]
pub struct Stream {
    /// Marked as damaged on the way, and passed over.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub flagged: u64,
    /// Missing between two sequence numbers.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub lost: u64,
    /// Times that the stream was given up and opened again.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub reopened: u64,
}

/// Counts of the messages since start, by outcome.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "messages"))]
pub struct Messages {
    /// Taken over by the broker.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub delivered: u64,
    /// Refused by the broker, with a reason (MQTT 5).
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub refused: u64,
    /// Windows that the broker has not taken.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub waiting: u64,
    /// Of these, windows that are not on the disk because it refuses them.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub in_memory: u64,
    /// Windows lost because too many waited: the oldest.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub dropped: u64,
    /// Records of the spool that could not be read.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub damaged: u64,
}

/// The box around the camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "board"))]
pub struct Board {
    /// Temperature in the enclosure, degrees Celsius; null without a sensor.
    #[cfg_attr(feature = "schema", schemars(range(min = -MOST_C, max = MOST_C)))]
    pub enclosure_c: Option<f32>,
    /// How fast the line may run.
    pub pace: Pace,
    /// Failures of its parts since start.
    pub faults: BoardFaults,
    /// The latest failure, for people; null while every part works.
    pub last_fault: Option<String>,
}

/// How fast the line may run, by the heat in the enclosure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(inline))]
#[serde(rename_all = "lowercase")]
pub enum Pace {
    /// As configured.
    Full,
    /// Each second picture.
    Half,
    /// Not at all.
    Stopped,
}

impl Pace {
    /// The name in messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::Half => "half",
            Self::Stopped => "stopped",
        }
    }
}

/// Failures of a board's parts since start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "board_faults"))]
pub struct BoardFaults {
    /// The status lamp.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub status_led: u64,
    /// The camera's relay.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub camera_power: u64,
    /// The hardware watchdog.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub watchdog: u64,
    /// The thermometer.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = MOST_COUNT)))]
    pub thermometer: u64,
}
