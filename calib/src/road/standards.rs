//! Dashes and gaps as countries paint them: lengths that nobody has to measure.
//!
//! Owns the named choices (`data/road_marks.json`, each with its source) and their tolerance.
//! A wrong choice is a wrong scale: traffic and lane widths are the check. Does not own marks
//! as cues (see `fit`).

use crate::error::{Error, Result};
use serde::Deserialize;
use std::sync::LazyLock;

/// A broken line of a national standard.
#[derive(Clone, Debug, Deserialize)]
pub struct Standard {
    /// The name by which it is chosen.
    pub name: String,
    /// Which line of which road it is.
    pub what: String,
    /// Length of a dash, m.
    pub line_m: f64,
    /// Length of a gap, m.
    pub gap_m: f64,
    /// Standard deviation of what is painted, as a part of it.
    pub tolerance: f64,
    /// Where it is written.
    pub source: String,
}

#[derive(Deserialize)]
struct File {
    marks: Vec<Standard>,
}

static ALL: LazyLock<Vec<Standard>> = LazyLock::new(|| {
    let text = include_str!("../../data/road_marks.json");
    serde_json::from_str::<File>(text).expect("the shipped standards are readable").marks
});

/// All of them.
pub fn all() -> &'static [Standard] {
    &ALL
}

/// The standard of this name.
///
/// # Errors
/// Lists the names that are known.
pub fn find(name: &str) -> Result<&'static Standard> {
    all().iter().find(|s| s.name.eq_ignore_ascii_case(name.trim())).ok_or_else(|| {
        let known: Vec<&str> = all().iter().map(|s| s.name.as_str()).collect();
        Error::Marks(format!(
            "'{name}' is neither a length in metres nor a known standard; known are {}",
            known.join(", ")
        ))
    })
}

impl Standard {
    /// From the start of a dash to the start of the next, m.
    pub fn pitch_m(&self) -> f64 {
        self.line_m + self.gap_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_standard_is_named_once_and_has_a_source() {
        for (k, s) in all().iter().enumerate() {
            assert!(all()[..k].iter().all(|o| o.name != s.name), "{}", s.name);
            assert!(s.line_m > 0.0 && s.gap_m > 0.0 && !s.source.is_empty(), "{}", s.name);
            assert!((0.005..0.1).contains(&s.tolerance), "{}", s.name);
        }
        assert!((find("us-lane").unwrap().pitch_m() - 12.192).abs() < 1e-9);
        assert!(find("xx").unwrap_err().to_string().contains("us-lane"));
    }
}
