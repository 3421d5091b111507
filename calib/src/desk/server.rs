//! HTTP on loopback: which requests are answered, and who is refused.
//!
//! Owns the socket, the token, the checks of host and origin, and the table of addresses.
//! Does not own what is behind them. The crate's door to HTTP.
//!
//! A request is answered when it comes to a loopback address under a loopback name (no page
//! of elsewhere reaches it by a name of its own), from this page or from the address bar, and
//! knows the token in the address that the program printed.

use super::backdrop::{Backdrop, Shift, name_of};
use super::drawing::Drawing;
use super::look::look;
use super::page;
use super::save::{interval_of, save};
use super::site::{Opened, POSE, Site};
use super::traffic::{Detector, Traffic, count};
use crate::error::{Error, Result};
use crate::model::KEY_POINT_NAMES;
use crate::road::standards;
use serde_json::{Value, json};
use std::io::Write;
use std::net::{Ipv4Addr, SocketAddr};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, OnceLock};
use tiny_http::{Header, Method, Request, Server, StatusCode};

/// Largest body of a request, bytes.
const MAX_BODY: u64 = 4 << 20;
/// Requests that are answered at the same time.
const WORKERS: usize = 4;
/// What a browser may do with the page: nothing from elsewhere, nothing to elsewhere.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' \
                      blob: data:; connect-src 'self'; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'none'";

/// A desk that answers.
pub struct Desk {
    server: Server,
    token: String,
    site: Site,
    traffic: Traffic,
    detector: Option<Detector>,
    backdrop: OnceLock<std::result::Result<Backdrop, String>>,
    /// What was saved before, or why the site's folder must not be written.
    opened: OnceLock<std::result::Result<Option<Opened>, String>>,
}

/// An answer.
struct Reply {
    status: u16,
    media: String,
    body: Vec<u8>,
}

impl Reply {
    fn json(value: &impl serde::Serialize) -> Self {
        let body = serde_json::to_vec(value).expect("answers are made of finite numbers and text");
        Reply { status: 200, media: "application/json".into(), body }
    }

    fn text(status: u16, text: &str) -> Self {
        let body = format!("{text}\n").into_bytes();
        Reply { status, media: "text/plain; charset=utf-8".into(), body }
    }

    fn wrong(error: &impl std::fmt::Display) -> Self {
        Reply { status: 422, ..Self::json(&json!({ "error": error.to_string() })) }
    }

    fn of<T: serde::Serialize>(result: Result<T>) -> Self {
        result.map_or_else(|e| Self::wrong(&e), |value| Self::json(&value))
    }
}

impl Desk {
    /// Binds a port of loopback; 0 takes a free one.
    ///
    /// # Errors
    /// Where the port is taken.
    pub fn bind(
        site: Site,
        port: u16,
        detector: Option<Detector>,
        traffic: Traffic,
    ) -> Result<Self> {
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        let server = Server::http(address)
            .map_err(|e| Error::Usage(format!("{address}: {e}; give another --port")))?;
        let token: [u8; 16] = rand::random();
        let token = token.iter().map(|b| format!("{b:02x}")).collect();
        let (backdrop, opened) = (OnceLock::new(), OnceLock::new());
        Ok(Desk { server, token, site, traffic, detector, backdrop, opened })
    }

    /// The address to open in a browser.
    pub fn address(&self) -> String {
        let at = self.server.server_addr().to_ip().map_or(0, |a| a.port());
        format!("http://127.0.0.1:{at}/{}/", self.token)
    }

    /// Answers until the process ends.
    pub fn serve(self) {
        let desk = Arc::new(self);
        let work = |desk: Arc<Desk>| {
            move || {
                while let Ok(request) = desk.server.recv() {
                    desk.answer(request);
                }
            }
        };
        let workers: Vec<_> =
            (0..WORKERS).map(|_| std::thread::spawn(work(Arc::clone(&desk)))).collect();
        for worker in workers {
            let _ = worker.join();
        }
    }

