//! The address of a camera, as people type it.
//!
//! Owns what an address means (RFC 3986, as far as browsers and curl agree on it) and how it
//! is shown: without login, query and passwords in the path. Asks nobody.

use super::foreign::shown;
use std::fmt;

/// How a camera is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// One request, one picture.
    Snapshot,
    /// One request, picture after picture.
    Mjpeg,
    /// A session that plays video.
    Rtsp,
}

/// Prefixes of addresses.
pub const SCHEMES: [&str; 6] =
    ["http://", "https://", "mjpeg+http://", "mjpeg+https://", "rtsp://", "rtsps://"];

/// Address of a camera's picture, stream or video.
#[derive(Clone, PartialEq, Eq)]
pub struct Address {
    /// Protocol by which it is asked.
    pub protocol: Protocol,
    /// Whether the connection is secured by TLS.
    pub secure: bool,
    /// Host name or IP address, without brackets.
    pub host: String,
    /// Port.
    pub port: u16,
    /// Path and query, as a request has them.
    pub target: String,
    /// User and password of the address, decoded.
    pub login: Option<(String, String)>,
}

/// Why a text is not an address. Never quotes it: it may hold a password.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AddressError {
    /// Another scheme.
    #[error(
        "{0:?} is not supported: give an address that begins with http://, https://, mjpeg+http://, \
         mjpeg+https://, rtsp:// or rtsps://, a device under /dev, or a folder"
    )]
    Scheme(String),
    /// No host.
    #[error("the address names no host: it has the form http://host/path")]
    NoHost,
    /// Not a host name.
    #[error("{0:?} is not a host name or an IP address")]
    Host(String),
    /// IPv6 without brackets.
    #[error("write an IPv6 address in brackets: http://[2001:db8::1]/path")]
    Brackets,
    /// Not a port.
    #[error(
        "behind the host's colon there is no port from 1 to 65535; a user and password go into \
         camera.user and camera.password_file, or, in the address, with # / ? @ : written as \
         %23 %2F %3F %40 %3A"
    )]
    Port,
    /// A fragment with an at sign in it: a password with a `#`.
    #[error(
        "a # in the address's password ends the address: write it as %23, or use camera.user and \
         camera.password_file"
    )]
    Fragment,
    /// A percent sign without two digits.
    #[error("the login in the address has a % that is not followed by two hexadecimal digits")]
    Percent,
    /// A control character.
    #[error("the address holds a control character")]
    Control,
}

impl Address {
    /// Reads an address. Blanks around it do not count, those inside are encoded.
    ///
    /// # Errors
    /// [`AddressError`] says what to write instead.
    pub fn parse(text: &str) -> Result<Self, AddressError> {
        let text = text.trim();
        if text.chars().any(char::is_control) {
            return Err(AddressError::Control);
        }
        let (scheme, rest) = text.split_once("://").ok_or(AddressError::NoHost)?;
        let scheme = scheme.to_ascii_lowercase();
        let (protocol, secure) = match scheme.as_str() {
            "http" => (Protocol::Snapshot, false),
            "https" => (Protocol::Snapshot, true),
            "mjpeg+http" => (Protocol::Mjpeg, false),
            "mjpeg+https" => (Protocol::Mjpeg, true),
            "rtsp" => (Protocol::Rtsp, false),
            "rtsps" => (Protocol::Rtsp, true),
            _ => return Err(AddressError::Scheme(shown(&format!("{scheme}://")))),
        };
        let (rest, fragment) = rest.split_once('#').unwrap_or((rest, ""));
        let authority_len = rest.find(['/', '?']).unwrap_or(rest.len());
        let (authority, target) = rest.split_at(authority_len);
        if fragment.contains('@') && !authority.contains('@') {
            return Err(AddressError::Fragment);
        }
        // The last at sign: users put them into passwords.
        let (login, host_port) = match authority.rsplit_once('@') {
            Some((login, host_port)) => (Some(read_login(login)?), host_port),
            None => (None, authority),
        };
        let (host, port) = read_host(host_port)?;
        let port = match port {
            Some(port) => port,
            None => default_port(protocol, secure),
        };
        let slash = if target.starts_with('/') { "" } else { "/" };
        let target = encode(&format!("{slash}{target}"));
        Ok(Self { protocol, secure, host, port, target, login })
    }

