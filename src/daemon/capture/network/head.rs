//! The head of an answer: a line with the status, then header lines, then an empty one.
//!
//! Owns how it is read: as browsers and curl do, which skip lines that are not quite a header.
//! HTTP (RFC 9112) and RTSP (RFC 2326) have the same form.
//!
//! ```text
//! HTTP/1.1 200 OK CRLF   Name: value CRLF   [blank continued value CRLF]   CRLF
//! ```

use crate::daemon::foreign::shown_bytes;

/// Longest head, bytes.
pub const MAX_HEAD: usize = 64 << 10;

/// A head that was read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Head {
    /// Status of the answer.
    pub status: u16,
    headers: Vec<(String, String)>,
}

impl Head {
    /// Reads a head without the empty line behind it. `None`: it is not an answer of `protocol`
    /// (`HTTP` or `RTSP`).
    pub fn parse(bytes: &[u8], protocol: &str) -> Option<Self> {
        let mut lines = bytes.split(|&byte| byte == b'\n');
        let first = text(lines.next()?);
        let mut words = first.split_ascii_whitespace();
        let version = words.next()?;
        // ICY: Shoutcast, whose answer old encoders imitate.
        let known =
            version.split('/').next().is_some_and(|name| name.eq_ignore_ascii_case(protocol))
                || (protocol == "HTTP" && version == "ICY");
        let status = words.next()?.get(..3)?.parse().ok()?;
        if !known || !(100..=999).contains(&status) {
            return None;
        }
        let mut headers: Vec<(String, String)> = Vec::new();
        for line in lines {
            let line = text(line);
            if line.starts_with([' ', '\t']) {
                if let Some((_, value)) = headers.last_mut() {
                    value.push(' ');
                    value.push_str(line.trim());
                }
            } else if let Some((name, value)) = line.split_once(':') {
                headers.push((name.trim().to_ascii_lowercase(), value.trim().to_owned()));
            }
        }
        Some(Self { status, headers })
    }

    /// The first header of this name, which is written in small letters.
    pub fn get(&self, name: &str) -> Option<&str> {
        self.headers.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str())
    }

    /// All headers of this name.
    pub fn all<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a str> {
        self.headers.iter().filter(move |(known, _)| known == name).map(|(_, value)| value.as_str())
    }

    /// The body's length, where it is given and a number.
    pub fn content_length(&self) -> Option<u64> {
        self.all("content-length").find_map(|value| value.split(',').next()?.trim().parse().ok())
    }

    /// Whether the body comes in chunks.
    pub fn is_chunked(&self) -> bool {
        self.get("transfer-encoding").is_some_and(|value| {
            value.rsplit(',').next().is_some_and(|last| last.trim().eq_ignore_ascii_case("chunked"))
        })
    }

    /// The type of the body without its parameters, in small letters.
    pub fn content_type(&self) -> String {
        let value = self.get("content-type").unwrap_or_default();
        value.split(';').next().unwrap_or_default().trim().to_ascii_lowercase()
    }
}

/// Where the head at the front of `bytes` ends: before and behind its empty line.
pub fn end(bytes: &[u8]) -> Option<(usize, usize)> {
    let line_ends = bytes.iter().enumerate().filter(|&(_, &byte)| byte == b'\n');
    line_ends.map(|(at, _)| at).find_map(|at| match bytes.get(at + 1..)? {
        [b'\n', ..] => Some((at, at + 2)),
        [b'\r', b'\n', ..] => Some((at, at + 3)),
        _ => None,
    })
}

/// How something that is not a head begins, for a message.
pub fn beginning(bytes: &[u8]) -> String {
    match bytes {
        [] => "nothing came".to_owned(),
        // A TLS alert.
        [0x15, 3, ..] => "it is TLS: https or rtsps in place of http or rtsp?".to_owned(),
        _ => format!("it begins {:?}", shown_bytes(&bytes[..bytes.len().min(40)])),
    }
}

/// A line's text without its end. Headers in Latin-1 are read as such.
fn text(line: &[u8]) -> String {
    let line = line.strip_suffix(b"\r").unwrap_or(line);
    match std::str::from_utf8(line) {
        Ok(text) => text.to_owned(),
        Err(_) => line.iter().map(|&byte| char::from(byte)).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_as_cameras_send_them() {
        let head = b"HTTP/1.0 200\r\nContent-Type : image/jpeg;\r\n charset=x\r\nrubbish\r\n\
                     Server: S\xfcd\r\ncontent-length: 12\r\nContent-Length: 12";
        let head = Head::parse(head, "HTTP").expect("a head");
        assert_eq!((head.status, head.content_length()), (200, Some(12)));
        assert_eq!(head.get("content-type"), Some("image/jpeg; charset=x"));
        assert_eq!((head.content_type().as_str(), head.get("server")), ("image/jpeg", Some("Süd")));
        assert_eq!(Head::parse(b"ICY 200 OK\nA: b", "HTTP").map(|head| head.status), Some(200));
        assert_eq!(Head::parse(b"RTSP/1.0 454 X", "RTSP").map(|head| head.status), Some(454));
        for bad in [&b"<html>"[..], b"", b"HTTP/1.1", b"HTTP/1.1 abc", b"RTSP/1.0 200 OK"] {
            assert_eq!(Head::parse(bad, "HTTP"), None);
        }
    }

    #[test]
    fn a_head_ends_at_its_empty_line() {
        assert_eq!(end(b"a\r\nb\r\n\r\nbody"), Some((5, 8)));
        assert_eq!(end(b"a\nb\n\nbody"), Some((3, 5)));
        assert_eq!(end(b"a\r\nb\r\n"), None);
    }
}
