//! A configuration that people have changed by hand, with what was changed at the desk since.
//!
//! Owns which of the desk's keys are whose. Keys that the desk does not write, comments and order stay
//! as they are. Does not own what the desk writes (see `save`).

use toml_edit::{DocumentMut, Item, Table, Value};

/// A key in its section; the site's name stands in front of all sections.
type Key = [&'static str; 2];

const SITE: Key = ["", "site"];
/// The desk's keys: where one was changed at the desk it is set, else it stays as it is found.
const KEYS: [Key; 5] = [
    SITE,
    ["camera", "source"],
    ["camera", "interval_s"],
    ["lane_table", "file"],
    ["windows", "lengths_s"],
];
/// Keys that follow from what is saved beside the configuration: the table's camera, the model that
/// counted.
const SET: [Key; 2] = [["camera", "id"], ["model", "file"]];
/// The audit holds for its lane table alone; only the desk's own is taken out.
const AUDIT: Key = ["lane_table", "audit"];
const OWN_AUDIT: &str = "\"audit.toml\"";

/// `found` with what the desk would write `now`, where that is another than it wrote `before`.
///
/// # Errors
/// Why `found` cannot be read.
pub fn merged(found: &str, before: &str, now: &str) -> Result<String, String> {
    let read = |text: &str| text.parse::<DocumentMut>();
    let mut document = read(found).map_err(|error| {
        let at = error.span().map_or(0, |span| span.start);
        let line = 1 + found.bytes().take(at).filter(|byte| *byte == b'\n').count();
        format!("line {line}: {}", error.message().lines().next().unwrap_or_default())
    })?;
    let before = read(before).unwrap_or_default();
    let now = read(now).map_err(|error| error.to_string())?;
    for key in KEYS {
        let (is, was) = (text_of(&now, key), text_of(&before, key));
        if is != was && is != text_of(&document, key) {
            set(&mut document, key, value(&now, key));
        }
    }
    for key in SET {
        let is = text_of(&now, key);
        if is.is_some() && is != text_of(&document, key) {
            set(&mut document, key, value(&now, key));
        }
    }
    match (text_of(&now, AUDIT), text_of(&document, AUDIT)) {
        (Some(is), found) if found.as_ref() != Some(&is) => {
            set(&mut document, AUDIT, value(&now, AUDIT));
        }
        (None, Some(found)) if found == OWN_AUDIT => set(&mut document, AUDIT, None),
        _ => {}
    }
    Ok(document.to_string())
}

/// Where a key stands: a site may be a section of its own, whose `id` is its name.
fn place(document: &DocumentMut, key: Key) -> Key {
    let is_section = document.get(SITE[1]).is_some_and(Item::is_table_like);
    if key == SITE && is_section { ["site", "id"] } else { key }
}

fn value(document: &DocumentMut, key: Key) -> Option<&Value> {
    let [section, name] = place(document, key);
    let item = match section {
        "" => document.get(name)?,
        _ => document.get(section)?.get(name)?,
    };
    item.as_value()
}

/// A value as it stands there, without what is around it.
fn text_of(document: &DocumentMut, key: Key) -> Option<String> {
    let mut value = value(document, key)?.clone();
    value.decor_mut().clear();
    Some(value.to_string())
}

/// Sets a value, in the place of the one before, or takes it out.
fn set(document: &mut DocumentMut, key: Key, to: Option<&Value>) {
    let around = value(document, key).map(|value| value.decor().clone());
    let [section, name] = place(document, key);
    let table = match section {
        "" => document.as_table_mut(),
        _ => {
            let section = document.entry(section).or_insert_with(|| Item::Table(Table::new()));
            let Some(table) = section.as_table_mut() else {
                // An inline table, which has no room for comments.
                if let (Some(table), Some(to)) = (section.as_inline_table_mut(), to) {
                    table.insert(name, to.clone().decorated(" ", ""));
                }
                return;
            };
            table
        }
    };
    let Some(to) = to else {
        table.remove(name);
        return;
    };
    let mut to = to.clone();
    *to.decor_mut() = around.unwrap_or_else(|| {
        let mut plain = Value::from(true);
        plain.decor_mut().set_prefix(" ");
        plain.decor().clone()
    });
    match table.get_mut(name) {
        // Its comments in front are the key's.
        Some(item) => *item = Item::Value(to),
        None => _ = table.insert(name, Item::Value(to)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEFORE: &str = "# Made.\nsite = \"a\"\n\n[camera]\nid = \"c\"\n# The folder.\n\
        source = \"/frames\"\ninterval_s = 4.0\n\n[lane_table]\nfile = \"lanes.lut\"\n\n\
        [windows]\nlengths_s = [60, 900]\n";

    #[test]
    fn what_nobody_changed_at_the_desk_stays() {
        let hand = BEFORE.replace("/frames\"", "rtsp://cam/s\" # the box\nuser = \"u\"");
        assert_eq!(merged(&hand, BEFORE, BEFORE).as_deref(), Ok(hand.as_str()));
        let now = BEFORE.replace("/frames", "http://cam/").replace("4.0", "5.0");
        let expected = hand.replace("rtsp://cam/s", "http://cam/").replace("4.0", "5.0");
        assert_eq!(merged(&hand, BEFORE, &now), Ok(expected));
    }

    #[test]
    fn keys_and_sections_come_and_go_and_a_site_may_be_a_section() {
        let hand = BEFORE
            .replace("site = \"a\"\n", "")
            .replace("[camera]", "[site]\nid = \"a\"\n[camera]");
        let now = BEFORE.replace("\"a\"", "\"b\"") + "\n[model]\nfile = \"m.toml\"\n";
        let now = now.replace("lut\"\n", "lut\"\naudit = \"audit.toml\"\n");
        let text = merged(&hand, BEFORE, &now).expect("TOML");
        for line in
            ["[site]\nid = \"b\"", "lut\"\naudit = \"audit.toml\"\n", "[model]\nfile = \"m.toml\""]
        {
            assert!(text.contains(line), "{text}");
        }
        assert_eq!(text.matches("site").count(), 1, "{text}");
        let without = merged(&text, &now, &BEFORE.replace("\"a\"", "\"b\"")).expect("TOML");
        assert!(!without.contains("audit") && without.contains("m.toml"), "{without}");
        let others = BEFORE.replace("lut\"\n", "lut\"\naudit = \"mine.toml\"\n");
        assert_eq!(merged(&others, BEFORE, BEFORE), Ok(others));
        let inline = "site = \"a\"\ncamera = { id = \"x\", source = \"s\" }\n";
        let text = merged(inline, BEFORE, BEFORE).expect("TOML");
        assert!(text.contains("camera = { id = \"c\", source = \"s\" }"), "{text}");
    }

    #[test]
    fn what_is_no_toml_is_named_with_its_line() {
        let why = merged("site = \"a\"\n[camera\n", BEFORE, BEFORE).unwrap_err();
        assert!(why.starts_with("line 2: "), "{why}");
    }
}
