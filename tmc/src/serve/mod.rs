//! `verge-tmc serve`: the morning page, live, on loopback. The crate's door to HTTP.
//!
//! Owns the socket and who is answered: programs on this machine, under a name of loopback, so that
//! no page of elsewhere reaches it by a name of its own. It reads and changes nothing, and asks for
//! no token. A page is made when it is asked for, and kept for [`FRESH`]. `data` has the numbers for
//! other programs.

mod data;

use crate::failure::Failure;
use crate::html;
use crate::morning::map::Tiles;
use crate::morning::places::{self, Places};
use crate::morning::{Morning, Options};
use crate::report::{now_ms, offset_ms, threads};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tiny_http::{Header, Method, Request, Response, Server, StatusCode};
use verge_desk::print;

/// A page that was made is shown again for so long.
const FRESH: Duration = Duration::from_secs(30);
/// A browser asks again after so many seconds.
const AGAIN_S: u32 = 60;
/// Longest wait for a request before the signals are looked at.
const TICK: Duration = Duration::from_millis(200);

/// Arguments of `serve`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Folder of the archive.
    #[arg(long, value_name = "DIR")]
    archive: PathBuf,
    /// Port on loopback; 0 takes a free one.
    #[arg(long, default_value_t = 8088)]
    port: u16,
    /// Names and places of the sites, as for `report`.
    #[arg(long, value_name = "FILE.csv")]
    sites: Option<PathBuf>,
    /// Local time ahead of UTC: +08:00.
    #[arg(long, value_name = "+HH:MM", default_value = "+00:00", allow_hyphen_values = true)]
    utc_offset: String,
    /// Source of the map's tiles, as for `report`.
    #[arg(long, value_name = "URL", requires = "tiles_by")]
    tiles: Option<String>,
    /// Whose tiles they are.
    #[arg(long, value_name = "TEXT")]
    tiles_by: Option<String>,
    /// Files read at the same time; without it as many as there are processors.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,
}

/// Runs `serve` until SIGTERM or SIGINT.
///
/// # Errors
/// [`Failure`]: no archive, a port that is taken, a wrong argument.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        // Registering fails for signals that cannot be caught; these can.
        let _ = signal_hook::flag::register(signal, Arc::clone(&stop));
    }
    let centre = Centre::of(arguments)?;
    // An archive that is not there is found now, not by whoever opens the page.
    drop(centre.morning()?);
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, arguments.port));
    let server = Server::http(address)
        .map_err(|error| Failure::usage(format!("{address}: {error}; give another --port")))?;
    let address = server.server_addr().to_ip().unwrap_or(address);
    print(&format!("http://{address}/\n"))?;
    while !stop.load(Ordering::Relaxed) {
        // A socket that fails is tried again: it is the kernel's, not a client's.
        if let Ok(Some(request)) = server.recv_timeout(TICK) {
            centre.answer(request, address.port());
        }
    }
    Ok(())
}

/// Data that pages are made of, and the latest page.
struct Centre {
    archive: PathBuf,
    places: Places,
    tiles: Option<Tiles>,
    offset_ms: i64,
    threads: usize,
    latest: Mutex<Option<(Instant, Arc<Morning>)>>,
}

impl Centre {
    fn of(arguments: &Arguments) -> Result<Self, Failure> {
        let places = arguments.sites.as_deref().map_or_else(|| Ok(Places::new()), places::read)?;
        Ok(Self {
            archive: arguments.archive.clone(),
            places,
            tiles: Tiles::of(arguments.tiles.as_deref(), arguments.tiles_by.as_deref())?,
            offset_ms: offset_ms(&arguments.utc_offset)?,
            threads: threads(arguments.threads),
            latest: Mutex::new(None),
        })
    }

    /// The morning, not older than [`FRESH`].
    fn morning(&self) -> Result<Arc<Morning>, Failure> {
        let mut latest = self.latest.lock().expect("no thread panics with it");
        if let Some((made, morning)) = &*latest
            && made.elapsed() < FRESH
        {
            return Ok(Arc::clone(morning));
        }
        let now_ms = now_ms()?;
        let options = Options {
            only: Vec::new(),
            made_ms: now_ms,
            now_ms,
            offset_ms: self.offset_ms,
            threads: self.threads,
        };
        let morning = Arc::new(Morning::of(&self.archive, &self.places, &options)?);
        *latest = Some((Instant::now(), Arc::clone(&morning)));
        Ok(morning)
    }

