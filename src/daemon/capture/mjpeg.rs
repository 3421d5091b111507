//! Multipart MJPEG over HTTP: a camera that answers one request with picture after picture.
//!
//! Owns the request, the thread that reads the stream (a camera that is not read falls
//! behind, so all is read and the latest picture kept), and its end: a stream that fails or
//! stalls is left, and another is opened after a wait.

use super::backoff::Backoff;
use super::multipart::{self, PartError, Parts};
use super::queue::FRESH;
use super::snapshot::basic;
use super::{CaptureError, Captured, Credentials, StreamCounts, decode};
use crate::daemon::clock;
use crate::daemon::frame::Frame;
use std::hash::{DefaultHasher, Hasher};
use std::io::Read;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use ureq::http::{Uri, header};

/// What an address begins with that is a stream.
pub const SCHEME: &str = "mjpeg+";

/// How to ask a camera for its stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MjpegSettings {
    /// Address of the stream, `http://` or `https://`.
    pub url: String,
    /// User and password, sent as basic authentication to this host only.
    pub credentials: Option<Credentials>,
    /// Time between two pictures that are taken.
    pub interval: Duration,
    /// Longest wait for a picture.
    pub timeout: Duration,
}

/// Why a stream gives no picture.
#[derive(Clone, Debug, thiserror::Error)]
pub enum MjpegError {
    /// No answer.
    #[error("{url}: {reason}")]
    Transport {
        /// The address.
        url: String,
        /// What happened.
        reason: String,
    },
    /// An answer other than a stream.
    #[error("{url}: HTTP status {status}{}", super::snapshot::hint(*status))]
    Status {
        /// The address.
        url: String,
        /// The status.
        status: u16,
    },
    /// An answer of another type.
    #[error(
        "{url}: {content_type:?} is no multipart stream with a boundary; for an address of single \
         pictures leave {SCHEME} away"
    )]
    NotMultipart {
        /// The address.
        url: String,
        /// What it says it is.
        content_type: String,
    },
    /// The stream ended, or is none.
    #[error("{url}: {source}")]
    Part {
        /// The address.
        url: String,
        /// What happened.
        source: PartError,
    },
    /// No picture in time.
    #[error("{url}: no picture for {:.1} s", timeout.as_secs_f32())]
    Timeout {
        /// The address.
        url: String,
        /// How long was waited.
        timeout: Duration,
    },
    /// The address does not parse.
    #[error("{SCHEME}{url}: not an address of the form {SCHEME}http://host/path")]
    Url {
        /// The address.
        url: String,
    },
}

/// A camera whose stream is read.
#[derive(Debug)]
pub struct Mjpeg {
    settings: MjpegSettings,
    worker: Option<Worker>,
    backoff: Backoff,
    last_error: Option<MjpegError>,
    last_digest: Option<u64>,
    counts: StreamCounts,
    bytes: Vec<u8>,
}

impl Mjpeg {
    /// A camera; no request is made before the first picture is asked for.
    ///
    /// # Errors
    /// [`MjpegError::Url`].
    pub fn new(settings: MjpegSettings) -> Result<Self, MjpegError> {
        let uri: Option<Uri> = settings.url.parse().ok();
        let right =
            |u: &Uri| matches!(u.scheme_str(), Some("http" | "https")) && u.host().is_some();
        if !uri.as_ref().is_some_and(right) {
            return Err(MjpegError::Url { url: settings.url });
        }
        Ok(Self {
            settings,
            worker: None,
            backoff: Backoff::default(),
            last_error: None,
            last_digest: None,
            counts: StreamCounts::default(),
            bytes: Vec::new(),
        })
    }

    /// What became of the stream since start.
    pub fn counts(&self) -> StreamCounts {
        self.counts
    }

    /// Time between two pictures.
    pub fn interval(&self) -> Duration {
        self.settings.interval
    }

    pub(super) fn next(&mut self, frame: &mut Frame) -> Result<Captured, CaptureError> {
        if let Some(error) = &self.last_error
            && self.backoff.waits(Instant::now())
        {
            return Err(error.clone().into());
        }
        let worker = match &self.worker {
            Some(worker) if !worker.left() => worker,
            // A thread that was left ends with its next read, which has a time-out.
            Some(left) if !left.thread.is_finished() => return Err(self.timeout().into()),
            _ => self.worker.insert(Worker::start(&self.settings)),
        };
        if let Err(error) = worker.take(&self.settings, &mut self.bytes) {
            worker.shared.leave();
            self.counts.reopened += 1;
            self.backoff.failed(Instant::now(), fastrand::f32());
            self.last_error = Some(error.clone());
            return Err(error.into());
        }
        self.backoff.succeeded();
        self.last_error = None;
        let mut hasher = DefaultHasher::new();
        hasher.write(&self.bytes);
        let digest = hasher.finish();
        if self.last_digest.replace(digest) == Some(digest) {
            return Ok(Captured::Unchanged);
        }
        frame.time = clock::now();
        "stream".clone_into(&mut frame.name);
        decode(&self.bytes, &mut frame.picture)
            .map_err(|source| CaptureError::Decode { name: self.settings.url.clone(), source })?;
        Ok(Captured::New)
    }

