//! JSON objects in what people pipe: one a line, with the topic in front or without, wrapped by
//! the program that received them, pretty-printed, in arrays, as texts of JSON.
//!
//! Owns where an object begins and ends, and which messages are in it. [`crate::read`]
//! has their meaning. Memory is bounded whatever comes, and behind something that is not JSON the
//! next line begins afresh.

use crate::presence::Presence;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde_json::{Map, Value};
use std::io::{self, BufRead};

/// Longest object, bytes: hundreds of messages in one wrapper.
pub const LONGEST: usize = 1 << 20;
/// Deepest nesting: a message has four levels, and wrappers some more.
const DEEPEST: usize = 16;
/// Wrappers around a message, one inside the other: Elasticsearch has five.
const MOST_WRAPPERS: usize = 8;
/// Characters of a line that are looked at where it is not JSON.
const SHOWN: usize = 400;
/// Fewest characters in which a message may be hidden as base64.
const LEAST_BASE64: usize = 64;

/// An object, or what is not one, and the line on which it begins, from 1.
#[derive(Debug, PartialEq, Eq)]
pub struct Found {
    /// The line.
    pub line: usize,
    /// The object's text, or why there is none.
    pub object: Result<Vec<u8>, String>,
}

/// The objects of an input.
#[derive(Debug)]
pub struct Objects<R> {
    input: R,
    /// Bytes read and not yet handed out.
    bytes: Vec<u8>,
    /// Up to where it was given out.
    at: usize,
    line: usize,
    is_over: bool,
    others: usize,
}

/// Content of an object.
#[derive(Debug, PartialEq, Eq)]
pub enum Inside {
    /// Messages, or the object as it is where none is found: its reader says what is wrong.
    Messages(Vec<Vec<u8>>),
    /// A health or alarm message, or a topic without one.
    Other,
}

/// The piece at the beginning of some bytes.
enum Piece {
    /// An object of so many bytes.
    Object(usize),
    /// Not JSON, for a reason.
    Wrong(String),
    /// More has to be read to know.
    Unknown,
}

impl<R: BufRead> Objects<R> {
    /// The objects of `input`.
    pub const fn of(input: R) -> Self {
        Self { input, bytes: Vec::new(), at: 0, line: 1, is_over: false, others: 0 }
    }

    /// Lines so far that were of another kind: the presence of a sensor, a topic that was cleared.
    pub const fn others(&self) -> usize {
        self.others
    }

    /// The next one; none at the end.
    ///
    /// # Errors
    /// Those of the input.
    pub fn next_object(&mut self) -> io::Result<Option<Found>> {
        loop {
            let Some(head) = self.head()? else { return Ok(None) };
            if let Some(text) = head {
                let line = self.line;
                if let Some(object) = self.text()? {
                    return Ok(Some(Found { line, object: Ok(object) }));
                }
                self.skip_line()?;
                if is_of_another_kind(&text) {
                    self.others += 1;
                    continue;
                }
                return Ok(Some(Found { line, object: Err(not_json(&text)) }));
            }
            match self.piece() {
                Piece::Object(length) => {
                    let object = self.bytes[self.at..self.at + length].to_vec();
                    let line = self.line;
                    self.give(length);
                    return Ok(Some(Found { line, object: Ok(object) }));
                }
                Piece::Wrong(reason) => {
                    let line = self.line;
                    self.skip_line()?;
                    return Ok(Some(Found { line, object: Err(reason) }));
                }
                Piece::Unknown => drop(self.fill()?),
            }
        }
    }

    /// Passes over what may stand before an object: blanks, brackets and commas of arrays, a
    /// topic. Some text where it is something else; none at the end.
    fn head(&mut self) -> io::Result<Option<Option<String>>> {
        loop {
            let rest = &self.bytes[self.at..];
            let blank =
                |byte: &u8| byte.is_ascii_whitespace() || b"[],\x1e\xef\xbb\xbf".contains(byte);
            let count = rest.iter().take_while(|byte| blank(byte)).count();
            if count == rest.len() {
                self.give(count);
                if !self.fill()? {
                    return Ok(None);
                }
                continue;
            }
            self.give(count);
            let rest = &self.bytes[self.at..];
            if rest[0] == b'"' {
                return Ok(Some(Some(String::new())));
            }
            let end = rest.iter().position(|&byte| byte == b'{' || byte == b'\n');
            if let Some(at) = end.filter(|&at| rest[at] == b'{') {
                self.give(at);
                return Ok(Some(None));
            }
            let may_go_on = end.is_none() && rest.len() < LONGEST;
            let text = String::from_utf8_lossy(&rest[..rest.len().min(4 * SHOWN)]);
            let text = text.lines().next().unwrap_or_default().chars().take(SHOWN).collect();
            if !may_go_on || !self.fill()? {
                return Ok(Some(Some(text)));
            }
        }
    }

