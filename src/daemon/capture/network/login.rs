//! Authentication at a camera: Digest (RFC 7616, MD5 and SHA-256) and Basic (RFC 7617).
//!
//! Owns when a login is sent: never unasked, Basic only where no Digest is offered, and after a
//! refusal not before a wait, for cameras lock accounts after a few wrong logins. HTTP and RTSP
//! ask in the same way.

use super::head::Head;
use super::{Credentials, Fault};
use crate::daemon::foreign::shown;
use http_auth::{ChallengeParser, PasswordClient, PasswordParams};
use std::time::{Duration, Instant};

/// Wait after the first refusal.
const FIRST_WAIT: Duration = Duration::from_secs(60);
/// Longest wait: what locks an account forgets it within an hour.
const LONGEST_WAIT: Duration = Duration::from_secs(600);

/// The login at one camera, with what is known of what it wants.
pub struct Login {
    credentials: Option<Credentials>,
    client: Option<PasswordClient>,
    /// Whether the challenge in `client` was answered before.
    used: bool,
    /// Answers in a row that the camera called stale.
    stale: u32,
    refusals: u32,
    wait_until: Option<Instant>,
    warned: bool,
}

impl std::fmt::Debug for Login {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Login").field("credentials", &self.credentials).finish_non_exhaustive()
    }
}

impl Login {
    /// A login that was not asked for yet.
    pub fn new(credentials: Option<Credentials>) -> Self {
        Self {
            credentials,
            client: None,
            used: false,
            stale: 0,
            refusals: 0,
            wait_until: None,
            warned: false,
        }
    }

    /// Whether the camera may be asked now.
    ///
    /// # Errors
    /// [`Fault::LoginRefused`] while a refusal is waited out.
    pub fn ready(&self, now: Instant) -> Result<(), Fault> {
        match self.wait_until {
            Some(until) if now < until => Err(self.refused()),
            _ => Ok(()),
        }
    }

    /// The value of `Authorization` for a request, where the camera has asked for it before.
    pub fn answer(&mut self, method: &str, uri: &str) -> Option<String> {
        let (Some(client), Some(credentials)) = (&mut self.client, &self.credentials) else {
            return None;
        };
        let mut parameters = PasswordParams {
            username: &credentials.user,
            password: &credentials.password,
            uri,
            method,
            body: None,
        };
        // Without a body `auth` is answered wherever it is offered: cameras that offer `auth-int` too
        // get it wrong.
        if let Ok(answer) = client.respond(&parameters) {
            return Some(answer);
        }
        // The crate (0.1.10) takes for the body what RFC 7616, section 3.4.3, has as its hash.
        let hash = match client {
            PasswordClient::Digest(digest) => empty_hash(&format!("{:?}", digest.algorithm())),
            _ => return None,
        };
        parameters.body = Some(hash.as_bytes());
        client.respond(&parameters).ok()
    }

    /// Takes the challenges of a 401. `answered`: the request held a login. With `Ok` the
    /// request is to be sent once more.
    ///
    /// # Errors
    /// [`Fault::LoginWanted`], [`Fault::LoginRefused`], [`Fault::LoginUnknown`].
    pub fn challenged(&mut self, head: &Head, answered: bool, secure: bool) -> Result<(), Fault> {
        let Some(credentials) = &self.credentials else { return Err(Fault::LoginWanted) };
        let client = read_challenges(head.all("www-authenticate"))?;
        let stale = matches!(&client, PasswordClient::Digest(digest) if digest.stale());
        // A nonce that was answered before may have run out, whether the camera says so or not.
        self.stale = if stale && answered { self.stale.saturating_add(1) } else { 0 };
        // Some cameras call a wrong password stale, again and again.
        let stale = stale && self.stale <= 1;
        let ran_out = matches!(client, PasswordClient::Digest(_)) && (stale || self.used);
        if answered && !ran_out {
            self.refusals = self.refusals.saturating_add(1);
            let wait = FIRST_WAIT.saturating_mul(1 << (self.refusals - 1).min(8)).min(LONGEST_WAIT);
            self.wait_until = Instant::now().checked_add(wait);
            self.client = None;
            self.used = false;
            return Err(self.refused());
        }
        if matches!(client, PasswordClient::Basic(_)) && !secure && !self.warned {
            self.warned = true;
            log::warn!(
                "the camera wants user {:?}'s password in clear (basic authentication without TLS): \
                 whoever listens can read it. Take https, or let the camera ask for Digest",
                credentials.user
            );
        }
        self.client = Some(client);
        self.used = false;
        Ok(())
    }

    /// The camera answered without asking for the login again: what it calls stale later has run out.
    pub fn passed(&mut self) {
        self.stale = 0;
    }

    /// The camera took the login, or wants none.
    pub fn accepted(&mut self) {
        self.used = self.client.is_some();
        self.stale = 0;
        (self.refusals, self.wait_until) = (0, None);
    }

