//! The life of sessions: connect, send in order, hear acknowledgements, back off.
//!
//! Owns reconnection and the queues of a session. States (health, alarms) are kept until a
//! broker has them; windows live in a session and no longer, for the spool has them and gives
//! them again to the next.

use super::backoff::Backoff;
use super::link::{IN_FLIGHT, Link, Signal};
use super::{CONNECT, Message, MqttSettings, Report, Statistics};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, TryRecvError};
use std::time::{Duration, Instant};
use verge_messages::{Presence, Topic};

/// How often the thread looks for new messages while it is connected.
const TICK: Duration = Duration::from_millis(50);
/// Longest wait for the last words of a connection to leave.
const GOODBYE: Duration = Duration::from_secs(1);
/// Most states that wait: health and alarms are a dozen topics, discovery up to fifty.
const MAX_STATES: usize = 128;

/// What the handle asks for.
pub(super) enum Command {
    State(Message),
    Window { session: u64, key: u64, live: bool, message: Message },
    Change { settings: Box<MqttSettings>, within: Duration },
    Stop { within: Duration },
}

/// The phase of a connection.
#[derive(Clone, Copy, PartialEq)]
enum Phase {
    Connecting,
    Open,
    Leaving { until: Instant },
}

/// What a message is, which decides what becomes of it when the session ends.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    /// Said anew by each session.
    Presence,
    /// Kept until a broker has it.
    State,
    /// Given again by the spool.
    Window { key: u64 },
}

struct Sending {
    kind: Kind,
    message: Message,
    /// Known once it has left.
    packet: Option<u16>,
}

pub(super) struct Worker {
    settings: MqttSettings,
    commands: Receiver<Command>,
    reports: Sender<Report>,
    statistics: Arc<Statistics>,
    backoff: Backoff,
    session: u64,
    /// States and live windows, in their order.
    queue: VecDeque<Sending>,
    /// Windows of an outage: they go when nothing else waits.
    arrears: VecDeque<Sending>,
    in_flight: VecDeque<Sending>,
    /// What to connect with next, when this connection is done or at that time.
    change: Option<(Box<MqttSettings>, Instant)>,
    stop_at: Option<Instant>,
}

impl Worker {
    pub(super) fn new(
        settings: MqttSettings,
        commands: Receiver<Command>,
        reports: Sender<Report>,
        statistics: Arc<Statistics>,
    ) -> Self {
        Self {
            settings,
            commands,
            reports,
            statistics,
            backoff: Backoff::new(),
            session: 0,
            queue: VecDeque::new(),
            arrears: VecDeque::new(),
            in_flight: VecDeque::new(),
            change: None,
            stop_at: None,
        }
    }

    pub(super) fn run(mut self) {
        let mut random = fastrand::Rng::new();
        loop {
            let reason = self.session().unwrap_or_else(|reason| reason);
            self.collect();
            self.end_session();
            if self.stop_at.is_some() {
                return;
            }
            if let Some((settings, _)) = self.change.take() {
                self.settings = *settings;
                self.backoff.reset();
                continue;
            }
            let wait = self.backoff.wait(&mut random);
            let MqttSettings { host, port, .. } = &self.settings;
            log::warn!(
                "broker {host}:{port}: {reason}; next attempt in {:.1} s",
                wait.as_secs_f64()
            );
            self.rest(wait);
        }
    }

    /// One connection from its beginning to its end; returns why it ended.
    fn session(&mut self) -> Result<String, String> {
        let will = self.presence(Presence::Offline);
        let mut link = Link::open(&self.settings, &self.settings.client_id(), Some(will))?;
        let mut phase = Phase::Connecting;
        loop {
            if phase == Phase::Open {
                self.collect();
                self.pump(&link);
                if self.is_done() {
                    self.transmit(&link, Kind::Presence, self.presence(Presence::Shutdown));
                    link.disconnect();
                    phase = Phase::Leaving { until: Instant::now() + GOODBYE };
                }
            }
            match link.next(if phase == Phase::Connecting { CONNECT } else { TICK }) {
                Signal::Accepted => {
                    phase = Phase::Open;
                    log::info!("connected to {}:{}", self.settings.host, self.settings.port);
                    self.transmit(&link, Kind::Presence, self.presence(Presence::Online));
                    self.session += 1;
                    self.report(Report::Opened { session: self.session });
                }
                Signal::Sent(packet) => {
                    if let Some(sent) = self.in_flight.iter_mut().find(|m| m.packet.is_none()) {
                        sent.packet = Some(packet);
                    }
                }
                Signal::Taken(packet) => self.taken(packet),
                Signal::Refused(packet, reason) => self.refused(packet, &reason),
                Signal::Ended(reason) => return Ok(reason),
                Signal::Other => {}
                Signal::Quiet => match phase {
                    Phase::Connecting => return Err("no answer".to_owned()),
                    Phase::Leaving { until } if Instant::now() >= until => {
                        return Ok("stopped".to_owned());
                    }
                    Phase::Open | Phase::Leaving { .. } => {}
                },
            }
        }
    }

