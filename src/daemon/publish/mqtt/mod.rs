//! The connection to the broker, in a thread of its own.
//!
//! Owns what the connection is made with and the handle on its thread. `worker` owns the life of
//! sessions, `backoff` the waits between them, `ways` the version that is spoken, `outbox` what
//! waits, `bans` what a broker does not take, `echo` whether 3.1.1 keeps it; `link` is one
//! connection, `packet` the door of the crate `rumqttc`.

mod backoff;
mod bans;
mod echo;
mod link;
mod outbox;
mod packet;
mod probe;
mod tls;
mod ways;
mod worker;

pub use probe::probe;
pub use tls::{Tls, TlsError, TlsFiles};

use crate::daemon::clock;
use crate::daemon::foreign::shown;
use packet::{Denial, Spoken};
use serde::Deserialize;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use worker::Worker;

/// The protocol's version.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
pub enum MqttVersion {
    /// 5, and 3.1.1 with a broker that does not speak it.
    #[default]
    #[serde(rename = "auto")]
    Auto,
    /// 3.1.1, which every broker speaks.
    #[serde(rename = "3.1.1")]
    V3,
    /// 5, which says what became of a message.
    #[serde(rename = "5")]
    V5,
}

/// Address of the broker, and our identity there.
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
    /// Whether the broker keeps the latest live window of each length (`latest/<window>`).
    pub keeps_latest: bool,
}

impl MqttSettings {
    /// An unsecured broker of MQTT 3.1.1 on this machine.
    pub fn local(port: u16, root: &str) -> Self {
        Self {
            host: "127.0.0.1".into(),
            port,
            tls: None,
            version: MqttVersion::V3,
            client_id: String::new(),
            credentials: None,
            root: root.into(),
            keep_alive: Duration::from_secs(30),
            replay_per_s: 10.0,
            keeps_latest: false,
        }
    }

    fn client_id(&self) -> String {
        match self.client_id.as_str() {
            "" => self.root.replace('/', "-"),
            given => given.to_owned(),
        }
    }

    /// Whom the broker's access list must name, for people.
    fn who(&self) -> String {
        match &self.credentials {
            Some((user, _)) => format!("user {:?}", shown(user)),
            None => format!("the client id {:?}", self.client_id()),
        }
    }
}

/// The meaning of a broker's refusal, and what to do.
fn said_of(denial: &Denial, settings: &MqttSettings, spoken: Spoken) -> String {
    match denial {
        Denial::Version => {
            let version = match spoken {
                Spoken::V3 => "3.1.1",
                Spoken::V5 => "5",
            };
            format!("it does not speak MQTT {version} (mqtt.version)")
        }
        Denial::Retain => "it keeps no retained messages".to_owned(),
        Denial::Login => match &settings.credentials {
            Some((user, _)) => format!(
                "the broker refuses user {:?}: check mqtt.user and mqtt.password_file, and that it \
                 may write {}/presence",
                shown(user),
                settings.root
            ),
            None => "the broker wants a user and a password: set mqtt.user and mqtt.password_file"
                .to_owned(),
        },
        Denial::ClientId => {
            format!(
                "the broker refuses the client id {:?}: set mqtt.client_id",
                settings.client_id()
            )
        }
        Denial::Other(reason) => format!("the broker refuses the session: {reason}"),
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

/// Counts of the messages by outcome, readable from other threads.
#[derive(Debug, Default)]
pub struct Statistics {
    /// Taken over by the broker.
    pub delivered: AtomicU64,
    /// Not taken by the broker, in words or without.
    pub refused: AtomicU64,
    /// When the thread last turned, by the clock that nobody sets, ms.
    beat_ms: AtomicU64,
    /// Topics of states whose empty message the broker has taken: it keeps nothing on them.
    cleared: Mutex<Vec<String>>,
}

impl Statistics {
    /// The broker has taken an empty state.
    fn note_cleared(&self, topic: &str) {
        let mut cleared = self.cleared.lock().unwrap_or_else(PoisonError::into_inner);
        cleared.push(topic.to_owned());
    }

    /// The thread turns.
    fn beat(&self) {
        self.beat_ms.store(now_ms(), Ordering::Relaxed);
    }
}

fn now_ms() -> u64 {
    u64::try_from(clock::monotonic().as_millis()).unwrap_or(u64::MAX)
}

/// A request of the handle.
enum Command {
    State(Message),
    Window { session: u64, key: u64, live: bool, message: Message },
    Change { settings: Box<MqttSettings>, within: Duration },
    Stop { within: Duration },
}

/// A report of the connection's thread, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Report {
    /// A session is open.
    Opened { session: u64 },
    /// It has ended; what it has not acknowledged is forgotten.
    Closed,
    /// The broker has taken the window.
    Taken { key: u64 },
    /// It does not take it now.
    PutOff { key: u64 },
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
        statistics.beat();
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

    /// The topics that were emptied since it was asked last.
    pub(super) fn cleared(&self) -> Vec<String> {
        let mut cleared = self.statistics.cleared.lock().unwrap_or_else(PoisonError::into_inner);
        std::mem::take(&mut cleared)
    }

    pub(super) fn refused(&self) -> u64 {
        self.statistics.refused.load(Ordering::Relaxed)
    }

    /// How long the thread has not turned; `None` where it has ended.
    pub(super) fn stalled(&self) -> Option<Duration> {
        let beat_ms = self.statistics.beat_ms.load(Ordering::Relaxed);
        let stalled = Duration::from_millis(now_ms().saturating_sub(beat_ms));
        (!self.thread.is_finished()).then_some(stalled)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_has_panicked_turns_no_more() {
        let (commands, _kept) = mpsc::channel();
        let (_sender, reports) = mpsc::channel();
        let thread = std::thread::spawn(|| panic!("as a fault of the thread would"));
        while !thread.is_finished() {
            std::thread::yield_now();
        }
        let statistics = Arc::new(Statistics::default());
        statistics.beat();
        let connection = Connection { commands, reports, statistics, thread };
        assert_eq!(connection.stalled(), None);
    }
}
