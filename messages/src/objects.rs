//! JSON objects in what people pipe: one a line, with the topic in front or without, wrapped by
//! the program that received them, pretty-printed, in arrays.
//!
//! Owns where an object begins and ends. What it means is [`crate::read`]'s. Memory is bounded
//! whatever comes, and behind something that is not JSON the next line begins afresh.

use serde_json::Value;
use std::io::{self, BufRead};

/// Longest object, bytes: several times the largest message, pretty-printed.
pub const LONGEST: usize = 256 << 10;
/// Deepest nesting: a message has four levels, and wrappers some more.
const DEEPEST: usize = 16;
/// Wrappers around a message, one inside the other.
const MOST_WRAPPERS: usize = 4;
/// Fields in which a wrapper has the message: `mosquitto_sub -F %j` and `%J`, Node-RED,
/// Kafka's consumers, Azure and AWS.
const WRAPPED: [&str; 6] = ["payload", "message", "value", "data", "body", "Body"];

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
    /// What was read and not yet given out.
    bytes: Vec<u8>,
    /// Up to where it was given out.
    at: usize,
    line: usize,
    is_over: bool,
}

/// What stands at the beginning of some bytes.
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
        Self { input, bytes: Vec::new(), at: 0, line: 1, is_over: false }
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
                self.skip_line()?;
                let reason = format!("not a density message: {text:?} is not JSON");
                return Ok(Some(Found { line, object: Err(reason) }));
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
            let end = rest.iter().position(|&byte| byte == b'{' || byte == b'\n');
            if let Some(at) = end.filter(|&at| rest[at] == b'{') {
                self.give(at);
                return Ok(Some(None));
            }
            let may_go_on = end.is_none() && rest.len() < LONGEST;
            let text = String::from_utf8_lossy(&rest[..rest.len().min(160)]);
            let text = text.lines().next().unwrap_or_default().chars().take(40).collect();
            if !may_go_on || !self.fill()? {
                return Ok(Some(Some(text)));
            }
        }
    }

    /// What begins at the brace.
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

/// The message inside the wrappers that receiving programs put around it, or the object itself
/// where it is one.
pub fn unwrapped(object: &[u8]) -> Vec<u8> {
    let mut object = object.to_vec();
    for _ in 0..MOST_WRAPPERS {
        let Ok(Value::Object(fields)) = serde_json::from_slice(&object) else { break };
        if fields.contains_key("schema") || fields.contains_key("lanes") {
            break;
        }
        let inside = WRAPPED.iter().find_map(|name| fields.get(*name));
        object = match inside {
            // As text, or as it is.
            Some(Value::String(text)) => text.clone().into_bytes(),
            Some(value @ Value::Object(_)) => value.to_string().into_bytes(),
            _ => break,
        };
    }
    object
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
    fn wrappers_are_taken_off() {
        let message = r#"{"schema":1,"payload":2}"#;
        let text = Value::from(message).to_string();
        for wrapped in [
            message.to_owned(),
            format!("{{\"topic\":\"a\",\"payload\":{message}}}"),
            format!("{{\"tst\":\"x\",\"topic\":\"a\",\"qos\":1,\"payload\":{text}}}"),
            format!("{{\"value\":{{\"payload\":{text}}}}}"),
        ] {
            let found: Value =
                serde_json::from_slice(&unwrapped(wrapped.as_bytes())).expect("JSON");
            assert_eq!(found["schema"], 1, "{wrapped}");
        }
        assert_eq!(unwrapped(b"{\"payload\":7}"), b"{\"payload\":7}");
        assert_eq!(unwrapped(b"{"), b"{");
    }
}
