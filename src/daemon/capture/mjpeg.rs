//! MJPEG over HTTP: a camera that answers one request with picture after picture.
//!
//! Owns the stream's thread (a camera that is not read falls behind, so all is read and the
//! latest picture kept), and its end: a stream that fails or stalls is left, and another is
//! opened after a wait.

use super::backoff::Backoff;
use super::latest::{Latest, Worker};
use super::network::http::{Answer, Body, Client};
use super::network::{CameraError, CameraSettings, Fault};
use super::picture::scan::{Pictures, StreamError};
use super::queue::FRESH;
use super::{CaptureError, Captured, StreamCounts, decode_shaped};
use crate::daemon::clock;
use crate::daemon::frame::Frame;
use std::hash::{DefaultHasher, Hasher};
use std::io::{self, Read};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// A camera whose stream is read.
#[derive(Debug)]
pub struct Mjpeg {
    settings: CameraSettings,
    /// Kept from one stream to the next, for the login that it has.
    client: Arc<Mutex<Client>>,
    worker: Option<Worker<Vec<u8>>>,
    backoff: Backoff,
    last_error: Option<CameraError>,
    last_digest: Option<u64>,
    counts: StreamCounts,
    bytes: Vec<u8>,
}

impl Mjpeg {
    /// A camera; no request is made before the first picture is asked for.
    pub fn new(settings: CameraSettings) -> Self {
        Self {
            client: Arc::new(Mutex::new(Client::new(settings.clone()))),
            settings,
            worker: None,
            backoff: Backoff::default(),
            last_error: None,
            last_digest: None,
            counts: StreamCounts::default(),
            bytes: Vec::new(),
        }
    }

    /// Counts of the stream's frames since start.
    pub fn counts(&self) -> StreamCounts {
        self.counts
    }

    /// Time between two pictures that are taken.
    pub fn interval(&self) -> Duration {
        self.settings.interval
    }

    pub(super) fn next(&mut self, frame: &mut Frame) -> Result<Captured, CaptureError> {
        let worker = match &mut self.worker {
            Some(worker) if !worker.is_left() => worker,
            // The thread of a stream that was left may wait for the camera still.
            Some(worker) if !worker.is_finished() => return Err(self.failed()),
            _ if self.backoff.waits(Instant::now()) => return Err(self.failed()),
            worker => {
                let (client, timeout) = (Arc::clone(&self.client), self.settings.timeout);
                let start = move |latest: &Latest<Vec<u8>>| read(&client, timeout, latest);
                worker.insert(Worker::start("mjpeg", start))
            }
        };
        if let Err(fault) = worker.take(self.settings.timeout, FRESH, &mut self.bytes) {
            worker.leave();
            self.counts.reopened += 1;
            self.backoff.failed(Instant::now(), fastrand::f32());
            let error = fault.at(&self.settings.address);
            self.last_error = Some(error.clone());
            return Err(error.into());
        }
        self.backoff.succeeded();
        self.last_error = None;
        let mut hasher = DefaultHasher::new();
        hasher.write(&self.bytes);
        let digest = hasher.finish();
        if self.last_digest == Some(digest) {
            return Ok(Captured::Unchanged);
        }
        frame.time = clock::now();
        "stream".clone_into(&mut frame.name);
        decode_shaped(&self.bytes, self.settings.shape(), &mut frame.picture).map_err(
            |source| CaptureError::Decode { name: self.settings.address.to_string(), source },
        )?;
        self.last_digest = Some(digest);
        Ok(Captured::New)
    }

    fn failed(&self) -> CaptureError {
        let waited = self.settings.timeout;
        let timeout = || Fault::Timeout { what: "picture", waited }.at(&self.settings.address);
        self.last_error.clone().unwrap_or_else(timeout).into()
    }
}

/// Reads the stream into the slot until it ends, and says why it did.
fn read(client: &Mutex<Client>, timeout: Duration, latest: &Latest<Vec<u8>>) -> Fault {
    // Nobody else asks while this thread lives; a client that panicked holds nothing broken.
    let mut client = client.lock().unwrap_or_else(PoisonError::into_inner);
    let Answer { head, body } = match client.get(&[], timeout) {
        Ok(answer) => answer,
        Err(error) => return error.fault,
    };
    let content_type = head.content_type();
    let mut pictures = Pictures::new(Stream { body, timeout, latest });
    let mut picture = Vec::new();
    loop {
        if let Err(error) = pictures.next(&mut picture) {
            return ended(&error, &content_type, pictures.found());
        }
        latest.put(&mut picture);
    }
}

/// Why a stream ended.
fn ended(error: &StreamError, content_type: &str, found: u64) -> Fault {
    let single = found <= 1 && content_type.starts_with("image/");
    match error {
        StreamError::Ended | StreamError::Nothing(_) if single => Fault::Ended(format!(
            "{error}; the camera says {content_type}: for an address of single pictures leave mjpeg+ away"
        )),
        _ => Fault::Ended(error.to_string()),
    }
}

/// A body that ends when its stream is left, and whose silence has a limit.
struct Stream<'a> {
    body: Body,
    timeout: Duration,
    latest: &'a Latest<Vec<u8>>,
}

impl Read for Stream<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.body.connection().set_limit(self.timeout);
        loop {
            if self.latest.is_left() {
                return Ok(0);
            }
            match self.body.read(buffer) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                Err(error) => {
                    let fault = self.body.connection().fault(&error, "bytes");
                    return Err(io::Error::other(fault.to_string()));
                }
                read => return read,
            }
        }
    }
}
