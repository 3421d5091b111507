//! Words to the service manager: ready, alive, reloading, stopping (`sd_notify(3)`).
//!
//! Owns the datagrams. Without `NOTIFY_SOCKET` all of it does nothing, so that the same
//! program runs by hand. A failure here never stops the measurement.

use super::clock;
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::UnixDatagram;
use std::time::{Duration, Instant};

/// Shortest time between two signs of life; WatchdogSec in the unit file is 30 s.
const ALIVE_INTERVAL: Duration = Duration::from_secs(1);

/// The way to the service manager, where there is one.
#[derive(Debug)]
pub struct Notify {
    socket: Option<UnixDatagram>,
    alive: Option<Instant>,
    status: String,
}

impl Notify {
    /// As the environment says.
    pub fn from_environment() -> Self {
        Self::to(std::env::var_os("NOTIFY_SOCKET").as_deref())
    }

    /// To the socket of that name; a name that begins with `@` is an abstract one.
    fn to(name: Option<&OsStr>) -> Self {
        let socket = name.filter(|name| !name.is_empty()).and_then(|name| {
            connect(name)
                .inspect_err(|error| log::warn!("NOTIFY_SOCKET {}: {error}", name.display()))
                .ok()
        });
        Self { socket, alive: None, status: String::new() }
    }

    /// The line is open and its first turn is done.
    pub fn ready(&mut self) {
        self.send("READY=1");
    }

    /// The configuration is being read again; [`Self::ready`] ends it.
    pub fn reloading(&mut self) {
        let now = clock::monotonic().as_micros();
        self.send(&format!("RELOADING=1\nMONOTONIC_USEC={now}"));
    }

    /// A turn of the loop has ended. To be called there and nowhere else.
    pub fn alive(&mut self) {
        if self.alive.is_none_or(|sent| sent.elapsed() >= ALIVE_INTERVAL) {
            self.alive = Some(Instant::now());
            self.send("WATCHDOG=1");
        }
    }

    /// One line for people, sent when it changes.
    pub fn status(&mut self, text: &str) {
        if self.status != text {
            text.clone_into(&mut self.status);
            self.send(&format!("STATUS={}", text.replace('\n', " ")));
        }
    }

    /// The program ends on purpose.
    pub fn stopping(&mut self) {
        self.send("STOPPING=1");
    }

    fn send(&self, message: &str) {
        if let Some(socket) = &self.socket
            && let Err(error) = socket.send(message.as_bytes())
        {
            log::debug!("service manager: {error}");
        }
    }
}

fn connect(name: &OsStr) -> std::io::Result<UnixDatagram> {
    let socket = UnixDatagram::unbound()?;
    // A manager that does not read costs a message, not the measurement.
    socket.set_nonblocking(true)?;
    match name.as_bytes().strip_prefix(b"@") {
        #[cfg(target_os = "linux")]
        Some(name) => {
            use std::os::linux::net::SocketAddrExt;
            let address = std::os::unix::net::SocketAddr::from_abstract_name(name)?;
            socket.connect_addr(&address)?;
        }
        _ => socket.connect(name)?,
    }
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn received(socket: &UnixDatagram) -> String {
        let mut buffer = [0; 200];
        let len = socket.recv(&mut buffer).expect("a message");
        String::from_utf8_lossy(&buffer[..len]).into_owned()
    }

    #[test]
    fn each_word_is_a_datagram_and_life_is_not_told_at_every_turn() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let name = folder.path().join("notify");
        let manager = UnixDatagram::bind(&name).expect("a socket");
        manager.set_read_timeout(Some(Duration::from_secs(1))).expect("a time-out");
        let mut notify = Notify::to(Some(name.as_os_str()));
        notify.ready();
        for _ in 0..10 {
            notify.alive();
            notify.status("oK\nall is well");
        }
        notify.reloading();
        notify.stopping();
        let expected = ["READY=1", "WATCHDOG=1", "STATUS=oK all is well"];
        assert_eq!(expected.map(|_| received(&manager)), expected);
        let reloading = received(&manager);
        let time = reloading.strip_prefix("RELOADING=1\nMONOTONIC_USEC=").expect("its two words");
        assert!(time.parse::<u64>().is_ok(), "{reloading}");
        assert_eq!(received(&manager), "STOPPING=1");
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn abstract_names_are_understood() {
        use std::os::linux::net::SocketAddrExt;
        use std::os::unix::net::SocketAddr;
        let name = format!("verge-notify-{}", std::process::id());
        let address = SocketAddr::from_abstract_name(&name).expect("a name");
        let manager = UnixDatagram::bind_addr(&address).expect("a socket");
        Notify::to(Some(format!("@{name}").as_ref())).ready();
        assert_eq!(received(&manager), "READY=1");
    }

    #[test]
    fn a_manager_that_is_not_there_is_no_fault() {
        for name in [None, Some(OsStr::new("")), Some(OsStr::new("/nowhere/notify"))] {
            let mut notify = Notify::to(name);
            notify.ready();
            notify.alive();
            notify.stopping();
        }
    }
}
