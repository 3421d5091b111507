//! The version of messages, and their JSON.

use serde::{Deserialize, Serialize};

/// Version of a JSON message without a place; a reader refuses a version that it does not know.
pub const SCHEMA: u32 = 1;
/// Version of a density message that says where its site is.
pub const SCHEMA_WITH_PLACE: u32 = 2;

/// The version that a message is written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Schema(pub(crate) u32);

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
