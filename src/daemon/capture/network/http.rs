//! One HTTP request (RFC 9112) and the answer to it.
//!
//! Owns redirects, the login, and where a body ends. One connection an answer. What is wrong
//! with lengths and ends is the reader's to judge: it knows what a whole picture is.

use super::connection::Connection;
use super::head::{self, Head, MAX_HEAD};
use super::login::Login;
use super::{CameraError, CameraSettings, Fault};
use crate::daemon::address::Address;
use crate::daemon::dial;
use crate::daemon::foreign::shown;
use std::io::{self, Read, Write};
use std::time::{Duration, Instant};

/// Most redirects that are followed.
const MAX_REDIRECTS: usize = 3;
/// Bytes that are read at once.
const CHUNK: usize = 16 << 10;
/// Longest line in front of a chunk, bytes.
const MAX_CHUNK_LINE: usize = 256;

/// A camera that is asked by HTTP.
#[derive(Debug)]
pub struct Client {
    settings: CameraSettings,
    login: Login,
}

/// An answer whose body is read from `body`.
#[derive(Debug)]
pub struct Answer {
    /// Its head.
    pub head: Head,
    /// Its body.
    pub body: Body,
}

impl Client {
    /// A camera that was not asked yet.
    pub fn new(settings: CameraSettings) -> Self {
        let login = Login::new(settings.login());
        Self { settings, login }
    }

    /// Asks, and returns an answer of status 200 to 299, or 304.
    ///
    /// # Errors
    /// [`CameraError`], within `limit`, from the name's look-up to the answer's head.
    pub fn get(
        &mut self,
        headers: &[(&str, &str)],
        limit: Duration,
    ) -> Result<Answer, CameraError> {
        let home = self.settings.address.clone();
        self.try_get(headers, limit).map_err(|fault| fault.at(&home))
    }

    fn try_get(&mut self, headers: &[(&str, &str)], limit: Duration) -> Result<Answer, Fault> {
        self.login.ready(Instant::now())?;
        let deadline = Instant::now() + limit;
        let home = self.settings.address.clone();
        let (mut address, mut redirects, mut answered) = (home.clone(), 0, 0);
        loop {
            let is_home = home.shares_login_with(&address);
            let login = if is_home { self.login.answer("GET", &address.target) } else { None };
            let with_login = login.is_some();
            let rest = deadline.saturating_duration_since(Instant::now());
            if rest.is_zero() {
                return Err(Fault::Timeout { what: "answer", waited: limit });
            }
            let mut connection = Connection::open(&address, &self.settings.trust, rest)?;
            let request = request(&address, headers, login.as_deref());
            let sent = connection.write_all(request.as_bytes()).and_then(|()| connection.flush());
            // A camera may answer and close before it has read everything.
            let (head, rest) = match read_head(&mut connection, "HTTP", limit) {
                Err(Fault::Broken(_)) if sent.is_err() => {
                    let error = sent.expect_err("it is one");
                    return Err(connection.fault(&error, "answer"));
                }
                read => read?,
            };
            match head.status {
                200..=299 | 304 => {
                    if is_home {
                        self.login.accepted();
                    }
                    let body = Body::new(&head, connection, rest);
                    return Ok(Answer { head, body });
                }
                401 if is_home && answered < 3 => {
                    answered += 1;
                    self.login.challenged(&head, with_login, address.secure)?;
                }
                301..=303 | 307 | 308 if head.get("location").is_some() => {
                    self.login.passed();
                    redirects += 1;
                    if redirects > MAX_REDIRECTS {
                        return Err(Fault::Redirects(format!("more than {MAX_REDIRECTS} times")));
                    }
                    let location = head.get("location").unwrap_or_default();
                    let there = address.redirected(location).map_err(|error| {
                        Fault::Redirects(format!(
                            "to something that is not the address of a picture: {error}"
                        ))
                    })?;
                    let is_allowed = |host: &String| host.eq_ignore_ascii_case(&there.host);
                    if !there.host.eq_ignore_ascii_case(&home.host)
                        && !self.settings.redirect_hosts.iter().any(is_allowed)
                    {
                        return Err(Fault::RedirectedAway { host: shown(&there.host) });
                    }
                    address = there;
                }
                status => return Err(Fault::Status { protocol: "HTTP", status }),
            }
        }
    }
}

fn request(address: &Address, headers: &[(&str, &str)], login: Option<&str>) -> String {
    let mut text = format!(
        "GET {} HTTP/1.1\r\nHost: {}\r\nUser-Agent: verge/{}\r\nAccept: image/jpeg, image/png, \
         multipart/x-mixed-replace, */*;q=0.5\r\nAccept-Encoding: identity\r\nConnection: close\r\n",
        address.target,
        address.host_port(),
        env!("CARGO_PKG_VERSION"),
    );
    for (name, value) in headers.iter().copied().chain(login.map(|login| ("Authorization", login)))
    {
        // The camera chose this text: it must not become header lines of its own.
        if value.chars().all(|c| c == '\t' || !c.is_control()) {
            text.push_str(&format!("{name}: {value}\r\n"));
        }
    }
    text + "\r\n"
}

