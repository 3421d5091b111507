//! Reaching a host: its addresses, and which of them is tried for how long.
//!
//! Owns what cameras and brokers have in common before a first byte is sent, and the words for
//! what the system says. Proxies are not used: a host is reached as it stands.

use super::foreign::shown;
use std::io::{self, Read, Write};
use std::net::{IpAddr, SocketAddr, TcpStream, ToSocketAddrs};
use std::sync::{Mutex, PoisonError, mpsc};
use std::thread;
use std::time::{Duration, Instant};

/// How long one address of several is tried.
const ONE_OF_SEVERAL: Duration = Duration::from_secs(2);

/// The addresses of a host, one family after the other. The system's resolver has no time limit:
/// it is asked in a thread that is left behind where it takes too long.
///
/// # Errors
/// Why there is none.
pub fn resolve(host: &str, port: u16, limit: Duration) -> Result<Vec<SocketAddr>, String> {
    if let Ok(ip) = host.parse::<IpAddr>() {
        return Ok(vec![SocketAddr::new(ip, port)]);
    }
    let (sender, receiver) = mpsc::channel();
    let name = host.to_owned();
    let asked = thread::Builder::new().name("resolve".into()).spawn(move || {
        let found = (name.as_str(), port).to_socket_addrs();
        let _ = sender.send(found.map(Iterator::collect::<Vec<_>>));
    });
    asked.map_err(|error| system(&error))?;
    match receiver.recv_timeout(limit) {
        Ok(Ok(found)) if found.is_empty() => Err("none".to_owned()),
        Ok(Ok(found)) => Ok(alternating(found)),
        Ok(Err(error)) => Err(shown(&error.to_string())),
        Err(_) => Err(format!("no answer in {:.1} s", limit.as_secs_f32())),
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

/// Addresses that answered when one in front of them did not, the latest last: a camera is asked every
/// few seconds, and would wait for the dead one each time.
static ANSWERED: Mutex<Vec<SocketAddr>> = Mutex::new(Vec::new());
/// Most of them.
const MOST_ANSWERED: usize = 16;

/// The addresses with those in front that answered before.
fn sorted(addresses: &[SocketAddr], answered: &[SocketAddr]) -> Vec<SocketAddr> {
    let mut sorted = addresses.to_vec();
    sorted.sort_by_key(|address| !answered.contains(address));
    sorted
}

/// Notes which address answered, and that those before it did not.
fn note(tried: &[SocketAddr], address: Option<SocketAddr>) {
    // A thread that panicked left the list whole.
    let mut answered = ANSWERED.lock().unwrap_or_else(PoisonError::into_inner);
    answered.retain(|known| !tried.contains(known) && Some(*known) != address);
    answered.extend(address);
    let excess = answered.len().saturating_sub(MOST_ANSWERED);
    answered.drain(..excess);
}

/// Connects to the first of these addresses that answers, before `deadline`, which is at most
/// `limit` away; first to one that answered before.
///
/// # Errors
/// The outcome at each address.
pub fn connect(
    addresses: &[SocketAddr],
    deadline: Instant,
    limit: Duration,
) -> Result<TcpStream, String> {
    let mut faults: Vec<String> = Vec::new();
    let several = addresses.len() > 1;
    let addresses = sorted(addresses, &ANSWERED.lock().unwrap_or_else(PoisonError::into_inner));
    for (index, address) in addresses.iter().enumerate() {
        let mut rest = deadline.saturating_duration_since(Instant::now());
        if index + 1 < addresses.len() {
            rest = rest.min(ONE_OF_SEVERAL.min(limit / 2));
        }
        if rest.is_zero() {
            break;
        }
        match TcpStream::connect_timeout(address, rest) {
            Ok(stream) => {
                if several {
                    note(&addresses[..index], Some(*address));
                }
                return Ok(stream);
            }
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
    if several {
        note(&addresses, None);
    }
    faults.truncate(4);
    Err(faults.join("; "))
}

/// Whether an error says that time has passed and nothing else.
pub fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut)
}

/// A socket whose reads and writes end at an instant: all of them together, however little each of
/// them brings. TLS reads until a whole record is there, and a time-out for each read alone would let
/// who sends a byte now and then keep the caller for days.
#[derive(Debug)]
pub struct Timed {
    socket: TcpStream,
    until: Instant,
}

impl Timed {
    /// The socket, with no time yet.
    pub fn new(socket: TcpStream) -> Self {
        Self { socket, until: Instant::now() }
    }

    /// Reads and writes may take until then.
    pub fn set_until(&mut self, until: Instant) {
        self.until = until;
    }

    /// The time that is left.
    fn rest(&self) -> io::Result<Option<Duration>> {
        let rest = self.until.saturating_duration_since(Instant::now());
        // The system takes less than a microsecond for no timeout at all.
        if rest < Duration::from_micros(1) {
            Err(io::ErrorKind::TimedOut.into())
        } else {
            Ok(Some(rest))
        }
    }
}

impl Read for Timed {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.socket.set_read_timeout(self.rest()?)?;
        self.socket.read(buffer)
    }
}

impl Write for Timed {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.socket.set_write_timeout(self.rest()?)?;
        self.socket.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.socket.flush()
    }
}

