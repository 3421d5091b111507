//! No document names a key, command, option, topic, alarm or metric that the code does not have.
//!
//! Names in the code are read from `docs/reference/`, whose pages are generated from it or checked
//! against it by tests of the crates.

use crate::pages::{Page, all, page, prose, spans};
use std::collections::{BTreeMap, BTreeSet};

/// The first code span of each row of a page's tables.
fn rows(text: &str) -> BTreeSet<String> {
    let rows = text.lines().filter_map(|line| line.strip_prefix("| `"));
    rows.filter_map(|row| Some(row.split_once('`')?.0.to_owned())).collect()
}

/// The parts of a page below its headings of the second level, by heading.
fn sections(text: &str) -> BTreeMap<&str, &str> {
    let parts = text.split("\n## ").skip(1);
    parts.filter_map(|part| part.split_once('\n')).collect()
}

/// Names that exist in the code.
struct Known {
    /// `camera.source` and all others.
    keys: BTreeSet<String>,
    /// `health.board.pace` and all others.
    fields: BTreeSet<String>,
    alarms: BTreeSet<String>,
    metrics: BTreeSet<String>,
    /// Options by command: `verge replay`.
    commands: BTreeMap<String, BTreeSet<String>>,
}

impl Known {
    fn read() -> Self {
        let reference = |name: &str| page(&format!("docs/reference/{name}.md"));
        let messages = reference("messages");
        let mut fields = BTreeSet::new();
        for (heading, section) in sections(&messages) {
            let Some(name) = heading.strip_prefix("The ") else { continue };
            let name = name.trim_end_matches(" message");
            fields.extend(rows(section).iter().map(|field| format!("{name}.{field}")));
        }
        let alarms = reference("alarms");
        let alarms =
            sections(&alarms).keys().map(|name| name.trim_matches('`').to_owned()).collect();
        let mut commands = BTreeMap::new();
        for program in ["verge", "mvcalib", "street", "verge-detector"] {
            let text = reference(program);
            for (heading, section) in sections(&text) {
                let options = section.match_indices("--").map(|(at, _)| option(&section[at..]));
                commands.insert(heading.to_owned(), options.collect());
            }
        }
        let known = Self {
            keys: rows(&reference("verge.toml")),
            fields,
            alarms,
            metrics: rows(&reference("metrics")),
            commands,
        };
        assert!(known.keys.len() > 40 && known.metrics.len() > 20, "the reference was not found");
        assert!(known.commands.len() > 15 && known.alarms.len() > 8 && known.fields.len() > 60);
        known
    }

    /// The fault of a code span, or of a line of a code block.
    fn fault(&self, code: &str) -> Option<String> {
        let code = code.trim().trim_start_matches("$ ");
        if let Some(fault) = code.split('|').find_map(|part| self.command_fault(part.trim())) {
            return Some(fault);
        }
        let word = code.split([' ', '{', '=']).next().unwrap_or_default();
        if let Some(name) = word.strip_prefix("alarm/") {
            let is_name = name.chars().all(|c| c.is_ascii_lowercase() || c == '_');
            if is_name && !name.is_empty() && !self.alarms.contains(name) {
                return Some("not an alarm".into());
            }
        }
        let is_metric =
            word.starts_with("verge_") && word.chars().all(|c| c.is_ascii_lowercase() || c == '_');
        // The model's files and a crate begin so too.
        let other = word.starts_with("verge_nanodet") || word == "verge_messages";
        if is_metric && !other && !self.metrics.contains(word) {
            return Some("not a metric".into());
        }
        self.key_fault(word)
    }

    /// A key of a section that the configuration or a message has.
    fn key_fault(&self, word: &str) -> Option<String> {
        let (section, _) = word.split_once('.')?;
        let is_key = word.chars().all(|c| c.is_ascii_lowercase() || c == '_' || c == '.');
        let is_file = [".toml", ".rs", ".md", ".json"].iter().any(|end| word.ends_with(end));
        if !is_key || is_file {
            return None;
        }
        let dotted = format!("{section}.");
        let of_configuration = self.keys.iter().any(|key| key.starts_with(&dotted));
        let of_message = self.fields.iter().any(|field| field.starts_with(&dotted));
        if !of_configuration && !of_message {
            return None;
        }
        let known = self.keys.contains(word) || self.fields.contains(word);
        (!known).then(|| "neither a key of verge.toml nor a field of a message".into())
    }

