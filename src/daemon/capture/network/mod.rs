//! Shared by cameras on a network: how they are reached, and how they are named in
//! messages.
//!
//! Owns settings and faults of such cameras. [`connection`] is the bytes, with TLS and time
//! limits; [`head`] the lines in front of an answer; [`login`] the authentication; [`http`] one
//! request. The crate `http_auth` is known here alone.
//!
//! This is a client of our own, not a library's: cameras answer with header lines and lengths
//! that a strict client refuses, want Digest, present certificates of their own, and are asked
//! over RTSP by the same connection and the same login. It reads one answer a connection, which
//! leaves out what goes wrong with connections that are kept.

pub mod connection;
pub mod head;
pub mod http;
pub mod login;

use crate::daemon::address::Address;
use crate::daemon::frame::Shape;
use crate::daemon::trust::Trust;
use std::time::Duration;

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

/// How to ask a camera on a network for pictures.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CameraSettings {
    /// Its address.
    pub address: Address,
    /// User and password; the address may hold them too.
    pub credentials: Option<Credentials>,
    /// Certificates that it may show.
    pub trust: Trust,
    /// Other hosts to which it may redirect.
    pub redirect_hosts: Vec<String>,
    /// Time between two pictures that are taken.
    pub interval: Duration,
    /// Longest wait for a picture.
    pub timeout: Duration,
    /// Columns and rows of the lane table, px: pictures of another shape are refused undecoded.
    pub size: Option<(u32, u32)>,
    /// Whether every picture of a video is decoded, as one that follows vehicles needs, or key
    /// pictures alone.
    pub every_picture: bool,
}

impl CameraSettings {
    /// A camera that is asked as most are.
    pub fn new(address: Address, interval: Duration, timeout: Duration) -> Self {
        Self {
            address,
            credentials: None,
            trust: Trust::Public,
            redirect_hosts: Vec::new(),
            interval,
            timeout,
            size: None,
            every_picture: false,
        }
    }

    /// The shape that pictures must have.
    pub(super) fn shape(&self) -> Option<Shape> {
        self.size.map(|(width, height)| Shape { width, height })
    }

    /// The login: of its own keys, else of the address.
    pub fn login(&self) -> Option<Credentials> {
        let of_address = |(user, password): &(String, String)| Credentials {
            user: user.clone(),
            password: password.clone(),
        };
        self.credentials.clone().or_else(|| self.address.login.as_ref().map(of_address))
    }
}

/// Why a camera on a network gave no picture.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{address}: {fault}")]
pub struct CameraError {
    /// The camera, without login and query.
    pub address: String,
    /// The fault.
    pub fault: Fault,
}

/// A fault of the connection or of the answer. Words of the camera in it are cut short.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// Its name has no address.
    #[error(
        "the name {host} has no address ({reason}): is it spelled right, and is there a name server?"
    )]
    Name {
        /// The name.
        host: String,
        /// The system's reason.
        reason: String,
    },
    /// Nobody answers there.
    #[error("{0}; is the camera on, and are host and port right?")]
    Connect(String),
    /// TLS failed.
    #[error("{0}")]
    Secure(String),
    /// The connection broke.
    #[error("the connection broke: {0}")]
    Broken(String),
    /// Nothing came for as long as it may take.
    #[error("no {what} for {:.1} s", waited.as_secs_f32())]
    Timeout {
        /// The part that was waited for.
        what: &'static str,
        /// Time waited.
        waited: Duration,
    },
    /// The answer is not of the protocol.
    #[error("the answer is not {protocol} ({begins})")]
    Protocol {
        /// The protocol.
        protocol: &'static str,
        /// First bytes of the answer.
        begins: String,
    },
    /// An answer other than a picture.
    #[error("{protocol} status {status}{}", hint(*status))]
    Status {
        /// The protocol.
        protocol: &'static str,
        /// The status.
        status: u16,
    },
    /// It wants a login and there is none.
    #[error("the camera wants a login: set camera.user and camera.password_file")]
    LoginWanted,
    /// It refuses the login.
    #[error(
        "the camera refuses user {user:?}: check camera.user and camera.password_file. Cameras lock \
         the account after a few wrong logins: it is tried again after 1 minute, later after up to \
         10, and at once with a new configuration"
    )]
    LoginRefused {
        /// The user.
        user: String,
    },
    /// It wants a login of a kind that verge does not know.
    #[error(
        "the camera wants a login that verge does not know ({0}); verge knows Digest and Basic"
    )]
    LoginUnknown(String),
    /// It leads to another host.
    #[error(
        "the camera redirects to {host}: give that address, or allow the host in \
         camera.redirect_hosts"
    )]
    RedirectedAway {
        /// The other host.
        host: String,
    },
    /// It redirects in a circle, or to nowhere.
    #[error("the camera redirects {0}")]
    Redirects(String),
    /// More bytes than a picture has.
    #[error("the answer has more than {} bytes; is this the picture?", super::MAX_PICTURE_BYTES)]
    TooLarge,
    /// Whole, and no picture.
    #[error("{0}")]
    NoPicture(String),
    /// A stream at the address of a snapshot.
    #[error("this is a stream, picture after picture: put mjpeg+ before its address")]
    IsStream,
    /// A video without key pictures.
    #[error(
        "{pictures} pictures in {:.0} s and no key picture among them: set the camera's key (I-frame) \
         interval to a few seconds, and switch smart codecs (H.264+, Zipstream) off",
        waited.as_secs_f32()
    )]
    NoKey {
        /// Time waited.
        waited: Duration,
        /// Pictures that came.
        pictures: u64,
    },
    /// A stream that ended.
    #[error("{0}")]
    Ended(String),
}

/// Advice for a status, for the end of a message.
const fn hint(status: u16) -> &'static str {
    match status {
        401 | 403 => "; check camera.user and camera.password_file, and what this user may see",
        404 | 410 => "; check the path in the address",
        429 | 503 => "; the camera is busy: ask it less often (camera.interval_s)",
        454 | 461 | 463 => "; the camera does not play this",
        _ => "",
    }
}

impl Fault {
    /// With the camera that it is about.
    pub fn at(self, address: &Address) -> CameraError {
        CameraError { address: address.to_string(), fault: self }
    }
}
