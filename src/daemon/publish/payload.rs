//! The payloads of messages: the types of `verge_messages`, filled with the core's values.

pub use verge_messages::{
    Aim, AlarmMessage, Board, BoardFaults, Camera, Following, Frames, Health, Light, Messages,
    Pace, Presence, Schema, Stream, rounded,
};

use crate::density::SampleZoneStatus;
use crate::messages;
use crate::wire::DensityMessage;

/// The name of a status in messages: its label in NTCIP 1209.
pub fn status_name(status: SampleZoneStatus) -> &'static str {
    status.name()
}

/// One window of one site, in JSON. `done` stands in replayed windows alone: whether it is the
/// last of its length that was waiting.
pub fn density(message: &DensityMessage, done: Option<bool>) -> Vec<u8> {
    verge_messages::json(&messages::density(message, done))
}

/// The same from a site that says where it is.
pub fn density_at(message: &DensityMessage, done: Option<bool>, at: &Located) -> Vec<u8> {
    let Located { place, lanes } = at;
    verge_messages::json(&messages::density(message, done).at(place, lanes))
}

/// Position of a site, and names of its lanes.
#[derive(Clone, Debug, PartialEq)]
pub struct Located {
    /// Position.
    pub place: verge_messages::Place,
    /// Its lanes.
    pub lanes: Vec<verge_messages::LaneName>,
}