    /// A text of JSON that holds an object, where one begins here.
    fn text(&mut self) -> io::Result<Option<Vec<u8>>> {
        if self.bytes[self.at] != b'"' {
            return Ok(None);
        }
        loop {
            let rest = &self.bytes[self.at..];
            let (mut is_escaped, mut end) = (false, None);
            for (index, &byte) in rest.iter().enumerate().skip(1) {
                match byte {
                    _ if is_escaped => is_escaped = false,
                    b'\\' => is_escaped = true,
                    b'"' | b'\n' => {
                        end = Some(index + 1);
                        break;
                    }
                    _ => {}
                }
            }
            if let Some(end) = end {
                let text: Option<String> = serde_json::from_slice(&rest[..end]).ok();
                let object = text.filter(|text| text.trim_start().starts_with('{'));
                if object.is_some() {
                    self.give(end);
                }
                return Ok(object.map(String::into_bytes));
            }
            if rest.len() >= LONGEST || !self.fill()? {
                return Ok(None);
            }
        }
    }

    /// The piece that begins at the brace.
    fn piece(&self) -> Piece {
        let (mut depth, mut in_text, mut is_escaped) = (0usize, false, false);
        for (index, &byte) in self.bytes[self.at..].iter().enumerate() {
            if index >= LONGEST {
                return Piece::Wrong(format!("an object of more than {LONGEST} bytes"));
            }
            match byte {
                _ if is_escaped => is_escaped = false,
                b'\\' if in_text => is_escaped = true,
                b'"' => in_text = !in_text,
                b'\n' if in_text => {
                    return Piece::Wrong("not a density message: a text ends with its line".into());
                }
                _ if in_text => {}
                b'{' | b'[' => depth += 1,
                b'}' | b']' => depth = depth.saturating_sub(1),
                _ => {}
            }
            if depth == 0 {
                return Piece::Object(index + 1);
            }
            if depth > DEEPEST {
                return Piece::Wrong("not a density message: it is nested too deeply".into());
            }
        }
        if self.is_over {
            return Piece::Wrong("not a density message: its end is missing".into());
        }
        Piece::Unknown
    }

    /// Gives so many bytes out.
    fn give(&mut self, count: usize) {
        let given = &self.bytes[self.at..self.at + count];
        self.line += given.iter().filter(|&&byte| byte == b'\n').count();
        self.at += count;
        if self.at > LONGEST {
            self.bytes.drain(..self.at);
            self.at = 0;
        }
    }

    /// Passes over the rest of the line, however long it is.
    fn skip_line(&mut self) -> io::Result<()> {
        loop {
            let rest = &self.bytes[self.at..];
            if let Some(end) = rest.iter().position(|&byte| byte == b'\n') {
                self.give(end + 1);
                return Ok(());
            }
            self.give(rest.len());
            if !self.fill()? {
                return Ok(());
            }
        }
    }

    /// Reads on; false at the end.
    fn fill(&mut self) -> io::Result<bool> {
        if self.is_over {
            return Ok(false);
        }
        let more = self.input.fill_buf()?;
        let count = more.len();
        self.bytes.extend(more);
        self.input.consume(count);
        self.is_over = count == 0;
        Ok(!self.is_over)
    }
}

/// Whether a line is what else comes under a sensor's topics: its presence, or a topic alone, whose
/// kept message was cleared.
fn is_of_another_kind(line: &str) -> bool {
    let mut words = line.split_ascii_whitespace();
    let has_topic =
        words.next().is_some_and(|topic| topic.contains('/') && !topic.starts_with('/'));
    has_topic && words.next().is_none_or(|word| word == "(null)" || is_presence(word))
}

fn is_presence(text: &str) -> bool {
    Presence::ALL.iter().any(|presence| presence.text() == text)
}