    /// A command and its options.
    fn command_fault(&self, line: &str) -> Option<String> {
        let line = line.split(" #").next().unwrap_or_default();
        let mut words = line.split_whitespace();
        let program = words.next()?;
        let prefix = format!("{program} ");
        if !self.commands.keys().any(|command| command.starts_with(&prefix)) {
            return None;
        }
        let command = words.next()?;
        if !command.starts_with(|c: char| c.is_ascii_lowercase()) || command.contains('.') {
            return None;
        }
        let Some(options) = self.commands.get(&format!("{program} {command}")) else {
            return Some(format!("{program} has no command {command}"));
        };
        let unknown = |word: &&str| {
            let word = word.trim_start_matches('[');
            word.starts_with("--") && !options.contains(&option(word))
        };
        words.find(unknown).map(|word| format!("{program} {command} has no option {word}"))
    }
}

/// An option's name without what follows it.
fn option(text: &str) -> String {
    text.chars().take_while(|&c| c == '-' || c.is_ascii_alphanumeric()).collect()
}

/// The code of a page: spans of its prose, and lines of its blocks.
fn code(page: &Page) -> Vec<(usize, String)> {
    let mut code: Vec<(usize, String)> = Vec::new();
    for (number, line) in prose(&page.text) {
        code.extend(spans(line).map(|span| (number, span.to_owned())));
    }
    let of_prose: BTreeSet<usize> = prose(&page.text).map(|(number, _)| number).collect();
    let mut joined = String::new();
    for (index, line) in page.text.lines().enumerate() {
        if of_prose.contains(&(index + 1)) {
            continue;
        }
        joined.push_str(line.trim_end_matches('\\').trim());
        if line.ends_with('\\') {
            joined.push(' ');
        } else {
            code.push((index + 1, std::mem::take(&mut joined)));
        }
    }
    code
}

#[test]
fn documents_name_what_there_is() {
    let known = Known::read();
    let mut faults = Vec::new();
    // The changelog has names of the past; fields are under their message in that page.
    let others = ["CHANGELOG.md", "docs/reference/messages.md"];
    for page in all().iter().filter(|page| !others.contains(&page.path.as_str())) {
        for (number, code) in code(page) {
            if let Some(fault) = known.fault(&code) {
                faults.push(format!("{}:{number}: `{code}`: {fault}", page.path));
            }
        }
    }
    assert!(faults.is_empty(), "{faults:#?}");
}

#[test]
fn versions_of_formats_are_those_of_the_sources() {
    let text = page("docs/reference/files.md");
    let rows: Vec<Vec<&str>> = text
        .lines()
        .filter(|line| line.starts_with('|') && line.contains(".rs`"))
        .map(|line| line.split('|').map(str::trim).collect())
        .collect();
    assert!(rows.len() > 7, "{rows:?}");
    for row in rows {
        let (version, source) = (row[2], page(row[3].trim_matches('`')));
        // The newest stands first, under one of these names, or as a byte behind a magic.
        let stated = source.lines().find_map(|line| {
            let line = line.trim_start_matches("pub ").trim_start_matches("const ");
            let value = line.split_once(" = ").map(|(_, value)| value.trim_end_matches(';'));
            let named = line.starts_with("VERSION:") || line.starts_with("SCHEMA:");
            let format = line.starts_with("FORMAT: u");
            let magic = line.contains("HEAD: [u8; 4]");
            let hex =
                value.and_then(|value| Some(value.rsplit_once("\\x0")?.1.trim_end_matches('"')));
            if magic { hex } else { value.filter(|_| named || format) }
        });
        assert_eq!(stated, Some(version), "{}", row[1]);
    }
}

#[test]
fn what_is_not_there_is_found() {
    let known = Known::read();
    for wrong in [
        "camera.sauce",
        "health.no_such_field",
        "alarm/no_pictures",
        "verge_no_such_metric{lane=\"1\"}",
        "verge measure --config FILE",
        "verge run --configuration FILE",
        "cat x | verge convert --into fiware",
        "mvcalib table --lane FILE",
    ] {
        assert!(known.fault(wrong).is_some(), "{wrong}");
    }
    for right in [
        "camera.source",
        "health.board.last_fault",
        "alarm/no_picture",
        "alarm/<name>",
        "verge_uptime_seconds",
        "verge run --config FILE",
        "mosquitto_sub -t x | verge convert --to fiware",
        "street record --set light.daylight=night",
    ] {
        assert_eq!(known.fault(right), None, "{right}");
    }
}
