//! A broker that misbehaves on request: it speaks enough of MQTT 3.1.1 and 5 to a client that
//! publishes, and notes what came.
#![allow(dead_code, reason = "each test file uses its own part")]

use crate::common::packets::packet;
use std::io::Write;
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Behaviour of a broker towards a client.
#[derive(Clone, Debug, Default)]
pub struct Manners {
    /// Versions that it speaks: 4 (3.1.1), 5, or both where empty.
    pub versions: Vec<u8>,
    /// Closes the connection without an answer on other versions, in place of saying so.
    pub mute: bool,
    /// The answer to CONNECT, where it is not yes.
    pub refuses: Option<u8>,
    /// Closes on CONNECT with a retained will, or says that it keeps none (MQTT 5).
    pub keeps_nothing: bool,
    /// Closes the connection on a publish whose topic has this part.
    pub closes_on: Option<&'static str>,
    /// Closes it on a packet of more bytes.
    pub closes_from: Option<usize>,
    /// Neither acknowledges nor closes on a publish whose topic has this part.
    pub ignores: Option<&'static str>,
    /// Acknowledges a publish with this reason where its topic has this part (MQTT 5).
    pub reason: Option<(&'static str, u8)>,
    /// Acknowledges such a publish, and throws it away.
    pub drops: Option<&'static str>,
    /// Lets nobody read.
    pub deaf: bool,
    /// Properties of CONNACK (MQTT 5).
    pub properties: Vec<u8>,
    /// Sent over and over once the client is in.
    pub flood: Option<Vec<u8>>,
    /// Time between two floods of some 60 KB.
    pub flood_pause: Duration,
    /// Ends each session when it has taken so many windows.
    pub ends_after: Option<usize>,
}

/// Everything that a broker has seen.
#[derive(Debug, Default)]
pub struct Seen {
    /// When each CONNECT came, and in which version.
    pub connects: Vec<(Instant, u8)>,
    /// Topic and payload of each publish that was acknowledged, or taken and not kept.
    pub taken: Vec<(String, Vec<u8>)>,
    /// Topic of each publish that came.
    pub came: Vec<String>,
}

/// A broker on a port of its own; its threads end with the program.
pub struct FakeBroker {
    pub port: u16,
    manners: Arc<Mutex<Manners>>,
    seen: Arc<Mutex<Seen>>,
    open: Arc<Mutex<Vec<TcpStream>>>,
}

impl FakeBroker {
    pub fn start(manners: Manners) -> Self {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
        let port = listener.local_addr().expect("bound").port();
        let manners = Arc::new(Mutex::new(manners));
        let seen = Arc::new(Mutex::new(Seen::default()));
        let (shared, noted) = (Arc::clone(&manners), Arc::clone(&seen));
        let open = Arc::new(Mutex::new(Vec::new()));
        let sockets = Arc::clone(&open);
        std::thread::spawn(move || {
            for stream in listener.incoming().map_while(Result::ok) {
                let (shared, noted) = (Arc::clone(&shared), Arc::clone(&noted));
                sockets.lock().expect("unpoisoned").extend(stream.try_clone());
                std::thread::spawn(move || {
                    let _ = serve(&stream, &shared, &noted);
                    let _ = stream.shutdown(Shutdown::Both);
                });
            }
        });
        Self { port, manners, seen, open }
    }

    /// Changes its manners from the next packet on.
    pub fn change(&self, manners: Manners) {
        *self.manners.lock().expect("unpoisoned") = manners;
    }

    pub fn seen<T>(&self, what: impl FnOnce(&Seen) -> T) -> T {
        what(&self.seen.lock().expect("unpoisoned"))
    }

    pub fn connections(&self) -> usize {
        self.seen(|seen| seen.connects.len())
    }

    /// Closes all connections.
    pub fn hang_up(&self) {
        for stream in self.open.lock().expect("unpoisoned").drain(..) {
            let _ = stream.shutdown(Shutdown::Both);
        }
    }

    /// Time since the latest connection.
    pub fn quiet_for(&self) -> Duration {
        self.seen(|seen| seen.connects.last().map_or(Duration::ZERO, |&(at, _)| at.elapsed()))
    }

