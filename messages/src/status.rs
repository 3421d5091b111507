//! How far a reading can be used, in the words and numbers of NTCIP 1209 `sampleZoneStatus`.

use serde::{Deserialize, Serialize};

/// How far a reading can be used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "status"))]
#[serde(rename_all = "camelCase")]
pub enum Status {
    /// It can.
    #[default]
    #[serde(rename = "oK")]
    Ok,
    /// No picture.
    SensorFailure,
    /// Frozen, damaged or too few pictures.
    InputDataIntegrity,
    /// Blinded or too dark.
    PoorContrast,
    /// The camera has moved.
    DetectionAutoSuspended,
}

impl Status {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::Ok,
        Self::SensorFailure,
        Self::InputDataIntegrity,
        Self::PoorContrast,
        Self::DetectionAutoSuspended,
    ];

    /// Its label in the standard, which is its name in messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ok => "oK",
            Self::SensorFailure => "sensorFailure",
            Self::InputDataIntegrity => "inputDataIntegrity",
            Self::PoorContrast => "poorContrast",
            Self::DetectionAutoSuspended => "detectionAutoSuspended",
        }
    }

    /// Its number in the standard.
    pub const fn number(self) -> u8 {
        match self {
            Self::Ok => 2,
            Self::SensorFailure => 10,
            Self::InputDataIntegrity => 11,
            Self::PoorContrast => 12,
            Self::DetectionAutoSuspended => 13,
        }
    }
}

#[cfg(all(test, feature = "json"))]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_in_messages() {
        for status in Status::ALL {
            let json = serde_json::to_string(&status).expect("a name");
            assert_eq!(json, format!("{:?}", status.name()));
        }
    }
}
