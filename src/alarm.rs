//! The alarms: what the sensor says of itself beyond numbers.
//!
//! Owns their names and the status that each gives to measurements. When they are raised is
//! decided in [`crate::health`] and [`crate::sensor`].

use crate::density::SampleZoneStatus;
use crate::picture::Flaw;

/// An alarm that is raised and cleared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
}

impl Alarm {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::NoPicture,
        Self::FrozenPicture,
        Self::BlankPicture,
        Self::BlindedPicture,
        Self::BlurredPicture,
        Self::CameraMoved,
        Self::Overheated,
        Self::BoardFault,
    ];

    /// The alarm's name in topics and messages.
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
        }
    }

    /// How far a measurement can be used while it lasts. One at half the pace, or on a board
    /// whose lamp fails, is as good as any.
    pub const fn status(self) -> SampleZoneStatus {
        match self {
            Self::NoPicture | Self::BlankPicture => SampleZoneStatus::SensorFailure,
            Self::FrozenPicture => SampleZoneStatus::InputDataIntegrity,
            Self::BlindedPicture | Self::BlurredPicture => SampleZoneStatus::PoorContrast,
            Self::CameraMoved => SampleZoneStatus::DetectionAutoSuspended,
            Self::Overheated | Self::BoardFault => SampleZoneStatus::Ok,
        }
    }

    /// Whether switching the camera off and on may help.
    pub const fn is_of_camera(self) -> bool {
        matches!(self, Self::NoPicture | Self::FrozenPicture | Self::BlankPicture)
    }
}

impl From<Flaw> for Alarm {
    fn from(flaw: Flaw) -> Self {
        match flaw {
            Flaw::Blank => Self::BlankPicture,
            Flaw::Blinded => Self::BlindedPicture,
            Flaw::Blurred => Self::BlurredPicture,
        }
    }
}
