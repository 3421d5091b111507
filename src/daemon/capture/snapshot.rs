//! HTTP snapshots: a camera, or its server, that answers a request with one picture.
//!
//! Owns the request (time-outs, size limit, redirects, basic authentication, conditional
//! requests) and notices a picture that was sent before.

use super::{CaptureError, Captured, MAX_PICTURE_BYTES, decode};
use crate::daemon::clock;
use crate::daemon::frame::Frame;
use base64::{Engine, prelude::BASE64_STANDARD as BASE64};
use std::hash::{DefaultHasher, Hasher};
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;
use ureq::http::header::{self, HeaderMap, HeaderValue};

/// Most redirects that are followed.
const MAX_REDIRECTS: u32 = 3;

/// User and password for the camera.
#[derive(Clone, PartialEq, Eq)]
pub struct Credentials {
    /// User name.
    pub user: String,
    /// Password.
    pub password: String,
}

impl std::fmt::Debug for Credentials {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Credentials {{ user: {:?}, password: *** }}", self.user)
    }
}

/// How to ask a camera for its picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SnapshotSettings {
    /// Address of the picture, `http://` or `https://`.
    pub url: String,
    /// User and password, sent as basic authentication to this host only.
    pub credentials: Option<Credentials>,
    /// Time between two requests.
    pub interval: Duration,
    /// Longest time from request to last byte.
    pub timeout: Duration,
}

/// Why no snapshot came.
#[derive(Debug, thiserror::Error)]
pub enum SnapshotError {
    /// No answer, or one that broke off.
    #[error("{url}: {reason}")]
    Transport {
        /// The address without credentials.
        url: String,
        /// What happened.
        reason: String,
    },
    /// An answer other than a picture.
    #[error("{url}: HTTP status {status}{}", hint(*status))]
    Status {
        /// The address without credentials.
        url: String,
        /// The status.
        status: u16,
    },
    /// The answer is larger than any picture of a camera.
    #[error("{url}: the answer has more than {MAX_PICTURE_BYTES} bytes; is this the picture?")]
    TooLarge {
        /// The address without credentials.
        url: String,
    },
    /// The HTTP client panicked, which it should not whatever it gets.
    #[error("{url}: the HTTP client broke down over the answer; is this a camera?")]
    Client {
        /// The address without credentials.
        url: String,
    },
    /// The address does not parse.
    #[error("{url}: not an address of the form http://host/path")]
    Url {
        /// The address.
        url: String,
    },
}

/// What to do about a status, for the end of a message.
pub(super) const fn hint(status: u16) -> &'static str {
    match status {
        401 | 403 => "; check camera.user and camera.password_file",
        404 => "; check the path in camera.source",
        _ => "",
    }
}

/// A camera that is asked for its picture again and again.
#[derive(Debug)]
pub struct Snapshot {
    settings: SnapshotSettings,
    agent: ureq::Agent,
    authorization: Option<HeaderValue>,
    last: Option<Sent>,
    bytes: Vec<u8>,
}

/// What is remembered of the last picture.
#[derive(Debug)]
struct Sent {
    etag: Option<HeaderValue>,
    last_modified: Option<HeaderValue>,
    digest: u64,
}

impl Snapshot {
    /// A camera to be asked; no request is made yet.
    ///
    /// # Errors
    /// [`SnapshotError::Url`].
    pub fn new(settings: SnapshotSettings) -> Result<Self, SnapshotError> {
        let bad_url = || SnapshotError::Url { url: settings.url.clone() };
        let uri: ureq::http::Uri = settings.url.parse().map_err(|_| bad_url())?;
        if !matches!(uri.scheme_str(), Some("http" | "https")) || uri.host().is_none() {
            return Err(bad_url());
        }
        let agent = agent(settings.timeout);
        let authorization = settings.credentials.as_ref().and_then(basic);
        Ok(Self { settings, agent, authorization, last: None, bytes: Vec::new() })
    }

