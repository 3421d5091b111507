//! The connection to the broker: a thread that keeps messages until they are acknowledged.
//!
//! Owns reconnection, acknowledgement and the bounded outbox. A message leaves the outbox
//! when the broker has acknowledged it (QoS 1), so that it may arrive twice and is lost
//! only when the outbox overflows, which is counted. rumqttc forgets what it was sending
//! when the broker has forgotten the session; here every connection starts clean and what
//! was not acknowledged is sent again.

use rumqttc::{Client, Event, LastWill, MqttOptions, Outgoing, Packet, QoS};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Most messages that wait in memory: a day of one-minute windows.
pub const OUTBOX: usize = 1440;
/// Most messages that are sent ahead of their acknowledgements.
const IN_FLIGHT: usize = 16;
/// How often the thread looks for new messages while it is connected.
const TICK: Duration = Duration::from_millis(50);
/// Longest wait for the last words of a connection to leave.
const GOODBYE: Duration = Duration::from_secs(1);
/// Longest wait for a connection and its acknowledgement.
const CONNECT: Duration = Duration::from_secs(10);
/// Shortest and longest ceiling of the wait between two attempts; the wait itself is
/// uniform between 0 and the ceiling, which doubles ("full jitter"), so that a city of
/// boxes does not knock at a restarted broker at once.
const BACKOFF: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));

/// Where the broker is, and who we are to it.
#[derive(Clone)]
pub struct MqttSettings {
    /// Host name or address.
    pub host: String,
    /// Port.
    pub port: u16,
    /// Client id; empty: made from the root topic.
    pub client_id: String,
    /// User and password.
    pub credentials: Option<(String, String)>,
    /// Topic under which all of this site's topics stand.
    pub root: String,
    /// Silence after which the connection is tested.
    pub keep_alive: Duration,
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
    /// Acknowledged by the broker.
    pub delivered: AtomicU64,
    /// In the outbox.
    pub waiting: AtomicU64,
    /// Dropped from a full outbox.
    pub dropped: AtomicU64,
    /// Connections so far.
    pub connections: AtomicU64,
    /// Whether a broker is there.
    pub connected: AtomicBool,
}

/// The life of one connection.
#[derive(Clone, Copy, PartialEq)]
enum Session {
    Connecting,
    Open,
    Leaving { until: Instant },
}

enum Command {
    Send(Message),
    Stop { within: Duration },
}

/// Handle of the connection's thread.
#[derive(Debug)]
pub(super) struct Connection {
    commands: Sender<Command>,
    statistics: Arc<Statistics>,
    thread: JoinHandle<()>,
}

impl Connection {
    pub(super) fn start(settings: MqttSettings) -> Self {
        let (commands, receiver) = mpsc::channel();
        let statistics = Arc::new(Statistics::default());
        let worker = Worker {
            settings,
            commands: receiver,
            statistics: Arc::clone(&statistics),
            outbox: VecDeque::new(),
            in_flight: VecDeque::new(),
            stop_at: None,
        };
        let thread = std::thread::Builder::new()
            .name("publish".into())
            .spawn(move || worker.run())
            .expect("the system gives a thread at start");
        Self { commands, statistics, thread }
    }

    pub(super) fn send(&self, message: Message) {
        // The worker ends only in `stop`, which takes `self`.
        let _ = self.commands.send(Command::Send(message));
    }

    pub(super) fn statistics(&self) -> Arc<Statistics> {
        Arc::clone(&self.statistics)
    }

    pub(super) fn stop(self, within: Duration) {
        let _ = self.commands.send(Command::Stop { within });
        if self.thread.join().is_err() {
            log::error!("the publishing thread ended by a panic");
        }
    }
}

