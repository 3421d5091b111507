//! HTTP on loopback: which requests are answered, and who is refused.
//!
//! Owns the socket, the token, the checks of host and origin, and how an answer is written. Does
//! not own what is behind the addresses. The crate's door to HTTP.
//!
//! A request is answered when it comes to a loopback address under a loopback name (no page
//! of elsewhere reaches it by a name of its own), from this page or from the address bar, and
//! knows the token in the address that the program printed.

use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, SocketAddr};
use std::panic::{AssertUnwindSafe, catch_unwind};
use tiny_http::{Header, Method, Request, Server, StatusCode};

/// Largest body of a request, bytes.
const MAX_BODY: u64 = 4 << 20;
/// Requests that are answered at the same time.
const WORKERS: usize = 4;
/// Content security policy of the page: nothing is loaded from, or sent to, another origin.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' \
                      blob: data:; connect-src 'self'; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'none'";

/// A port of loopback with a token in its address.
pub struct Loopback {
    server: Server,
    token: String,
}

/// A request of the page, its token checked.
pub enum Asked<'a> {
    /// A path without its query.
    Get(&'a str),
    /// A path and the JSON that was sent to it.
    Post(&'a str, Vec<u8>),
}

/// An answer.
pub struct Reply {
    status: u16,
    media: String,
    body: Vec<u8>,
}

impl Reply {
    /// A body of this media type.
    pub fn of(media: &str, body: impl Into<Vec<u8>>) -> Self {
        Reply { status: 200, media: media.into(), body: body.into() }
    }

    /// A value in JSON.
    pub fn json(text: impl Into<Vec<u8>>) -> Self {
        Self::of("application/json", text)
    }

    /// The answer to a request that cannot be met; `text` is JSON with the reason.
    pub fn refused(text: impl Into<Vec<u8>>) -> Self {
        Reply { status: 422, ..Self::json(text) }
    }

    /// A status with a line of text.
    pub fn text(status: u16, text: &str) -> Self {
        Reply { status, ..Self::of("text/plain; charset=utf-8", format!("{text}\n")) }
    }

    /// Nothing is there.
    pub fn missing() -> Self {
        Self::text(404, "there is no such thing here")
    }
}

/// Why a port of loopback is not to be had, and what to do.
fn unbound(port: u16, error: Option<&io::Error>) -> String {
    match error.map(io::Error::kind) {
        Some(io::ErrorKind::AddrInUse) => format!(
            "port {port} is in use, maybe by this very program: end that one, or give another --port"
        ),
        Some(io::ErrorKind::PermissionDenied) => format!(
            "port {port} is kept for services of the system: give a --port from 1024 on, or none"
        ),
        _ => format!("port {port} of this machine cannot be had: give another --port, or none"),
    }
}

impl Loopback {
    /// Binds a port of loopback; 0 takes a free one.
    ///
    /// # Errors
    /// Where the port is taken, or the system gives no random bytes; says what to do.
    pub fn bind(port: u16) -> Result<Self, String> {
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        let server = Server::http(address).map_err(|e| unbound(port, e.downcast_ref()))?;
        let mut token = [0_u8; 16];
        getrandom::fill(&mut token).map_err(|e| format!("no random bytes for a token: {e}"))?;
        Ok(Loopback { server, token: token.iter().map(|b| format!("{b:02x}")).collect() })
    }

    /// The address to open in a browser.
    pub fn address(&self) -> String {
        let at = self.server.server_addr().to_ip().map_or(0, |a| a.port());
        format!("http://127.0.0.1:{at}/{}/", self.token)
    }

    /// Answers until the process ends.
    pub fn serve(&self, answer: impl Fn(Asked<'_>) -> Reply + Sync) {
        let answer = &answer;
        std::thread::scope(|scope| {
            for _ in 0..WORKERS {
                scope.spawn(move || {
                    while let Ok(request) = self.server.recv() {
                        self.respond(request, answer);
                    }
                });
            }
        });
    }

    fn respond(&self, mut request: Request, answer: &impl Fn(Asked<'_>) -> Reply) {
        let reply = catch_unwind(AssertUnwindSafe(|| self.reply(&mut request, answer)))
            .unwrap_or_else(|_| Reply::text(500, "this is a fault of the program; see its output"));
        let head = format!(
            "HTTP/1.1 {} {}\r\nContent-Type: {}\r\nContent-Length: {}\r\n\
             Content-Security-Policy: {POLICY}\r\nCache-Control: no-store\r\n\
             X-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n\
             Cross-Origin-Resource-Policy: same-origin\r\n\
             Cross-Origin-Opener-Policy: same-origin\r\nConnection: close\r\n\r\n",
            reply.status,
            StatusCode(reply.status).default_reason_phrase(),
            reply.media,
            reply.body.len(),
        );
        // By hand, for the crate sends no `Connection: close`, and of connections that are kept
        // it leaves one that came in a burst without a thread.
        let mut writer = request.into_writer();
        // A browser that has gone away needs no answer.
        let _ = writer
            .write_all(head.as_bytes())
            .and_then(|()| writer.write_all(&reply.body))
            .and_then(|()| writer.flush());
    }

    fn reply(&self, request: &mut Request, answer: &impl Fn(Asked<'_>) -> Reply) -> Reply {
        if let Some(why) = refusal(request) {
            return Reply::text(403, why);
        }
        let url = request.url().to_owned();
        let path = url.split(['?', '#']).next().unwrap_or_default();
        let known = path.strip_prefix('/').and_then(|p| p.split_once('/'));
        let Some((_, rest)) =
            known.filter(|(token, _)| same(token.as_bytes(), self.token.as_bytes()))
        else {
            return Reply::text(403, "open the whole address that the program printed");
        };
        match request.method() {
            Method::Get => answer(Asked::Get(rest)),
            Method::Post => match body(request) {
                Ok(body) => answer(Asked::Post(rest, body)),
                Err(reply) => reply,
            },
            _ => Reply::text(405, "only GET and POST are answered"),
        }
    }
}

/// Why a request is not answered, whatever it asks for.
fn refusal(request: &Request) -> Option<&'static str> {
    let value = |name: &str| {
        let of = |h: &&Header| h.field.as_str().as_str().eq_ignore_ascii_case(name);
        request.headers().iter().find(of).map(|h| h.value.as_str())
    };
    let host = value("Host").unwrap_or_default();
    if !is_loopback(host) {
        return Some("this page is asked for as 127.0.0.1 or localhost only");
    }
    let foreign = value("Origin").is_some_and(|origin| origin != format!("http://{host}"));
    let site = value("Sec-Fetch-Site");
    if foreign || site.is_some_and(|site| !matches!(site, "same-origin" | "none")) {
        return Some("another page asks for this; only the page itself may");
    }
    None
}

fn is_loopback(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) => name,
        _ => host,
    };
    matches!(name, "127.0.0.1" | "localhost" | "[::1]")
}

/// Whether two texts are the same, in a time that does not tell where they differ.
fn same(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |all, (a, b)| all | (a ^ b)) == 0
}

