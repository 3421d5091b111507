//! Recognises by their first bytes files that are not a picture to measure.
//!
//! Owns the words for what is not a picture to measure: a page, an error in JSON, another format.

use crate::daemon::foreign::{shown, shown_bytes};

/// Bytes in which a page's words are looked for.
const LOOKED_AT: usize = 4 << 10;
/// Characters of a page that are shown.
const MOST_WORDS: usize = 80;

/// The formats that are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// JPEG.
    Jpeg,
    /// PNG.
    Png,
}

/// How a PNG begins.
pub const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";

impl Kind {
    /// The kind of these bytes, if it is one of them.
    pub fn of(bytes: &[u8]) -> Option<Self> {
        match bytes {
            [0xff, 0xd8, 0xff, ..] => Some(Self::Jpeg),
            _ if bytes.starts_with(PNG) => Some(Self::Png),
            _ => None,
        }
    }
}

/// `bytes` without the line ends and zeros that some cameras put in front of a picture.
pub fn trimmed(bytes: &[u8]) -> &[u8] {
    let blank = bytes.iter().take_while(|byte| matches!(byte, b'\r' | b'\n' | b' ' | 0)).count();
    match Kind::of(&bytes[blank..]) {
        Some(_) => &bytes[blank..],
        None => bytes,
    }
}

/// Words for bytes that are not a picture, and what to do about them.
pub fn described(bytes: &[u8]) -> String {
    if bytes.is_empty() {
        return "the answer is empty (0 bytes)".to_owned();
    }
    if let Some(format) = video(bytes) {
        return format!(
            "{format} in place of a picture: give the camera's rtsp:// address, or that of its JPEG"
        );
    }
    if let Some(format) = other_format(bytes) {
        return format!(
            "{format}: verge reads JPEG and PNG; set the camera, or its address, to JPEG"
        );
    }
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(LOOKED_AT)]);
    let text = text.trim_start_matches('\u{feff}').trim_start();
    let small = text.get(..text.len().min(256)).unwrap_or(text).to_ascii_lowercase();
    let login = "does the camera want a login, or is the picture at another address?";
    if small.starts_with("<!doctype html") || small.contains("<html") || small.contains("<head") {
        return format!("an HTML page in place of a picture ({:?}): {login}", words(text));
    }
    if small.starts_with("<?xml") || small.starts_with('<') {
        return format!("XML in place of a picture ({:?}): {login}", words(text));
    }
    if small.starts_with(['{', '[']) {
        return format!("JSON in place of a picture ({}): {login}", cut(text));
    }
    let is_text =
        bytes.iter().take(LOOKED_AT).all(|byte| *byte >= b' ' || byte.is_ascii_whitespace());
    if is_text && (text.starts_with("/9j/") || small.starts_with("data:image/")) {
        return "a picture written as text (base64): verge reads pictures as they are; has the camera an \
                address for them?"
            .to_owned();
    }
    if is_text {
        return format!("text in place of a picture ({:?}): {login}", cut(text));
    }
    let beginning: String = bytes.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    format!("neither JPEG nor PNG ({} bytes, beginning {beginning})", bytes.len())
}

/// Whether a body is a stream of parts, picture after picture.
pub fn is_multipart(bytes: &[u8]) -> bool {
    let head = &bytes[..bytes.len().min(1 << 10)];
    let dashes = head.iter().position(|byte| !byte.is_ascii_whitespace()).unwrap_or_default();
    head[dashes..].starts_with(b"--")
        && String::from_utf8_lossy(head).to_ascii_lowercase().contains("content-type")
}

fn other_format(bytes: &[u8]) -> Option<&'static str> {
    let brand = bytes.get(8..12).unwrap_or_default();
    Some(match bytes {
        [b'G', b'I', b'F', b'8', ..] => "a GIF picture",
        [b'B', b'M', _, _, _, _, 0, 0, 0, 0, ..] => "a BMP picture",
        [b'R', b'I', b'F', b'F', ..] if brand == b"WEBP" => "a WebP picture",
        [b'I', b'I', b'*', 0, ..] | [b'M', b'M', 0, b'*', ..] => "a TIFF picture",
        [_, _, _, _, b'f', b't', b'y', b'p', ..] => match brand {
            b"avif" | b"avis" => "an AVIF picture",
            b"heic" | b"heix" | b"mif1" | b"hevc" | b"msf1" => "a HEIF picture",
            _ => return None,
        },
        [0, 0, 0, 12, b'j', b'P', ..] | [0xff, 0x4f, 0xff, 0x51, ..] => "a JPEG 2000 picture",
        [0, 0, 0, 12, b'J', b'X', ..] | [0xff, 0x0a, ..] => "a JPEG XL picture",
        [0x1f, 0x8b, ..] => "gzip",
        _ => return None,
    })
}

