//! The life of sessions: connect, send in order, hear acknowledgements, back off.
//!
//! Owns reconnection, and what is sent when; `verdict` draws the consequences of a broker's
//! behaviour. `outbox` has the queues, `bans` the messages set aside, `echo` the proof that 3.1.1
//! lacks. States (health, alarms, discovery) are kept until a broker has them; windows live in a
//! session and no longer, for the spool has them and gives them again to the next.

mod verdict;

use super::backoff::Backoff;
use super::bans::Bans;
use super::echo::Echo;
use super::link::{End, Link};
use super::outbox::{Kind, Outbox, Sending, States};
use super::packet::{Incoming, Limits, Spoken};
use super::ways::Ways;
use super::{Command, Message, MqttSettings, Report, Statistics, said_of};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, TryRecvError};
use std::time::{Duration, Instant};
use verge_messages::{Presence, Topic};

/// How often the thread looks for new messages while it is connected.
const TICK: Duration = Duration::from_millis(50);
/// Longest wait for the last words of a connection to leave.
const GOODBYE: Duration = Duration::from_secs(1);
/// How long states wait in a session whose predecessor ended on a message: the spool's windows, which are
/// given once it is open, go before what may end it again.
const WINDOWS_FIRST: Duration = Duration::from_secs(2);
/// A session that has lasted so long is a good one.
const QUIET: Duration = Duration::from_secs(60);

/// One session, from the broker's yes on.
struct Session {
    link: Link,
    limits: Limits,
    echo: Echo,
    since: Instant,
    leaving: Option<Instant>,
}

