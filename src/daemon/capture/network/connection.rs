//! One connection to a camera: TCP, with TLS where the address says so, and a time limit.
//!
//! Owns which of a name's addresses is tried for how long, and that no read or write outlasts
//! the limit. Proxies are not used: a camera is reached as it stands.

use super::Fault;
use crate::daemon::address::Address;
use crate::daemon::foreign::shown;
use crate::daemon::trust::Trust;
use rustls::pki_types::ServerName;
use rustls::{ClientConnection, StreamOwned};
use std::io::{self, Read, Write};
use std::net::{IpAddr, SocketAddr, TcpStream, ToSocketAddrs};
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::{Duration, Instant};

/// How long one address of several is tried.
const ONE_OF_SEVERAL: Duration = Duration::from_secs(2);
/// Longest time that a read waits before it is asked whether to go on.
const SLICE: Duration = Duration::from_millis(250);

/// A connection with a time limit, which may be moved.
#[derive(Debug)]
pub struct Connection {
    stream: Stream,
    deadline: Instant,
    asked: Duration,
}

#[derive(Debug)]
enum Stream {
    Plain(TcpStream),
    Secure(Box<StreamOwned<ClientConnection, TcpStream>>),
}

impl Connection {
    /// Connects within `limit`, which then counts for what is read and written too.
    ///
    /// # Errors
    /// [`Fault::Name`], [`Fault::Connect`], [`Fault::Secure`], [`Fault::Timeout`].
    pub fn open(address: &Address, trust: &Trust, limit: Duration) -> Result<Self, Fault> {
        let deadline = Instant::now() + limit;
        let addresses = resolve(address, limit)?;
        let stream = connect(&addresses, deadline, limit)?;
        // What is sent is short, and waits for an answer.
        let _ = stream.set_nodelay(true);
        let mut connection = Self { stream: Stream::Plain(stream), deadline, asked: limit };
        if address.secure {
            connection = connection.secured(address, trust)?;
        }
        Ok(connection)
    }

    /// From now on reads and writes may take this long, all together.
    pub fn set_limit(&mut self, limit: Duration) {
        (self.deadline, self.asked) = (Instant::now() + limit, limit);
    }

    /// How long reads and writes may take now.
    pub fn limit(&self) -> Duration {
        self.asked
    }

    /// Whether the time is over.
    pub fn is_over(&self) -> bool {
        Instant::now() >= self.deadline
    }

    /// What an error of a read or write is.
    pub fn fault(&self, error: &io::Error, what: &'static str) -> Fault {
        if let Some(error) = error.get_ref().and_then(|inner| inner.downcast_ref::<rustls::Error>())
        {
            return secure_fault(error);
        }
        if is_timeout(error) {
            return Fault::Timeout { what, waited: self.asked };
        }
        Fault::Broken(system(error))
    }

    fn secured(self, address: &Address, trust: &Trust) -> Result<Self, Fault> {
        let Self { stream, deadline, asked } = self;
        let Stream::Plain(socket) = stream else { return Ok(Self { stream, deadline, asked }) };
        let name = ServerName::try_from(address.host.clone())
            .map_err(|_| Fault::Secure(format!("{} cannot be in a certificate", address.host)))?;
        let config = trust.config().map_err(|error| secure_fault(&error))?;
        let client = ClientConnection::new(Arc::new(config), name).map_err(|e| secure_fault(&e))?;
        let mut secure = Box::new(StreamOwned::new(client, socket));
        while secure.conn.is_handshaking() {
            let rest = deadline.saturating_duration_since(Instant::now());
            if rest.is_zero() {
                return Err(Fault::Timeout { what: "TLS handshake", waited: asked });
            }
            set_timeouts(&secure.sock, rest).map_err(|error| Fault::Broken(system(&error)))?;
            match secure.conn.complete_io(&mut secure.sock) {
                Ok(_) => {}
                Err(error) if is_timeout(&error) => {}
                Err(error) => {
                    let inner = error.get_ref().and_then(|e| e.downcast_ref::<rustls::Error>());
                    return Err(inner.map_or_else(
                        || {
                            Fault::Secure(format!(
                                "the connection broke in the TLS handshake: {}",
                                system(&error)
                            ))
                        },
                        secure_fault,
                    ));
                }
            }
        }
        Ok(Self { stream: Stream::Secure(secure), deadline, asked })
    }

    fn socket(&self) -> &TcpStream {
        match &self.stream {
            Stream::Plain(socket) => socket,
            Stream::Secure(secure) => &secure.sock,
        }
    }

    /// Lets the next system call wait as long as is left, at most a slice of it.
    fn arm(&self) -> io::Result<()> {
        let rest = self.deadline.saturating_duration_since(Instant::now());
        if rest.is_zero() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        set_timeouts(self.socket(), rest.min(SLICE))
    }
}

/// A read that gives an error of kind `WouldBlock` may be repeated: nothing came for a moment,
/// and there is time left. With `TimedOut` there is none.
impl Read for Connection {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.arm()?;
        let read = match &mut self.stream {
            Stream::Plain(socket) => socket.read(buffer),
            Stream::Secure(secure) => secure.read(buffer),
        };
        match read {
            // Cameras close without saying so first.
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(0),
            Err(error) if is_timeout(&error) => Err(io::ErrorKind::WouldBlock.into()),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {
                Err(io::ErrorKind::WouldBlock.into())
            }
            read => read,
        }
    }
}