fn not_json(line: &str) -> String {
    if line.len() >= 20 && line.trim().bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return "it is hexadecimal: read it with --from postcard".to_owned();
    }
    let begins: String = line.chars().take(40).collect();
    format!("not a density message: {begins:?} is not JSON")
}

/// The messages in an object: itself, or those inside the wrappers that receiving programs put around
/// them (`mosquitto_sub -F %j`, Node-RED, Kafka, Kinesis, AWS, Azure, Elasticsearch), also as text, as
/// base64 and in lists.
pub fn messages_in(object: &[u8]) -> Inside {
    let Ok(value) = serde_json::from_slice::<Value>(object) else {
        return Inside::Messages(vec![object.to_vec()]);
    };
    let mut found = Vec::new();
    match &value {
        Value::Object(fields) if is_message(fields) => found.push(object.to_vec()),
        _ => collect(&value, MOST_WRAPPERS, &mut found),
    }
    if found.is_empty() {
        if is_other(&value) {
            return Inside::Other;
        }
        found.push(object.to_vec());
    }
    Inside::Messages(found)
}

fn is_message(fields: &Map<String, Value>) -> bool {
    (fields.contains_key("schema") || fields.contains_key("lanes")) && !is_health_or_alarm(fields)
}

fn is_health_or_alarm(fields: &Map<String, Value>) -> bool {
    fields.contains_key("schema")
        && (fields.contains_key("uptime_s") || fields.contains_key("active"))
}

/// A health or alarm message, wrapped or not, or the wrapper of a presence or of nothing.
fn is_other(value: &Value) -> bool {
    let Value::Object(fields) = value else { return false };
    is_health_or_alarm(fields)
        || fields.values().any(|inner| match inner {
            Value::Object(inner) => is_health_or_alarm(inner),
            Value::String(text) => serde_json::from_str(text)
                .is_ok_and(|inner: Value| inner.as_object().is_some_and(is_health_or_alarm)),
            _ => false,
        })
        || fields.contains_key("topic")
            && fields.get("payload").is_none_or(|payload| match payload {
                Value::Null => true,
                Value::String(text) => text.is_empty() || is_presence(text),
                _ => false,
            })
}