    fn presence(&self, state: Presence) -> Message {
        let topic = Topic::Presence.under(&self.settings.root);
        Message { topic, payload: state.text().into(), retain: true }
    }

    /// Sends what waits, as far as it may go ahead.
    fn pump(&mut self, link: &Link) {
        while self.in_flight.len() < IN_FLIGHT {
            let next = self.queue.pop_front().or_else(|| self.arrears.pop_front());
            let Some(Sending { kind, message, .. }) = next else { break };
            self.transmit(link, kind, message);
        }
    }

    /// Whether the connection is to end, and everything is delivered or the time is up.
    fn is_done(&self) -> bool {
        let delivered = self.in_flight.is_empty() && self.queue.is_empty();
        let end = self.stop_at.or(self.change.as_ref().map(|&(_, at)| at));
        end.is_some_and(|end| delivered || Instant::now() >= end)
    }

    fn transmit(&mut self, link: &Link, kind: Kind, message: Message) {
        let sending = Sending { kind, message, packet: None };
        // The link holds twice what may be in flight: it is never full.
        if link.publish(&sending.message) {
            self.in_flight.push_back(sending);
        } else {
            self.queue.push_front(sending);
        }
    }

    fn remove(&mut self, packet: u16) -> Option<Sending> {
        let index = self.in_flight.iter().position(|m| m.packet == Some(packet))?;
        self.in_flight.remove(index)
    }

    fn taken(&mut self, packet: u16) {
        let Some(sent) = self.remove(packet) else { return };
        self.backoff.reset();
        if sent.kind != Kind::Presence {
            self.statistics.delivered.fetch_add(1, Ordering::Relaxed);
        }
        if let Kind::Window { key } = sent.kind {
            self.report(Report::Taken { key });
        }
    }

    fn refused(&mut self, packet: u16, reason: &str) {
        let Some(sent) = self.remove(packet) else { return };
        let refused: &AtomicU64 = &self.statistics.refused;
        if refused.fetch_add(1, Ordering::Relaxed) == 0 {
            log::error!(
                "the broker refuses {}: {reason}; allow this client to publish there. Windows \
                 stay in the spool",
                sent.message.topic
            );
        }
    }

    fn report(&self, report: Report) {
        // The handle outlives this thread: `stop` joins it first.
        let _ = self.reports.send(report);
    }

    /// Forgets the session's windows; states go to the next one, in their order.
    fn end_session(&mut self) {
        let sent = std::mem::take(&mut self.in_flight);
        let waiting = std::mem::take(&mut self.queue);
        self.arrears.clear();
        for sending in sent.into_iter().chain(waiting) {
            if sending.kind == Kind::State {
                self.keep_state(sending.message);
            }
        }
        // Windows that are still given to this session are refused from here on.
        self.session += 1;
        self.report(Report::Closed);
    }

    /// Takes new commands without waiting.
    fn collect(&mut self) {
        loop {
            match self.commands.try_recv() {
                Ok(command) => self.accept(command),
                Err(TryRecvError::Empty) => return,
                // Nobody is there to hear of it: it ends without a goodbye's patience.
                Err(TryRecvError::Disconnected) => {
                    self.stop_at.get_or_insert_with(Instant::now);
                    return;
                }
            }
        }
    }

    /// Takes new commands for `wait`, or until a stop or a change is asked for.
    fn rest(&mut self, wait: Duration) {
        let until = Instant::now() + wait;
        while self.stop_at.is_none() && self.change.is_none() {
            let left = until.saturating_duration_since(Instant::now());
            match self.commands.recv_timeout(left) {
                Ok(command) => self.accept(command),
                Err(RecvTimeoutError::Timeout) => return,
                Err(RecvTimeoutError::Disconnected) => self.stop_at = Some(Instant::now()),
            }
        }
    }

    fn accept(&mut self, command: Command) {
        match command {
            Command::Stop { within } => self.stop_at = Some(Instant::now() + within),
            Command::Change { settings, .. } if *settings == self.settings => self.change = None,
            Command::Change { settings, within } => {
                self.change = Some((settings, Instant::now() + within));
            }
            Command::State(message) => self.keep_state(message),
            // Of a session that has ended: the spool gives it again.
            Command::Window { session, .. } if session != self.session => {}
            Command::Window { key, live, message, .. } => {
                let kind = Kind::Window { key };
                let queue = if live { &mut self.queue } else { &mut self.arrears };
                queue.push_back(Sending { kind, message, packet: None });
            }
        }
    }

    fn keep_state(&mut self, message: Message) {
        // Only the latest state of a topic is of use.
        self.queue.retain(|waiting| waiting.message.topic != message.topic);
        if self.queue.iter().filter(|waiting| waiting.kind == Kind::State).count() < MAX_STATES {
            self.queue.push_back(Sending { kind: Kind::State, message, packet: None });
        }
    }
}
