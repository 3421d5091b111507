//! What leaves the box: topics, messages, statuses and alarms, and the formats of `convert`.
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
//! A test finds a bound that stands in the schema and not in the check, or the other way round.
//! A field that is added changes no version. One that goes, or means something else, is a new
//! [`SCHEMA`]. A place came with a version of its own, [`SCHEMA_WITH_PLACE`]: a message without one
//! has the bytes it always had.

mod alarm;
#[cfg(feature = "schema")]
pub mod asyncapi;
mod density;
#[cfg(feature = "formats")]
pub mod formats;
mod health;
pub mod objects;
mod place;
mod presence;
mod read;
mod status;
mod time;
mod topic;
mod traffic;
mod wrong;

pub use alarm::{Alarm, AlarmMessage};
pub use density::{
    ByClass, Calibration, Cells, Density, Direction, LONGEST_WINDOW_S, Lane, MOST_CELLS,
    MOST_LANES, Model, SHORTEST_WINDOW_S, rounded,
};
pub use health::{
    Aim, Board, BoardFaults, Camera, Following, Frames, Health, Light, Messages, Pace, Stream,
};
pub use place::{LONGEST_PLACE, LaneName, Place, check_lane};
pub use presence::Presence;
pub use read::{ReadError, read, read_alarm, read_health};
pub use status::Status;
pub use time::{Utc, rfc3339};
pub use topic::{Kind, Topic, window_name};
pub use traffic::{Passed, Traffic};
pub use wrong::Wrong;

use serde::{Deserialize, Serialize};

/// Version of a JSON message without a place; a reader refuses a version that it does not know.
pub const SCHEMA: u32 = 1;
/// Version of a density message that says where its site is.
pub const SCHEMA_WITH_PLACE: u32 = 2;
/// Longest name of a site, calibration or model, bytes.
pub const LONGEST_NAME: usize = 48;

/// The version that a message is written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Schema(u32);

impl Default for Schema {
    fn default() -> Self {
        Self(SCHEMA)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Schema {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Schema".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({ "const": SCHEMA })
    }
}

impl Schema {
    /// Of a density message that says where its site is.
    pub(crate) const WITH_PLACE: Self = Self(SCHEMA_WITH_PLACE);

    /// Whether this program reads it.
    pub(crate) const fn is_known(self) -> bool {
        matches!(self.0, SCHEMA | SCHEMA_WITH_PLACE)
    }
}

/// A message in JSON.
pub fn json(message: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec(message).expect("these types have string keys and no failing parts")
}