fn collect(value: &Value, depth: usize, found: &mut Vec<Vec<u8>>) {
    let Some(depth) = depth.checked_sub(1) else { return };
    match value {
        Value::Object(fields) if is_message(fields) => found.push(value.to_string().into_bytes()),
        Value::Object(fields) => fields.values().for_each(|inner| collect(inner, depth, found)),
        Value::Array(values) => values.iter().for_each(|inner| collect(inner, depth, found)),
        Value::String(text) => {
            let text = text.trim();
            let hidden = if text.starts_with(['{', '[']) {
                Some(text.as_bytes().to_vec())
            } else if text.len() >= LEAST_BASE64 {
                BASE64_STANDARD.decode(text).ok()
            } else {
                None
            };
            let inner = hidden.and_then(|bytes| serde_json::from_slice::<Value>(&bytes).ok());
            if let Some(inner) = inner {
                collect(&inner, depth, found);
            }
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(text: &str) -> Vec<(usize, Result<String, String>)> {
        // A small buffer, so that every object comes in pieces.
        let capacity = if text.len() < 1000 { 7 } else { 1 << 16 };
        let mut objects = Objects::of(io::BufReader::with_capacity(capacity, text.as_bytes()));
        let mut all = Vec::new();
        while let Some(Found { line, object }) = objects.next_object().expect("memory is readable")
        {
            all.push((line, object.map(|bytes| String::from_utf8(bytes).expect("UTF-8"))));
        }
        all
    }

    #[test]
    fn objects_are_found_however_they_come() {
        let (a, b) = (r#"{"a":"}\"{","b":[{}]}"#, r#"{"c":1}"#);
        for text in [
            format!("{a}\n{b}\n"),
            format!("{a}{b}"),
            format!("[{a},{b}]"),
            format!("[\n  {a},\n  {b}\n]\n"),
            format!("verge/k/density/60s {a}\r\nverge/k/density/60s {b}\r\n"),
            format!("\u{feff}{a}\n\n\n{b}"),
            format!("\u{1e}{a}\n\u{1e}{b}\n"),
        ] {
            let objects: Vec<_> = found(&text).into_iter().map(|(_, object)| object).collect();
            assert_eq!(objects, [Ok(a.to_owned()), Ok(b.to_owned())], "{text:?}");
        }
        let pretty = "{\n  \"a\": {\n    \"b\": 1\n  }\n}";
        assert_eq!(found(&format!("\n{pretty}\n{b}")), [(2, Ok(pretty.into())), (7, Ok(b.into()))]);
        assert_eq!(found(""), []);
    }

    #[test]
    fn behind_what_is_wrong_the_next_line_begins_afresh() {
        let right = r#"{"c":1}"#;
        let deep = "{\"a\":".repeat(40);
        let long = format!("{{\"a\":\"{}\"}}", "x".repeat(LONGEST));
        let endless = "x".repeat(3 * LONGEST);
        for wrong in ["hello", "{\"a\":\"x", &deep, &long, &endless, "nul"] {
            let all = found(&format!("{right}\n{wrong}\n{right}\n"));
            assert_eq!(
                (all.len(), &all[0], &all[2]),
                (3, &(1, Ok(right.to_owned())), &(3, Ok(right.to_owned())),)
            );
            assert!(all[1].1.is_err());
        }
        // An object whose end is missing costs its line.
        let all = found(&format!("{{\"a\":1\n{right}\n"));
        assert_eq!(all.last(), Some(&(2, Ok(right.to_owned()))));
        // Lines that open and never close take no time without bound.
        assert_eq!(found(&"{\n".repeat(20_000)).len(), 20_000);
    }

    #[test]
    fn messages_are_found_in_their_wrappers() {
        let message = r#"{"schema":1,"payload":2}"#;
        let text = Value::from(message).to_string();
        let packed = BASE64_STANDARD.encode(format!("{message}{}", " ".repeat(LEAST_BASE64)));
        for wrapped in [
            message.to_owned(),
            format!("{{\"topic\":\"a\",\"payload\":{message}}}"),
            format!("{{\"tst\":\"x\",\"topic\":\"a\",\"qos\":1,\"payload\":{text}}}"),
            format!("{{\"value\":{{\"payload\":{text}}}}}"),
            format!("{{\"Records\":[{{\"kinesis\":{{\"data\":\"{packed}\"}}}}]}}"),
            format!("{{\"hits\":{{\"hits\":[{{\"_source\":{message}}}]}}}}"),
            format!("{{\"messages\":[{text}]}}"),
        ] {
            let Inside::Messages(found) = messages_in(wrapped.as_bytes()) else {
                panic!("{wrapped}")
            };
            let found: Vec<Value> =
                found.iter().map(|one| serde_json::from_slice(one).expect("JSON")).collect();
            let expected: Value = serde_json::from_str(message).expect("JSON");
            assert_eq!(found, [expected], "{wrapped}");
        }
        let two = format!("{{\"items\":[{message},{message}]}}");
        assert!(matches!(messages_in(two.as_bytes()), Inside::Messages(two) if two.len() == 2));
        for nothing in ["{\"payload\":7}", "{"] {
            let itself = Inside::Messages(vec![nothing.as_bytes().to_vec()]);
            assert_eq!(messages_in(nothing.as_bytes()), itself);
        }
        for other in [
            r#"{"schema":1,"uptime_s":7}"#,
            r#"{"topic":"v/x/alarm/a","payload":"{\"schema\":1,\"active\":true}"}"#,
            r#"{"topic":"v/x/presence","payload":"online"}"#,
            r#"{"topic":"v/x/alarm/a","payload":null}"#,
        ] {
            assert_eq!(messages_in(other.as_bytes()), Inside::Other, "{other}");
        }
    }

    #[test]
    fn texts_of_json_and_lines_of_other_kinds() {
        let object = r#"{"a":"\"}"}"#;
        let text = Value::from(object).to_string();
        assert_eq!(found(&format!("{text}\n[{text},{text}]\n")).len(), 3);
        assert_eq!(found(&text), [(1, Ok(object.to_owned()))]);
        assert!(found("\"plain\"\n")[0].1.is_err());
        let mut objects =
            Objects::of("v/x/presence online\nv/x/alarm/a \nv/x/alarm/b (null)\n".as_bytes());
        assert_eq!(objects.next_object().expect("readable"), None);
        assert_eq!(objects.others(), 3);
        let wrong = found("0501ab0501ab0501ab0501ab\n");
        assert!(wrong[0].1.as_ref().is_err_and(|reason| reason.contains("--from postcard")));
    }
}
