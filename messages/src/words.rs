//! Findings of a JSON parser, in words of whoever sends messages.
//!
//! Owns the mapping from serde's findings. Which field it is, the reader says.

/// `found`, as `serde_json` prints it, in other words.
pub(crate) fn plain(found: &str) -> String {
    let (found, place) = match found.split_once(" at line ") {
        Some((found, place)) => (found, place.rsplit_once(' ').map_or(place, |(_, column)| column)),
        None => (found, ""),
    };
    // Messages have one line; a value that was read whole has no place.
    let at =
        if matches!(place, "" | "0") { String::new() } else { format!(" (character {place})") };
    // Of a part that was read by itself.
    let is_name =
        |text: &str| text.bytes().all(|b| b.is_ascii_alphanumeric() || b"_.[]".contains(&b));
    if let Some((name, rest)) = found.split_once(": ").filter(|(name, _)| is_name(name)) {
        return format!("{name}: {}{at}", plain(rest));
    }
    if let Some(rest) = found.strip_prefix("unknown variant `") {
        let (value, expected) = rest.split_once('`').unwrap_or((rest, ""));
        let known: Vec<_> = expected.split('`').skip(1).step_by(2).collect();
        return format!("\"{value}\" is not known, only {}{at}", known.join(", "));
    }
    for (kind, words) in
        [("missing field `", "is missing"), ("duplicate field `", "is there twice")]
    {
        if let Some(name) = found.strip_prefix(kind).and_then(|rest| rest.strip_suffix('`')) {
            return format!("{name} {words}{at}");
        }
    }
    let is_of_kind = ["invalid type: ", "invalid value: ", "invalid length "];
    let of_kind = is_of_kind.iter().find_map(|kind| found.strip_prefix(kind));
    if let Some((value, expected)) = of_kind.and_then(|rest| rest.split_once(", expected ")) {
        return format!("must be {}, not {}{at}", right(expected), value_of(value));
    }
    let words = match found {
        _ if found.starts_with("EOF while parsing") => "its end is missing",
        "trailing characters" => "there is more text after its end",
        "trailing comma" => "there is a comma after the last value",
        "expected value" => {
            "this is not a value: write a number, true, false, null, or text in quotes"
        }
        "key must be a string" => "a name needs quotes",
        "expected `:`" => "the : behind a name is missing",
        "expected `,` or `}`" | "expected `,` or `]`" => {
            "a comma or the closing bracket is missing"
        }
        "number out of range" => "the number is too large",
        "invalid number" => "this is not a number",
        "recursion limit exceeded" => "it is nested too deeply",
        _ if found.contains("control character") => {
            "a text contains a line break or a control character"
        }
        "invalid escape"
        | "invalid unicode code point"
        | "lone leading surrogate in hex escape"
        | "unexpected end of hex escape" => "a text contains a \\ with something unknown after it",
        _ => return format!("{found}{at}"),
    };
    format!("{words}{at}")
}

/// The kind that serde expected.
fn right(expected: &str) -> String {
    match expected {
        "f32" | "f64" => "a number".into(),
        "u8" => "a whole number from 0 to 255".into(),
        "u16" => "a whole number from 0 to 65535".into(),
        "u32" | "u64" | "usize" => "a whole number, 0 or more".into(),
        "i32" | "i64" => "a whole number".into(),
        "a boolean" => "true or false".into(),
        "a string" | "string or map" => "text in quotes".into(),
        "a sequence" => "a list".into(),
        other if other.starts_with("struct ") || other == "a map" => "an object".into(),
        other => other.replace("an array of length", "a list of"),
    }
}

/// The value that serde found.
fn value_of(found: &str) -> String {
    let (kind, value) = found.split_once(' ').unwrap_or((found, ""));
    match kind {
        "string" => format!("the text {value}"),
        "integer" | "boolean" => value.trim_matches('`').to_owned(),
        "floating" => value.trim_start_matches("point ").trim_matches('`').to_owned(),
        "sequence" => "a list".into(),
        "map" => "an object".into(),
        _ => found.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::plain;

    #[test]
    fn each_finding_has_words_of_its_own() {
        for (found, words) in [
            ("missing field `site` at line 1 column 7", "site is missing (character 7)"),
            ("passed: missing field `car`", "passed: car is missing"),
            ("duplicate field `seq` at line 1 column 9", "seq is there twice (character 9)"),
            (
                "invalid type: string \"soon\", expected f32",
                "must be a number, not the text \"soon\"",
            ),
            ("invalid type: map, expected a sequence", "must be a list, not an object"),
            ("invalid type: null, expected u64", "must be a whole number, 0 or more, not null"),
            (
                "invalid value: integer `-7`, expected u8",
                "must be a whole number from 0 to 255, not -7",
            ),
            (
                "invalid type: floating point `1.5`, expected u8",
                "must be a whole number from 0 to 255, not 1.5",
            ),
            ("invalid length 1, expected an array of length 2", "must be a list of 2, not 1"),
            (
                "unknown variant `fine`, expected one of `oK`, `noActivity`",
                "\"fine\" is not known, only oK, noActivity",
            ),
            ("EOF while parsing an object at line 1 column 3", "its end is missing (character 3)"),
            (
                "trailing characters at line 1 column 3",
                "there is more text after its end (character 3)",
            ),
            ("key must be a string at line 1 column 2", "a name needs quotes (character 2)"),
        ] {
            assert_eq!(plain(found), words);
        }
    }
}
