//! What is wrong with a JSON file, in words of the file and not of the program.
//!
//! Owns the words for serde's messages. Knows no format.

use serde_json::Error;
use serde_json::error::Category;

/// Types as serde names them, and as a person knows them.
const TYPES: [(&str, &str); 22] = [
    ("floating point", "the number"),
    ("integer", "the number"),
    ("boolean", "the value"),
    ("string", "the text"),
    ("sequence", "a list"),
    ("map", "an object"),
    ("null", "nothing (null)"),
    ("a sequence", "a list"),
    ("a map", "an object in braces"),
    ("a string", "text in quotes"),
    ("a borrowed string", "text in quotes"),
    ("a boolean", "true or false"),
    ("unit", "nothing"),
    ("f64", "a number"),
    ("f32", "a number"),
    ("u8", "a whole number from 0 to 255"),
    ("u16", "a whole number from 0 on"),
    ("u32", "a whole number from 0 on"),
    ("u64", "a whole number from 0 on"),
    ("usize", "a whole number from 0 on"),
    ("i64", "a whole number"),
    ("i32", "a whole number"),
];

/// Words for an error of JSON, with line and column.
pub fn words(error: &Error) -> String {
    let said = error.to_string();
    let said = said.split(" at line ").next().unwrap_or_default();
    let place = match (error.line(), error.column()) {
        (0, _) => String::new(),
        (line, column) => format!("line {line}, column {column}: "),
    };
    let text = match error.classify() {
        Category::Eof => "it ends too early: is it cut off?".to_owned(),
        Category::Data => data(said),
        Category::Syntax if said.contains("number out of range") => {
            "a number is too large".to_owned()
        }
        Category::Syntax if said.contains("trailing characters") => {
            "something follows behind its end".to_owned()
        }
        Category::Syntax | Category::Io => {
            "here it is no JSON: look for a comma, a quote or a bracket \
                                            that is missing or too many"
                .to_owned()
        }
    };
    format!("{place}{text}")
}

/// Words for values that are not what belongs there.
fn data(said: &str) -> String {
    let key = |from: &str| said.strip_prefix(from)?.split('`').next();
    if let Some(key) = key("missing field `") {
        return format!("\"{key}\" is missing");
    }
    if let Some(key) = key("duplicate field `") {
        return format!("\"{key}\" is there twice");
    }
    if let Some(key) = key("unknown field `") {
        return format!("\"{key}\" is not known here");
    }
    if let Some(value) = key("unknown variant `") {
        let known: Vec<_> = said.split('`').skip(3).step_by(2).collect();
        return format!("\"{value}\" is not known here: {}", known.join(", "));
    }
    let wrong = ["invalid type: ", "invalid value: ", "invalid length "];
    let Some((found, wanted)) = wrong
        .iter()
        .find_map(|kind| said.strip_prefix(kind))
        .and_then(|s| s.split_once(", expected "))
    else {
        return said.replace('`', "\"");
    };
    if found.starts_with(|first: char| first.is_ascii_digit()) {
        return format!("a list of {found} stands where {} belongs", belongs(wanted));
    }
    format!("{} stands where {} belongs", kind(found), belongs(wanted))
}

/// A value as serde names it: its kind, and itself where it is short.
fn kind(found: &str) -> String {
    let of = |(name, plain): &(&str, &str)| {
        let rest = found.strip_prefix(name)?;
        let value = rest.trim().trim_matches('`');
        Some(if value.is_empty() { (*plain).to_owned() } else { format!("{plain} {value}") })
    };
    TYPES.iter().find_map(of).unwrap_or_else(|| found.replace('`', "\""))
}

fn belongs(wanted: &str) -> String {
    let count = |from: &str| wanted.strip_prefix(from)?.split(' ').next();
    for from in ["an array of length ", "a tuple of size "] {
        if let Some(count) = count(from) {
            return format!("a list of {count}");
        }
    }
    if let Some(rest) = wanted.strip_prefix("tuple struct ") {
        return rest
            .split_once(" with ")
            .map_or("a list".into(), |(_, many)| format!("a list of {many}"));
    }
    if wanted.starts_with("struct ")
        || wanted.starts_with("enum ")
        || wanted.starts_with("internally")
    {
        return "an object in braces".to_owned();
    }
    let plain = TYPES.iter().find(|(name, _)| *name == wanted).map(|(_, plain)| *plain);
    plain.map_or_else(|| wanted.replace('`', "\""), str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct File {
        #[expect(dead_code, reason = "read alone")]
        points: Vec<[f64; 2]>,
        #[expect(dead_code, reason = "read alone")]
        size: Option<u8>,
    }

    #[test]
    fn no_word_is_the_program_s() {
        for (json, expected) in [
            ("3", "the number 3 stands where an object in braces belongs"),
            ("{}", "\"points\" is missing"),
            ("{\"points\":[[1,2]],\"x\":1}", "\"x\" is not known here"),
            ("{\"points\":7}", "the number 7 stands where a list belongs"),
            ("{\"points\":[[1,\"a\"]]}", "the text \"a\" stands where a number belongs"),
            ("{\"points\":[[1]]}", "a list of 1 stands where a list of 2 belongs"),
            ("{\"points\":[],\"size\":300}", "the number 300 stands where a whole number from 0"),
            ("{\"points\":[],\"points\":[]}", "\"points\" is there twice"),
            ("{\"points\":[[1e999,2]]}", "a number is too large"),
            ("{\"points\":[[1,2", "ends too early"),
            ("{\"points\":[]} x", "something follows"),
            ("{points:[]}", "line 1, column 2: here it is no JSON"),
        ] {
            let said = words(&serde_json::from_str::<File>(json).unwrap_err());
            assert!(said.contains(expected), "{json}: {said}");
            assert!(!said.contains('`') && !said.contains("File"), "{said}");
        }
    }
}
