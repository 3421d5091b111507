//! The reference of the configuration: read out of the example, `boards/linux/verge.toml`.
//!
//! The example says of each key what it is, in a comment in front; keys with a `#` in front stand
//! at their defaults, but for those of [`NO_DEFAULT`]. Tests hold the example to the types.

use crate::daemon::config::example::{Key, keys};
use verge_desk::manual::{escaped, list};

/// Keys that the example shows by a value which is not their default.
#[cfg(test)]
pub(super) const NO_DEFAULT: [&str; 26] = [
    "site.id",
    "site.name",
    "site.road",
    "site.direction",
    "site.latitude",
    "site.longitude",
    "site.bearing",
    "site.lanes",
    "camera.user",
    "camera.password_file",
    "camera.ca_file",
    "camera.fingerprint",
    "model.score",
    "lane_table.audit",
    "traffic.section_m",
    "mqtt.tls",
    "mqtt.ca_file",
    "mqtt.certificate_file",
    "mqtt.key_file",
    "mqtt.root",
    "mqtt.client_id",
    "mqtt.user",
    "mqtt.password_file",
    "serial.device",
    "serial.window_s",
    "metrics.file",
];

/// verge.toml(5).
pub(super) fn roff() -> String {
    let (top, keys) = keys();
    let mut text = format!(
        ".TH verge.toml 5 \"\" \"\" verge\n.SH NAME\nverge.toml \\- configuration of verge run\n\
         .SH DESCRIPTION\n{}\n",
        escaped(&top)
    );
    for section in sections(&keys) {
        let title = if section.is_empty() { "KEYS".into() } else { format!("[{section}]") };
        let own = keys.iter().filter(|key| key.section == section);
        let entries: Vec<(String, &str)> = own
            .map(|key| {
                let mark = if key.off { "# " } else { "" };
                (format!("{mark}{} = {}", key.name, key.value), key.about.as_str())
            })
            .collect();
        let entries = entries.iter().map(|(key, about)| (key.as_str(), *about));
        text += &format!(".SH \"{title}\"\n{}", list(entries));
    }
    text += &format!(
        ".SH FILES\n{}.SH EXAMPLES\n{}.SH \"SEE ALSO\"\nverge\\-run(1), verge\\-check(1)\n",
        list([("/etc/verge/verge.toml", "The configuration of the service.")].into_iter()),
        list(
            [("verge check --config /etc/verge/verge.toml", "Say what is wrong with it.")]
                .into_iter()
        ),
    );
    text
}

fn sections<'a>(keys: &[Key<'a>]) -> Vec<&'a str> {
    let mut sections: Vec<&str> = keys.iter().map(|key| key.section).collect();
    sections.dedup();
    sections
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;
    use std::fmt::Write;

    /// The page of the handbook.
    fn markdown() -> String {
        let (top, keys) = keys();
        let mut text = format!("# verge.toml\n\n{top}\n\n");
        for section in sections(&keys) {
            let title = if section.is_empty() { "Above all sections" } else { section };
            let _ = writeln!(text, "## {title}\n");
            let _ = writeln!(
                text,
                "| key | default | in the example | what it is |\n|---|---|---|---|"
            );
            let mut before = "";
            for key in keys.iter().filter(|key| key.section == section) {
                let full = full_name(key);
                let value = format!("`{}`", key.value);
                let (default, shown) = match (key.off, NO_DEFAULT.contains(&full.as_str())) {
                    (true, false) => (value, String::new()),
                    _ => (String::new(), value),
                };
                let about = if key.about == before { "as above" } else { &key.about };
                before = &key.about;
                let about = linked(&about.replace('|', "\\|").replace('<', "\\<"));
                let _ = writeln!(text, "| `{full}` | {default} | {shown} | {about} |");
            }
            text.push('\n');
        }
        text
    }

    /// Pages of the handbook as links from `docs/reference`.
    fn linked(about: &str) -> String {
        let words = about.split(' ').map(|word| {
            let page = word.trim_matches(['(', ')', '.', ',', ':']);
            match page.strip_prefix("docs/") {
                Some(path) => word.replace(page, &format!("[{path}](../{path})")),
                None => word.to_owned(),
            }
        });
        words.collect::<Vec<_>>().join(" ")
    }

    fn full_name(key: &Key<'_>) -> String {
        let dot = if key.section.is_empty() { "" } else { "." };
        format!("{}{dot}{}", key.section, key.name)
    }

    /// The fields of the types: serde names them when it meets another.
    fn fields(section: &str) -> Vec<String> {
        let head = if section.is_empty() { String::new() } else { format!("[{section}]\n") };
        let text = format!("{head}no_such_key = 1\n");
        let error = toml::from_str::<crate::daemon::config::Config>(&text).expect_err("unknown");
        let error = error.to_string();
        let (_, expected) = error.split_once("expected ").expect("serde names the fields");
        expected.split('`').skip(1).step_by(2).map(ToOwned::to_owned).collect()
    }

    #[test]
    fn the_example_has_every_key_and_no_other() {
        let (_, keys) = keys();
        let shown: BTreeSet<String> = keys.iter().map(full_name).collect();
        // A string, or a table.
        let mut known = BTreeSet::from(["site".to_owned()]);
        for section in fields("") {
            let fields = fields(&section);
            if fields.contains(&section) || fields.is_empty() {
                known.insert(section);
            } else {
                known.extend(fields.iter().map(|field| format!("{section}.{field}")));
            }
        }
        assert_eq!(shown, known);
        assert!(NO_DEFAULT.iter().all(|key| shown.contains(*key)));
    }

    #[test]
    fn every_key_says_what_it_is() {
        for key in keys().1 {
            assert!(!key.about.is_empty(), "{}", full_name(&key));
        }
    }

    #[test]
    fn the_reference_is_that_of_the_example() {
        verge_desk::hold("verge.toml.md", &markdown());
    }
}