/// The video format of these bytes.
pub fn video(bytes: &[u8]) -> Option<&'static str> {
    let brand = bytes.get(8..12).unwrap_or_default();
    Some(match bytes {
        [b'R', b'I', b'F', b'F', ..] if brand == b"AVI " => "an AVI video",
        [_, _, _, _, b'f', b't', b'y', b'p', ..] if other_format(bytes).is_none() => "an MP4 video",
        [0, 0, 1, ..] | [0, 0, 0, 1, ..] => "raw video (H.264 or H.265)",
        [b'F', b'L', b'V', ..] => "a Flash video",
        [0x1a, 0x45, 0xdf, 0xa3, ..] => "a Matroska video",
        // MPEG-TS: packets of 188 bytes.
        [0x47, ..] if bytes.get(188) == Some(&0x47) => "a video (MPEG transport stream)",
        _ if bytes.starts_with(b"#EXTM3U") => "an HLS playlist",
        _ => return None,
    })
}

/// The words of a page, without its marks.
fn words(page: &str) -> String {
    let (mut text, mut inside) = (String::new(), false);
    for character in page.chars() {
        match character {
            '<' => (inside, _) = (true, text.push(' ')),
            '>' => inside = false,
            _ if !inside => text.push(character),
            _ => {}
        }
    }
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    // Marks alone, such as one that refreshes to another address.
    cut(if text.is_empty() { page } else { &text })
}

fn cut(text: &str) -> String {
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    let short: String = text.chars().take(MOST_WORDS).collect();
    let more = if short.len() < text.len() { "…" } else { "" };
    shown(&short) + more
}

/// The first bytes of something as text, for a message.
pub fn beginning(bytes: &[u8]) -> String {
    shown_bytes(&bytes[..bytes.len().min(MOST_WORDS)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_in_place_of_a_picture_is_named() {
        for (bytes, expected) in [
            (&b"GIF89a"[..], "a GIF picture"),
            (b"BM\x36\x10\x0e\0\0\0\0\0", "a BMP picture"),
            (b"RIFF\0\0\0\0WEBPVP8 ", "a WebP picture"),
            (b"\0\0\0\x18ftypavif", "an AVIF picture"),
            (
                b"\0\0\0\x18ftypisom",
                "an MP4 video in place of a picture: give the camera's rtsp://",
            ),
            (b"\0\0\0\x01\x67\x42", "raw video (H.264 or H.265) in place"),
            (b"/9j/4AAQSkZJRgABAQ", "base64"),
            (
                b"<!DOCTYPE html><html><title>Login</title><p>now",
                "an HTML page in place of a picture (\"Login now\")",
            ),
            (b"\xef\xbb\xbf <HTML>x", "an HTML page"),
            (b"<html><meta content=\"0;url=/jpg\"></html>", "url=/jpg"),
            (b"<?xml version=\"1.0\"?><e>bad user</e>", "XML in place of a picture (\"bad user\")"),
            (
                b"{\"error\":{\"code\":-6}}",
                "JSON in place of a picture ({\"error\":{\"code\":-6}})",
            ),
            (b"no such channel\r\n", "text in place of a picture (\"no such channel\")"),
            (b"", "empty"),
            (b"\x01\x02\x03", "neither JPEG nor PNG (3 bytes, beginning 010203)"),
        ] {
            let said = described(bytes);
            assert!(said.contains(expected), "{said}");
        }
        let page = format!("<html>{}", "word ".repeat(10_000));
        assert!(described(page.as_bytes()).len() < 300);
    }

    #[test]
    fn a_stream_of_parts_is_one() {
        assert!(is_multipart(b"\r\n--frame\r\nContent-Type: image/jpeg\r\n\r\n"));
        assert!(!is_multipart(b"<html>--content-type"));
    }
}