    fn answer(&self, mut request: Request) {
        let reply = catch_unwind(AssertUnwindSafe(|| self.reply(&mut request)))
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

    fn reply(&self, request: &mut Request) -> Reply {
        if let Some(why) = refusal(request) {
            return Reply::text(403, why);
        }
        let url = request.url().to_owned();
        let path = url.split(['?', '#']).next().unwrap_or_default();
        let Some((token, rest)) = path.strip_prefix('/').and_then(|p| p.split_once('/')) else {
            return Reply::text(403, "open the whole address that `mvcalib desk` printed");
        };
        if !same(token.as_bytes(), self.token.as_bytes()) {
            return Reply::text(403, "open the whole address that `mvcalib desk` printed");
        }
        match request.method() {
            Method::Get => self.get(rest),
            Method::Post => match body(request) {
                Ok(body) => self.post(rest, &body),
                Err(reply) => reply,
            },
            _ => Reply::text(405, "only GET and POST are answered"),
        }
    }

    fn get(&self, path: &str) -> Reply {
        let png = |body: Vec<u8>| Reply { status: 200, media: "image/png".into(), body };
        match path {
            "" => Reply {
                status: 200,
                media: "text/html; charset=utf-8".into(),
                body: page::INDEX.into(),
            },
            "api/site" => Reply::of(self.site_json()),
            "api/backdrop.png" => Reply::of_bytes(self.backdrop().map(|b| b.png.clone()), png),
            "api/pose.png" => {
                let bytes = verge_desk::read_bytes(&self.site.file(POSE)).map_err(Error::from);
                Reply::of_bytes(bytes, png)
            }
            "api/traffic" => Reply::json(&self.traffic.state()),
            _ => self.named(path),
        }
    }

    /// Files of the page, and pictures by their name.
    fn named(&self, path: &str) -> Reply {
        let missing = || Reply::text(404, "there is no such thing here");
        if let Some(name) = path.strip_prefix("page/") {
            let Some((media, text)) = page::find(name) else { return missing() };
            return Reply { status: 200, media: media.into(), body: text.into() };
        }
        let (what, name) = path.rsplit_once('/').unwrap_or_default();
        let found = decoded(name).and_then(|name| self.site.picture(&name));
        let Some(file) = found else { return missing() };
        match what {
            "api/picture" => {
                let is_png = file.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"));
                let media = if is_png { "image/png" } else { "image/jpeg" };
                let bytes = verge_desk::read_bytes(&file).map_err(Error::from);
                Reply::of_bytes(bytes, |body| Reply { status: 200, media: media.into(), body })
            }
            "api/shift" => Reply::of(
                self.backdrop().and_then(|b| b.shift(&file)).map(|shift| shift_json(&shift)),
            ),
            _ => missing(),
        }
    }

    fn post(&self, path: &str, body: &[u8]) -> Reply {
        if path == "api/traffic" {
            return Reply::of(self.traffic.start(&self.site).map(|()| self.traffic.state()));
        }
        let drawing = match Drawing::parse(body) {
            Ok(drawing) => drawing,
            Err(why) => return Reply::wrong(&format!("the drawing: {why}")),
        };
        match path {
            "api/look" => Reply::json(&look(&drawing, &self.traffic.cue())),
            "api/save" => Reply::of(self.save(&drawing)),
            "api/count" => Reply::of(
                self.backdrop().and_then(|b| count(&drawing, &self.traffic, b, &self.site)),
            ),
            _ => Reply::text(404, "there is no such thing here"),
        }
    }

    fn save(&self, drawing: &Drawing) -> Result<super::save::Saved> {
        let backdrop = self.backdrop()?;
        self.opened(backdrop)?;
        let model = self.detector.as_ref().map(|d| d.model.as_path());
        save(drawing, &self.site, backdrop, &self.traffic, model)
    }

    fn backdrop(&self) -> Result<&Backdrop> {
        let made = self.backdrop.get_or_init(|| {
            let frames = self.site.pictures().map_err(|e| e.to_string())?;
            Backdrop::of(&frames).map_err(|e| e.to_string())
        });
        made.as_ref().map_err(|why| Error::Usage(why.clone()))
    }

    fn opened(&self, backdrop: &Backdrop) -> Result<Option<&Opened>> {
        let opened =
            self.opened.get_or_init(|| self.site.open(backdrop).map_err(|e| e.to_string()));
        opened.as_ref().map(Option::as_ref).map_err(|why| Error::Usage(why.clone()))
    }

    fn site_json(&self) -> Result<Value> {
        let backdrop = self.backdrop()?;
        let opened = self.opened(backdrop);
        let problem = opened.as_ref().err().map(ToString::to_string);
        let opened = opened.ok().flatten();
        let empty = || Drawing::empty(backdrop.image_size, backdrop.sha256.clone());
        let drawing = opened.map_or_else(empty, |o| o.drawing.clone());
        let frames: Vec<String> = self.site.pictures()?.iter().map(|p| name_of(p)).collect();
        let standards: Vec<Value> = standards::all()
            .iter()
            .map(|s| json!({"name": s.name, "what": s.what, "pitch_m": s.pitch_m()}))
            .collect();
        Ok(json!({
            "folder": self.site.folder.display().to_string(),
            "frames": frames,
            "used": backdrop.frames.iter().map(|p| name_of(p)).collect::<Vec<_>>(),
            "left_out": backdrop.left_out,
            "image_size": backdrop.image_size,
            "backdrop": backdrop.sha256,
            "drawing": drawing,
            "saved": opened.is_some(),
            "moved": opened.and_then(|o| o.moved.as_ref()).map(shift_json),
            "problem": problem,
            "standards": standards,
            "key_points": KEY_POINT_NAMES,
            "interval_s": interval_of(&self.site),
            "traffic": self.traffic.state(),
        }))
    }
}

impl Reply {
    fn of_bytes(bytes: Result<Vec<u8>>, reply: impl Fn(Vec<u8>) -> Reply) -> Self {
        bytes.map_or_else(|e| Self::wrong(&e), reply)
    }
}

fn shift_json(shift: &Shift) -> Value {
    json!({
        "by": shift.by,
        "turn_deg": shift.turn.to_degrees(),
        "zoom": shift.zoom,
        "displacement_px": shift.displacement_px,
        "sure": shift.sure,
    })
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

fn body(request: &mut Request) -> std::result::Result<Vec<u8>, Reply> {
    let is_json = request
        .headers()
        .iter()
        .any(|h| h.field.equiv("Content-Type") && h.value.as_str().starts_with("application/json"));
    if !is_json {
        return Err(Reply::text(415, "send application/json"));
    }
    let mut bytes = Vec::new();
    let read = std::io::Read::take(request.as_reader(), MAX_BODY + 1);
    let broken = |_| Reply::text(400, "the request broke off");
    std::io::Read::read_to_end(&mut { read }, &mut bytes).map_err(broken)?;
    if bytes.len() as u64 > MAX_BODY {
        return Err(Reply::text(413, "more than 4 MiB"));
    }
    Ok(bytes)
}

/// A name of an address, its percent signs resolved.
fn decoded(name: &str) -> Option<String> {
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
