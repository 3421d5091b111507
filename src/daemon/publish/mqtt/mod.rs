//! The connection to the broker, in a thread of its own.
//!
//! Owns what the connection is made with and the handle on its thread. `worker` owns the
//! life of sessions, `backoff` the waits between them, `link` the two versions of MQTT: the
//! door of the crate `rumqttc`.

mod backoff;
mod link;
mod tls;
mod worker;

pub use tls::{Tls, TlsError, TlsFiles};

use link::{Link, Signal};
use serde::Deserialize;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use worker::{Command, Worker};

/// Longest wait for a connection and its acknowledgement.
const CONNECT: Duration = Duration::from_secs(10);

/// The protocol's version.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
pub enum MqttVersion {
    /// 3.1.1, which every broker speaks.
    #[default]
    #[serde(rename = "3.1.1")]
    V3,
    /// 5, which says why it refuses a message.
    #[serde(rename = "5")]
    V5,
}

/// Where the broker is, and who we are to it.
#[derive(Clone, PartialEq)]
pub struct MqttSettings {
    /// Host name or address.
    pub host: String,
    /// Port.
    pub port: u16,
    /// How the connection is secured; `None`: not at all.
    pub tls: Option<Tls>,
    /// Version of the protocol.
    pub version: MqttVersion,
    /// Client id; empty: made from the root topic.
    pub client_id: String,
    /// User and password.
    pub credentials: Option<(String, String)>,
    /// Topic under which all of this site's topics stand.
    pub root: String,
    /// Silence after which the connection is tested.
    pub keep_alive: Duration,
    /// Most windows of an outage that are sent later, a second.
    pub replay_per_s: f64,
}

impl MqttSettings {
    /// An unsecured broker on this machine.
    pub fn local(port: u16, root: &str) -> Self {
        Self {
            host: "127.0.0.1".into(),
            port,
            tls: None,
            version: MqttVersion::default(),
            client_id: String::new(),
            credentials: None,
            root: root.into(),
            keep_alive: Duration::from_secs(30),
            replay_per_s: 10.0,
        }
    }

    fn client_id(&self) -> String {
        match self.client_id.as_str() {
            "" => self.root.replace('/', "-"),
            given => given.to_owned(),
        }
    }
}

impl std::fmt::Debug for MqttSettings {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "MqttSettings {{ {}:{}, root {:?} }}", self.host, self.port, self.root)
    }
}

/// One message on its way.
#[derive(Clone, Debug)]
pub(super) struct Message {
    pub(super) topic: String,
    pub(super) payload: Vec<u8>,
    pub(super) retain: bool,
}

/// What has become of the messages, readable from other threads.
#[derive(Debug, Default)]
pub struct Statistics {
    /// Taken over by the broker.
    pub delivered: AtomicU64,
    /// Refused by the broker, with a reason (MQTT 5).
    pub refused: AtomicU64,
}

/// What the connection's thread has to say, in its order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Report {
    /// A session is open.
    Opened { session: u64 },
    /// It has ended; what it has not acknowledged is forgotten.
    Closed,
    /// The broker has taken the window.
    Taken { key: u64 },
}

/// Handle of the connection's thread.
#[derive(Debug)]
pub(super) struct Connection {
    commands: Sender<Command>,
    reports: Receiver<Report>,
    statistics: Arc<Statistics>,
    thread: JoinHandle<()>,
}

impl Connection {
    pub(super) fn start(settings: MqttSettings) -> Self {
        let (commands, receiver) = mpsc::channel();
        let (sender, reports) = mpsc::channel();
        let statistics = Arc::new(Statistics::default());
        let worker = Worker::new(settings, receiver, sender, Arc::clone(&statistics));
        let thread = std::thread::Builder::new()
            .name("publish".into())
            .spawn(move || worker.run())
            .expect("the system gives a thread at start");
        Self { commands, reports, statistics, thread }
    }

    /// Sends a state, in this session or a later one.
    pub(super) fn state(&self, message: Message) {
        self.command(Command::State(message));
    }

    /// Sends a window in this session or not at all; `live` ones go before others.
    pub(super) fn window(&self, session: u64, key: u64, live: bool, message: Message) {
        self.command(Command::Window { session, key, live, message });
    }

    fn command(&self, command: Command) {
        // The worker ends only in `stop`, which takes `self`.
        let _ = self.commands.send(command);
    }

    /// The next report, if there is one.
    pub(super) fn report(&self) -> Option<Report> {
        self.reports.try_recv().ok()
    }

    pub(super) fn delivered(&self) -> u64 {
        self.statistics.delivered.load(Ordering::Relaxed)
    }

    pub(super) fn refused(&self) -> u64 {
        self.statistics.refused.load(Ordering::Relaxed)
    }

    /// Connects with these settings instead, where they differ: says goodbye when what there
    /// is was delivered, or after `within`.
    pub(super) fn change(&self, settings: MqttSettings, within: Duration) {
        self.command(Command::Change { settings: Box::new(settings), within });
    }

    /// Ends the thread when it has delivered what it has, or after `within`; returns the
    /// last reports.
    pub(super) fn stop(self, within: Duration) -> Vec<Report> {
        self.command(Command::Stop { within });
        if self.thread.join().is_err() {
            log::error!("the publishing thread ended by a panic");
        }
        self.reports.try_iter().collect()
    }
}

/// Asks the broker for a connection and ends it again; nothing is published.
///
/// # Errors
/// The reason, where no connection came about within ten seconds.
pub fn probe(settings: &MqttSettings) -> Result<(), String> {
    let id = format!("{}-check", settings.client_id());
    let mut link = Link::open(settings, &id, None)?;
    let until = Instant::now() + CONNECT;
    let outcome = loop {
        match link.next(until.saturating_duration_since(Instant::now())) {
            Signal::Accepted => break Ok(()),
            Signal::Ended(reason) => break Err(reason),
            Signal::Quiet => break Err(format!("no answer within {} s", CONNECT.as_secs())),
            Signal::Sent(_) | Signal::Taken(_) | Signal::Refused(..) | Signal::Other => {}
        }
    };
    link.disconnect();
    outcome
}
