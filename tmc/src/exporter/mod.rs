//! `verge-tmc exporter`: the latest numbers of all sites for Prometheus, fed by the broker.
//!
//! Owns the command: one connection that the broker does not keep, and one address, `/metrics`.
//! `state` has what sites said last, `text` writes it. What a site says is checked as the archive
//! checks it; no site speaks for another.

mod state;
mod text;

pub use text::FAMILIES;

use crate::broker::{BrokerArguments, Subscriber};
use crate::failure::Failure;
use state::State;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tiny_http::{Header, Method, Request, Response, Server, StatusCode};
use verge_desk::print;
use verge_messages::Utc;

/// Longest wait for messages, and for a request, before the signals are looked at.
const TICK: Duration = Duration::from_millis(200);

/// Arguments of `exporter`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    broker: BrokerArguments,
    /// Name of this exporter at the broker.
    #[arg(long, default_value = "verge-tmc-exporter")]
    name: String,
    /// Where Prometheus finds it. It answers everybody who reaches it, so that on other addresses
    /// than loopback a firewall decides.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:9187")]
    bind: SocketAddr,
}

/// Runs `exporter` until SIGTERM or SIGINT.
///
/// # Errors
/// [`Failure`]: no broker at the start, an address that is taken.
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        // Registering fails for signals that cannot be caught; these can.
        let _ = signal_hook::flag::register(signal, Arc::clone(&stop));
    }
    let root = &arguments.broker.root;
    let kinds = ["latest/+", "density/+", "health", "alarm/+", "presence"];
    let filters = kinds.map(|kind| format!("{root}/+/{kind}")).to_vec();
    let settings = arguments.broker.settings(&arguments.name, filters, false)?;
    let bind = arguments.bind;
    let server = Server::http(bind)
        .map_err(|error| Failure::usage(format!("--bind {bind}: {error}; give another")))?;
    let mut subscriber = Subscriber::connect(settings)?;
    let address = server.server_addr().to_ip().unwrap_or(bind);
    print(&format!("http://{address}/metrics\n"))?;
    let state = Mutex::new(State::of(root));
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !stop.load(Ordering::Relaxed) {
                // A socket that fails is tried again: it is the kernel's, not a client's.
                if let Ok(Some(request)) = server.recv_timeout(TICK) {
                    answer(request, &state);
                }
            }
        });
        while !stop.load(Ordering::Relaxed) {
            let messages = subscriber.receive(TICK);
            let mut state = state.lock().expect("no thread panics with it");
            state.is_connected = subscriber.is_connected();
            for message in &messages {
                state.take(&message.topic, &message.payload, now());
            }
            drop(state);
            subscriber.acknowledge(&messages);
        }
    });
    subscriber.leave();
    Ok(())
}

fn now() -> Utc {
    Utc(jiff::Timestamp::now().as_millisecond())
}

fn answer(request: Request, state: &Mutex<State>) {
    let is_asked = matches!(request.method(), Method::Get | Method::Head);
    let (status, body) = match request.url() {
        "/metrics" if is_asked => {
            (200, text::text(&state.lock().expect("no thread panics with it"), now()))
        }
        _ => (404, "the numbers are at /metrics\n".to_owned()),
    };
    let media = Header::from_bytes("Content-Type", "text/plain; version=0.0.4; charset=utf-8")
        .expect("that is a header");
    let response =
        Response::from_string(body).with_status_code(StatusCode(status)).with_header(media);
    // Whoever asked has gone away: nobody is left to tell.
    let _ = request.respond(response);
}