    /// The scheme by which the camera asks.
    pub fn scheme(&self) -> &'static str {
        match &self.client {
            None => "no login",
            Some(PasswordClient::Digest(digest)) => {
                match format!("{:?}", digest.algorithm()).as_str() {
                    "Md5" => "Digest MD5",
                    "Sha256" => "Digest SHA-256",
                    _ => "Digest",
                }
            }
            Some(_) => "Basic",
        }
    }

    fn refused(&self) -> Fault {
        let user = self.credentials.as_ref().map(|known| known.user.clone());
        Fault::LoginRefused { user: user.unwrap_or_default() }
    }
}

/// The hash of a request without a body.
fn empty_hash(algorithm: &str) -> &'static str {
    match algorithm {
        "Md5" => "d41d8cd98f00b204e9800998ecf8427e",
        "Sha256" => "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855",
        _ => "c672b8d1ef56ed28ab87c3622c5114069bdd3ad7b8f9737498d0c01ecef0967a",
    }
}

/// A challenge as the standard writes it: cameras write the algorithm in small letters or without its
/// dash, an empty `qop`, no realm, and no commas between parameters.
fn standard(challenge: &str) -> String {
    const ALGORITHMS: [&str; 6] =
        ["MD5", "MD5-sess", "SHA-256", "SHA-256-sess", "SHA-512-256", "SHA-512-256-sess"];
    let bare = |text: &str| text.to_ascii_lowercase().replace(['-', '_', '"'], "");
    // Parts between blanks and commas, outside of quotes.
    let (mut parts, mut is_quoted, mut is_escaped) = (vec![String::new()], false, false);
    for character in challenge.chars() {
        match character {
            _ if is_escaped => is_escaped = false,
            '\\' if is_quoted => is_escaped = true,
            '"' => is_quoted = !is_quoted,
            _ => {}
        }
        if !is_quoted && (character.is_ascii_whitespace() || character == ',') {
            parts.push(String::new());
        } else if let Some(part) = parts.last_mut() {
            part.push(character);
        }
    }
    let (mut out, mut in_digest, mut has_realm) = (String::new(), false, true);
    let close = |out: &mut String, in_digest: bool, has_realm: bool| {
        if in_digest && !has_realm {
            out.push_str(", realm=\"\"");
        }
    };
    for part in parts.iter().filter(|part| !part.is_empty()) {
        let Some((name, value)) = part.split_once('=').filter(|(name, _)| !name.is_empty()) else {
            close(&mut out, in_digest, has_realm);
            let is_first = out.is_empty();
            out.push_str(if is_first { "" } else { ", " });
            out.push_str(part);
            (in_digest, has_realm) = (part.eq_ignore_ascii_case("digest"), false);
            continue;
        };
        let value = match name.to_ascii_lowercase().as_str() {
            "algorithm" => {
                let known = ALGORITHMS.iter().find(|known| bare(known) == bare(value));
                known.map_or(value, |known| known)
            }
            "qop" if bare(value).trim().is_empty() => continue,
            _ => value,
        };
        has_realm |= name.eq_ignore_ascii_case("realm");
        let behind_scheme = out.ends_with(|last: char| last.is_ascii_alphabetic())
            && out.rsplit([' ', ',']).next().is_some_and(|last| !last.contains('='));
        out.push_str(if behind_scheme { " " } else { ", " });
        out.push_str(&format!("{name}={value}"));
    }
    close(&mut out, in_digest, has_realm);
    out
}