pub(super) struct Worker {
    settings: MqttSettings,
    commands: Receiver<Command>,
    reports: Sender<Report>,
    statistics: Arc<Statistics>,
    backoff: Backoff,
    ways: Ways,
    bans: Bans,
    outbox: Outbox,
    session: u64,
    /// One message at a time: a connection has ended, and it is not known on which.
    careful: bool,
    /// A broker that closes on subscriptions is asked for none.
    echoes: bool,
    early_ends: u32,
    /// Facts that were logged once: topics without a subscriber, sizes, and the like.
    said: BTreeSet<String>,
    /// Settings for the next connection, when this one is done or at that time.
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
            ways: Ways::new(settings.version),
            settings,
            commands,
            reports,
            statistics,
            backoff: Backoff::new(),
            bans: Bans::default(),
            outbox: Outbox::default(),
            session: 0,
            careful: false,
            echoes: true,
            early_ends: 0,
            said: BTreeSet::new(),
            change: None,
            stop_at: None,
        }
    }

    pub(super) fn run(mut self) {
        let mut random = fastrand::Rng::new();
        loop {
            let reason = self.life();
            self.collect();
            self.end_session();
            if self.stop_at.is_some() {
                return;
            }
            if let Some((settings, _)) = self.change.take() {
                self.begin_anew(*settings);
                continue;
            }
            let Some(reason) = reason else { continue };
            let wait = self.backoff.wait(&mut random, Instant::now());
            self.ways.rested();
            let MqttSettings { host, port, .. } = &self.settings;
            log::warn!(
                "broker {host}:{port}: {reason}; next attempt in {:.1} s",
                wait.as_secs_f64()
            );
            self.rest(wait);
        }
    }

    fn begin_anew(&mut self, settings: MqttSettings) {
        self.ways = Ways::new(settings.version);
        self.settings = settings;
        self.backoff = Backoff::new();
        (self.bans, self.said) = (Bans::default(), BTreeSet::new());
        (self.careful, self.echoes, self.early_ends) = (false, true, 0);
    }

    /// One connection from its beginning to its end; returns why it ended, or nothing where the
    /// next one is to follow at once, in other words.
    fn life(&mut self) -> Option<String> {
        self.statistics.beat();
        let (spoken, retains) = self.ways.now();
        let will = self.presence(Presence::Offline, retains);
        let id = self.settings.client_id();
        let link = match Link::open(&self.settings, spoken, &id, will) {
            Ok(link) => link,
            Err(end) => {
                if matches!(end, End::Unreachable(_)) {
                    // It was away, or is another one: nothing that went wrong before counts.
                    self.backoff.away();
                    self.early_ends = 0;
                }
                return Some(end.reason());
            }
        };
        self.backoff.connected(Instant::now());
        let (mut link, limits) = match self.knock(link, spoken) {
            Ok(Some(accepted)) => accepted,
            Ok(None) => return None,
            Err(reason) => return Some(reason),
        };
        let retains = retains && limits.retains;
        self.ways.accepted(limits.retains);
        if let Some(seconds) = limits.keep_alive_s {
            link.keep_alive_within(Duration::from_secs(u64::from(seconds)));
        }
        let now = Instant::now();
        let presence = Topic::Presence.under(&self.settings.root);
        let wanted = spoken == Spoken::V3 && self.echoes;
        let limits = Limits { retains, ..limits };
        let echo = Echo::new(wanted, presence, now);
        let mut session = Session { link, limits, echo, since: now, leaving: None };
        self.opened(&session);
        let end = self.serve(&mut session).unwrap_or_else(|end| end);
        Some(self.judge(&session, &end))
    }

    /// Waits for the broker's answer to our first packet.
    fn knock(&mut self, mut link: Link, spoken: Spoken) -> Result<Option<(Link, Limits)>, String> {
        let until = Instant::now() + super::link::CONNECT;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            match link.next(left.max(Duration::from_millis(1))) {
                Ok(Some(Incoming::Accepted(limits))) => return Ok(Some((link, limits))),
                Ok(Some(Incoming::Denied(denial))) => {
                    if self.ways.denied(&denial) {
                        let said = said_of(&denial, &self.settings, spoken);
                        log::info!("another way to the broker: {said}");
                        return Ok(None);
                    }
                    return Err(said_of(&denial, &self.settings, spoken));
                }
                Ok(Some(_)) => return Err("it answers with something else than yes or no".into()),
                Ok(None) if left.is_zero() => return Err("no answer to our first packet".into()),
                Ok(None) => {}
                Err(End::Closed) => {
                    self.ways.closed();
                    let tls = match self.settings.tls {
                        None => "; does it want TLS (mqtt.tls = true)?",
                        Some(_) => "; does it want a certificate of the box?",
                    };
                    return Err(format!("it closed the connection in place of an answer{tls}"));
                }
                Err(end) => return Err(end.reason()),
            }
        }
    }

    fn opened(&mut self, session: &Session) {
        let MqttSettings { host, port, .. } = &self.settings;
        log::info!("connected to {host}:{port}");
        if !session.limits.retains && self.said.insert("retain".to_owned()) {
            log::warn!(
                "the broker keeps no retained messages: who subscribes later misses presence, \
                 health and alarms until the next of them"
            );
        }
        self.bans.begin();
        self.outbox.first(Kind::Presence, self.presence(Presence::Online, true));
        self.session += 1;
        self.report(Report::Opened { session: self.session });
    }

    /// A session until it ends.
    fn serve(&mut self, session: &mut Session) -> Result<End, End> {
        loop {
            self.statistics.beat();
            let now = Instant::now();
            if session.leaving.is_none() {
                self.collect();
                self.pump(session, now)?;
                if self.is_done(now) {
                    let shutdown = self.presence(Presence::Shutdown, session.limits.retains);
                    let packet = session.link.publish(&shutdown)?;
                    let sending = Sending { kind: Kind::Presence, message: shutdown };
                    self.outbox.sent(sending, packet, now);
                    session.leaving = Some(now + GOODBYE);
                }
            } else if session.leaving.is_some_and(|until| now >= until || self.outbox.is_idle()) {
                session.link.disconnect();
                return Ok(End::Told("stopped".to_owned()));
            }
            if let Some(incoming) = session.link.next(TICK)? {
                self.hear(session, incoming)?;
            }
            if let Some(verdict) = session.echo.tick(Instant::now()) {
                self.follow(verdict);
            }
            let patience = 2 * self.settings.keep_alive;
            if let Some(sent) = self.outbox.oldest_in_flight().filter(|at| at.elapsed() > patience)
            {
                return Ok(End::Broken(format!(
                    "the broker acknowledges nothing for {} s",
                    sent.elapsed().as_secs()
                )));
            }
            if session.since.elapsed() > QUIET && (self.careful || self.early_ends > 0) {
                (self.careful, self.early_ends) = (false, 0);
            }
            if session.since.elapsed() > QUIET {
                self.backoff.reset();
            }
        }
    }

    fn presence(&self, state: Presence, retain: bool) -> Message {
        let topic = Topic::Presence.under(&self.settings.root);
        Message { topic, payload: state.text().into(), retain }
    }

    /// Sends what waits, as far as it may go ahead.
    fn pump(&mut self, session: &mut Session, now: Instant) -> Result<(), End> {
        let (most, states) = match self.careful {
            true if session.since.elapsed() < WINDOWS_FIRST => (1, States::Wait),
            true => (1, States::Last),
            false => (session.limits.in_flight, States::BeforeArrears),
        };
        while let Some(mut sending) = self.outbox.next(most, states) {
            let size = sending.message.payload.len();
            let topic = sending.message.topic.clone();
            // Topic, packet id, header, and properties of a byte.
            let whole = size + topic.len() + 12;
            if whole > session.limits.packet {
                if self.said.insert(format!("size {topic}")) {
                    log::error!(
                        "the broker takes packets of {} bytes at most, and {topic} has {whole}: it is \
                         set aside. Raise the broker's limit. Windows stay in the spool",
                        session.limits.packet
                    );
                }
                self.statistics.refused.fetch_add(1, Ordering::Relaxed);
                self.set_aside(&sending);
                continue;
            }
            if self.bans.forbid(&self.family(&topic), size, now) {
                self.set_aside(&sending);
                continue;
            }
            if !matches!(sending.kind, Kind::State) && session.echo.asks(&topic) {
                session.link.subscribe(&topic)?;
            }
            sending.message.retain &= session.limits.retains;
            let sent = session.link.publish(&sending.message);
            self.outbox.sent(sending, sent.as_ref().ok().copied().unwrap_or_default(), now);
            sent?;
        }
        Ok(())
    }

    /// Under which name a topic is set aside: its own, and for discovery one for all, of which a broker
    /// takes each or none.
    fn family(&self, topic: &str) -> String {
        if topic.starts_with(&self.settings.root) {
            return topic.to_owned();
        }
        format!("{}/#", topic.split('/').next().unwrap_or_default())
    }

    /// Whether the connection is to end, and everything is delivered or the time is up.
    fn is_done(&self, now: Instant) -> bool {
        let end = self.stop_at.or(self.change.as_ref().map(|&(_, at)| at));
        end.is_some_and(|end| self.outbox.is_delivered() || now >= end)
    }

    fn report(&self, report: Report) {
        // The handle outlives this thread: `stop` joins it first.
        let _ = self.reports.send(report);
    }

    /// Forgets the session's windows; states go to the next one, in their order.
    fn end_session(&mut self) {
        self.outbox.end_session();
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
            self.statistics.beat();
            let left = until.saturating_duration_since(Instant::now());
            match self.commands.recv_timeout(left.min(Duration::from_secs(1))) {
                Ok(command) => self.accept(command),
                Err(RecvTimeoutError::Timeout) if left.is_zero() => return,
                Err(RecvTimeoutError::Timeout) => {}
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
            Command::State(message) => self.outbox.state(message),
            // Of a session that has ended: the spool gives it again.
            Command::Window { session, .. } if session != self.session => {}
            Command::Window { key, live, message, .. } => self.outbox.window(key, live, message),
        }
    }
}
