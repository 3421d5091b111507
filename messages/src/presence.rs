//! Whether the box is there: `<root>/presence`, plain text.

use serde::{Deserialize, Serialize};

/// Published on `<root>/presence`, QoS 1, retained, as plain text without quotes: online after
/// each connection, shutdown before a wanted end, offline by the broker when the connection is
/// lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(title = "verge presence"))]
#[serde(rename_all = "lowercase")]
pub enum Presence {
    /// Connected.
    Online,
    /// About to end, on purpose.
    Shutdown,
    /// Gone without a goodbye: the last will.
    Offline,
}

impl Presence {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Online, Self::Shutdown, Self::Offline];

    /// The payload.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Online => "online",
            Self::Shutdown => "shutdown",
            Self::Offline => "offline",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_those_of_the_schema() {
        for presence in Presence::ALL {
            let json = serde_json::to_string(&presence).expect("a name");
            assert_eq!(json, format!("{:?}", presence.text()));
        }
    }
}
