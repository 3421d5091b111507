//! Messages as they arrive: a window in JSON (`docs/reference/schemas/density.schema.json`) or in the
//! compact form (`verge::wire`), the state of a sensor, an alarm.
//!
//! Owns which form it is, and what the archive asks of a message beyond the check that all
//! readers share (`verge_messages`). Both forms of a message give the same window.

use serde::Deserialize;
use serde::de::IgnoredAny;
use verge::wire;
use verge_messages::{AlarmMessage, Density, Health, Kind, Utc};

/// A message of any kind.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// A window.
    Density(Box<Density>),
    /// The state of the sensor.
    Health(Box<Health>),
    /// An alarm that is raised or over.
    Alarm(AlarmMessage),
}

impl Message {
    /// The site.
    pub fn site(&self) -> &str {
        match self {
            Self::Density(message) => &message.site,
            Self::Health(message) => &message.site,
            Self::Alarm(message) => &message.site,
        }
    }

    /// From when to when it tells.
    pub fn span(&self) -> (Utc, Utc) {
        match self {
            Self::Density(message) => (message.from, message.to),
            Self::Health(message) => (message.time, message.time),
            Self::Alarm(message) => (message.time, message.time),
        }
    }

    /// Rows of the archive that it becomes.
    pub fn rows(&self) -> usize {
        match self {
            Self::Density(message) => rows(message),
            Self::Health(_) | Self::Alarm(_) => 1,
        }
    }
}

/// Reads a message of that kind and checks it.
///
/// # Errors
/// The fault of the message.
pub fn read_kind(kind: Kind, bytes: &[u8]) -> Result<Message, String> {
    let message = match kind {
        Kind::Density => return read(bytes).map(|message| Message::Density(Box::new(message))),
        Kind::Health => verge_messages::read_health(bytes).map(|it| Message::Health(Box::new(it))),
        Kind::Alarm => verge_messages::read_alarm(bytes).map(Message::Alarm),
    };
    let message = message.map_err(|error| error.to_string())?;
    check_site(message.site())?;
    Ok(message)
}

/// Reads a message whose kind nobody tells: one of the journal.
///
/// # Errors
/// The fault of the message.
pub fn read_any(bytes: &[u8]) -> Result<Message, String> {
    /// Fields that tell the kinds apart; any of them may be absent.
    #[derive(Deserialize)]
    struct Marks {
        lanes: Option<IgnoredAny>,
        uptime_s: Option<IgnoredAny>,
        active: Option<IgnoredAny>,
    }
    let kind = match serde_json::from_slice(bytes) {
        Ok(Marks { lanes: None, uptime_s: Some(_), .. }) => Kind::Health,
        Ok(Marks { lanes: None, uptime_s: None, active: Some(_) }) => Kind::Alarm,
        _ => Kind::Density,
    };
    read_kind(kind, bytes)
}

/// Reads a message and checks it.
///
/// # Errors
/// The fault of the message.
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
    check_site(&message.site)?;
    Ok(message)
}

/// A folder of the archive has the site's name.
fn check_site(site: &str) -> Result<(), String> {
    if is_site(site) {
        return Ok(());
    }
    Err(format!("site {site:?}: letters, digits, '-', '_' and '.' make a name"))
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
            ("\"schema\":1", "\"schema\":3", "schema version 3"),
            ("k109f", "../etc", "make a name"),
            ("k109f", "", "make a name"),
            ("k109f", ".hidden", "make a name"),
            ("\"seq\":7", "\"seq\":-7", "seq: must be a whole number"),
            ("{\"schema", "{{", "a name needs quotes"),
        ] {
            let error = read(right.replacen(from, to, 1).as_bytes()).unwrap_err();
            assert!(error.contains(said), "{to}: {error}");
        }
    }

    /// An alarm as a box writes it.
    pub(crate) fn alarm(site: &str, name: &str, active: bool, time: &str) -> String {
        format!(
            r#"{{"schema":1,"site":"{site}","time":"{time}","name":"{name}","active":{active}}}"#
        )
    }

    /// The state of a sensor as a box writes it.
    pub(crate) fn health(site: &str, time: &str, clock_synced: bool) -> String {
        format!(
            r#"{{"schema":1,"site":"{site}","time":"{time}","version":"0.1.0","status":"oK",
            "alarm":null,"uptime_s":75,"clock_synced":{clock_synced},"camera":null,
            "frames":{{"measured":1,"unchanged":0,"damaged":0,"missing":0,"withheld":0}},
            "stream":{{"flagged":0,"lost":0,"reopened":0}},"messages":{{"delivered":4,"refused":0,
            "waiting":0,"in_memory":0,"dropped":0,"damaged":0}},"traffic":null,
            "board":{{"enclosure_c":41.5,"pace":"full","faults":{{"status_led":0,"camera_power":0,
            "watchdog":0,"thermometer":0}},"last_fault":null}},"stage_faults":0,
            "certificate_days":null,"last_fault":null}}"#
        )
    }

    #[test]
    fn kinds_are_told_apart_and_each_is_checked() {
        let time = "2026-01-05T08:00:00.000Z";
        let of = |text: &str| read_any(text.as_bytes());
        assert!(matches!(of(&message("a", 7, time)), Ok(Message::Density(_))));
        assert!(matches!(of(&health("a", time, true)), Ok(Message::Health(_))));
        let raised = of(&alarm("a", "camera_moved", true, time)).unwrap();
        assert_eq!(
            (raised.site(), raised.span().0, raised.rows()),
            ("a", Utc(1_767_600_000_000), 1)
        );
        for (text, said) in [
            (alarm("a", "camera_stolen", true, time), "name: \"camera_stolen\" is not known"),
            (alarm("../a", "camera_moved", true, time), "make a name"),
            (alarm("a", "camera_moved", true, "1969-12-31T00:00:00Z"), "time: 1969-12-31"),
            (health("a", time, true).replace("41.5", "4e9"), "board.enclosure_c: 4000000000"),
            (health("a", time, true).replace(":75", ":-1"), "uptime_s: must be a whole number"),
            (health("a", time, true).replace("\"delivered\":4,", ""), "delivered is missing"),
            (health("a", time, true).replace("\"schema\":1", "\"schema\":2"), "schema version 2"),
            ("{}".into(), "not a density message"),
        ] {
            let error = of(&text).unwrap_err();
            assert!(error.contains(said), "{said}: {error}");
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
