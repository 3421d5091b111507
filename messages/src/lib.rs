//! All that leaves the box: topics, messages, statuses, alarms, and the formats of `convert`.
//!
//! Owns the JSON of every message, in both directions: the daemon writes by these types, the
//! centre and `verge convert` read by them and by one [check](Density::check). The schemas in
//! `docs/reference/schemas/` and `docs/reference/asyncapi.json` are generated from them, and a
//! test holds the files to them. Does not know where numbers come from: the core's types become
//! these in `src/messages.rs`. The compact form is the core's `wire`; read, it becomes these too.
//!
//! # Adding a field
//!
//! 1. Add it to its type with a doc comment, which becomes its description in the schema. An
//!    optional one is an `Option`, always written, `null` where it is not known, and has
//!    `#[cfg_attr(feature = "schema", schemars(extend("x-since" = "0.2")))]`: the schema then
//!    says that it is absent in messages of versions before that one, and readers get `None`.
//!    A number names its bounds: `schemars(range(min = 0, max = ..))`.
//! 2. Build: the compiler names `Lane::check` (each type takes itself apart there), where
//!    the same bounds are checked, and `src/messages.rs`, where the core's value comes in.
//! 3. `cargo run -p verge-messages --features schema --example documents` writes the schemas.
//!
//! A test finds a bound that is in the schema and not in the check, or the other way round.
//! A field that is added changes no version. One that goes, or means something else, is a new
//! [`SCHEMA`]. A place came with a version of its own, [`SCHEMA_WITH_PLACE`]: a message without one
//! has the bytes it always had.
//!
//! Without the feature `json` there is what the core says by these words, alarms and statuses,
//! and no std.
#![cfg_attr(not(feature = "json"), no_std)]

mod alarm;
#[cfg(feature = "json")]
mod alarm_message;
#[cfg(feature = "schema")]
pub mod asyncapi;
#[cfg(feature = "json")]
mod density;
#[cfg(feature = "formats")]
pub mod formats;
#[cfg(feature = "json")]
mod health;
#[cfg(feature = "json")]
pub mod objects;
#[cfg(feature = "json")]
mod place;
#[cfg(feature = "json")]
mod presence;
#[cfg(feature = "json")]
mod read;
#[cfg(feature = "json")]
mod schema;
mod status;
#[cfg(feature = "json")]
mod time;
#[cfg(feature = "json")]
mod topic;
#[cfg(feature = "json")]
mod traffic;
#[cfg(feature = "json")]
mod words;
#[cfg(feature = "json")]
mod wrong;

pub use alarm::Alarm;
pub use status::Status;
#[cfg(feature = "json")]
pub use {
    alarm_message::AlarmMessage,
    density::{
        ByClass, Calibration, Cells, Density, Direction, LONGEST_WINDOW_S, Lane, MOST_CELLS,
        MOST_LANES, Model, SHORTEST_WINDOW_S, rounded,
    },
    health::{
        Aim, Board, BoardFaults, Camera, Following, Frames, Health, Light, Messages, Pace, Stream,
    },
    place::{LONGEST_PLACE, LaneName, Place, check_lane},
    presence::Presence,
    read::{ReadError, read, read_alarm, read_health},
    schema::{SCHEMA, SCHEMA_WITH_PLACE, Schema, json},
    time::{Utc, rfc3339},
    topic::{Kind, Topic, window_name},
    traffic::{Passed, Traffic},
    wrong::Wrong,
};

/// Longest name of a site, calibration or model, bytes.
pub const LONGEST_NAME: usize = 48;
