//! A short name without allocation: of a site, a camera, a calibration, a model.
//!
//! Owns its longest length and where a longer one is cut. On the wire it is a plain string.

use super::MAX_NAME;
use core::fmt;
use core::ops::Deref;
use serde::{Deserialize, Serialize};

/// A name of at most [`MAX_NAME`] bytes of UTF-8.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Name(heapless::String<MAX_NAME>);

/// A text is longer than [`MAX_NAME`] bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NameTooLong;

impl Name {
    /// The empty name.
    pub const fn new() -> Self {
        Name(heapless::String::new())
    }

    /// The first [`MAX_NAME`] bytes of a text, cut at a character's end: a name is for people.
    pub fn truncated(text: &str) -> Self {
        let mut name = heapless::String::new();
        // Stops at the first character that does not fit.
        let _ = text.chars().try_for_each(|c| name.push(c));
        Name(name)
    }

    /// Its text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl TryFrom<&str> for Name {
    type Error = NameTooLong;

    fn try_from(text: &str) -> Result<Self, NameTooLong> {
        heapless::String::try_from(text).map(Name).map_err(|_| NameTooLong)
    }
}

impl Deref for Name {
    type Target = str;

    fn deref(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl fmt::Display for NameTooLong {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "is longer than {MAX_NAME} bytes")
    }
}

impl core::error::Error for NameTooLong {}
