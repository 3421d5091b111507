//! Debian's broker as a process of the test's own.

use std::net::{Ipv4Addr, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const PATIENCE: Duration = Duration::from_secs(20);

/// Debian's broker, on ports of this machine.
pub struct Mosquitto {
    program: &'static str,
}

impl Mosquitto {
    /// The installed broker, or a skip.
    pub fn installed() -> Option<Self> {
        let program = ["/usr/sbin/mosquitto", "/usr/local/sbin/mosquitto"]
            .into_iter()
            .find(|path| Path::new(path).exists());
        if program.is_none() {
            super::skip("mosquitto is not installed");
        }
        program.map(|program| Self { program })
    }

    /// Starts it and waits until it listens.
    pub fn start(&self, port: u16) -> Running {
        self.run(port, &["-p", &port.to_string()])
    }

    /// The same with a configuration of its own, which names the port.
    pub fn start_with(&self, port: u16, config: &Path) -> Running {
        self.run(port, &["-c", config.to_str().expect("UTF-8")])
    }

    fn run(&self, port: u16, arguments: &[&str]) -> Running {
        let child = Command::new(self.program)
            .args(arguments)
            .stderr(Stdio::null())
            .spawn()
            .expect("mosquitto starts");
        let mut running = Running(child);
        let started = Instant::now();
        while TcpStream::connect((Ipv4Addr::LOCALHOST, port)).is_err() {
            assert!(started.elapsed() < PATIENCE, "mosquitto does not listen");
            assert_eq!(running.0.try_wait().expect("ours"), None, "mosquitto goes on");
            std::thread::sleep(Duration::from_millis(20));
        }
        running
    }
}

/// A process that ends with the value.
pub struct Running(pub Child);

impl Running {
    /// Ends it at once, as `kill -9` does.
    pub fn kill(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.kill();
    }
}
