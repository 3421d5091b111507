//! Lines that are no TOML: what they should look like.
//!
//! Owns the mapping from the parser's findings. Quotes the name of a key at most: a line may hold a
//! password.

use super::{Fault, line};
use crate::daemon::foreign::shown;
use std::ops::Range;

/// The parser's finding in other words. Quotes the name of a key at most.
pub(super) fn syntax(text: &str, message: &str, span: Range<usize>) -> Fault {
    let at = span.start.min(text.len());
    let mut number = line(text, at);
    let line = |number: usize| text.lines().nth(number - 1).unwrap_or_default();
    if message.contains("array") {
        // The parser finds that a list goes on where the next key begins.
        let opens = |number: &usize| line(*number).contains('=') && line(*number).contains('[');
        number = (1..=number).rev().find(opens).unwrap_or(number);
    }
    let whole = line(number).trim();
    let (key, value) = whole.split_once('=').unwrap_or(("", ""));
    let (key, value) = (key.trim(), value.trim());
    let named = !key.is_empty() && !key.contains(['"', '\'', '#', ' ', ':']);
    let about = if named { format!("{}: ", shown(key)) } else { String::new() };
    let reason = if message.starts_with("duplicate key") {
        let name = text.get(span).map(|name| name.trim_matches(['[', ']'])).unwrap_or_default();
        format!("{} is there twice: keep one", shown(name))
    } else if key.is_empty() {
        of_no_key(whole)
    } else {
        format!("{about}{}", of_value(value, message))
    };
    Fault { line: Some(number), reason }
}

/// A line without a key.
fn of_no_key(line: &str) -> String {
    let name = line.split_once(':').map(|(name, _)| name.trim().trim_matches('"'));
    match (line.chars().next(), name) {
        (Some('{'), _) => "this looks like JSON; here a line has the form key = value".into(),
        (Some('<'), _) => {
            "this looks like XML or HTML; here a line has the form key = value".into()
        }
        (Some('['), _) => "a section's name stands between [ and ] on a line of its own".into(),
        // Anything else may be a part of a password.
        (_, Some(name)) if is_key(name) => {
            format!("write {} = with its value behind, no colon", shown(name))
        }
        _ => "a line has the form key = value, or [section]".into(),
    }
}

fn is_key(text: &str) -> bool {
    text.bytes().all(|byte| byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'-' | b'.'))
}

/// Says what is wrong with a value that TOML cannot read.
fn of_value(value: &str, message: &str) -> &'static str {
    let word: String = value.chars().take_while(|c| !c.is_whitespace() && *c != '#').collect();
    let number = word.trim_start_matches(['-', '+']);
    let is_digits = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    let begins = |c: &[char]| value.starts_with(c);
    if word.is_empty() {
        "no value stands behind the ="
    } else if value
        .contains(['\u{201c}', '\u{201d}', '\u{201e}', '\u{2018}', '\u{2019}', '\u{ab}', '\u{bb}'])
    {
        "typographic quotes: write straight ones (\")"
    } else if message.contains("escape") {
        "a \\ has a meaning of its own between double quotes: write /, or take single quotes"
    } else if number.split_once(',').is_some_and(|(a, b)| is_digits(a) && is_digits(b)) {
        "a number has a point, no comma"
    } else if number.strip_prefix('.').is_some_and(is_digits)
        || number.strip_suffix('.').is_some_and(is_digits)
    {
        "a number has digits on both sides of its point: 0.5"
    } else if number.len() > 1 && number.starts_with('0') && is_digits(number) {
        "a number has no 0 in front"
    } else if number.starts_with(|c: char| c.is_ascii_digit()) && !value.contains(['"', '\'']) {
        "write a number without a unit, and text in quotes"
    } else if matches!(&*word.to_lowercase(), "true" | "false" | "yes" | "no" | "on" | "off") {
        "write true or false, in small letters"
    } else if begins(&['[']) {
        "a list has its values between [ and ], texts in quotes, with commas between them"
    } else if begins(&['{']) {
        "a table has key = value between { and }, with commas between them"
    } else if begins(&['"', '\'']) && message.contains("string") {
        "the text's closing quote is missing"
    } else if begins(&['"', '\'']) {
        "nothing stands behind the text's closing quote"
    } else {
        "text needs quotes"
    }
}