    /// Time between two requests.
    pub fn interval(&self) -> Duration {
        self.settings.interval
    }

    pub(super) fn next(&mut self, frame: &mut Frame) -> Result<Captured, CaptureError> {
        // ureq 3.5.1 panics on a redirect whose chunked body breaks off behind its last
        // chunk. What a camera answers costs a picture and never the daemon.
        let Ok(asked) = catch_unwind(AssertUnwindSafe(|| self.ask())) else {
            self.agent = agent(self.settings.timeout);
            return Err(SnapshotError::Client { url: self.settings.url.clone() }.into());
        };
        let Some(sent) = asked? else { return Ok(Captured::Unchanged) };
        if self.last.as_ref().is_some_and(|last| last.digest == sent.digest) {
            return Ok(Captured::Unchanged);
        }
        self.last = Some(sent);
        frame.time = clock::now();
        "snapshot".clone_into(&mut frame.name);
        decode(&self.bytes, &mut frame.picture)
            .map_err(|source| CaptureError::Decode { name: self.settings.url.clone(), source })?;
        Ok(Captured::New)
    }

    /// Makes one request and reads the picture's bytes; `None` where the camera says that
    /// it is the one before.
    fn ask(&mut self) -> Result<Option<Sent>, SnapshotError> {
        let url = &self.settings.url;
        let transport = |reason: String| SnapshotError::Transport { url: url.clone(), reason };
        let mut request = self.agent.get(url);
        if let Some(value) = &self.authorization {
            request = request.header(header::AUTHORIZATION, value);
        }
        if let Some(last) = &self.last {
            if let Some(etag) = &last.etag {
                request = request.header(header::IF_NONE_MATCH, etag);
            }
            if let Some(time) = &last.last_modified {
                request = request.header(header::IF_MODIFIED_SINCE, time);
            }
        }
        let mut response = request.call().map_err(|error| transport(error.to_string()))?;
        match response.status().as_u16() {
            200 => {}
            304 => return Ok(None),
            status => return Err(SnapshotError::Status { url: url.clone(), status }),
        }
        self.bytes.clear();
        let reader = response.body_mut().as_reader();
        reader
            .take(MAX_PICTURE_BYTES as u64 + 1)
            .read_to_end(&mut self.bytes)
            .map_err(|error| transport(format!("the answer broke off: {error}")))?;
        if self.bytes.len() > MAX_PICTURE_BYTES {
            return Err(SnapshotError::TooLarge { url: url.clone() });
        }
        Ok(Some(Sent::new(response.headers(), &self.bytes)))
    }
}

fn agent(timeout: Duration) -> ureq::Agent {
    ureq::Agent::config_builder()
        .timeout_global(Some(timeout))
        .max_redirects(MAX_REDIRECTS)
        .redirect_auth_headers(ureq::config::RedirectAuthHeaders::SameHost)
        .http_status_as_error(false)
        .user_agent(concat!("verge/", env!("CARGO_PKG_VERSION")))
        .build()
        .new_agent()
}

impl Sent {
    fn new(headers: &HeaderMap, bytes: &[u8]) -> Self {
        let mut hasher = DefaultHasher::new();
        hasher.write(bytes);
        Self {
            etag: headers.get(header::ETAG).cloned(),
            last_modified: headers.get(header::LAST_MODIFIED).cloned(),
            digest: hasher.finish(),
        }
    }
}

/// The `Authorization` header of RFC 7617.
pub(super) fn basic(credentials: &Credentials) -> Option<HeaderValue> {
    let text = format!("{}:{}", credentials.user, credentials.password);
    let mut value = HeaderValue::from_str(&format!("Basic {}", BASE64.encode(text))).ok()?;
    value.set_sensitive(true);
    Some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_password_is_not_printed() {
        let credentials = Credentials { user: "box".into(), password: "hunter2".into() };
        assert!(!format!("{credentials:?}").contains("hunter2"));
        assert!(!format!("{:?}", basic(&credentials)).contains("aHVudGVy"));
    }
}
