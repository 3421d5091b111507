//! The example, `boards/linux/verge.toml`, taken apart: its sections, its keys, and what it says of
//! each.
//!
//! Owns how the example is read. The manual is made of it, and errors name its keys.

const EXAMPLE: &str = include_str!("../../../boards/linux/verge.toml");

/// A key of the example.
#[derive(Debug, PartialEq, Eq)]
pub(in crate::daemon) struct Key<'a> {
    /// Empty for keys above all sections.
    pub(in crate::daemon) section: &'a str,
    pub(in crate::daemon) name: &'a str,
    pub(in crate::daemon) value: &'a str,
    /// Whether it has a `#` in front.
    pub(in crate::daemon) off: bool,
    /// The comment before it; keys that follow one another share it.
    pub(in crate::daemon) about: String,
}

/// The keys in their order, and what the example says at its top.
pub(in crate::daemon) fn keys() -> (String, Vec<Key<'static>>) {
    let (mut section, mut about, mut top) = ("", String::new(), None);
    let (mut keys, mut fresh) = (Vec::new(), true);
    for line in EXAMPLE.lines() {
        if let Some(name) = table(line) {
            section = name;
        } else if let Some((name, value, off)) = key(line) {
            keys.push(Key { section, name, value, off, about: about.clone() });
            fresh = true;
        } else if let Some(text) = line.strip_prefix('#') {
            if std::mem::take(&mut fresh) {
                about.clear();
            }
            about.push_str(text);
        } else {
            // The first blank line ends the text on the whole section.
            top.get_or_insert_with(|| about.trim().to_owned());
            about.clear();
            fresh = false;
        }
    }
    for key in &mut keys {
        key.about = key.about.trim().to_owned();
    }
    (top.unwrap_or_default(), keys)
}

/// Section and name of every key.
pub(in crate::daemon) fn names() -> Vec<(&'static str, &'static str)> {
    keys().1.iter().map(|key| (key.section, key.name)).collect()
}

/// The section that a line begins, in a comment too.
fn table(line: &str) -> Option<&str> {
    let line = line.strip_prefix('#').unwrap_or(line).trim_start();
    line.strip_prefix('[')?.strip_suffix(']')
}

/// Name, value and whether it is switched off. Comments have a blank behind their `#`, but for
/// keys that a comment shows further in.
fn key(line: &str) -> Option<(&str, &str, bool)> {
    let rest = line.strip_prefix('#');
    let off = rest.is_some();
    let rest = rest.unwrap_or(line);
    let shown = rest.strip_prefix("     ").unwrap_or(rest);
    let (name, value) = shown.split_once(" = ")?;
    let is_name = name.chars().all(|c| c.is_ascii_lowercase() || c == '_' || c.is_ascii_digit());
    (is_name && !name.is_empty()).then_some((name, value, off))
}
