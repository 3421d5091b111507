//! Where a camera's pictures come from, as a person types it.
//!
//! Owns what is refused at the desk, by the rules of the sensor's `camera.source`. What it says never
//! quotes an address: it may hold a password.

use std::net::Ipv6Addr;
use std::path::Path;

/// Schemes of cameras that the sensor knows.
const SCHEMES: [&str; 6] = ["http", "https", "mjpeg+http", "mjpeg+https", "rtsp", "rtsps"];
/// How a camera's address begins.
const BEGINS: &str = "a camera's begins with http://, https://, mjpeg+http://, mjpeg+https://, \
    rtsp:// or rtsps://, one at the box with /dev/";
/// What becomes of a login in the address.
const LOGIN: &str = "it holds a user or a password, and would be written where others may read it: leave \
    them out here, and put them into camera.user and camera.password_file of verge.toml";

/// The same of one in its query.
const IN_QUERY: &str = "it holds a user or a password behind its path, and would be written where others may \
    read it: leave them out here, and try camera.user and camera.password_file of verge.toml; where the \
    camera takes them in the address alone, write that into verge.toml by hand, which saving keeps";
/// Names that cameras have for a password in the query.
const SECRETS: [&str; 15] = [
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

/// A camera that can be asked at once; its address may hold a login.
///
/// # Errors
/// Why it is none.
pub fn camera(text: &str) -> Result<(), String> {
    match text.trim() {
        "" => Err(format!("it is empty: {BEGINS}")),
        text if is_device(text) => Ok(()),
        text if text.contains("://") => address(text).map(|_| ()),
        _ => Err(format!("it is no address: {BEGINS}")),
    }
}

/// A source that may be saved: without a login; a relative folder counts from that of the site.
///
/// # Errors
/// Why it may not.
pub fn saved(text: &str, site: &Path) -> Result<(), String> {
    let text = text.trim();
    if text.contains("://") {
        return address(text)?.map_or(Ok(()), |login| Err(login.into()));
    }
    let is_folder = !text.starts_with("/dev/") && !text.contains(['?', '@']);
    if is_device(text) || (is_folder && site.join(text).is_dir()) {
        return Ok(());
    }
    Err(format!("it is neither an address nor a folder that is there: {BEGINS}"))
}

fn is_device(text: &str) -> bool {
    text.strip_prefix("/dev/").is_some_and(|name| !name.is_empty())
        && !text.contains(char::is_control)
}

/// Why an address may not be written, where it holds a login.
fn address(text: &str) -> Result<Option<&'static str>, String> {
    if text.contains(char::is_control) {
        return Err("it holds a control character".into());
    }
    let (scheme, rest) = text.split_once("://").unwrap_or_default();
    if !SCHEMES.iter().any(|known| scheme.eq_ignore_ascii_case(known)) {
        return Err(format!("its scheme is not known: {BEGINS}"));
    }
    let (rest, fragment) = rest.split_once('#').unwrap_or((rest, ""));
    let end = rest.find(['/', '?']).unwrap_or(rest.len());
    let (login, place) = match rest[..end].rsplit_once('@') {
        Some((_, place)) => (true, place),
        None => (false, &rest[..end]),
    };
    // A password with a # in it.
    if !login && fragment.contains('@') {
        return Ok(Some(LOGIN));
    }
    host(place)?;
    let is_secret = |part: &str| {
        let name = part.split_once('=').map_or("", |(name, _)| name).trim();
        SECRETS.iter().any(|secret| name.eq_ignore_ascii_case(secret))
    };
    let in_query = || rest[end..].split(['?', '&', ';', '/']).any(is_secret);
    Ok(if login { Some(LOGIN) } else { in_query().then_some(IN_QUERY) })
}

/// Checks a host and its port.
fn host(place: &str) -> Result<(), String> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_');
    let port = if let Some(rest) = place.strip_prefix('[') {
        let (host, port) = rest.split_once(']').unwrap_or_default();
        let (host, zone) = host.split_once('%').unwrap_or((host, ""));
        if host.parse::<Ipv6Addr>().is_err() || !zone.chars().all(is_plain) {
            return Err("between its brackets there is no IPv6 address".into());
        }
        port
    } else {
        let end = place.find(':').unwrap_or(place.len());
        let (host, port) = place.split_at(end);
        if host.is_empty() || !host.chars().all(is_plain) {
            return Err("it names no host: it has the form http://host/path".into());
        }
        port
    };
    let number = port.strip_prefix(':').unwrap_or(port);
    if number.is_empty() || (port.starts_with(':') && number.parse::<u16>().is_ok_and(|n| n > 0)) {
        return Ok(());
    }
    Err("behind the host's colon there is no port from 1 to 65535; a user and password go into \
         camera.user and camera.password_file of verge.toml"
        .into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_sensor_cannot_open_is_not_saved() {
        let site = tempfile::tempdir().unwrap();
        std::fs::create_dir(site.path().join("frames")).unwrap();
        let saved = |text: &str| saved(text, site.path());
        for right in [
            "http://10.0.0.1/a.jpg?x=1",
            "HTTPS://cam:8443",
            "mjpeg+http://cam/s",
            "rtsps://[fe80::1%25eth0]:322/s",
            "/dev/video0",
            "frames",
            " http://cam/p@th ",
        ] {
            assert_eq!(saved(right), Ok(()), "{right}");
        }
        for wrong in [
            "not an address",
            "cam/a.jpg",
            "ftp://cam/a",
            "http://",
            "http://a b/",
            "http://cam:0/",
            "http://cam:port/",
            "http://2001:db8::1/",
            "rtsp://[::1/",
            "/dev/",
            "/nowhere/at/all",
            "http://c\tam/",
        ] {
            assert!(saved(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_login_is_refused_where_it_would_be_saved_and_never_quoted() {
        let site = Path::new(".");
        for address in [
            "rtsp://u:secret@cam/s",
            "http://u@cam/",
            "http://u:sec#ret@cam/",
            "http://u:se/cret@cam/",
        ] {
            let said = saved(address, site).unwrap_err();
            assert!(said.contains("camera.user and camera.password_file"), "{said}");
            assert!(!said.contains("sec") && !said.contains("se/"), "{said}");
        }
        assert_eq!(camera("rtsp://u:secret@cam/s"), Ok(()));
        assert!(camera("").unwrap_err().starts_with("it is empty"));
        assert!(camera("bogus").unwrap_err().starts_with("it is no address"));
    }
}
