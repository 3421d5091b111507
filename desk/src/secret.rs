//! Passwords in an address behind its host, by the names that cameras have for them.
//!
//! Owns the names, and where a value ends. Does not own logins in front of the host.

use std::ops::Range;

/// Names of a password, alone or as the last word of a name (`admin_password`).
const NAMES: [&str; 15] = [
    "pwd",
    "password",
    "passwd",
    "pass",
    "pw",
    "psw",
    "passcode",
    "passphrase",
    "loginpas",
    "userpwd",
    "auth",
    "token",
    "apikey",
    "api_key",
    "secret",
];

/// Whether a path, query or fragment holds one.
pub fn holds_secret(text: &str) -> bool {
    // A whole query may be percent-encoded, its marks too.
    !values(text).is_empty() || !values(&decoded(text)).is_empty()
}

/// A path, query or fragment with `...` in place of each.
pub fn without_secrets(text: &str) -> String {
    let (mut shown, mut from) = (String::new(), 0);
    for value in values(text).into_iter().filter(|value| !value.is_empty()) {
        if value.start >= from {
            shown.push_str(&text[from..value.start]);
            shown.push_str("...");
            from = value.end;
        }
    }
    shown + &text[from..]
}

/// Where their values stand.
fn values(text: &str) -> Vec<Range<usize>> {
    let value = |(at, _): (usize, &str)| {
        let begin = text[..at].rfind(['/', '?', '&', ';', '#', '=']).map_or(0, |mark| mark + 1);
        let end = text[at..].find(['?', '&', ';', '#']).map_or(text.len(), |len| at + len);
        is_secret(&text[begin..at]).then_some(at + 1..end)
    };
    text.match_indices('=').filter_map(value).collect()
}

fn is_secret(name: &str) -> bool {
    let name = decoded(name).trim().to_ascii_lowercase();
    let is_known = |word: &str| NAMES.contains(&word);
    let mut words = name.match_indices(|c: char| !c.is_ascii_alphanumeric());
    is_known(&name) || words.any(|(at, mark)| is_known(&name[at + mark.len()..]))
}

/// Percent-encoding undone, where it is one.
fn decoded(text: &str) -> String {
    let bytes = text.as_bytes();
    let digit = |at: usize| char::from(*bytes.get(at)?).to_digit(16);
    let (mut plain, mut at) = (Vec::with_capacity(bytes.len()), 0);
    while let Some(&byte) = bytes.get(at) {
        let code = digit(at + 1).zip(digit(at + 2)).filter(|_| byte == b'%');
        let code = code.and_then(|(high, low)| u8::try_from(16 * high + low).ok());
        plain.push(code.unwrap_or(byte));
        at += if code.is_some() { 3 } else { 1 };
    }
    String::from_utf8_lossy(&plain).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passwords_are_found_by_name_and_taken_out() {
        for (text, shown) in [
            ("/a?user=x&pwd=s3cret&b=1", "/a?user=x&pwd=...&b=1"),
            ("/s;pass=s3/cret=;x=1", "/s;pass=...;x=1"),
            ("/cgi?pass%77ord=s3cret", "/cgi?pass%77ord=..."),
            ("/a.jpg#PWD=s3cret", "/a.jpg#PWD=..."),
            ("/user=admin_password=s3cret_channel=1.sdp", "/user=admin_password=..."),
            ("/s?access-token=s3cret", "/s?access-token=..."),
            ("/é?é_pw=s3cret", "/é?é_pw=..."),
        ] {
            assert!(holds_secret(text), "{text}");
            assert_eq!(without_secrets(text), shown);
        }
        assert!(holds_secret("/cgi?a%26pwd%3Ds3cret") && holds_secret("/user=admin&password="));
        for plain in ["/a?compass=2&bypass=1&user=x", "/pass/pwd?x=%", "", "=", "/a%e9=1"] {
            assert!(!holds_secret(plain), "{plain}");
            assert_eq!(without_secrets(plain), plain);
        }
    }
}
