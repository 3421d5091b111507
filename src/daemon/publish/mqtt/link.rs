//! One connection to a broker: TCP, TLS where it is asked for, packets in and out.
//!
//! Owns the socket and its time limits, pings, and the words for the end of a connection. `worker`
//! decides what is sent and when, `packet` makes the bytes. Every connection starts clean: we send
//! again what was not acknowledged.
//!
//! The sockets are blocking ones of our own, and not those of an MQTT client: so one packet is
//! held at a time whatever a broker sends, and each address of a name gets its turn.

use super::packet::{self, Incoming, MAX_INCOMING, Spoken};
use super::{Message, MqttSettings, tls};
use crate::daemon::dial::{self, Timed};
use bytes::BytesMut;
use rustls::pki_types::ServerName;
use rustls::{ClientConnection, StreamOwned};
use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// Longest wait for a connection and for the broker's answer.
pub(super) const CONNECT: Duration = Duration::from_secs(10);
/// Longest wait until the broker takes bytes.
const WRITE: Duration = Duration::from_secs(10);

/// Why a connection is over, or did not come about.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum End {
    /// The host could not be reached: there is no broker, or the way to it is broken.
    Unreachable(String),
    /// No trust, or no TLS at all.
    Unsafe(String),
    /// The broker has closed it, without a reason.
    Closed,
    /// The broker has ended it, with a reason.
    Told(String),
    /// The broker does not keep to the protocol, or says nothing for too long.
    Broken(String),
}

impl End {
    /// The reason, for people.
    pub(super) fn reason(&self) -> String {
        match self {
            Self::Closed => "the broker closed the connection".to_owned(),
            Self::Told(reason) => format!("the broker ends the session: {reason}"),
            Self::Unreachable(reason) | Self::Unsafe(reason) | Self::Broken(reason) => {
                reason.clone()
            }
        }
    }
}

#[derive(Debug)]
enum Stream {
    Plain(Timed),
    Secure(Box<StreamOwned<ClientConnection, Timed>>),
}

/// One connection.
#[derive(Debug)]
pub(super) struct Link {
    spoken: Spoken,
    stream: Stream,
    arrived: BytesMut,
    /// Whether the broker has said anything that is a packet.
    has_answered: bool,
    last_packet: u16,
    keep_alive: Duration,
    sent: Instant,
    heard: Instant,
    /// Since when a ping waits for its answer.
    pinged: Option<Instant>,
}

impl Link {
    /// Begins a connection and asks to be let in; `will` is what the broker says when it breaks.
    pub(super) fn open(
        settings: &MqttSettings,
        spoken: Spoken,
        client_id: &str,
        will: Message,
    ) -> Result<Self, End> {
        let deadline = Instant::now() + CONNECT;
        let (host, port) = (settings.host.as_str(), settings.port);
        let addresses = dial::resolve(host, port, CONNECT)
            .map_err(|reason| End::Unreachable(format!("no address of {host:?}: {reason}")))?;
        let socket = dial::connect(&addresses, deadline, CONNECT).map_err(|reason| {
            End::Unreachable(format!("{reason}; is it running, and are host and port right?"))
        })?;
        // Messages are short, and each waits for an answer.
        let _ = socket.set_nodelay(true);
        let stream = match &settings.tls {
            None => Stream::Plain(Timed::new(socket)),
            Some(tls) => Stream::Secure(secured(socket, tls, host, deadline)?),
        };
        let now = Instant::now();
        let mut link = Self {
            spoken,
            stream,
            arrived: BytesMut::with_capacity(4096),
            has_answered: false,
            last_packet: 0,
            keep_alive: settings.keep_alive,
            sent: now,
            heard: now,
            pinged: None,
        };
        let connect = packet::connect(spoken, settings, client_id, will);
        link.send(connect)?;
        Ok(link)
    }

    /// The broker wants to hear from us at least this often.
    pub(super) fn keep_alive_within(&mut self, keep_alive: Duration) {
        self.keep_alive = self.keep_alive.min(keep_alive.max(Duration::from_secs(1)));
    }

    /// Sends a message and returns its packet id.
    pub(super) fn publish(&mut self, message: &Message) -> Result<u16, End> {
        let id = self.next_packet();
        self.send(packet::publish(self.spoken, id, message))?;
        Ok(id)
    }

    /// Asks for what is published on a topic.
    pub(super) fn subscribe(&mut self, topic: &str) -> Result<(), End> {
        let id = self.next_packet();
        self.send(packet::subscribe(self.spoken, id, topic))
    }

    /// Asks for it no more.
    pub(super) fn unsubscribe(&mut self, topic: &str) -> Result<(), End> {
        let id = self.next_packet();
        self.send(packet::unsubscribe(self.spoken, id, topic))
    }

    /// Says goodbye.
    pub(super) fn disconnect(&mut self) {
        let _ = self.send(Some(packet::disconnect()));
        if let Stream::Secure(secure) = &mut self.stream {
            secure.conn.send_close_notify();
            let _ = secure.flush();
        }
    }

    /// The broker's next packet, within `patience`; `None` where none comes.
    pub(super) fn next(&mut self, patience: Duration) -> Result<Option<Incoming>, End> {
        self.ping()?;
        if let Some(incoming) = self.take()? {
            return Ok(Some(incoming));
        }
        let mut bytes = [0; 4096];
        self.set_until(Instant::now() + patience);
        let read = match &mut self.stream {
            Stream::Plain(socket) => socket.read(&mut bytes),
            Stream::Secure(secure) => secure.read(&mut bytes),
        };
        match read {
            Ok(0) => Err(self.closed()),
            Ok(len) => {
                self.arrived.extend_from_slice(&bytes[..len]);
                self.take()
            }
            Err(error) if dial::is_timeout(&error) => Ok(None),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => Ok(None),
            Err(error) => Err(self.broken(&error)),
        }
    }

