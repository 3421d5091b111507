//! HTTP snapshots: a camera, or its server, that answers a request with one picture.
//!
//! Owns which answers hold a picture, where it ends whatever the answer's length says, and
//! notices one that was sent before.

use super::network::http::{Answer, Body, Client};
use super::network::{CameraError, CameraSettings, Fault};
use super::picture::{kind, scan};
use super::{CaptureError, Captured, MAX_PICTURE_BYTES, decode_shaped};
use crate::daemon::clock;
use crate::daemon::frame::Frame;
use std::hash::{DefaultHasher, Hasher};
use std::io::{self, Read};
use std::time::{Duration, Instant};

/// Bytes that are read at once.
const CHUNK: usize = 16 << 10;
/// Silence after which a whole picture counts, though more was announced.
const QUIET: Duration = Duration::from_millis(500);

/// Types of a stream of JPEGs without parts. Other video is named by what it is.
const MOTION_JPEG: [&str; 3] = ["video/x-motion-jpeg", "video/mjpeg", "video/x-mjpeg"];

/// A camera that is asked for its picture again and again.
#[derive(Debug)]
pub struct Snapshot {
    settings: CameraSettings,
    client: Client,
    last: Option<Sent>,
    bytes: Vec<u8>,
}

/// The last picture, as far as it is remembered.
#[derive(Debug)]
struct Sent {
    etag: Option<String>,
    last_modified: Option<String>,
    digest: u64,
}

impl Snapshot {
    /// A camera to be asked; no request is made yet.
    pub fn new(settings: CameraSettings) -> Self {
        Self { client: Client::new(settings.clone()), settings, last: None, bytes: Vec::new() }
    }

    /// Time between two requests.
    pub fn interval(&self) -> Duration {
        self.settings.interval
    }

    pub(super) fn next(&mut self, frame: &mut Frame) -> Result<Captured, CaptureError> {
        let sent = self.ask()?;
        let is_known =
            |sent: &Sent| self.last.as_ref().is_some_and(|last| last.digest == sent.digest);
        let Some(sent) = sent.filter(|sent| !is_known(sent)) else {
            return Ok(Captured::Unchanged);
        };
        frame.time = clock::now();
        "snapshot".clone_into(&mut frame.name);
        let name = || self.settings.address.to_string();
        decode_shaped(&self.bytes, self.settings.shape(), &mut frame.picture)
            .map_err(|source| CaptureError::Decode { name: name(), source })?;
        // Only now: a picture that cannot be used is not one that stands still.
        self.last = Some(sent);
        Ok(Captured::New)
    }

    /// Makes one request and reads the picture's bytes; `None` where the camera says that
    /// it is the one before.
    fn ask(&mut self) -> Result<Option<Sent>, CameraError> {
        let begun = Instant::now();
        let at = |fault: Fault| fault.at(&self.settings.address);
        let last = self.last.as_ref();
        let headers = [
            ("If-None-Match", last.and_then(|last| last.etag.as_deref())),
            ("If-Modified-Since", last.and_then(|last| last.last_modified.as_deref())),
        ];
        let headers: Vec<_> =
            headers.into_iter().filter_map(|(name, value)| Some((name, value?))).collect();
        let Answer { head, mut body } = self.client.get(&headers, self.settings.timeout)?;
        if head.status == 304 {
            // Of a picture that it never gave, or that was asked for without a condition, it is none.
            let status = Fault::Status { protocol: "HTTP", status: 304 };
            return if headers.is_empty() { Err(at(status)) } else { Ok(None) };
        }
        let content_type = head.content_type();
        if content_type.starts_with("multipart/") || MOTION_JPEG.contains(&content_type.as_str()) {
            return Err(at(Fault::IsStream));
        }
        let rest = self.settings.timeout.saturating_sub(begun.elapsed());
        body.connection().set_limit(rest);
        read_picture(&mut body, &mut self.bytes).map_err(at)?;
        let encoding = head.get("content-encoding").unwrap_or_default().to_ascii_lowercase();
        if encoding.contains("gzip") || encoding.contains("deflate") {
            unpack(&mut self.bytes, &encoding).map_err(at)?;
        }
        let picture = kind::trimmed(&self.bytes);
        if kind::Kind::of(picture).is_none() {
            let fault = if kind::is_multipart(picture) {
                Fault::IsStream
            } else {
                Fault::NoPicture(kind::described(picture))
            };
            return Err(at(fault));
        }
        let header = |name| head.get(name).map(str::to_owned);
        let mut hasher = DefaultHasher::new();
        hasher.write(&self.bytes);
        Ok(Some(Sent {
            etag: header("etag"),
            last_modified: header("last-modified"),
            digest: hasher.finish(),
        }))
    }
}

