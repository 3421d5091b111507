//! Keys that a file may not hold: which one was meant.
//!
//! Owns how near two names are, and the names that other programs use.

use crate::daemon::foreign::shown;

/// Names that other programs use for a key.
const OTHER_NAMES: [(&str, &str); 16] = [
    ("address", "source"),
    ("broker", "host"),
    ("cafile", "ca_file"),
    ("cert", "certificate_file"),
    ("id", "site"),
    ("key", "key_file"),
    ("name", "id"),
    ("name", "site"),
    ("password", "password_file"),
    ("path", "file"),
    ("server", "host"),
    ("topic", "root"),
    ("uri", "source"),
    ("url", "source"),
    ("username", "user"),
    ("weights", "file"),
];

/// Whether a name is a section's and nothing else: `site` may be a key as well.
pub(super) fn is_section(known: &[(&str, &str)], name: &str) -> bool {
    known.iter().any(|(section, _)| *section == name) && !known.contains(&("", name))
}

/// The keys that may stand where an unknown one does, and elsewhere.
pub(super) struct Keys<'k> {
    pub(super) section: String,
    pub(super) here: Vec<&'k str>,
    pub(super) known: &'k [(&'k str, &'k str)],
}

impl Keys<'_> {
    /// The remedy for `key`.
    pub(super) fn unknown(&self, key: &str) -> String {
        let lower = key.to_lowercase().replace('-', "_");
        let name = self.full(&shown(key));
        let meant = |near: &str| format!("{name} is not known: do you mean {}?", self.full(near));
        if let Some(near) = nearest(&lower, &self.here) {
            return meant(near);
        }
        if self.section == key {
            return format!("below [{key}] keys stand without \"{key}.\" in front");
        }
        if self.is_section(&lower) {
            return format!("{lower} is a section: [{lower}] on a line of its own, its keys below");
        }
        let elsewhere = self.known.iter().filter(|(_, known)| *known == lower);
        let elsewhere: Vec<_> = elsewhere
            .map(|(at, _)| match *at {
                "" => "above all sections".to_owned(),
                at => format!("below [{at}]"),
            })
            .collect();
        if !elsewhere.is_empty() {
            return format!("{name} is not known: {lower} stands {}", any_of(&elsewhere));
        }
        let other =
            OTHER_NAMES.iter().find(|(other, ours)| *other == lower && self.here.contains(ours));
        if let Some((_, ours)) = other {
            return meant(ours);
        }
        let all: Vec<_> = self.here.iter().map(|one| self.shown(one)).collect();
        match (self.section.as_str(), all.is_empty()) {
            (_, true) => format!("{name} is not known"),
            ("", _) => format!("{name} is not known: the file takes {}", all.join(", ")),
            (section, _) => format!("{name} is not known: [{section}] takes {}", all.join(", ")),
        }
    }

    fn is_section(&self, name: &str) -> bool {
        is_section(self.known, name)
    }

    /// A key as it is named to people.
    fn full(&self, key: &str) -> String {
        match self.section.as_str() {
            "" => self.shown(key),
            section => format!("{section}.{key}"),
        }
    }

    fn shown(&self, key: &str) -> String {
        let is_section = self.section.is_empty() && self.is_section(&key.to_lowercase());
        if is_section { format!("[{key}]") } else { key.to_owned() }
    }
}

/// The one that was meant, as far as its letters tell.
fn nearest<'k>(key: &str, known: &'k [&'k str]) -> Option<&'k &'k str> {
    let parts = |one: &&&str| key.len() > 2 && (one.starts_with(key) || key.starts_with(**one));
    let far = |one: &&str| strsim::damerau_levenshtein(key, one);
    let best = known.iter().min_by_key(|one| far(one))?;
    let close = far(best) <= (key.len() / 3).clamp(1, 3);
    if close { Some(best) } else { known.iter().find(parts) }
}

/// The names between backquotes.
pub(super) fn quoted(text: &str) -> Vec<&str> {
    text.split('`').skip(1).step_by(2).collect()
}

pub(super) fn any_of(all: &[String]) -> String {
    match all.split_last() {
        Some((last, [])) => last.clone(),
        Some((last, rest)) => format!("{} or {last}", rest.join(", ")),
        None => "another".into(),
    }
}
