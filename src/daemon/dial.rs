//! Reaching a host: its addresses, and which of them is tried for how long.
//!
//! Owns what cameras and brokers have in common before a first byte is sent, and the words for
//! what the system says. Proxies are not used: a host is reached as it stands.

use super::foreign::shown;
use std::io;
use std::net::{IpAddr, SocketAddr, TcpStream, ToSocketAddrs};
use std::sync::mpsc;
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

/// Connects to the first of these addresses that answers, before `deadline`, which is at most
/// `limit` away.
///
/// # Errors
/// What became of each address.
pub fn connect(
    addresses: &[SocketAddr],
    deadline: Instant,
    limit: Duration,
) -> Result<TcpStream, String> {
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
    Err(faults.join("; "))
}

/// Whether an error says that time has passed and nothing else.
pub fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut)
}

/// Lets a system call on the socket wait for at most this long.
///
/// # Errors
/// What the system says.
pub fn set_timeouts(socket: &TcpStream, limit: Duration) -> io::Result<()> {
    // Zero would mean no limit.
    let limit = Some(limit.max(Duration::from_millis(1)));
    socket.set_read_timeout(limit)?;
    socket.set_write_timeout(limit)
}

/// What the system says, without the number in brackets.
pub fn system(error: &io::Error) -> String {
    let text = error.to_string();
    shown(text.split(" (os error").next().unwrap_or_default())
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

    #[test]
    fn a_dead_address_beside_a_good_one_costs_two_seconds() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
        let good = listener.local_addr().expect("bound");
        // RFC 5737: nobody is there; packets vanish, or the system knows no way.
        let dead = SocketAddr::new("192.0.2.1".parse().expect("right"), good.port());
        let limit = Duration::from_secs(10);
        let stream = connect(&[dead, good], Instant::now() + limit, limit).expect("the good one");
        assert_eq!(stream.peer_addr().expect("connected"), good);
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
