//! The alarms: what the sensor says of itself beyond numbers.
//!
//! Owns their names and the status that each gives to measurements, for the core as for messages.
//! When they are raised is decided in `verge::health` and `verge::sensor`; the one of certificates
//! by the daemon.

use crate::Status;
use serde::{Deserialize, Serialize};

/// A fault of the box or of its pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(inline))]
#[serde(rename_all = "snake_case")]
pub enum Alarm {
    /// No picture for longer than the limit.
    NoPicture,
    /// The same picture for longer than the limit.
    FrozenPicture,
    /// Black pictures, or of one colour, for longer than the limit.
    BlankPicture,
    /// Sun, headlights or fog for longer than the limit.
    BlindedPicture,
    /// Nothing sharp in the pictures for longer than the limit.
    BlurredPicture,
    /// The camera looks at none of its presets.
    CameraMoved,
    /// Heat in the enclosure slows the line or stops it.
    Overheated,
    /// A part of the board fails: lamp, relay, watchdog or thermometer.
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

    /// How far a measurement can be used while it lasts. One at half the pace, or on a board
    /// whose lamp fails, is as good as any.
    pub const fn status(self) -> Status {
        match self {
            Self::NoPicture | Self::BlankPicture => Status::SensorFailure,
            Self::FrozenPicture => Status::InputDataIntegrity,
            Self::BlindedPicture | Self::BlurredPicture => Status::PoorContrast,
            Self::CameraMoved => Status::DetectionAutoSuspended,
            Self::Overheated | Self::BoardFault | Self::CertificateExpires => Status::Ok,
        }
    }

    /// Whether switching the camera off and on may help.
    pub const fn is_of_camera(self) -> bool {
        matches!(self, Self::NoPicture | Self::FrozenPicture | Self::BlankPicture)
    }
}

#[cfg(all(test, feature = "json"))]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_in_messages() {
        for alarm in Alarm::ALL {
            let json = serde_json::to_string(&alarm).expect("a name");
            assert_eq!(json, format!("{:?}", alarm.name()));
        }
    }
}
