//! The alarms and the message that raises or clears one: `<root>/alarm/<name>`.

use crate::wrong::{name, time};
use crate::{Schema, Utc, Wrong};
use serde::{Deserialize, Serialize};

/// What is wrong at the box or with its pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(inline))]
#[serde(rename_all = "snake_case")]
pub enum Alarm {
    /// No picture for longer than the limit.
    NoPicture,
    /// The same picture for longer than the limit.
    FrozenPicture,
    /// Black pictures, or of one colour.
    BlankPicture,
    /// Sun, headlights or fog.
    BlindedPicture,
    /// Nothing sharp in the pictures.
    BlurredPicture,
    /// The camera looks at none of its presets.
    CameraMoved,
    /// The enclosure is too warm to measure at the full pace.
    Overheated,
    /// A part of the board does not work.
    BoardFault,
    /// A certificate that is in use ends within 14 days, or has.
    CertificateExpires,
}

impl Alarm {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::NoPicture,
        Self::FrozenPicture,
        Self::BlankPicture,
        Self::BlindedPicture,
        Self::BlurredPicture,
        Self::CameraMoved,
        Self::Overheated,
        Self::BoardFault,
        Self::CertificateExpires,
    ];

    /// Its name in topics and messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::NoPicture => "no_picture",
            Self::FrozenPicture => "frozen_picture",
            Self::BlankPicture => "blank_picture",
            Self::BlindedPicture => "blinded_picture",
            Self::BlurredPicture => "blurred_picture",
            Self::CameraMoved => "camera_moved",
            Self::Overheated => "overheated",
            Self::BoardFault => "board_fault",
            Self::CertificateExpires => "certificate_expires",
        }
    }
}

/// Published on `<root>/alarm/<name>`, QoS 1, retained, when it is raised and when it is over.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(title = "verge alarm"))]
pub struct AlarmMessage {
    /// Version of the message.
    #[serde(default)]
    pub schema: Schema,
    /// Who.
    #[cfg_attr(feature = "schema", schemars(length(max = crate::LONGEST_NAME)))]
    pub site: String,
    /// Since when.
    pub time: Utc,
    /// Which.
    pub name: Alarm,
    /// Raised, or over.
    pub active: bool,
}

impl AlarmMessage {
    /// Refuses what no box publishes.
    ///
    /// # Errors
    /// The first [`Wrong`] field.
    pub fn check(&self) -> Result<(), Wrong> {
        let Self { schema: _, site, time: at, name: _, active: _ } = self;
        name("site", site)?;
        time("time", *at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_in_messages() {
        for alarm in Alarm::ALL {
            let json = serde_json::to_string(&alarm).expect("a name");
            assert_eq!(json, format!("{:?}", alarm.name()));
        }
    }

    #[test]
    fn golden_bytes() {
        let message = AlarmMessage {
            schema: Schema::default(),
            site: "k109f".into(),
            time: Utc(1_767_600_000_000),
            name: Alarm::CameraMoved,
            active: true,
        };
        let golden = "{\"schema\":1,\"site\":\"k109f\",\"time\":\"2026-01-05T08:00:00.000Z\",\
            \"name\":\"camera_moved\",\"active\":true}";
        assert_eq!(String::from_utf8(crate::json(&message)).expect("JSON"), golden);
    }
}