/// The strongest challenge that can be answered: Digest by SHA-256, Digest by MD5, Basic. Basic
/// does not count where Digest is offered in a form that cannot be read.
fn read_challenges<'a>(values: impl Iterator<Item = &'a str>) -> Result<PasswordClient, Fault> {
    let (mut best, mut offers): (Option<(u8, PasswordClient)>, Vec<String>) = (None, Vec::new());
    let mut digest_offered = false;
    for value in values {
        let value = standard(value.trim_end_matches([',', ';', ' ']));
        let value = value.as_str();
        digest_offered |= value.to_ascii_lowercase().contains("digest ");
        for challenge in ChallengeParser::new(value).map_while(Result::ok) {
            let of = |name: &str| {
                let value =
                    challenge.params.iter().find(|(known, _)| known.eq_ignore_ascii_case(name));
                value.map(|(_, value)| format!(" {}", value.to_unescaped())).unwrap_or_default()
            };
            offers.push(shown(&format!("{}{}{}", challenge.scheme, of("algorithm"), of("qop"))));
            let Ok(client) = PasswordClient::builder().challenge(&challenge).build() else {
                continue;
            };
            let rank =
                match &client {
                    PasswordClient::Digest(digest) => {
                        if format!("{:?}", digest.algorithm()) == "Md5" { 1 } else { 2 }
                    }
                    _ => 0,
                };
            if best.as_ref().is_none_or(|(known, _)| rank > *known) {
                best = Some((rank, client));
            }
        }
        if offers.is_empty() {
            // The crate reads ASCII alone.
            let hint = "its realm, the camera's name, has letters beyond ASCII: rename the camera";
            offers.push(if value.is_ascii() { shown(value) } else { hint.to_owned() });
        }
    }
    match best {
        Some((rank, client)) if rank > 0 || !digest_offered => Ok(client),
        _ if offers.is_empty() => Err(Fault::LoginUnknown("it does not say which".to_owned())),
        _ => Err(Fault::LoginUnknown(offers.join(", "))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head(lines: &str) -> Head {
        Head::parse(format!("HTTP/1.1 401 X\r\n{lines}").as_bytes(), "HTTP").expect("a head")
    }

    fn login() -> Login {
        Login::new(Some(Credentials { user: "admin".into(), password: "secret#1".into() }))
    }

    const BASIC: &str = "WWW-Authenticate: Basic realm=\"cam\"\r\n";
    const MD5: &str = "WWW-Authenticate: Digest realm=\"cam\", nonce=\"n1\", qop=\"auth\",\r\n";
    const SHA: &str =
        "WWW-Authenticate: Digest realm=\"cam\", nonce=\"n2\", qop=\"auth\", algorithm=SHA-256\r\n";

    #[test]
    fn the_strongest_is_answered_and_basic_only_where_nothing_else_is_offered() {
        for (lines, scheme) in [
            (BASIC.to_owned(), "Basic"),
            (format!("{BASIC}{MD5}"), "Digest MD5"),
            (format!("{MD5}{BASIC}"), "Digest MD5"),
            (format!("{MD5}{SHA}"), "Digest SHA-256"),
        ] {
            let mut login = login();
            assert_eq!(login.answer("GET", "/"), None, "never unasked");
            login.challenged(&head(&lines), false, false).expect(scheme);
            assert_eq!(login.scheme(), scheme, "{lines}");
            let answer = login.answer("GET", "/x").expect("an answer");
            assert!(answer.starts_with(scheme.split(' ').next().expect("a word")), "{answer}");
            assert!(!answer.contains("secret"));
        }
        let unknown =
            format!("{BASIC}WWW-Authenticate: Digest realm=\"x\", nonce=\"n\", algorithm=XYZ\r\n");
        let fault = login().challenged(&head(&unknown), false, true).expect_err("unknown");
        assert!(matches!(fault, Fault::LoginUnknown(_)), "{fault}");
    }

    #[test]
    fn a_refusal_waits_for_minutes_and_an_old_nonce_does_not() {
        let mut login = login();
        login.challenged(&head(MD5), false, false).expect("asked");
        login.accepted();
        login.challenged(&head(MD5), true, false).expect("the nonce ran out");
        let fault = login.challenged(&head(MD5), true, false).expect_err("refused");
        assert_eq!(fault, Fault::LoginRefused { user: "admin".into() });
        let now = Instant::now();
        assert!(login.ready(now + Duration::from_secs(50)).is_err());
        assert!(login.ready(now + Duration::from_secs(61)).is_ok());
        for _ in 0..10 {
            login.challenged(&head(BASIC), false, true).expect("asked");
            login.challenged(&head(BASIC), true, true).expect_err("refused");
        }
        assert!(login.ready(Instant::now() + Duration::from_secs(590)).is_err());
        assert!(login.ready(Instant::now() + Duration::from_secs(601)).is_ok());
        let stale = MD5.replace("qop", "stale=true, qop");
        login.challenged(&head(MD5), false, true).expect("asked");
        login.challenged(&head(&stale), true, true).expect("stale is not a refusal");
        let fault = login.challenged(&head(&stale), true, true).expect_err("stale once more is");
        assert!(
            matches!(fault, Fault::LoginRefused { .. }) && login.ready(Instant::now()).is_err()
        );
    }

    #[test]
    fn challenges_as_cameras_write_them() {
        for (written, starts) in [
            ("Digest realm=\"c\", nonce=\"n\", qop=\"auth-int,auth\"", "qop=auth,"),
            ("Digest realm=\"c\", nonce=\"n\", qop=\"auth-int\"", "qop=auth-int,"),
            ("digest realm=\"c\",nonce=\"n\",algorithm=md5", "Digest username"),
            (
                "Digest realm=\"c\", nonce=\"n\", algorithm=\"sha256\", qop=auth",
                "algorithm=SHA-256",
            ),
            ("Digest realm=\"c\", nonce=\"n\", qop=\"\"", "Digest username"),
            ("Digest nonce=\"n\", qop=\"auth\"", "realm=\"\""),
            ("Digest realm=\"c d, e=f\" nonce=\"n\" qop=\"auth\"", "realm=\"c d, e=f\""),
            ("Digest realm=c, nonce=n, qop=auth", "nonce=\"n\""),
            ("Negotiate, Digest realm=\"\\\"c\\\"\", nonce=\"n\",, ", "realm=\"\\\"c\\\"\""),
            ("Basic realm=\"x\", Digest realm=\"c\", nonce=\"n\"", "Digest username"),
        ] {
            let mut login = login();
            let head = head(&format!("WWW-Authenticate: {written}\r\n"));
            login.challenged(&head, false, false).expect(written);
            let answer = login.answer("GET", "/").expect(written);
            assert!(answer.contains(starts), "{written}: {answer}");
        }
    }

    #[test]
    fn who_has_no_login_is_told() {
        let fault = Login::new(None).challenged(&head(BASIC), false, true).expect_err("none");
        assert_eq!(fault, Fault::LoginWanted);
    }
}