/// Asks the broker for a connection and ends it again; nothing is published.
///
/// # Errors
/// The reason, where no connection came about within ten seconds.
pub fn probe(settings: &MqttSettings) -> Result<(), String> {
    let mut options =
        MqttOptions::new(format!("{}-check", client_id(settings)), &settings.host, settings.port);
    if let Some((user, password)) = &settings.credentials {
        options.set_credentials(user, password);
    }
    let (client, mut connection) = Client::new(options, 1);
    let outcome = match connection.recv_timeout(CONNECT) {
        Ok(Ok(Event::Incoming(Packet::ConnAck(_)))) => Ok(()),
        Ok(Ok(other)) => Err(format!("unexpected answer {other:?}")),
        Ok(Err(error)) => Err(error.to_string()),
        Err(_) => Err(format!("no answer within {} s", CONNECT.as_secs())),
    };
    let _ = client.try_disconnect();
    outcome
}

fn client_id(settings: &MqttSettings) -> String {
    if settings.client_id.is_empty() {
        settings.root.replace('/', "-")
    } else {
        settings.client_id.clone()
    }
}

/// A message that was given to rumqttc, with the packet id once it is known.
struct InFlight {
    message: Message,
    packet: Option<u16>,
    counted: bool,
}

struct Worker {
    settings: MqttSettings,
    commands: Receiver<Command>,
    statistics: Arc<Statistics>,
    outbox: VecDeque<Message>,
    in_flight: VecDeque<InFlight>,
    stop_at: Option<Instant>,
}

impl Worker {
    fn run(mut self) {
        let mut ceiling = BACKOFF.0;
        loop {
            let started = Instant::now();
            let reason = self.session();
            self.statistics.connected.store(false, Ordering::Relaxed);
            self.take_back();
            self.collect();
            if self.stop_at.is_some() {
                break;
            }
            if started.elapsed() > BACKOFF.1 {
                ceiling = BACKOFF.0;
            }
            let wait = ceiling.mul_f64(fastrand::f64());
            let MqttSettings { host, port, .. } = &self.settings;
            log::warn!(
                "broker {host}:{port}: {reason}; {} messages wait, next attempt in {:.1} s",
                self.outbox.len(),
                wait.as_secs_f64()
            );
            ceiling = (ceiling * 2).min(BACKOFF.1);
            self.rest(wait);
        }
        let left = self.outbox.len();
        if left > 0 {
            log::error!("stopped with {left} messages that the broker did not take");
        }
    }

    /// One connection from its beginning to its end; returns why it ended.
    fn session(&mut self) -> String {
        let (client, mut connection) = Client::new(self.options(), 2 * IN_FLIGHT);
        let mut state = Session::Connecting;
        loop {
            if state == Session::Open {
                self.collect();
                self.pump(&client);
                if self.is_done() {
                    self.say_goodbye(&client);
                    state = Session::Leaving { until: Instant::now() + GOODBYE };
                }
            }
            let patience = if state == Session::Connecting { CONNECT } else { TICK };
            match connection.recv_timeout(patience) {
                Ok(Ok(Event::Incoming(Packet::ConnAck(_)))) => {
                    state = Session::Open;
                    self.statistics.connected.store(true, Ordering::Relaxed);
                    self.statistics.connections.fetch_add(1, Ordering::Relaxed);
                    log::info!("connected to {}:{}", self.settings.host, self.settings.port);
                    self.present(&client, "online");
                }
                Ok(Ok(Event::Outgoing(Outgoing::Publish(packet)))) => {
                    if let Some(sent) = self.in_flight.iter_mut().find(|m| m.packet.is_none()) {
                        sent.packet = Some(packet);
                    }
                }
                Ok(Ok(Event::Incoming(Packet::PubAck(ack)))) => self.acknowledged(ack.pkid),
                Ok(Ok(Event::Outgoing(Outgoing::Disconnect))) => return "stopped".to_owned(),
                Ok(Ok(_)) => {}
                Ok(Err(error)) => return error.to_string(),
                Err(_) => match state {
                    Session::Connecting => return "no answer".to_owned(),
                    Session::Leaving { until } if Instant::now() >= until => {
                        return "stopped".to_owned();
                    }
                    Session::Open | Session::Leaving { .. } => {}
                },
            }
        }
    }