/// Reads a body that is one picture. A picture that has its end counts, whether the length that
/// was announced is right or not.
fn read_picture(body: &mut Body, bytes: &mut Vec<u8>) -> Result<(), Fault> {
    bytes.clear();
    let (mut chunk, mut quiet) = ([0; CHUNK], Instant::now());
    loop {
        if body.is_complete() {
            // A length that is too short: the rest comes behind it.
            let cut = kind::Kind::of(kind::trimmed(bytes)).is_some() && !scan::is_whole(bytes);
            if !cut {
                return Ok(());
            }
            body.read_beyond();
            if body.is_complete() {
                return Ok(());
            }
        }
        match body.read(&mut chunk) {
            Ok(0) if body.is_complete() => {}
            Ok(0) => return Ok(()),
            Ok(read) => {
                bytes.extend_from_slice(&chunk[..read]);
                quiet = Instant::now();
                if kind::is_multipart(bytes) {
                    return Err(Fault::IsStream);
                }
                if bytes.len() > MAX_PICTURE_BYTES {
                    let is_stream = scan::is_whole(bytes);
                    return Err(match foreign(bytes) {
                        _ if is_stream => Fault::IsStream,
                        Some(fault) if kind::video(bytes).is_some() => fault,
                        _ => Fault::TooLarge,
                    });
                }
            }
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                if quiet.elapsed() >= QUIET && scan::is_whole(bytes) {
                    return Ok(());
                }
            }
            Err(error) => {
                let whole = scan::is_whole(bytes);
                return match body.connection().fault(&error, "whole picture") {
                    // It goes on and on behind a whole picture.
                    Fault::Timeout { .. } if whole => Err(Fault::IsStream),
                    _ if whole => Ok(()),
                    // An answer that never ends and is not a picture.
                    fault @ Fault::Timeout { .. } => Err(foreign(bytes).unwrap_or(fault)),
                    fault => Err(fault),
                };
            }
        }
    }
}

/// The fault of an answer that is not a picture.
fn foreign(bytes: &[u8]) -> Option<Fault> {
    let picture = kind::trimmed(bytes);
    let is_one = picture.is_empty() || kind::Kind::of(picture).is_some();
    (!is_one).then(|| Fault::NoPicture(kind::described(picture)))
}

/// Unpacks a body that came packed though nobody asked for it.
fn unpack(bytes: &mut Vec<u8>, encoding: &str) -> Result<(), Fault> {
    let mut unpacked = Vec::new();
    let most = MAX_PICTURE_BYTES as u64 + 1;
    let read = if encoding.contains("gzip") {
        flate2::read::GzDecoder::new(bytes.as_slice()).take(most).read_to_end(&mut unpacked)
    } else {
        flate2::read::ZlibDecoder::new(bytes.as_slice()).take(most).read_to_end(&mut unpacked)
    };
    read.map_err(|_| Fault::Broken("its packed body is damaged".to_owned()))?;
    if unpacked.len() > MAX_PICTURE_BYTES {
        return Err(Fault::TooLarge);
    }
    *bytes = unpacked;
    Ok(())
}
