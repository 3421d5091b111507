//! The kernel's watchdog device: `/dev/watchdog` and its kin.
//!
//! Owns opening (which starts the count), the time-out, and the magic close that stops it
//! (Linux, Documentation/watchdog/watchdog-api.rst). Closed in any other way, by a crash
//! above all, the count goes on and the box is reset unless the daemon is back in time.

use std::fs::{File, OpenOptions};
use std::io::{Error, Write};
use std::os::fd::AsRawFd;
use verge::hal::Watchdog;

/// `WDIOC_SETTIMEOUT`: `_IOWR('W', 6, int)`.
const SET_TIMEOUT: u32 = 0xc004_5706;
/// The byte that, written last, lets `close` stop the count.
const MAGIC_CLOSE: &[u8] = b"V";

/// A watchdog device; it is opened, and counts, when it is first fed.
pub struct DevWatchdog {
    path: &'static str,
    timeout_s: i32,
    device: Option<File>,
}

impl DevWatchdog {
    /// The device at `path`, which resets the box when it is not fed for `timeout_s`.
    pub const fn new(path: &'static str, timeout_s: i32) -> Self {
        Self { path, timeout_s, device: None }
    }

    fn open(&self) -> Result<File, Error> {
        let device = OpenOptions::new().write(true).open(self.path)?;
        let mut timeout_s = self.timeout_s;
        // SAFETY: the request takes a pointer to an int, which lives through the call.
        let outcome =
            unsafe { libc::ioctl(device.as_raw_fd(), SET_TIMEOUT as _, &raw mut timeout_s) };
        if outcome != 0 {
            // It counts already, with a time-out of its own: feeding is what matters.
            eprintln!("{}: its time-out stays: {}", self.path, Error::last_os_error());
        }
        Ok(device)
    }

    fn at(&self, error: &Error) -> String {
        format!("{}: {error}", self.path)
    }
}

impl Watchdog for DevWatchdog {
    type Error = String;

    fn feed(&mut self) -> Result<(), String> {
        if self.device.is_none() {
            self.device = Some(self.open().map_err(|error| self.at(&error))?);
        }
        let Some(device) = &mut self.device else { return Ok(()) };
        if let Err(error) = device.write_all(b"\0") {
            self.device = None;
            return Err(self.at(&error));
        }
        Ok(())
    }

    fn disarm(&mut self) -> Result<(), String> {
        match self.device.take() {
            Some(mut device) => device.write_all(MAGIC_CLOSE).map_err(|error| self.at(&error)),
            None => Ok(()),
        }
    }
}
