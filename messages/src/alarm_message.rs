//! The message that raises or clears an alarm: `<root>/alarm/<name>`.

use crate::wrong::{name, time};
use crate::{Alarm, Schema, Utc, Wrong};
use serde::{Deserialize, Serialize};

/// Published on `<root>/alarm/<name>`, QoS 1, retained, when it is raised and when it is over.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(title = "verge alarm"))]
pub struct AlarmMessage {
    /// Version of the message.
    #[serde(default)]
    pub schema: Schema,
    /// The site.
    #[cfg_attr(feature = "schema", schemars(length(max = crate::LONGEST_NAME)))]
    pub site: String,
    /// Time of the change.
    pub time: Utc,
    /// The alarm.
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
