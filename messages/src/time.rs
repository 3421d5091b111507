//! Times in messages: RFC 3339 in UTC with milliseconds.

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// The first instant of the year 10,000, ms since 1970: dates have four digits.
pub(crate) const YEAR_10000_MS: i64 = 253_402_300_800_000;

/// An instant, in milliseconds of UTC since 1970-01-01 (negative before).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Utc(pub i64);

impl std::fmt::Display for Utc {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&rfc3339(self.0))
    }
}

impl Serialize for Utc {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&rfc3339(self.0))
    }
}

/// Any offset is read; what is written is UTC.
impl<'de> Deserialize<'de> for Utc {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        let time: jiff::Timestamp = text.parse().map_err(|_| {
            let short: String = text.chars().take(40).collect();
            D::Error::custom(format!("{short:?} is not a time in RFC 3339"))
        })?;
        Ok(Self(time.as_millisecond()))
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Utc {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "time".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({
            "description": "UTC",
            "type": "string",
            "pattern": r"^\d{4}-\d{2}-\d{2}T\d{2}:\d{2}:\d{2}\.\d{3}Z$",
        })
    }
}

/// RFC 3339 in UTC with milliseconds, of milliseconds since 1970.
pub fn rfc3339(ms: i64) -> String {
    match jiff::Timestamp::from_millisecond(ms) {
        Ok(timestamp) => format!("{timestamp:.3}"),
        Err(_) => format!("{ms} ms since 1970"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_written_in_utc_and_read_with_any_offset() {
        assert_eq!(rfc3339(1_767_600_000_250), "2026-01-05T08:00:00.250Z");
        assert_eq!(rfc3339(0), "1970-01-01T00:00:00.000Z");
        let read = |text: &str| serde_json::from_str::<Utc>(text);
        assert_eq!(read("\"2026-01-05T16:00:00.25+08:00\"").unwrap(), Utc(1_767_600_000_250));
        let error = read("\"08:00\"").unwrap_err().to_string();
        assert!(error.contains("\"08:00\" is not a time in RFC 3339"), "{error}");
    }
}
