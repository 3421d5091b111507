//! An RTSP session (RFC 2326) over one TCP connection, with the media in between (interleaved).
//!
//! Owns requests and answers, the login, keeping the session alive, and its end. It sets up one
//! stream; UDP is not used, so that no port is opened and no packet lost on the way. This client
//! is our own because it must be bounded: whatever a server sends, a session holds one message or
//! packet of it.

use super::sdp::{self, Codec, Video};
use crate::daemon::address::{Address, Protocol};
use crate::daemon::capture::network::connection::Connection;
use crate::daemon::capture::network::head::{self, Head};
use crate::daemon::capture::network::login::Login;
use crate::daemon::capture::network::{CameraSettings, Fault};
use crate::daemon::dial;
use crate::daemon::foreign::shown;
use std::io::{self, Read, Write};
use std::time::{Duration, Instant};

/// Longest head of an answer, bytes.
const MAX_HEAD: usize = 16 << 10;
/// Longest body: a description.
const MAX_BODY: usize = 64 << 10;
/// Bytes that belong to nothing and are passed over before a connection is given up.
const MAX_RUBBISH: usize = 256 << 10;
/// Bytes that are read at once.
const CHUNK: usize = 16 << 10;
/// Time after which a session ends that says no other, s (RFC 2326, section 12.37).
const SESSION_S: u64 = 60;
/// Most messages and packets that are passed over while an answer is waited for.
const MAX_PASSED: usize = 10_000;

/// An event of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// A packet of the stream lies in [`Session::packet`].
    Packet,
    /// Nothing came for a moment.
    Quiet,
}

/// A session that plays.
#[derive(Debug)]
pub struct Session {
    connection: Connection,
    address: Address,
    buffer: Vec<u8>,
    start: usize,
    /// Where the latest packet lies in the buffer.
    packet: std::ops::Range<usize>,
    rubbish: usize,
    /// Bytes that came in place of the first answer.
    strange: Vec<u8>,
    number: u32,
    id: Option<String>,
    /// The channel of the stream's packets.
    channel: u8,
    /// Where the session is played.
    aggregate: String,
    keep_alive: Duration,
    sent: Instant,
}

/// A message in the buffer: an answer, or something else.
enum Message {
    Answer(Head, Vec<u8>),
    Packet(u8, std::ops::Range<usize>),
    /// A server's own request, or a packet that is passed over.
    Other,
}

impl Session {
    /// Describes, sets up and plays the camera's video.
    ///
    /// # Errors
    /// [`Fault`], within the camera's time limit.
    pub fn play(settings: &CameraSettings, login: &mut Login) -> Result<(Self, Video), Fault> {
        login.ready(Instant::now())?;
        let mut address = settings.address.clone();
        for _ in 0..2 {
            match Self::try_play(settings, &address, login)? {
                Outcome::Plays(session, video) => return Ok((*session, *video)),
                Outcome::Redirected(there) => address = there,
            }
        }
        Err(Fault::Redirects("more than once".to_owned()))
    }

    fn try_play(
        settings: &CameraSettings,
        address: &Address,
        login: &mut Login,
    ) -> Result<Outcome, Fault> {
        let connection = Connection::open(address, &settings.trust, settings.timeout)?;
        let uri = address.uri();
        let mut session = Self {
            connection,
            address: address.clone(),
            buffer: Vec::new(),
            start: 0,
            packet: 0..0,
            rubbish: 0,
            strange: Vec::new(),
            number: 0,
            id: None,
            channel: 0,
            aggregate: uri.clone(),
            keep_alive: Duration::from_secs(SESSION_S / 2),
            sent: Instant::now(),
        };
        let described = session.ask(login, "DESCRIBE", &uri, "Accept: application/sdp\r\n")?;
        let (head, body) = described;
        if (301..=308).contains(&head.status) {
            let there = head.get("location").map(Address::parse);
            return match there {
                Some(Ok(there)) if there.protocol == Protocol::Rtsp => {
                    let is_known = |host: &String| host.eq_ignore_ascii_case(&there.host);
                    if is_known(&settings.address.host)
                        || settings.redirect_hosts.iter().any(is_known)
                    {
                        Ok(Outcome::Redirected(there))
                    } else {
                        Err(Fault::RedirectedAway { host: shown(&there.host) })
                    }
                }
                _ => Err(Fault::Redirects("to what is no RTSP address".to_owned())),
            };
        }
        success(&head)?;
        let text = String::from_utf8_lossy(&body);
        let video = sdp::video(&text).ok_or_else(|| {
            Fault::NoPicture("the camera's description has no video: is the path right?".to_owned())
        })?;
        if let Codec::Other(name) = &video.codec {
            return Err(Fault::NoPicture(sdp::unread(name)));
        }
        let base = [head.get("content-base"), head.get("content-location")];
        let base =
            base.into_iter().flatten().find(|base| base.to_ascii_lowercase().starts_with("rtsp"));
        let base = base.unwrap_or(&uri).to_owned();
        session.aggregate = sdp::resolve(&base, video.session_control.as_deref());
        let control = sdp::resolve(&base, video.control.as_deref());
        let transport = "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\n";
        let (head, _) = session.ask(login, "SETUP", &control, transport)?;
        success(&head)?;
        session.set_up(&head);
        let aggregate = session.aggregate.clone();
        let (head, _) = session.ask(login, "PLAY", &aggregate, "Range: npt=0.000-\r\n")?;
        success(&head)?;
        login.accepted();
        Ok(Outcome::Plays(Box::new(session), Box::new(video)))
    }