    fn timeout(&self) -> MjpegError {
        let MjpegSettings { url, timeout, .. } = self.settings.clone();
        MjpegError::Timeout { url, timeout }
    }
}

impl Drop for Mjpeg {
    fn drop(&mut self) {
        if let Some(worker) = &self.worker {
            worker.shared.leave();
        }
    }
}

/// What the thread and the line share: the latest picture, or why there is none.
#[derive(Debug, Default)]
struct Shared {
    slot: Mutex<Slot>,
    changed: Condvar,
    left: AtomicBool,
}

#[derive(Debug, Default)]
struct Slot {
    bytes: Vec<u8>,
    arrived: Option<Instant>,
    ended: Option<MjpegError>,
}

impl Shared {
    fn slot(&self) -> MutexGuard<'_, Slot> {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn leave(&self) {
        self.left.store(true, Ordering::Relaxed);
    }
}

/// The thread that reads one stream to its end.
#[derive(Debug)]
struct Worker {
    shared: Arc<Shared>,
    thread: JoinHandle<()>,
}

impl Worker {
    fn start(settings: &MjpegSettings) -> Self {
        let (shared, settings) = (Arc::<Shared>::default(), settings.clone());
        let theirs = Arc::clone(&shared);
        let thread = thread::spawn(move || {
            let error = read(&settings, &theirs);
            theirs.slot().ended = Some(error);
            theirs.changed.notify_one();
        });
        Self { shared, thread }
    }

    fn left(&self) -> bool {
        self.shared.left.load(Ordering::Relaxed)
    }

    /// Takes the latest picture, and waits for one where there is none that is fresh.
    fn take(&self, settings: &MjpegSettings, bytes: &mut Vec<u8>) -> Result<(), MjpegError> {
        let begun = Instant::now();
        let mut slot = self.shared.slot();
        loop {
            if slot.arrived.is_some_and(|arrived| arrived.elapsed() < FRESH) {
                slot.arrived = None;
                std::mem::swap(bytes, &mut slot.bytes);
                return Ok(());
            }
            if let Some(error) = slot.ended.take() {
                return Err(error);
            }
            let Some(rest) = settings.timeout.checked_sub(begun.elapsed()) else {
                let MjpegSettings { url, timeout, .. } = settings.clone();
                return Err(MjpegError::Timeout { url, timeout });
            };
            let waited = self.shared.changed.wait_timeout(slot, rest);
            slot = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

/// A reader that ends when its stream is left.
struct Leaving<'a, R>(R, &'a AtomicBool);

impl<R: Read> Read for Leaving<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        if self.1.load(Ordering::Relaxed) { Ok(0) } else { self.0.read(buffer) }
    }
}

/// Reads the stream into the slot until it ends, and says why it did.
fn read(settings: &MjpegSettings, shared: &Shared) -> MjpegError {
    let url = || settings.url.clone();
    let timeout = Some(settings.timeout);
    let agent = ureq::Agent::config_builder()
        .timeout_resolve(timeout)
        .timeout_connect(timeout)
        .timeout_recv_response(timeout)
        .timeout_per_read(timeout)
        .max_redirects(3)
        .redirect_auth_headers(ureq::config::RedirectAuthHeaders::SameHost)
        .http_status_as_error(false)
        .user_agent(concat!("verge/", env!("CARGO_PKG_VERSION")))
        .build()
        .new_agent();
    let mut request = agent.get(&settings.url);
    if let Some(value) = settings.credentials.as_ref().and_then(basic) {
        request = request.header(header::AUTHORIZATION, value);
    }
    let mut response = match request.call() {
        Ok(response) => response,
        Err(error) => return MjpegError::Transport { url: url(), reason: error.to_string() },
    };
    let status = response.status().as_u16();
    if status != 200 {
        return MjpegError::Status { url: url(), status };
    }
    let content_type = response.headers().get(header::CONTENT_TYPE);
    let content_type = content_type.and_then(|value| value.to_str().ok()).unwrap_or_default();
    let Some(boundary) = multipart::boundary(content_type).map(str::to_owned) else {
        let content_type = content_type.to_owned();
        return MjpegError::NotMultipart { url: url(), content_type };
    };
    let reader = Leaving(response.body_mut().as_reader(), &shared.left);
    let (mut parts, mut part) = (Parts::new(reader, &boundary), Vec::new());
    loop {
        if let Err(source) = parts.next(&mut part) {
            return MjpegError::Part { url: url(), source };
        }
        let mut slot = shared.slot();
        std::mem::swap(&mut slot.bytes, &mut part);
        slot.arrived = Some(Instant::now());
        shared.changed.notify_one();
    }
}
