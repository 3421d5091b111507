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
        let parameters = PasswordParams {
            username: &credentials.user,
            password: &credentials.password,
            uri,
            method,
            body: Some(&[]),
        };
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

    /// The camera took the login, or wants none.
    pub fn accepted(&mut self) {
        self.used = self.client.is_some();
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

/// The strongest challenge that can be answered: Digest by SHA-256, Digest by MD5, Basic. Basic
/// does not count where Digest is offered in a form that cannot be read.
fn read_challenges<'a>(values: impl Iterator<Item = &'a str>) -> Result<PasswordClient, Fault> {
    let (mut best, mut offers): (Option<(u8, PasswordClient)>, Vec<String>) = (None, Vec::new());
    let mut digest_offered = false;
    for value in values {
        // Some cameras end the list with a comma.
        let value = value.trim().trim_end_matches([',', ';', ' ']);
        digest_offered |= value.to_ascii_lowercase().contains("digest ");
        for challenge in ChallengeParser::new(value).map_while(Result::ok) {
            offers.push(shown(challenge.scheme));
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
            offers.push(shown(value));
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
    }

    #[test]
    fn who_has_no_login_is_told() {
        let fault = Login::new(None).challenged(&head(BASIC), false, true).expect_err("none");
        assert_eq!(fault, Fault::LoginWanted);
    }
}
