//! Faults that make a message invalid.

/// A field with a value that cannot be.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {reason}")]
pub struct Wrong {
    /// Its path: `lanes[0].density_veh_km`.
    pub field: String,
    /// The fault, and what would be right.
    pub reason: String,
}

impl Wrong {
    /// Of a field, for a reason.
    pub fn new(field: impl Into<String>, reason: impl Into<String>) -> Self {
        Self { field: field.into(), reason: reason.into() }
    }

    /// The same, seen from the value that holds the one it was found in.
    #[must_use]
    pub(crate) fn inside(self, outer: &str) -> Self {
        Self { field: format!("{outer}.{}", self.field), ..self }
    }
}

/// A number that must lie in a range; one that is not finite lies in none.
pub(crate) fn number(field: &str, given: f32, least: f32, most: f32) -> Result<(), Wrong> {
    if (least..=most).contains(&given) {
        return Ok(());
    }
    Err(Wrong::new(field, format!("{given}: {least} to {most} is right")))
}

/// The same where something is known.
pub(crate) fn known(field: &str, given: Option<f32>, most: f32) -> Result<(), Wrong> {
    given.map_or(Ok(()), |given| number(field, given, 0.0, most))
}

/// Both ends of an interval, where it is known.
pub(crate) fn interval(field: &str, given: Option<[f32; 2]>, most: f32) -> Result<(), Wrong> {
    let Some([low, high]) = given else { return Ok(()) };
    number(&format!("{field}[0]"), low, 0.0, most)?;
    number(&format!("{field}[1]"), high, low, most)
}

/// A count that must lie in a range.
pub(crate) fn count(field: &str, given: u64, least: u64, most: u64) -> Result<(), Wrong> {
    if (least..=most).contains(&given) {
        return Ok(());
    }
    Err(Wrong::new(field, format!("{given}: {least} to {most} is right")))
}

/// A name, of at most [`crate::LONGEST_NAME`] bytes.
pub(crate) fn name(field: &str, given: &str) -> Result<(), Wrong> {
    if given.len() <= crate::LONGEST_NAME {
        return Ok(());
    }
    Err(Wrong::new(field, format!("longer than {} bytes", crate::LONGEST_NAME)))
}

/// A time of which the year has four digits, ms since 1970.
pub(crate) fn time(field: &str, given: crate::Utc) -> Result<(), Wrong> {
    if (0..crate::time::YEAR_10000_MS).contains(&given.0) {
        return Ok(());
    }
    Err(Wrong::new(field, format!("{given}: 1970 to 9999 is right")))
}

/// Words for people, of at most so many bytes.
pub(crate) fn words(field: &str, given: Option<&str>, most: usize) -> Result<(), Wrong> {
    if given.is_none_or(|given| given.len() <= most) {
        return Ok(());
    }
    Err(Wrong::new(field, format!("longer than {most} bytes")))
}

/// A SHA-256 in hexadecimal.
pub(crate) fn sha256(field: &str, given: &str) -> Result<(), Wrong> {
    let is_digit = |byte: u8| matches!(byte, b'0'..=b'9' | b'a'..=b'f');
    if given.len() == 64 && given.bytes().all(is_digit) {
        return Ok(());
    }
    let short: String = given.chars().take(70).collect();
    Err(Wrong::new(field, format!("{short:?}: 64 hexadecimal digits are right, in lower case")))
}
