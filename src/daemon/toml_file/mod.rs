//! TOML that people write: read into a type, and what is wrong in it in their words.
//!
//! Owns the mapping from the parser's and serde's findings to line, key, what is right and what stands
//! there instead. Which file it is, its reader says. Never quotes a whole line: it may hold a password.

mod keys;
mod syntax;

use super::address::veiled;
use super::foreign::shown;
use keys::{Keys, any_of, is_section, quoted};
use serde::de::DeserializeOwned;
use std::fmt;
use std::ops::Range;
use syntax::syntax;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A fault in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// Its line, where one can be named.
    pub line: Option<usize>,
    /// Key, what is right, and what stands there.
    pub reason: String,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            Some(line) => write!(f, "line {line}: {}", self.reason),
            None => f.write_str(&self.reason),
        }
    }
}

/// Reads `text`. `known` are the sections (empty above all of them) and keys that such a file may
/// hold, for whoever put one into the wrong place; it may be empty.
///
/// # Errors
/// The first thing that is wrong.
pub fn parse<T: DeserializeOwned>(text: &str, known: &[(&str, &str)]) -> Result<T, Fault> {
    let error = match toml::from_str(text) {
        Ok(value) => return Ok(value),
        Err(error) => error,
    };
    Err(match DeTable::parse(text) {
        Err(error) => syntax(text, error.message(), error.span().unwrap_or_default()),
        Ok(table) => {
            let span = error.span().unwrap_or_default();
            let message = error.message().lines().next().unwrap_or_default();
            // What the whole file lacks has no line of its own.
            let lacks = message.starts_with("missing field") && span == table.span();
            let place =
                if lacks { Place::default() } else { Place::find(text, table.get_ref(), &span) };
            let reason = veiled(&place.reason(message, known));
            Fault { line: (!lacks).then(|| line(text, span.start)), reason }
        }
    })
}

/// The line on which a key such as `camera.interval_s` stands.
pub fn line_of(text: &str, key: &str) -> Option<usize> {
    let table = DeTable::parse(text).ok()?;
    let (mut table, mut start) = (table.get_ref(), None);
    for part in key.split('.') {
        let (name, value) = table.iter().find(|(name, _)| name.get_ref() == part)?;
        start = Some(name.span().start);
        match value.get_ref() {
            DeValue::Table(inner) => table = inner,
            _ => break,
        }
    }
    start.map(|start| line(text, start))
}

fn line(text: &str, at: usize) -> usize {
    1 + text.bytes().take(at).filter(|&byte| byte == b'\n').count()
}

/// The place of a fault in a file.
#[derive(Default)]
struct Place<'a> {
    /// The keys that lead there.
    keys: Vec<&'a str>,
    /// The value there; `None`: the file itself.
    value: Option<&'a DeValue<'a>>,
    /// Whether it is one of several sections of a name, in double brackets.
    is_repeated: bool,
}

impl<'a> Place<'a> {
    /// The innermost key or value around `span`.
    fn find(text: &str, table: &'a DeTable<'a>, span: &Range<usize>) -> Self {
        let mut place = Self::default();
        place.enter(table, span);
        place.is_repeated &= text[span.start..].starts_with("[[");
        place
    }