    /// Windows that it has taken, live and replayed.
    pub fn windows(&self) -> usize {
        self.seen(|seen| seen.taken.iter().filter(|(t, p)| is_window(t) && !p.is_empty()).count())
    }
}

fn is_window(topic: &str) -> bool {
    topic.contains("density/")
}

fn serve(mut stream: &TcpStream, shared: &Mutex<Manners>, seen: &Mutex<Seen>) -> Option<()> {
    let manners = shared.lock().expect("unpoisoned").clone();
    let note = || seen.lock().expect("unpoisoned");
    let (kind, body) = packet(&mut stream)?;
    assert_eq!(kind, 0x10, "CONNECT comes first");
    if shared.lock().expect("unpoisoned").closes_from.is_some_and(|most| body.len() > most) {
        return None;
    }
    // Length and letters of MQTT, then the version and the flags.
    let (version, flags) = (body[6], body[7]);
    note().connects.push((Instant::now(), version));
    if !manners.versions.is_empty() && !manners.versions.contains(&version) {
        if !manners.mute {
            stream.write_all(b"\x20\x02\x00\x01").ok()?;
        }
        return None;
    }
    let code = match manners.refuses {
        Some(code) => code,
        None if manners.keeps_nothing && flags & 0x20 != 0 && version == 5 => 0x9a,
        None if manners.keeps_nothing && flags & 0x20 != 0 => return None,
        None => 0,
    };
    let properties = if code == 0 { manners.properties.clone() } else { Vec::new() };
    let mut answer = vec![0x20, 2, 0, code];
    if version == 5 {
        answer[1] = 3 + u8::try_from(properties.len()).ok()?;
        answer.push(u8::try_from(properties.len()).ok()?);
        answer.extend(properties);
    }
    stream.write_all(&answer).ok()?;
    if code != 0 {
        return None;
    }
    if let Some(flood) = &manners.flood {
        let mut many = flood.clone();
        while many.len() < 60_000 {
            many.extend_from_slice(flood);
        }
        let mut out = stream.try_clone().ok()?;
        let pause = manners.flood_pause;
        std::thread::spawn(move || {
            while out.write_all(&many).is_ok() {
                std::thread::sleep(pause);
            }
        });
    }
    let (mut subscribed, mut windows) = (Vec::new(), 0);
    loop {
        let (kind, body) = packet(&mut stream)?;
        let manners = shared.lock().expect("unpoisoned").clone();
        match kind & 0xf0 {
            0x30 => {
                let length = usize::from(u16::from_be_bytes([body[0], body[1]]));
                let topic = String::from_utf8(body[2..2 + length].to_vec()).ok()?;
                let has = |part: Option<&str>| part.is_some_and(|part| topic.contains(part));
                note().came.push(topic.clone());
                let id = [body[2 + length], body[3 + length]];
                let payload = body[4 + length + usize::from(version == 5)..].to_vec();
                if has(manners.closes_on) || manners.closes_from.is_some_and(|n| body.len() > n) {
                    return None;
                }
                if has(manners.ignores) {
                    continue;
                }
                match manners.reason.filter(|(part, _)| topic.contains(part)) {
                    Some((_, reason)) if version == 5 => {
                        stream.write_all(&[0x40, 3, id[0], id[1], reason]).ok()?;
                        continue;
                    }
                    _ => stream.write_all(&[0x40, 2, id[0], id[1]]).ok()?,
                }
                let dropped = has(manners.drops);
                if !dropped {
                    note().taken.push((topic.clone(), payload.clone()));
                    windows += usize::from(is_window(&topic));
                }
                if !dropped && !manners.deaf && subscribed.contains(&topic) {
                    let mut echo = vec![0x30];
                    let extra = usize::from(version == 5);
                    write_length(&mut echo, 2 + topic.len() + extra + payload.len());
                    echo.extend(u16::try_from(topic.len()).ok()?.to_be_bytes());
                    echo.extend(topic.as_bytes());
                    echo.extend(std::iter::repeat_n(0, extra));
                    echo.extend(payload);
                    stream.write_all(&echo).ok()?;
                }
                if manners.ends_after.is_some_and(|most| windows >= most) {
                    return None;
                }
            }
            0x80 => {
                let at = 2 + usize::from(version == 5);
                let length = usize::from(u16::from_be_bytes([body[at], body[at + 1]]));
                let topic = String::from_utf8(body[at + 2..at + 2 + length].to_vec()).ok()?;
                subscribed.push(topic);
                let answer = match version {
                    5 => vec![0x90, 4, body[0], body[1], 0, 1],
                    _ => vec![0x90, 3, body[0], body[1], 1],
                };
                stream.write_all(&answer).ok()?;
            }
            0xa0 => {
                let answer = match version {
                    5 => vec![0xb0, 4, body[0], body[1], 0, 0],
                    _ => vec![0xb0, 2, body[0], body[1]],
                };
                stream.write_all(&answer).ok()?;
            }
            0xc0 => stream.write_all(b"\xd0\x00").ok()?,
            0xe0 => return None,
            _ => {}
        }
    }
}

fn write_length(out: &mut Vec<u8>, mut length: usize) {
    loop {
        let byte = u8::try_from(length % 128).expect("seven bits");
        length /= 128;
        out.push(if length > 0 { byte | 0x80 } else { byte });
        if length == 0 {
            return;
        }
    }
}
