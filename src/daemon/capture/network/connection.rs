//! One connection to a camera: TCP, with TLS where the address says so, and a time limit.
//!
//! Owns that no read or write outlasts the limit. Proxies are not used: a camera is reached as it
//! stands.

use super::Fault;
use crate::daemon::address::Address;
use crate::daemon::dial::{self, Timed};
use crate::daemon::trust::{self, Trust};
use rustls::pki_types::ServerName;
use rustls::{ClientConnection, StreamOwned};
use std::io::{self, Read, Write};
use std::sync::Arc;
use std::time::{Duration, Instant};

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
    Plain(Timed),
    Secure(Box<StreamOwned<ClientConnection, Timed>>),
}

impl Connection {
    /// Connects within `limit`, which then counts for what is read and written too.
    ///
    /// # Errors
    /// [`Fault::Name`], [`Fault::Connect`], [`Fault::Secure`], [`Fault::Timeout`].
    pub fn open(address: &Address, trust: &Trust, limit: Duration) -> Result<Self, Fault> {
        let deadline = Instant::now() + limit;
        let addresses = dial::resolve(&address.host, address.port, limit)
            .map_err(|reason| Fault::Name { host: address.host.clone(), reason })?;
        let stream = dial::connect(&addresses, deadline, limit).map_err(Fault::Connect)?;
        // Requests are short, and wait for an answer.
        let _ = stream.set_nodelay(true);
        let mut connection =
            Self { stream: Stream::Plain(Timed::new(stream)), deadline, asked: limit };
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

    /// The fault in an error of a read or write.
    pub fn fault(&self, error: &io::Error, what: &'static str) -> Fault {
        if let Some(error) = error.get_ref().and_then(|inner| inner.downcast_ref::<rustls::Error>())
        {
            return secure_fault(error);
        }
        if dial::is_timeout(error) {
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
        secure.sock.set_until(deadline);
        while secure.conn.is_handshaking() {
            let rest = deadline.saturating_duration_since(Instant::now());
            if rest.is_zero() {
                return Err(Fault::Timeout { what: "TLS handshake", waited: asked });
            }
            match secure.conn.complete_io(&mut secure.sock) {
                Ok(_) => {}
                Err(error) if dial::is_timeout(&error) => {}
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

    /// Lets the next call wait as long as is left, at most a slice of it.
    fn arm(&mut self) -> io::Result<()> {
        let now = Instant::now();
        if now >= self.deadline {
            return Err(io::ErrorKind::TimedOut.into());
        }
        let until = self.deadline.min(now + SLICE);
        match &mut self.stream {
            Stream::Plain(socket) => socket.set_until(until),
            Stream::Secure(secure) => secure.sock.set_until(until),
        }
        Ok(())
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
            Err(error) if dial::is_timeout(&error) => Err(io::ErrorKind::WouldBlock.into()),
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
                Err(error) if dial::is_timeout(&error) => {}
                written => return written,
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        self.arm()?;
        match &mut self.stream {
            Stream::Plain(socket) => socket.flush(),
            Stream::Secure(secure) => secure.flush(),
        }
    }
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
        other => trust::fault(other),
    })
}

/// The system's words, without the number in brackets.
pub fn system(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::ConnectionReset | io::ErrorKind::BrokenPipe => {
            "the camera closed it".to_owned()
        }
        _ => dial::system(error),
    }
}
