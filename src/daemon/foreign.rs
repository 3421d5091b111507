//! Text from outside, made fit for a log, an error or a message.
//!
//! Owns the two rules for it: at most [`MOST`] characters, and what controls a terminal is
//! written out. What a camera or a broker says reaches both, and must neither fill them nor
//! steer them.

/// Most characters of foreign text that are shown.
pub const MOST: usize = 200;

/// `text` as it may be shown.
pub fn shown(text: &str) -> String {
    let mut out = String::new();
    for (count, character) in text.chars().enumerate() {
        if count == MOST {
            out.push('…');
            break;
        }
        if steers(character) {
            out.extend(character.escape_default());
        } else {
            out.push(character);
        }
    }
    out
}

/// Whether a text has nothing in it that [`shown`] would write out.
pub fn is_plain(text: &str) -> bool {
    !text.chars().any(steers)
}

/// Controls, marks that turn the direction of text and so can make a line read as another, and
/// characters without width.
fn steers(character: char) -> bool {
    character.is_control()
        || matches!(
            character,
            '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{2069}' | '\u{feff}'
        )
}

/// Bytes as text that may be shown; invalid UTF-8 is replaced.
pub fn shown_bytes(bytes: &[u8]) -> String {
    // A character has up to four bytes: no more are looked at than can be shown.
    let head = &bytes[..bytes.len().min(4 * (MOST + 1))];
    shown(&String::from_utf8_lossy(head))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn foreign_text_is_short_and_steers_nothing() {
        assert_eq!(shown("Kamera Süd"), "Kamera Süd");
        assert_eq!(shown("a\u{1b}[2J\r\nb\u{202e}c"), "a\\u{1b}[2J\\r\\nb\\u{202e}c");
        assert!(is_plain("道路 Süd") && !is_plain("a\u{202e}b") && !is_plain("a\u{200b}b"));
        assert_eq!(shown(&"x".repeat(70_000)).chars().count(), MOST + 1);
        assert_eq!(shown_bytes(&vec![0xff; 1 << 20]).chars().count(), MOST + 1);
    }
}