    fn options(&self) -> MqttOptions {
        let settings = &self.settings;
        let mut options = MqttOptions::new(client_id(settings), &settings.host, settings.port);
        options.set_keep_alive(settings.keep_alive);
        options.set_clean_session(true);
        options.set_inflight(2 * IN_FLIGHT as u16);
        let topic = self.presence_topic();
        options.set_last_will(LastWill::new(topic, "offline", QoS::AtLeastOnce, true));
        if let Some((user, password)) = &settings.credentials {
            options.set_credentials(user, password);
        }
        options
    }

    fn presence_topic(&self) -> String {
        format!("{}/presence", self.settings.root)
    }

    /// Puts a presence message in front of everything that waits.
    fn present(&mut self, client: &Client, state: &str) {
        let topic = self.presence_topic();
        let message = Message { topic, payload: state.into(), retain: true };
        self.transmit(client, InFlight { message, packet: None, counted: false });
    }

    /// Sends what waits, as far as it may go ahead.
    fn pump(&mut self, client: &Client) {
        while self.in_flight.len() < IN_FLIGHT {
            let Some(message) = self.outbox.pop_front() else { break };
            self.transmit(client, InFlight { message, packet: None, counted: true });
        }
        self.count_waiting();
    }

    /// Whether a stop was asked for, and everything is delivered or the time is up.
    fn is_done(&self) -> bool {
        let delivered = self.in_flight.is_empty() && self.outbox.is_empty();
        self.stop_at.is_some_and(|stop_at| delivered || Instant::now() >= stop_at)
    }

    fn transmit(&mut self, client: &Client, sent: InFlight) {
        let Message { topic, payload, retain } = sent.message.clone();
        // The channel holds twice what may be in flight: it is never full.
        if client.try_publish(topic, QoS::AtLeastOnce, retain, payload).is_ok() {
            self.in_flight.push_back(sent);
        } else {
            self.outbox.push_front(sent.message);
        }
    }

    fn say_goodbye(&mut self, client: &Client) {
        self.present(client, "shutdown");
        // The channel is FIFO: the broker hears of the shutdown before the disconnection.
        let _ = client.try_disconnect();
    }

    fn acknowledged(&mut self, packet: u16) {
        if let Some(index) = self.in_flight.iter().position(|m| m.packet == Some(packet))
            && let Some(sent) = self.in_flight.remove(index)
            && sent.counted
        {
            self.statistics.delivered.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Moves what was not acknowledged back in front of the outbox, in its order.
    fn take_back(&mut self) {
        for sent in self.in_flight.drain(..).rev().filter(|sent| sent.counted) {
            self.outbox.push_front(sent.message);
        }
        self.count_waiting();
    }

    /// Takes new commands without waiting.
    fn collect(&mut self) {
        while let Ok(command) = self.commands.try_recv() {
            self.accept(command);
        }
    }

    /// Takes new commands for `wait`, or until a stop is asked for.
    fn rest(&mut self, wait: Duration) {
        let until = Instant::now() + wait;
        while self.stop_at.is_none() {
            let left = until.saturating_duration_since(Instant::now());
            match self.commands.recv_timeout(left) {
                Ok(command) => self.accept(command),
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    fn accept(&mut self, command: Command) {
        match command {
            Command::Stop { within } => self.stop_at = Some(Instant::now() + within),
            Command::Send(message) => self.keep(message),
        }
    }

    fn keep(&mut self, message: Message) {
        if message.retain {
            // Only the latest state of a retained topic is of use.
            self.outbox.retain(|waiting| waiting.topic != message.topic);
        }
        if self.outbox.len() >= OUTBOX {
            self.outbox.pop_front();
            if self.statistics.dropped.fetch_add(1, Ordering::Relaxed) == 0 {
                log::error!("{OUTBOX} messages wait for the broker: the oldest are lost");
            }
        }
        self.outbox.push_back(message);
        self.count_waiting();
    }

    fn count_waiting(&self) {
        let counted = self.in_flight.iter().filter(|sent| sent.counted).count();
        let waiting = (self.outbox.len() + counted) as u64;
        self.statistics.waiting.store(waiting, Ordering::Relaxed);
    }
}