    /// Takes what the answer to SETUP says.
    fn set_up(&mut self, head: &Head) {
        if let Some(value) = head.get("session") {
            let mut parts = value.split(';');
            self.id = parts.next().map(|id| id.trim().to_owned());
            let seconds =
                parts.find_map(|part| part.trim().strip_prefix("timeout=")?.parse::<u64>().ok());
            // Half of it, and often enough for cameras that mean less than they say.
            let seconds = seconds.unwrap_or(SESSION_S).clamp(4, 60);
            self.keep_alive = Duration::from_secs(seconds) / 2;
        }
        let channel = head.get("transport").and_then(|value| {
            let value =
                value.split(';').find_map(|part| part.trim().strip_prefix("interleaved="))?;
            value.split(['-', ',']).next()?.trim().parse().ok()
        });
        self.channel = channel.unwrap_or(0);
    }

    /// The latest packet.
    pub fn packet(&self) -> &[u8] {
        &self.buffer[self.packet.clone()]
    }

    /// Waits for the next packet of the stream, and keeps the session alive.
    ///
    /// # Errors
    /// [`Fault`]: the session is over.
    pub fn next(&mut self, login: &mut Login, limit: Duration) -> Result<Event, Fault> {
        if self.sent.elapsed() >= self.keep_alive {
            let uri = self.aggregate.clone();
            self.send(login, "OPTIONS", &uri, "")?;
        }
        self.connection.set_limit(limit);
        loop {
            while let Some(message) = self.message()? {
                match message {
                    Message::Packet(channel, range) if channel == self.channel => {
                        self.packet = range;
                        self.rubbish = 0;
                        return Ok(Event::Packet);
                    }
                    Message::Answer(head, _) => match head.status {
                        401 => login.challenged(&head, true, self.address.secure)?,
                        454 => {
                            return Err(Fault::Broken(
                                "the camera has ended the session".to_owned(),
                            ));
                        }
                        _ => login.passed(),
                    },
                    Message::Packet(..) | Message::Other => {}
                }
            }
            if !self.fill("packet")? {
                return Ok(Event::Quiet);
            }
        }
    }

    /// Ends the session at the camera, which may have few of them. The answer is not awaited.
    pub fn end(&mut self, login: &mut Login) {
        if self.id.is_some() {
            self.connection.set_limit(Duration::from_millis(500));
            let uri = self.aggregate.clone();
            let _ = self.send(login, "TEARDOWN", &uri, "");
        }
    }

    /// Sends a request and waits for its answer, once more where a login is asked for.
    fn ask(
        &mut self,
        login: &mut Login,
        method: &'static str,
        uri: &str,
        lines: &str,
    ) -> Result<(Head, Vec<u8>), Fault> {
        for _ in 0..3 {
            let with_login = self.send(login, method, uri, lines)?;
            let (head, body) = self.answer()?;
            if head.status != 401 {
                login.passed();
                return Ok((head, body));
            }
            login.challenged(&head, with_login, self.address.secure)?;
        }
        Err(Fault::Status { protocol: "RTSP", status: 401 })
    }

    /// Sends a request; whether it held a login.
    fn send(
        &mut self,
        login: &mut Login,
        method: &'static str,
        uri: &str,
        lines: &str,
    ) -> Result<bool, Fault> {
        self.number += 1;
        self.sent = Instant::now();
        let uri: String = uri.chars().filter(|c| c.is_ascii_graphic()).collect();
        let answer = login.answer(method, &uri);
        let with_login = answer.is_some();
        let mut text = format!(
            "{method} {uri} RTSP/1.0\r\nCSeq: {}\r\nUser-Agent: verge/{}\r\n{lines}",
            self.number,
            env!("CARGO_PKG_VERSION")
        );
        if let Some(id) = self.id.as_ref().filter(|id| id.chars().all(|c| !c.is_control())) {
            text.push_str(&format!("Session: {id}\r\n"));
        }
        if let Some(answer) = answer {
            text.push_str(&format!("Authorization: {answer}\r\n"));
        }
        text.push_str("\r\n");
        let sent =
            self.connection.write_all(text.as_bytes()).and_then(|()| self.connection.flush());
        sent.map_err(|error| self.connection.fault(&error, "answer"))?;
        Ok(with_login)
    }

