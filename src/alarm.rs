//! The alarms, as the contract names them.
//!
//! Owns which flaw of a picture is which alarm. Names, and the status that each alarm gives to
//! measurements, are `verge_messages`'; when they are raised is decided in [`crate::health`] and
//! [`crate::sensor`].

use crate::picture::Flaw;
pub use verge_messages::Alarm;

impl From<Flaw> for Alarm {
    fn from(flaw: Flaw) -> Self {
        match flaw {
            Flaw::Blank => Self::BlankPicture,
            Flaw::Blinded => Self::BlindedPicture,
            Flaw::Blurred => Self::BlurredPicture,
        }
    }
}