impl Write for Connection {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        loop {
            self.arm()?;
            let written = match &mut self.stream {
                Stream::Plain(socket) => socket.write(bytes),
                Stream::Secure(secure) => secure.write(bytes),
            };
            match written {
                Err(error) if is_timeout(&error) => {}
                written => return written,
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match &mut self.stream {
            Stream::Plain(socket) => socket.flush(),
            Stream::Secure(secure) => secure.flush(),
        }
    }
}

/// Whether an error says that time has passed and nothing else.
pub fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut)
}

fn set_timeouts(socket: &TcpStream, limit: Duration) -> io::Result<()> {
    // Zero would mean for ever.
    let limit = Some(limit.max(Duration::from_millis(1)));
    socket.set_read_timeout(limit)?;
    socket.set_write_timeout(limit)
}

/// The addresses of a host. The system's resolver has no time limit: it is asked in a thread
/// that is left behind where it takes too long.
fn resolve(address: &Address, limit: Duration) -> Result<Vec<SocketAddr>, Fault> {
    if let Ok(ip) = address.host.parse::<IpAddr>() {
        return Ok(vec![SocketAddr::new(ip, address.port)]);
    }
    let (sender, receiver) = mpsc::channel();
    let (host, port) = (address.host.clone(), address.port);
    let asked = thread::Builder::new().name("resolve".into()).spawn(move || {
        let found = (host.as_str(), port).to_socket_addrs();
        let _ = sender.send(found.map(Iterator::collect::<Vec<_>>));
    });
    let wrong = |reason: String| Fault::Name { host: address.host.clone(), reason };
    asked.map_err(|error| wrong(system(&error)))?;
    match receiver.recv_timeout(limit) {
        Ok(Ok(found)) if found.is_empty() => Err(wrong("none".to_owned())),
        Ok(Ok(found)) => Ok(alternating(found)),
        Ok(Err(error)) => Err(wrong(shown(&error.to_string()))),
        Err(_) => Err(wrong(format!("no answer in {:.1} s", limit.as_secs_f32()))),
    }
}

/// One family after the other (RFC 8305, section 4), so that a family that is dead costs one try.
fn alternating(found: Vec<SocketAddr>) -> Vec<SocketAddr> {
    let first_is_v6 = found.first().is_some_and(SocketAddr::is_ipv6);
    let (first, second): (Vec<_>, Vec<_>) =
        found.into_iter().partition(|address| address.is_ipv6() == first_is_v6);
    let (mut first, mut second) = (first.into_iter(), second.into_iter());
    let mut mixed = Vec::new();
    loop {
        let pair = [first.next(), second.next()];
        if pair == [None, None] {
            return mixed;
        }
        mixed.extend(pair.into_iter().flatten());
    }
}

fn connect(
    addresses: &[SocketAddr],
    deadline: Instant,
    limit: Duration,
) -> Result<TcpStream, Fault> {
    let mut faults: Vec<String> = Vec::new();
    for (index, address) in addresses.iter().enumerate() {
        let mut rest = deadline.saturating_duration_since(Instant::now());
        if index + 1 < addresses.len() {
            rest = rest.min(ONE_OF_SEVERAL.min(limit / 2));
        }
        if rest.is_zero() {
            break;
        }
        match TcpStream::connect_timeout(address, rest) {
            Ok(stream) => return Ok(stream),
            Err(error) => {
                let ip = address.ip();
                faults.push(match error.kind() {
                    io::ErrorKind::ConnectionRefused => format!("{ip} refuses the connection"),
                    io::ErrorKind::TimedOut => {
                        format!("{ip} does not answer in {:.1} s", rest.as_secs_f32())
                    }
                    _ => format!("{ip}: {}", system(&error)),
                });
            }
        }
    }
    faults.truncate(4);
    Err(Fault::Connect(faults.join("; ")))
}

fn secure_fault(error: &rustls::Error) -> Fault {
    use rustls::{AlertDescription as Alert, Error};
    Fault::Secure(match error {
        Error::General(text) => text.clone(),
        Error::InvalidMessage(_) => {
            "the camera does not speak TLS at this port: is it http:// or rtsp://, or another port?".to_owned()
        }
        Error::PeerIncompatible(_)
        | Error::AlertReceived(Alert::ProtocolVersion | Alert::HandshakeFailure) => {
            "the camera speaks no TLS from version 1.2 on with ciphers that are safe today: can its \
             firmware be renewed?".to_owned()
        }
        other => format!("TLS: {}", shown(&other.to_string())),
    })
}

/// What the system says, without the number in brackets.
pub fn system(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::ConnectionReset | io::ErrorKind::BrokenPipe => {
            "the camera closed it".to_owned()
        }
        _ => {
            let text = error.to_string();
            shown(text.split(" (os error").next().unwrap_or_default())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn families_take_turns() {
        let address = |text: &str| text.parse::<SocketAddr>().expect("right");
        let [a, b, c] = ["[::1]:1", "[::2]:1", "127.0.0.1:1"].map(address);
        assert_eq!(alternating(vec![a, b, c]), [a, c, b]);
    }
}