    /// The address to which a `Location` leads from here. The protocol stays.
    ///
    /// # Errors
    /// [`AddressError`] where it does not lead to an address.
    pub fn redirected(&self, location: &str) -> Result<Self, AddressError> {
        let location = location.trim();
        let own = |target: String| Self { target, ..self.clone() };
        let plain = location.to_ascii_lowercase();
        let there = if plain.starts_with("http://") || plain.starts_with("https://") {
            Self::parse(location)?
        } else if let Some(rest) = location.strip_prefix("//") {
            Self::parse(&format!("http{}://{rest}", if self.secure { "s" } else { "" }))?
        } else if location.starts_with('/') {
            own(encode(location))
        } else if plain.split(['/', '?', '#']).next().is_some_and(|first| first.contains(':')) {
            return Err(AddressError::Scheme(shown(plain.split(':').next().unwrap_or_default())));
        } else {
            let path = self.target.split('?').next().unwrap_or("/");
            let folder = match location.strip_prefix('?') {
                Some(_) => path,
                None => &path[..=path.rfind('/').unwrap_or(0)],
            };
            own(encode(&format!("{folder}{location}")))
        };
        let there = Self { target: without_dots(&there.target), ..there };
        let target = there.target.split('#').next().unwrap_or("/").to_owned();
        Ok(Self { protocol: self.protocol, login: self.login.clone(), target, ..there })
    }

    /// Whether a login meant for this address may go to `other`: to the same host and port, or
    /// from a host's `http` to its `https`; never from a secured connection to one that is not.
    pub fn shares_login_with(&self, other: &Self) -> bool {
        let standard =
            |address: &Self| address.port == default_port(address.protocol, address.secure);
        self.host.eq_ignore_ascii_case(&other.host)
            && match (self.secure, other.secure) {
                (true, false) => false,
                (false, true) => standard(self) && standard(other),
                _ => self.port == other.port,
            }
    }

    /// Host and port as a request has them: the port where it is not the usual one.
    pub fn host_port(&self) -> String {
        let host = if self.host.contains(':') {
            format!("[{}]", self.host.split('%').next().unwrap_or_default())
        } else {
            self.host.clone()
        };
        if self.port == default_port(self.protocol, self.secure) {
            host
        } else {
            format!("{host}:{}", self.port)
        }
    }

    /// The whole address without the login, as RTSP wants it in a request.
    pub fn uri(&self) -> String {
        format!("{}{}{}", self.scheme(), self.host_port(), self.target)
    }

    fn scheme(&self) -> &'static str {
        let index = match self.protocol {
            Protocol::Snapshot => 0,
            Protocol::Mjpeg => 2,
            Protocol::Rtsp => 4,
        };
        SCHEMES[index + usize::from(self.secure)]
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (path, query) = match self.target.split_once('?') {
            Some((path, _)) => (path, "?..."),
            None => (self.target.as_str(), ""),
        };
        let there = self.host_port();
        // A request names no zone; for people it tells one interface from another.
        let there = match self.host.split_once('%') {
            Some((_, zone)) => there.replace(']', &format!("%{zone}]")),
            None => there,
        };
        let path = verge_desk::without_secrets(path);
        write!(f, "{}{there}{}{query}", self.scheme(), shown(&path))
    }
}

impl fmt::Debug for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Address({self})")
    }
}

/// A target without `.` and `..` in its path (RFC 3986, section 5.2.4).
fn without_dots(target: &str) -> String {
    let end = target.find(['?', '#']).unwrap_or(target.len());
    let (path, rest) = target.split_at(end);
    let mut kept: Vec<&str> = Vec::new();
    for part in path.split('/').skip(1) {
        match part {
            "." => {}
            ".." => _ = kept.pop(),
            part => kept.push(part),
        }
    }
    let is_folder = path.ends_with("/.") || path.ends_with("/..");
    let slash = if is_folder && !kept.is_empty() { "/" } else { "" };
    format!("/{}{slash}{rest}", kept.join("/"))
}