fn body(request: &mut Request) -> Result<Vec<u8>, Reply> {
    let is_json = request
        .headers()
        .iter()
        .any(|h| h.field.equiv("Content-Type") && h.value.as_str().starts_with("application/json"));
    if !is_json {
        return Err(Reply::text(415, "send application/json"));
    }
    let mut bytes = Vec::new();
    let read: io::Result<usize> = request.as_reader().take(MAX_BODY + 1).read_to_end(&mut bytes);
    read.map_err(|_| Reply::text(400, "the request broke off"))?;
    if bytes.len() as u64 > MAX_BODY {
        return Err(Reply::text(413, "more than 4 MiB"));
    }
    Ok(bytes)
}

/// A name of an address, its percent signs resolved; `None` where it is not text.
pub fn decoded(name: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(name.len());
    let mut rest = name.bytes();
    while let Some(byte) = rest.next() {
        if byte == b'%' {
            let mut digit = || rest.next().and_then(|b| char::from(b).to_digit(16));
            bytes.push((16 * digit()? + digit()?) as u8);
        } else {
            bytes.push(byte);
        }
    }
    String::from_utf8(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_loopback_names_are_answered() {
        for host in ["127.0.0.1:8000", "localhost", "localhost:1", "[::1]:80", "[::1]"] {
            assert!(is_loopback(host), "{host}");
        }
        for host in ["", "evil.example", "127.0.0.1.evil.example:80", "localhost.:80", "10.0.0.1"] {
            assert!(!is_loopback(host), "{host}");
        }
    }

    #[test]
    fn names_are_decoded_once() {
        assert_eq!(decoded("a%20b.jpg").as_deref(), Some("a b.jpg"));
        assert_eq!(decoded("%2e%2e%2fx").as_deref(), Some("../x"));
        assert_eq!(decoded("%252e").as_deref(), Some("%2e"));
        assert_eq!((decoded("%2"), decoded("%zz"), decoded("%ff")), (None, None, None));
    }
}