    /// Waits for the answer to the latest request; packets in front of it are passed over.
    fn answer(&mut self) -> Result<(Head, Vec<u8>), Fault> {
        let mut passed = 0;
        loop {
            while let Some(message) = self.message()? {
                passed += 1;
                if passed > MAX_PASSED {
                    return Err(Fault::Timeout { what: "answer", waited: self.connection.limit() });
                }
                if let Message::Answer(head, body) = message {
                    let number =
                        head.get("cseq").and_then(|number| number.trim().parse::<u32>().ok());
                    if number.is_none_or(|number| number == self.number) {
                        return Ok((head, body));
                    }
                }
            }
            self.fill("answer")?;
        }
    }

    /// Takes the next message out of the buffer, where a whole one is there.
    fn message(&mut self) -> Result<Option<Message>, Fault> {
        loop {
            let bytes = &self.buffer[self.start..];
            match bytes {
                [] => return Ok(None),
                [b'$', rest @ ..] => {
                    let &[channel, high, low, ..] = rest else { return Ok(None) };
                    let length = usize::from(u16::from_be_bytes([high, low]));
                    if rest.len() < 3 + length {
                        return Ok(None);
                    }
                    let from = self.start + 4;
                    self.start = from + length;
                    return Ok(Some(Message::Packet(channel, from..from + length)));
                }
                _ if bytes[0].is_ascii_uppercase() => {
                    let Some((end, next)) = head::end(bytes) else {
                        if bytes.len() > MAX_HEAD {
                            let begins = head::beginning(bytes);
                            return Err(Fault::Protocol { protocol: "RTSP", begins });
                        }
                        return Ok(None);
                    };
                    let parsed = Head::parse(&bytes[..end], "RTSP");
                    if parsed.is_none() && self.number < 2 && !is_request(&bytes[..end]) {
                        let begins = head::beginning(bytes);
                        return Err(Fault::Protocol { protocol: "RTSP", begins });
                    }
                    // A server's own request has a body as well, and is not answered.
                    let length = match &parsed {
                        Some(head) => head.content_length().unwrap_or(0),
                        None => 0,
                    };
                    let length = usize::try_from(length).unwrap_or(usize::MAX);
                    if length > MAX_BODY {
                        return Err(Fault::TooLarge);
                    }
                    let Some(body) = bytes.get(next..next + length) else { return Ok(None) };
                    let body = body.to_vec();
                    self.start += next + length;
                    return Ok(Some(match parsed {
                        Some(head) => Message::Answer(head, body),
                        None => Message::Other,
                    }));
                }
                _ => {
                    // Rubbish between messages: on to what may begin one.
                    let skip =
                        bytes.iter().skip(1).take_while(|b| **b != b'$' && **b != b'R').count() + 1;
                    self.rubbish += skip;
                    if self.strange.is_empty() && self.number < 2 {
                        self.strange = bytes[..bytes.len().min(64)].to_vec();
                    }
                    if self.rubbish > MAX_RUBBISH || self.number < 2 && self.rubbish > 64 {
                        let begins = head::beginning(bytes);
                        return Err(Fault::Protocol { protocol: "RTSP", begins });
                    }
                    self.start += skip;
                }
            }
        }
    }

    /// Reads more; false where nothing came for a moment.
    fn fill(&mut self, what: &'static str) -> Result<bool, Fault> {
        self.buffer.drain(..self.start);
        self.start = 0;
        let len = self.buffer.len();
        self.buffer.resize(len + CHUNK, 0);
        let read = self.connection.read(&mut self.buffer[len..]);
        self.buffer.truncate(len + *read.as_ref().unwrap_or(&0));
        match read {
            Ok(0) if self.strange.is_empty() => {
                Err(Fault::Broken("the camera closed it".to_owned()))
            }
            Ok(0) => {
                let begins = head::beginning(&self.strange);
                Err(Fault::Protocol { protocol: "RTSP", begins })
            }
            Ok(_) => Ok(true),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(false),
            Err(error) if dial::is_timeout(&error) => {
                Err(Fault::Timeout { what, waited: self.connection.limit() })
            }
            Err(error) => Err(self.connection.fault(&error, what)),
        }
    }
}

enum Outcome {
    Plays(Box<Session>, Box<Video>),
    Redirected(Address),
}

fn success(head: &Head) -> Result<(), Fault> {
    let status = head.status;
    if status / 100 == 2 { Ok(()) } else { Err(Fault::Status { protocol: "RTSP", status }) }
}

/// Whether a head is a request: its first line ends in the protocol's name.
fn is_request(head: &[u8]) -> bool {
    let line = head.split(|&byte| byte == b'\n').next().unwrap_or_default();
    String::from_utf8_lossy(line).trim_end().ends_with("RTSP/1.0")
}
