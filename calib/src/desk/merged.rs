//! A configuration that people have changed by hand, with what was changed at the desk since.
//!
//! Owns which of the desk's keys are whose. Keys that the desk does not write, comments and order stay
//! as they are. Does not own what the desk writes (see `save`).

use toml_edit::{DocumentMut, Item, Table, Value};

/// A key in its section; the site's name stands in front of all sections.
type Key = [&'static str; 2];

const SITE: Key = ["", "site"];
const SOURCE: Key = ["camera", "source"];
const INTERVAL: Key = ["camera", "interval_s"];
const WINDOWS: Key = ["windows", "lengths_s"];
const TABLE: Key = ["lane_table", "file"];
/// The desk's keys: where one was changed at the desk it is set, else it stays as it is found.
const KEYS: [Key; 5] = [SITE, SOURCE, INTERVAL, TABLE, WINDOWS];
/// Those of them that no configuration goes without.
const NEEDED: [Key; 3] = [SITE, SOURCE, TABLE];
/// The table's camera, which is saved beside the configuration.
const CAMERA: Key = ["camera", "id"];
/// The model that counted.
const MODEL: Key = ["model", "file"];
/// The audit holds for its lane table alone; only the desk's own is taken out.
const AUDIT: Key = ["lane_table", "audit"];

/// The desk's lane table.
pub const LANES: &str = "lanes.lut";
/// The desk's audit of it.
pub const AUDITED: &str = "audit.toml";
/// What the desk writes above a source that is the folder of its pictures.
pub const FOLDER: &str = "# The folder of pictures at the desk. On the box: the camera's address.";

/// `found` with what the desk would write `now`, where that is another than it wrote `before`. Where
/// nobody knows what it wrote, what is found stays; and so does what a person changed where the desk has
/// another value from the pictures alone. Whether the interval is one of these is asked for.
///
/// # Errors
/// Why `found` cannot be read.
pub fn merged(
    found: &str,
    before: Option<&str>,
    now: &str,
    is_interval_typed: bool,
) -> Result<String, String> {
    let mut document = read(found)?;
    // One without a site is not the desk's.
    let before = before.and_then(|text| read(text).ok()).filter(|d| value(d, SITE).is_some());
    let (with_folder, now) = (now.contains(FOLDER), read(now)?);
    let mut changed = Vec::new();
    for key in KEYS {
        let (is, found) = (text_of(&now, key), text_of(&document, key));
        let is_missing = found.is_none() && NEEDED.contains(&key);
        let is_typed = match key {
            SOURCE => !with_folder,
            INTERVAL => is_interval_typed,
            _ => key != WINDOWS,
        };
        let is_changed = before.as_ref().is_some_and(|before| {
            let was = text_of(before, key);
            was != is && (is_typed || was == found)
        });
        if (is_missing || is_changed) && is != found {
            changed.push((key, value(&now, key)));
        }
    }
    let follows = [Some(CAMERA), before.is_some().then_some(MODEL)];
    for key in follows.into_iter().flatten() {
        let is = text_of(&now, key);
        if is.is_some() && is != text_of(&document, key) {
            changed.push((key, value(&now, key)));
        }
    }
    let own = lane_table(&document, AUDIT).map(is_audit);
    match (value(&now, AUDIT), own) {
        (Some(audit), None | Some(false)) => changed.push((AUDIT, Some(audit))),
        (None, Some(true)) => changed.push((AUDIT, None)),
        _ => {}
    }
    if changed.is_empty() {
        return Ok(found.to_owned());
    }
    for (key, to) in changed {
        set(&mut document, key, to);
        if key == SOURCE && !with_folder {
            without_folder(&mut document);
        }
    }
    Ok(written(&document, found))
}

/// A configuration with the desk's audit in it.
///
/// # Errors
/// Why it cannot be read, or that it names another lane table than the desk's.
pub fn with_audit(config: &str) -> Result<String, String> {
    let mut document = read(config)?;
    if let Some(other) = other_table(&document) {
        return Err(format!("it names the lane table {other}, and the audit is one of {LANES}"));
    }
    if lane_table(&document, AUDIT).is_some_and(is_audit) {
        return Ok(config.to_owned());
    }
    set(&mut document, AUDIT, Some(&Value::from(AUDITED)));
    Ok(written(&document, config))
}

/// Whether a configuration names an audit, and whether that is the desk's of the desk's lane table.
pub fn audits(config: &str) -> (bool, bool) {
    let Ok(document) = read(config) else { return (false, false) };
    let audit = lane_table(&document, AUDIT);
    (audit.is_some(), audit.is_some_and(is_audit) && other_table(&document).is_none())
}

/// The lane table that a configuration names, where it is not the desk's.
pub fn names_other_table(config: &str) -> Option<String> {
    other_table(&read(config).ok()?).map(str::to_owned)
}

fn other_table(document: &DocumentMut) -> Option<&str> {
    lane_table(document, TABLE).filter(|file| !is_file(file, LANES))
}

fn lane_table(document: &DocumentMut, key: Key) -> Option<&str> {
    value(document, key)?.as_str()
}

fn is_audit(file: &str) -> bool {
    is_file(file, AUDITED)
}

/// Whether this is the file of that name beside the configuration.
fn is_file(file: &str, name: &str) -> bool {
    file.trim_start_matches("./") == name
}

fn read(text: &str) -> Result<DocumentMut, String> {
    text.parse::<DocumentMut>().map_err(|error| {
        let at = error.span().map_or(0, |span| span.start);
        let line = 1 + text.bytes().take(at).filter(|byte| *byte == b'\n').count();
        format!("line {line}: {}", error.message().lines().next().unwrap_or_default())
    })
}

/// The document with the ends of lines that it was found with.
fn written(document: &DocumentMut, found: &str) -> String {
    let text = document.to_string();
    if found.contains("\r\n") { text.replace("\r\n", "\n").replace('\n', "\r\n") } else { text }
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

/// A value without what is around it and how it is quoted.
fn text_of(document: &DocumentMut, key: Key) -> Option<String> {
    let mut value = value(document, key)?.clone();
    if let Some(text) = value.as_str() {
        return Some(format!("{text:?}"));
    }
    value.decor_mut().clear();
    Some(value.to_string())
}

/// Sets a value, in the place of the one before, or takes it out.
fn set(document: &mut DocumentMut, key: Key, to: Option<&Value>) {
    let around = value(document, key).map(|value| value.decor().clone());
    let [section, name] = place(document, key);
    let root = document.as_table_mut();
    let item = match section {
        "" => None,
        _ => Some(root.entry(section).or_insert_with(|| Item::Table(Table::new()))),
    };
    let table = match item {
        None => root,
        Some(item) if item.is_inline_table() => {
            let Some(table) = item.as_inline_table_mut() else { return };
            match to {
                Some(to) => _ = table.insert(name, to.clone().decorated(" ", "")),
                None => _ = table.remove(name),
            }
            return;
        }
        Some(item) => {
            let Some(table) = item.as_table_mut() else { return };
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

/// Takes [`FOLDER`] out, which is true of a folder alone.
fn without_folder(document: &mut DocumentMut) {
    let [section, name] = SOURCE;
    let camera = document.get_mut(section).and_then(Item::as_table_mut);
    let Some(mut key) = camera.and_then(|camera| camera.key_mut(name)) else { return };
    let decor = key.leaf_decor_mut();
    let above = decor.prefix().and_then(|above| above.as_str()).unwrap_or_default();
    let rest: String = above.split_inclusive('\n').filter(|line| line.trim() != FOLDER).collect();
    decor.set_prefix(rest);
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
        assert_eq!(merged(&hand, Some(BEFORE), BEFORE, false).as_deref(), Ok(hand.as_str()));
        let now = BEFORE.replace("/frames", "http://cam/").replace("4.0", "5.0");
        let expected = hand.replace("rtsp://cam/s", "http://cam/").replace("4.0", "5.0");
        assert_eq!(merged(&hand, Some(BEFORE), &now, true), Ok(expected));
        // From the pictures alone nothing of a person's is changed.
        let folder = |path: &str| BEFORE.replace("# The folder.", FOLDER).replace("/frames", path);
        let (before, now) = (folder("/a"), folder("/b").replace("4.0", "60.0"));
        let now = now.replace("[60, 900]", "[900]");
        assert_eq!(merged(&before, Some(&before), &now, false).as_ref(), Ok(&now));
        let hand = hand.replace("4.0", "2.0").replace("[60, 900]", "[300]");
        assert_eq!(merged(&hand, Some(&before), &now, false), Ok(hand.clone()));
        assert_eq!(merged(&hand, None, &now, true), Ok(hand));
    }

    #[test]
    fn keys_and_sections_come_and_go_and_a_site_may_be_a_section() {
        let hand = BEFORE
            .replace("site = \"a\"\n", "")
            .replace("[camera]", "[site]\nid = \"a\"\n[camera]");
        let now = BEFORE.replace("\"a\"", "\"b\"") + "\n[model]\nfile = \"m.toml\"\n";
        let now = now.replace("lut\"\n", "lut\"\naudit = \"audit.toml\"\n");
        let text = merged(&hand, Some(BEFORE), &now, true).expect("TOML");
        for line in
            ["[site]\nid = \"b\"", "lut\"\naudit = \"audit.toml\"\n", "[model]\nfile = \"m.toml\""]
        {
            assert!(text.contains(line), "{text}");
        }
        assert_eq!(text.matches("site").count(), 1, "{text}");
        let without =
            merged(&text, Some(&now), &BEFORE.replace("\"a\"", "\"b\""), false).expect("TOML");
        assert!(!without.contains("audit") && without.contains("m.toml"), "{without}");
        let others = BEFORE.replace("lut\"\n", "lut\"\naudit = \"mine.toml\"\n");
        assert_eq!(merged(&others, Some(BEFORE), BEFORE, false), Ok(others));
        let inline = "site = \"a\"\ncamera = { id = \"x\", source = \"s\" }\n";
        let text = merged(inline, Some(BEFORE), BEFORE, false).expect("TOML");
        assert!(text.contains("camera = { id = \"c\", source = \"s\" }"), "{text}");
    }

    #[test]
    fn what_is_no_toml_is_named_with_its_line() {
        let why = merged("site = \"a\"\n[camera\n", Some(BEFORE), BEFORE, false).unwrap_err();
        assert!(why.starts_with("line 2: "), "{why}");
    }

    #[test]
    fn the_audit_is_named_once_beside_the_desk_s_table() {
        let named = |text: &str| with_audit(text).expect("it can be named");
        let once = named("[lane_table]\nfile = \"lanes.lut\"\n\n[windows]\n");
        let expected = "[lane_table]\nfile = \"lanes.lut\"\naudit = \"audit.toml\"\n\n[windows]\n";
        assert_eq!(once, expected);
        assert_eq!(named(&once), once);
        for (text, of_desk) in [
            ("[lane_table]\r\nfile = \"lanes.lut\"\r\n# audit = \"audit.toml\"\r\n", true),
            ("[lane_table]\nfile='lanes.lut'\naudit = \"mine.toml\" # by hand\n", true),
            ("lane_table = { file = \"./lanes.lut\" }\n", true),
            ("lane_table.file = \"lanes.lut\"", true),
        ] {
            let now = named(text);
            assert_eq!(audits(&now), (true, of_desk), "{now}");
            assert_eq!(now.matches("\r\n").count() > 0, text.contains('\r'), "{now:?}");
        }
        assert!(with_audit("[lane_table]\nfile = \"old.lut\"\n").unwrap_err().contains("old.lut"));
        assert!(with_audit("[lane_table\n").unwrap_err().starts_with("line 1: "));
    }
}