/// The system's words, without the number in brackets.
pub fn system(error: &io::Error) -> String {
    let text = error.to_string();
    shown(text.split(" (os error").next().unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{Ipv4Addr, TcpListener};

    /// A pair of sockets: ours with a time, and the other end.
    fn pair() -> (Timed, TcpStream) {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
        let ours = TcpStream::connect(listener.local_addr().expect("bound")).expect("connected");
        (Timed::new(ours), listener.accept().expect("connected").0)
    }

    #[test]
    fn who_sends_a_byte_now_and_then_gets_no_more_time() {
        let (mut ours, mut theirs) = pair();
        thread::spawn(move || {
            while theirs.write_all(b"x").is_ok() {
                thread::sleep(Duration::from_millis(20));
            }
        });
        let begun = Instant::now();
        ours.set_until(begun + Duration::from_millis(300));
        let error = ours.read_exact(&mut [0; 100_000]).expect_err("it never gets so many");
        assert!(is_timeout(&error), "{error}");
        assert!(begun.elapsed() >= Duration::from_millis(300));
    }

    #[test]
    fn who_takes_a_byte_now_and_then_gets_no_more_time() {
        let (mut ours, mut theirs) = pair();
        thread::spawn(move || {
            while theirs.read(&mut [0; 4096]).is_ok_and(|read| read > 0) {
                thread::sleep(Duration::from_millis(20));
            }
        });
        ours.set_until(Instant::now() + Duration::from_millis(300));
        // More than the system's buffers hold.
        let error = ours.write_all(&vec![0; 64 << 20]).expect_err("it never takes so many");
        assert!(is_timeout(&error), "{error}");
    }

    #[test]
    fn families_take_turns() {
        let address = |text: &str| text.parse::<SocketAddr>().expect("right");
        let [a, b, c] = ["[::1]:1", "[::2]:1", "127.0.0.1:1"].map(address);
        assert_eq!(alternating(vec![a, b, c]), [a, c, b]);
    }

    #[test]
    fn a_dead_address_beside_a_good_one_costs_two_seconds() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
        let good = listener.local_addr().expect("bound");
        // RFC 5737: nobody is there; packets vanish, or the system knows no way.
        let dead = SocketAddr::new("192.0.2.1".parse().expect("right"), good.port());
        let limit = Duration::from_secs(10);
        let stream = connect(&[dead, good], Instant::now() + limit, limit).expect("the good one");
        assert_eq!(stream.peer_addr().expect("connected"), good);
        // And that once: from now on the good one is asked first.
        let known = || ANSWERED.lock().expect("unpoisoned").clone();
        assert_eq!(sorted(&[dead, good], &known()), [good, dead]);
        // Until it is the one that does not answer.
        note(&[good], Some(dead));
        assert_eq!(sorted(&[good, dead], &known()), [dead, good]);
        note(&[good, dead], None);
        assert_eq!(sorted(&[good, dead], &known()), [good, dead]);
    }

    #[test]
    fn each_address_that_fails_is_named() {
        let closed = |ip: &str| SocketAddr::new(ip.parse().expect("right"), 1);
        let limit = Duration::from_secs(2);
        let addresses = [closed("127.0.0.1"), closed("127.0.0.2")];
        let error = connect(&addresses, Instant::now() + limit, limit).expect_err("closed");
        assert!(error.contains("127.0.0.1 refuses") && error.contains("127.0.0.2"), "{error}");
    }
}