/// A source as it may be shown: an address without login and query, anything else as it is.
pub fn masked(source: &str) -> String {
    match Address::parse(source) {
        Ok(address) => address.to_string(),
        Err(_) if source.contains("://") || source.contains('@') => "an address".to_owned(),
        Err(_) => shown(source),
    }
}

/// A text in which an address may stand, such as a quoted line of a file, without what may be secret
/// in it.
pub fn veiled(text: &str) -> String {
    let (mut out, mut rest) = (String::new(), text);
    while let Some(at) = rest.find("://") {
        let (before, address) = rest.split_at(at + 3);
        out.push_str(before);
        let end = address.find(['"', '\'', '\n']).unwrap_or(address.len());
        let (address, behind) = address.split_at(end);
        let open = address.rsplit_once('@').map_or(address, |(_, open)| {
            out.push_str("***@");
            open
        });
        let (open, query) = open.split_once('?').map_or((open, ""), |(open, _)| (open, "?***"));
        out.push_str(open);
        out.push_str(query);
        rest = behind;
    }
    out + rest
}

const fn default_port(protocol: Protocol, secure: bool) -> u16 {
    match (protocol, secure) {
        (Protocol::Rtsp, false) => 554,
        (Protocol::Rtsp, true) => 322,
        (_, false) => 80,
        (_, true) => 443,
    }
}

fn read_login(text: &str) -> Result<(String, String), AddressError> {
    let (user, password) = text.split_once(':').unwrap_or((text, ""));
    Ok((decode(user)?, decode(password)?))
}

fn read_host(text: &str) -> Result<(String, Option<u16>), AddressError> {
    let (host, port) = if let Some(rest) = text.strip_prefix('[') {
        let (host, rest) = rest.split_once(']').ok_or(AddressError::Brackets)?;
        // A zone (RFC 6874), with its percent sign encoded or not.
        let (address, zone) = host.split_once('%').unwrap_or((host, ""));
        let zone = zone.strip_prefix("25").filter(|zone| !zone.is_empty()).unwrap_or(zone);
        let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_');
        if address.parse::<std::net::Ipv6Addr>().is_err() || !zone.chars().all(is_plain) {
            return Err(AddressError::Host(shown(host)));
        }
        let host = if zone.is_empty() { address.to_owned() } else { format!("{address}%{zone}") };
        (host, rest)
    } else {
        let end = text.find(':').unwrap_or(text.len());
        let (host, port) = text.split_at(end);
        if port.matches(':').count() > 1 {
            return Err(AddressError::Brackets);
        }
        let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_');
        if host.is_empty() {
            return Err(AddressError::NoHost);
        }
        if !host.chars().all(is_plain) {
            return Err(AddressError::Host(shown(host)));
        }
        (host.to_owned(), port)
    };
    match port {
        "" | ":" => Ok((host, None)),
        _ => {
            let port = port.strip_prefix(':').and_then(|port| port.parse().ok());
            Ok((host, Some(port.filter(|&port| port > 0).ok_or(AddressError::Port)?)))
        }
    }
}

/// Writes what is not allowed in a request's first line in hexadecimal; what is encoded stays.
fn encode(target: &str) -> String {
    let mut out = String::with_capacity(target.len());
    for byte in target.bytes() {
        if byte.is_ascii_graphic() && !matches!(byte, b'"' | b'<' | b'>') {
            out.push(char::from(byte));
        } else {
            out.push_str(&format!("%{byte:02X}"));
        }
    }
    out
}

fn decode(text: &str) -> Result<String, AddressError> {
    let (mut bytes, mut rest) = (Vec::new(), text.as_bytes());
    while let Some((&byte, tail)) = rest.split_first() {
        rest = tail;
        if byte != b'%' {
            bytes.push(byte);
            continue;
        }
        let digits = tail.get(..2).and_then(|digits| std::str::from_utf8(digits).ok());
        let digits = digits.filter(|digits| digits.bytes().all(|digit| digit.is_ascii_hexdigit()));
        let value = digits.and_then(|digits| u8::from_str_radix(digits, 16).ok());
        bytes.push(value.ok_or(AddressError::Percent)?);
        rest = &tail[2..];
    }
    String::from_utf8(bytes).map_err(|_| AddressError::Percent)
}

#[cfg(test)]
#[path = "address_tests.rs"]
mod tests;