    /// The next packet of what has arrived.
    fn take(&mut self) -> Result<Option<Incoming>, End> {
        if !self.has_answered
            && let Some(stranger) = stranger(&self.arrived)
        {
            return Err(End::Broken(stranger.to_owned()));
        }
        // More than a packet and its header is never waited for.
        debug_assert!(self.arrived.len() <= 2 * MAX_INCOMING);
        let incoming = packet::read(self.spoken, &mut self.arrived)
            .map_err(|reason| End::Broken(format!("the broker breaks the protocol: {reason}")))?;
        let Some(incoming) = incoming else { return Ok(None) };
        (self.has_answered, self.heard, self.pinged) = (true, Instant::now(), None);
        match incoming {
            Incoming::Closing(reason) => Err(End::Told(reason)),
            Incoming::Echo { packet: Some(id), .. } => {
                self.send(packet::acknowledge(self.spoken, id))?;
                Ok(Some(incoming))
            }
            incoming => Ok(Some(incoming)),
        }
    }

    /// Lets the broker know that we are there, and looks whether it is.
    fn ping(&mut self) -> Result<(), End> {
        if self.pinged.is_some_and(|at| at.elapsed() > self.keep_alive) {
            let silent = self.heard.elapsed().as_secs();
            return Err(End::Broken(format!("the broker has said nothing for {silent} s")));
        }
        // Three quarters: it must be there before the whole time is over.
        let idle = self.sent.elapsed().max(self.heard.elapsed());
        if self.has_answered && self.pinged.is_none() && idle >= self.keep_alive.mul_f32(0.75) {
            self.send(Some(packet::ping()))?;
            self.pinged = Some(Instant::now());
        }
        Ok(())
    }

    fn next_packet(&mut self) -> u16 {
        self.last_packet = self.last_packet.checked_add(1).unwrap_or(1);
        self.last_packet
    }

    fn send(&mut self, packet: Option<BytesMut>) -> Result<(), End> {
        let bytes = packet.ok_or_else(|| End::Broken("a message that cannot be written".into()))?;
        self.set_until(Instant::now() + WRITE);
        let written = match &mut self.stream {
            Stream::Plain(socket) => socket.write_all(&bytes),
            Stream::Secure(secure) => secure.write_all(&bytes).and_then(|()| secure.flush()),
        };
        self.sent = Instant::now();
        written.map_err(|error| self.broken(&error))
    }

    fn set_until(&mut self, until: Instant) {
        match &mut self.stream {
            Stream::Plain(socket) => socket.set_until(until),
            Stream::Secure(secure) => secure.sock.set_until(until),
        }
    }

    fn closed(&self) -> End {
        if self.has_answered {
            return End::Closed;
        }
        // The worker tries other ways on this one.
        End::Closed
    }

    fn broken(&self, error: &io::Error) -> End {
        if let Some(error) = error.get_ref().and_then(|inner| inner.downcast_ref::<rustls::Error>())
        {
            return tls::end(error);
        }
        match error.kind() {
            io::ErrorKind::ConnectionReset
            | io::ErrorKind::BrokenPipe
            | io::ErrorKind::UnexpectedEof
            | io::ErrorKind::ConnectionAborted => self.closed(),
            kind if kind == io::ErrorKind::WouldBlock || kind == io::ErrorKind::TimedOut => {
                End::Broken("the broker takes no more bytes".to_owned())
            }
            _ => End::Broken(dial::system(error)),
        }
    }
}

/// Who answers in a broker's place.
fn stranger(bytes: &[u8]) -> Option<&'static str> {
    match bytes {
        // An alert of TLS: who speaks it does not understand what we say.
        [0x15, 3, ..] => {
            Some("TLS is spoken at this port: set mqtt.tls = true, or take the plain port (1883)")
        }
        [b'H', b'T', b'T', b'P', ..] => {
            Some("a web server answers at this port: MQTT is usually on 1883, with TLS on 8883")
        }
        [b'S', b'S', b'H', ..] => Some("an SSH server answers at this port"),
        _ => None,
    }
}

fn secured(
    socket: TcpStream,
    tls: &tls::Tls,
    host: &str,
    deadline: Instant,
) -> Result<Box<StreamOwned<ClientConnection, Timed>>, End> {
    let name = ServerName::try_from(host.to_owned())
        .map_err(|_| End::Unsafe(format!("{host:?} cannot be a name in a certificate")))?;
    let client = ClientConnection::new(tls.config(), name).map_err(|error| tls::end(&error))?;
    let mut secure = Box::new(StreamOwned::new(client, Timed::new(socket)));
    secure.sock.set_until(deadline);
    while secure.conn.is_handshaking() {
        let rest = deadline.saturating_duration_since(Instant::now());
        if rest.is_zero() {
            return Err(End::Unsafe(
                "no answer to the TLS handshake: is it TLS at this port (usually 8883)?".into(),
            ));
        }
        match secure.conn.complete_io(&mut secure.sock) {
            Ok(_) => {}
            Err(error) if dial::is_timeout(&error) => {}
            Err(error) => {
                let inner = error.get_ref().and_then(|e| e.downcast_ref::<rustls::Error>());
                return Err(inner.map_or_else(
                    || {
                        End::Unsafe(
                            "the broker broke off the TLS handshake: is it TLS at this port \
                             (usually 8883), and does it want a certificate of the box \
                             (mqtt.certificate_file)?"
                                .to_owned(),
                        )
                    },
                    tls::end,
                ));
            }
        }
    }
    Ok(secure)
}