/// Reads the head of an answer that is not an interim one, and what came behind it.
pub(in crate::daemon::capture) fn read_head(
    connection: &mut Connection,
    protocol: &'static str,
    limit: Duration,
) -> Result<(Head, Vec<u8>), Fault> {
    let (mut buffer, mut chunk) = (Vec::new(), [0; 4 << 10]);
    loop {
        // Line ends in front of an answer belong to none.
        let skip = buffer.iter().take_while(|byte| matches!(byte, b'\r' | b'\n')).count();
        buffer.drain(..skip);
        if let Some((end, next)) = head::end(&buffer) {
            let head = Head::parse(&buffer[..end], protocol);
            let head =
                head.ok_or_else(|| Fault::Protocol { protocol, begins: head::beginning(&buffer) })?;
            buffer.drain(..next);
            if (100..200).contains(&head.status) {
                continue;
            }
            return Ok((head, buffer));
        }
        let begins = || Fault::Protocol { protocol, begins: head::beginning(&buffer) };
        let known = buffer.len() < 4
            || buffer.starts_with(protocol.as_bytes())
            || buffer.starts_with(b"ICY");
        if !known || buffer.len() > MAX_HEAD {
            return Err(begins());
        }
        match connection.read(&mut chunk) {
            Ok(0) => {
                // A head without its empty line, of an answer without a body.
                if let Some(head) = Head::parse(&buffer, protocol) {
                    return Ok((head, Vec::new()));
                }
                return Err(if buffer.is_empty() {
                    Fault::Broken("the camera closed it without an answer".to_owned())
                } else {
                    begins()
                });
            }
            Ok(bytes) => buffer.extend_from_slice(&chunk[..bytes]),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            Err(error) if dial::is_timeout(&error) => {
                return Err(Fault::Timeout { what: "answer", waited: limit });
            }
            Err(error) => return Err(connection.fault(&error, "answer")),
        }
    }
}

/// A body as it comes, without its chunks' frames.
#[derive(Debug)]
pub struct Body {
    connection: Connection,
    /// Bytes read, and how many of them were handed out.
    buffer: Vec<u8>,
    given: usize,
    /// Bytes that are left of the length or the chunk; `None`: until the connection ends.
    left: Option<u64>,
    chunked: Option<Chunks>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Chunks {
    First,
    Later,
    Over,
}

impl Body {
    fn new(head: &Head, connection: Connection, buffer: Vec<u8>) -> Self {
        let chunked = head.is_chunked().then_some(Chunks::First);
        let left = if chunked.is_some() { Some(0) } else { head.content_length() };
        let left = if matches!(head.status, 204 | 304) { Some(0) } else { left };
        Self { connection, buffer, given: 0, left, chunked }
    }

    /// Whether all that was announced has been read.
    pub fn is_complete(&self) -> bool {
        match self.chunked {
            Some(chunks) => chunks == Chunks::Over,
            None => self.left == Some(0),
        }
    }

    /// Reads on behind the announced end, to the connection's.
    pub fn read_beyond(&mut self) {
        if self.chunked.is_none() {
            self.left = None;
        }
    }

    /// The connection, for its time limit.
    pub fn connection(&mut self) -> &mut Connection {
        &mut self.connection
    }

    fn fill(&mut self) -> io::Result<usize> {
        if self.given == self.buffer.len() {
            self.given = 0;
            self.buffer.resize(CHUNK, 0);
            let read = self.connection.read(&mut self.buffer);
            self.buffer.truncate(*read.as_ref().unwrap_or(&0));
            read?;
        }
        Ok(self.buffer.len() - self.given)
    }

    /// The line in front of a chunk; `None` where the connection ends first.
    fn chunk_line(&mut self) -> io::Result<Option<u64>> {
        let bad =
            || io::Error::new(io::ErrorKind::InvalidData, "a chunk whose length is not a number");
        loop {
            // The whole line, before any of it is taken: a read may have to be repeated.
            let is_blank = |byte: &&u8| matches!(byte, b'\r' | b'\n');
            self.given += self.buffer[self.given..].iter().take_while(is_blank).count();
            self.buffer.drain(..std::mem::take(&mut self.given));
            if let Some(end) = self.buffer.iter().position(|&byte| byte == b'\n') {
                let line = &self.buffer[..end];
                let digits =
                    line.split(|&byte| !byte.is_ascii_hexdigit()).next().unwrap_or_default();
                let digits = std::str::from_utf8(digits).map_err(|_| bad())?;
                let length = u64::from_str_radix(digits, 16).map_err(|_| bad())?;
                self.given = end + 1;
                return Ok(Some(length));
            }
            if self.buffer.len() > MAX_CHUNK_LINE {
                return Err(bad());
            }
            let mut more = [0; 64];
            let bytes = self.connection.read(&mut more)?;
            if bytes == 0 {
                return Ok(None);
            }
            self.buffer.extend_from_slice(&more[..bytes]);
        }
    }
}

impl Read for Body {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        if self.chunked.is_some() && self.left == Some(0) && self.chunked != Some(Chunks::Over) {
            self.chunked = Some(Chunks::Later);
            match self.chunk_line()? {
                Some(length) if length > 0 => self.left = Some(length),
                // The end, or the connection's, which counts as one.
                _ => self.chunked = Some(Chunks::Over),
            }
        }
        if self.left == Some(0) {
            return Ok(0);
        }
        let have = self.fill()?;
        let most = self.left.map_or(usize::MAX, |left| usize::try_from(left).unwrap_or(usize::MAX));
        let bytes = have.min(most).min(out.len());
        out[..bytes].copy_from_slice(&self.buffer[self.given..self.given + bytes]);
        self.given += bytes;
        if bytes == 0 && self.chunked.is_some() {
            (self.chunked, self.left) = (Some(Chunks::Over), Some(0));
        } else {
            self.left = self.left.map(|left| left - bytes as u64);
        }
        Ok(bytes)
    }
}
