//! The serial line to an I/O node: each live window in one frame, and an engineer's questions.
//!
//! Owns the device and the thread that writes to it. A line that is unplugged or stuck costs
//! windows on that line only, each counted; what a node does without them is its fail-safe
//! state. Frames are the core's [`crate::node::link`].

use crate::node::link::{MAX_ENCODED, Receiver, encode};
use crate::wire::{self, DensityMessage, MAX_DENSITY_MESSAGE};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use rustix::termios::{ControlModes, OptionalActions, tcgetattr, tcsetattr};
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::{Duration, Instant};

/// Bits per second unless the configuration says otherwise: what the node's firmware uses.
pub const DEFAULT_BAUD: u32 = 115_200;
/// Longest time in which a frame must have left: 2 KB at 9,600 baud take 2.2 s.
const SEND_LIMIT: Duration = Duration::from_secs(5);
/// Frames that wait for the line. Windows of six lengths may end together.
const WAITING: usize = 8;

/// The line, and the windows that go over it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SerialSettings {
    /// The device.
    pub device: PathBuf,
    /// Bits per second.
    pub baud: u32,
    /// Length of the windows that are sent, s.
    pub window_s: u64,
}

/// An open serial line: raw, eight bits, no flow control.
#[derive(Debug)]
pub struct SerialLine {
    device: File,
}

impl SerialLine {
    /// Opens a device and sets it up.
    ///
    /// # Errors
    /// The system's error about the device.
    pub fn open(device: &Path, baud: u32) -> io::Result<Self> {
        // Not waiting for a carrier, and never the terminal that stops this program.
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let device = File::from(rustix::fs::open(device, flags, Mode::empty())?);
        let mut line = tcgetattr(&device)?;
        line.make_raw();
        line.control_modes |= ControlModes::CLOCAL | ControlModes::CREAD;
        line.control_modes &= !ControlModes::CRTSCTS;
        line.set_speed(baud)?;
        tcsetattr(&device, OptionalActions::Flush, &line)?;
        Ok(Self { device })
    }

    /// Sends `content` as one frame.
    ///
    /// # Errors
    /// The device's, or `TimedOut` where the line takes no more bytes.
    pub fn send(&mut self, content: &[u8]) -> io::Result<()> {
        let mut line = [0; MAX_ENCODED];
        let Some(mut bytes) = encode(content, &mut line) else {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "longer than a frame"));
        };
        let until = Instant::now() + SEND_LIMIT;
        while !bytes.is_empty() {
            match self.device.write(bytes) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(sent) => bytes = &bytes[sent..],
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    self.wait(PollFlags::OUT, until)?;
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// The next frame's content that `wanted` takes; other frames and damaged ones are passed
    /// over.
    ///
    /// # Errors
    /// The device's, or `TimedOut`.
    pub fn receive<T>(
        &mut self,
        within: Duration,
        wanted: impl Fn(&[u8]) -> Option<T>,
    ) -> io::Result<T> {
        let (until, mut receiver, mut bytes) =
            (Instant::now() + within, Receiver::default(), [0; 256]);
        loop {
            match self.device.read(&mut bytes) {
                Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
                Ok(read) => {
                    for &byte in &bytes[..read] {
                        if let Some(Ok(frame)) = receiver.push(byte)
                            && let Some(found) = wanted(frame)
                        {
                            return Ok(found);
                        }
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    self.wait(PollFlags::IN, until)?;
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
    }

    fn wait(&self, readiness: PollFlags, until: Instant) -> io::Result<()> {
        let left = until.saturating_duration_since(Instant::now());
        let left = Timespec {
            tv_sec: left.as_secs().try_into().unwrap_or(i64::MAX),
            tv_nsec: left.subsec_nanos().into(),
        };
        match poll(&mut [PollFd::new(&self.device, readiness)], Some(&left)) {
            Ok(0) => Err(io::ErrorKind::TimedOut.into()),
            Ok(_) | Err(rustix::io::Errno::INTR) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }
}

/// Windows on their way to a node.
#[derive(Debug)]
pub struct SerialOutput {
    settings: SerialSettings,
    frames: SyncSender<Vec<u8>>,
    lost: Arc<AtomicU64>,
}

impl SerialOutput {
    /// Starts the thread that writes. An absent device is not an error: each window tries again.
    pub fn start(settings: SerialSettings) -> Self {
        let (frames, waiting) = sync_channel::<Vec<u8>>(WAITING);
        let lost = Arc::new(AtomicU64::new(0));
        let (device, counted) = (settings.clone(), Arc::clone(&lost));
        std::thread::spawn(move || {
            let mut line = None;
            let mut working = true;
            for frame in waiting {
                let sent = match &mut line {
                    Some(line) => SerialLine::send(line, &frame),
                    None => SerialLine::open(&device.device, device.baud)
                        .and_then(|opened| line.insert(opened).send(&frame)),
                };
                let name = device.device.display();
                match sent {
                    Ok(()) if !working => log::info!("serial line {name}: windows go out again"),
                    Ok(()) => {}
                    Err(error) => {
                        counted.fetch_add(1, Ordering::Relaxed);
                        line = None;
                        if working {
                            log::warn!("serial line {name}: a window was not sent: {error}");
                        }
                        working = false;
                        continue;
                    }
                }
                working = true;
            }
        });
        Self { settings, frames, lost }
    }

    /// The settings it was started with.
    pub fn settings(&self) -> &SerialSettings {
        &self.settings
    }

    /// Sends a window, if it is of the length that is wanted. Never waits.
    pub fn window(&self, message: &DensityMessage) {
        let report = &message.report;
        if report.to.saturating_since(report.from).as_secs() != self.settings.window_s {
            return;
        }
        // The node switches by density, and has room for that.
        let mut message = message.clone();
        message.report.lanes.iter_mut().for_each(|lane| lane.traffic = None);
        let mut buffer = [0; MAX_DENSITY_MESSAGE];
        let sent = wire::encode(&message, &mut buffer)
            .is_ok_and(|frame| self.frames.try_send(frame.to_vec()).is_ok());
        if !sent {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Windows that did not leave.
    pub fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }
}