    fn enter(&mut self, table: &'a DeTable<'a>, span: &Range<usize>) {
        let holds = |range: Range<usize>| range.start <= span.start && span.end <= range.end;
        let inside = |value: &Spanned<DeValue<'_>>| {
            // A section's own span is its heading's: what stands below is outside of it.
            holds(value.span()) || nested(value.get_ref()).any(holds)
        };
        for (name, value) in table {
            if !holds(name.span()) && !inside(value) {
                continue;
            }
            self.keys.push(name.get_ref());
            self.value = Some(value.get_ref());
            match value.get_ref() {
                DeValue::Table(inner) => self.enter(inner, span),
                DeValue::Array(items) => {
                    let Some(item) = items.iter().find(|item| inside(item)) else { return };
                    self.value = Some(item.get_ref());
                    self.is_repeated = true;
                    if let DeValue::Table(inner) = item.get_ref() {
                        self.enter(inner, span);
                    }
                }
                _ => {}
            }
            return;
        }
    }

    fn name(&self) -> String {
        self.keys.join(".")
    }

    /// Serde's finding in other words.
    fn reason(&self, message: &str, known: &[(&str, &str)]) -> String {
        let name = self.name();
        let inner =
            |prefix| message.strip_prefix(prefix).and_then(|rest: &str| rest.split_once('`'));
        if let Some((key, expected)) = inner("unknown field `") {
            let keys = Keys { section: self.section(key), here: quoted(expected), known };
            return keys.unknown(key);
        }
        if let Some((key, _)) = inner("missing field `") {
            let is_section = is_section(known, key);
            return match (name.as_str(), is_section) {
                ("", true) => format!("the section [{key}] is missing"),
                ("", false) => format!("{key} is missing"),
                (section, _) if self.is_repeated => {
                    format!("{key} is missing in this [[{section}]]")
                }
                (section, _) => format!("{section}.{key} is missing: add it below [{section}]"),
            };
        }
        if let Some((_, expected)) = inner("unknown variant `") {
            let allowed: Vec<_> = quoted(expected).iter().map(|one| format!("\"{one}\"")).collect();
            return format!("{name} must be {}, not {}", any_of(&allowed), self.found());
        }
        let expected = match message.split_once(", expected ") {
            Some((found, expected)) if found.starts_with("invalid ") => Some(expected),
            // Of an enumeration.
            _ => message.strip_prefix("wanted "),
        };
        match expected {
            Some(_) if self.is_repeated => {
                format!("{name} is there once, in single brackets: [{name}]")
            }
            Some(expected) => format!(
                "{name} must be {}, not {}{}",
                self.right(expected),
                self.found(),
                self.hint(expected)
            ),
            None if message.ends_with("number overflowed") => {
                format!("{name}: the number is too large")
            }
            None if name.is_empty() => message.to_owned(),
            None => format!("{name}: {message}"),
        }
    }

    /// The keys around an unknown one.
    fn section(&self, key: &str) -> String {
        match self.keys.split_last() {
            Some((&last, around)) if last == key => around.join("."),
            _ => self.name(),
        }
    }

    /// The kind that serde expected.
    fn right(&self, expected: &str) -> String {
        let of = match self.keys.last() {
            Some(key) if key.ends_with("_s") => " of seconds",
            Some(key) if key.ends_with("_m") => " of metres",
            Some(key) if key.ends_with("_kmh") => " of km/h",
            Some(key) if key.ends_with("_px") => " of pixels",
            Some(&"days") => " of days",
            _ => "",
        };
        let up_to = |most: u64| format!("a whole number from 0 to {most}");
        match expected {
            "f32" | "f64" | "a number" => format!("a number{of}"),
            "u8" => up_to(u8::MAX.into()),
            "u16" => up_to(u16::MAX.into()),
            "u32" => up_to(u32::MAX.into()),
            "u64" | "usize" => format!("a whole number{of}, 0 or more"),
            "i8" | "i16" | "i32" | "i64" | "isize" => format!("a whole number{of}"),
            "a boolean" | "bool" => "true or false".into(),
            "a string" | "str" | "path string" | "a borrowed string" | "string or table" => {
                "text in quotes".into()
            }
            "a sequence" => format!("a list such as {}", self.list()),
            "a map" => format!("a section: [{}] on a line of its own, its keys below", self.name()),
            other if other.starts_with("struct ") => {
                format!("a section: [{}] on a line of its own, its keys below", self.name())
            }
            other if other.starts_with("an array of ") => {
                other.replace("an array of length ", "a list of ") + " values"
            }
            other => other.to_owned(),
        }
    }

    /// A list of what stands there alone.
    fn list(&self) -> String {
        match self.value {
            Some(DeValue::String(text)) => format!("[\"{}\"]", shown(text)),
            Some(DeValue::Integer(number)) => format!("[{number}]"),
            _ => "[60, 900]".into(),
        }
    }

    /// The value there, in words.
    fn found(&self) -> String {
        match self.value {
            Some(DeValue::String(text)) => format!("the text \"{}\"", shown(text)),
            Some(DeValue::Integer(number)) => number.to_string(),
            Some(DeValue::Float(number)) => number.to_string(),
            Some(DeValue::Boolean(value)) => value.to_string(),
            Some(DeValue::Datetime(_)) => "a date or a time".into(),
            Some(DeValue::Array(items)) => format!("a list of {}", items.len()),
            Some(DeValue::Table(_)) => "a section".into(),
            None => "what stands there".into(),
        }
    }

    /// The remedy for a value that is nearly right.
    fn hint(&self, expected: &str) -> &'static str {
        let Some(DeValue::String(text)) = self.value else { return "" };
        let is_number = text.trim().parse::<f64>().is_ok();
        let is_flag =
            matches!(&*text.to_lowercase(), "true" | "false" | "yes" | "no" | "on" | "off");
        match expected {
            "a boolean" | "bool" if is_flag => ": write true or false without quotes",
            "f32" | "f64" | "u8" | "u16" | "u32" | "u64" | "usize" if is_number => {
                ": leave the quotes away"
            }
            _ => "",
        }
    }
}

/// The spans of all that stands inside a value.
fn nested<'v>(value: &'v DeValue<'_>) -> Box<dyn Iterator<Item = Range<usize>> + 'v> {
    match value {
        DeValue::Table(table) => Box::new(table.iter().flat_map(|(name, value)| {
            [name.span(), value.span()].into_iter().chain(nested(value.get_ref()))
        })),
        DeValue::Array(items) => Box::new(
            items
                .iter()
                .flat_map(|item| std::iter::once(item.span()).chain(nested(item.get_ref()))),
        ),
        _ => Box::new(std::iter::empty()),
    }
}

#[cfg(test)]
mod tests;