    fn answer(&self, request: Request, port: u16) {
        let reply = self.reply(&request, port);
        let is_head = *request.method() == Method::Head;
        let header =
            |name: &str, value: &str| Header::from_bytes(name, value).expect("these are headers");
        let images =
            self.tiles.as_ref().map_or(String::new(), |tiles| format!(" {}", origin(tiles)));
        let policy = format!(
            "default-src 'none'; style-src 'unsafe-inline'; img-src data:{images}; base-uri 'none'; \
             form-action 'none'; frame-ancestors 'none'"
        );
        let body = if is_head { Vec::new() } else { reply.body };
        let response = Response::from_data(body)
            .with_status_code(StatusCode(reply.status))
            .with_header(header("Content-Type", reply.media))
            .with_header(header("Cache-Control", "no-store"))
            .with_header(header("X-Content-Type-Options", "nosniff"))
            .with_header(header("Referrer-Policy", "no-referrer"))
            .with_header(header("Content-Security-Policy", &policy));
        // Whoever asked has gone away: nobody is left to tell.
        let _ = request.respond(response);
    }

    fn reply(&self, request: &Request, port: u16) -> Reply {
        let host = request.headers().iter().find(|it| it.field.equiv("Host"));
        if !host.is_some_and(|host| is_loopback(host.value.as_str(), port)) {
            return Reply::text(403, "ask for it as http://127.0.0.1 or http://localhost");
        }
        if !matches!(request.method(), Method::Get | Method::Head) {
            return Reply::text(405, "this page is to be read");
        }
        let url = request.url().split('#').next().unwrap_or_default();
        let (path, query) = url.split_once('?').unwrap_or((url, ""));
        let morning = match self.morning() {
            Ok(morning) => morning,
            Err(failure) => return Reply::text(500, &failure.to_string()),
        };
        if let Some(name) = path.strip_prefix("/data/") {
            return match data::answer(name, query, &morning, &self.archive) {
                Some(Ok(rows)) => Reply::json(&rows),
                Some(Err(data::Refusal(status, words))) => Reply::text(status, &words),
                None => Reply::text(404, "there are /data/sites and /data/density"),
            };
        }
        match path {
            "/" | "/index.html" => {
                let body = morning.body(self.tiles.as_ref());
                Reply::html(html::page("Traffic density", &body, Some(AGAIN_S)))
            }
            "/trouble.csv" => Reply {
                status: 200,
                media: "text/csv; charset=utf-8",
                body: morning.trouble_csv().into_bytes(),
            },
            _ => {
                let name =
                    path.strip_prefix("/sites/").and_then(|rest| rest.strip_suffix("/index.html"));
                let site = name.and_then(|name| morning.sites.iter().find(|it| it.site == name));
                let Some(site) = site else { return Reply::text(404, "there is no such page") };
                let name = site.known.place.name.as_ref();
                let title = name
                    .map_or_else(|| site.site.clone(), |name| format!("{name} ({})", site.site));
                Reply::html(html::page(&title, &morning.site_body(site), Some(AGAIN_S)))
            }
        }
    }
}

/// An answer.
struct Reply {
    status: u16,
    media: &'static str,
    body: Vec<u8>,
}

impl Reply {
    fn html(body: Vec<u8>) -> Self {
        Self { status: 200, media: "text/html; charset=utf-8", body }
    }

    fn json(rows: &serde_json::Value) -> Self {
        Self { status: 200, media: "application/json", body: rows.to_string().into_bytes() }
    }

    fn text(status: u16, text: &str) -> Self {
        let body = format!("{text}\n").into_bytes();
        Self { status, media: "text/plain; charset=utf-8", body }
    }
}

/// Whether a `Host` names loopback and this port.
fn is_loopback(host: &str, port: u16) -> bool {
    ["127.0.0.1", "localhost", "[::1]"].iter().any(|name| host == format!("{name}:{port}"))
}

/// The part of the tiles' address that a policy names.
fn origin(tiles: &Tiles) -> String {
    let template = tiles.template.split('{').next().unwrap_or_default();
    match template.split_once("://") {
        Some((scheme, rest)) => {
            let host = rest.split('/').next().unwrap_or_default();
            // A policy's sources are parted by blanks and its directives by semicolons.
            let host: String = host.chars().filter(|c| !" ;,'\"".contains(*c)).collect();
            format!("{scheme}://{host}")
        }
        None => "'self'".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_names_of_loopback_are_answered() {
        assert!(is_loopback("127.0.0.1:8088", 8088) && is_loopback("localhost:8088", 8088));
        for wrong in ["evil.example:8088", "127.0.0.1:80", "127.0.0.1", "127.0.0.1.evil:8088", ""] {
            assert!(!is_loopback(wrong, 8088), "{wrong}");
        }
    }

    #[test]
    fn the_policy_lets_in_the_tiles_alone() {
        let of = |template: &str| {
            origin(&Tiles { template: template.into(), attribution: String::new() })
        };
        assert_eq!(of("https://tiles.example/a/{z}/{x}/{y}.png"), "https://tiles.example");
        assert_eq!(of("https://t.example; script-src *//{z}"), "https://t.examplescript-src*");
        assert_eq!(of("/tiles/{z}/{x}/{y}.png"), "'self'");
    }
}
