//! Certificates: whom we trust, and who we are to a broker that asks.
//!
//! Owns the files of the configuration that secure the connection, and the message where that
//! fails. `trust` decides which certificate is accepted.

use super::link::End as LinkEnd;
use crate::daemon::certificate::{End, not_after};
use crate::daemon::foreign::shown;
use crate::daemon::trust::{self, Peer, Trust};
use crate::daemon::{disk, plain};
use crate::units::UtcMs;
use rustls::pki_types::pem::{self, PemObject};
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::{AlertDescription as Alert, ClientConfig, Error};
use sha2::{Digest, Sha256};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Most bytes of a file of certificates: bundles of all public authorities have a quarter of it.
const MAX_FILE: u64 = 1 << 20;

/// Why a connection cannot be secured.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    /// A file that cannot be read as PEM.
    #[error("{key} {}: {reason}; it must be a PEM file with {expected}", path.display())]
    Read {
        /// The key of the configuration that names it.
        key: &'static str,
        /// The file.
        path: PathBuf,
        /// The fault.
        reason: String,
        /// The expected content.
        expected: &'static str,
    },
    /// Certificates that do not fit.
    #[error("mqtt.{key}{}: {reason}", file.as_ref().map_or(String::new(), |file| format!(" {}", file.display())))]
    Unfit {
        /// The key of the configuration that names them.
        key: &'static str,
        /// The file that it names, where it names one.
        file: Option<PathBuf>,
        /// The fault.
        reason: String,
    },
}

/// The files of a secured connection.
#[derive(Clone, Debug, Default)]
pub struct TlsFiles {
    /// Certificates that vouch for the broker, or its own; `None`: the public ones.
    pub ca: Option<PathBuf>,
    /// Our certificate chain and its private key.
    pub identity: Option<(PathBuf, PathBuf)>,
}

/// How a connection is secured.
#[derive(Clone)]
pub struct Tls {
    config: Arc<ClientConfig>,
    /// Of the files: a renewed certificate is another.
    digest: [u8; 32],
    /// Of the certificate that the broker shows.
    shown: End,
    /// Of our own, and of the one that vouches for the broker, where it is one.
    ends: Vec<UtcMs>,
}

impl PartialEq for Tls {
    fn eq(&self, other: &Self) -> bool {
        self.digest == other.digest
    }
}

impl fmt::Debug for Tls {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Tls")
    }
}

impl Tls {
    /// Reads the files.
    ///
    /// # Errors
    /// [`TlsError`] names the file and what is wrong with it.
    pub fn load(files: &TlsFiles) -> Result<Self, TlsError> {
        let (shown, mut ends) = (End::default(), Vec::new());
        let unfit = |key, file: Option<&PathBuf>, error: Error| TlsError::Unfit {
            key,
            file: file.cloned(),
            reason: misfit(&error),
        };
        let trust = match &files.ca {
            None => Trust::Public,
            Some(path) => {
                let wrong = |reason| TlsError::Read {
                    key: "mqtt.ca_file",
                    path: path.clone(),
                    reason,
                    expected: "certificates",
                };
                let file = plain::read(path, MAX_FILE)
                    .map_err(|error| wrong(disk::unread(&error).to_string()))?;
                let trust = Trust::certificates(path, &file).map_err(wrong)?;
                // Of a bundle most are other people's.
                if let Trust::Certificates(known) = &trust
                    && let [only] = known.certificates.as_slice()
                {
                    ends.extend(not_after(only));
                }
                trust
            }
        };
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let verifier = trust
            .verifier(Peer::Broker, &provider, shown.clone())
            .map_err(|error| unfit("ca_file", files.ca.as_ref(), error))?;
        let config = ClientConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .map_err(|error| unfit("tls", None, error))?
            .dangerous()
            .with_custom_certificate_verifier(verifier);
        let config = match &files.identity {
            None => config.with_no_client_auth(),
            Some((certificate, key)) => {
                let chain = certificates("mqtt.certificate_file", certificate)?;
                ends.extend(chain.iter().filter_map(|certificate| not_after(certificate)));
                let key = PrivateKeyDer::from_pem_file(key)
                    .map_err(|error| unreadable("mqtt.key_file", key, &error, "a private key"))?;
                config
                    .with_client_auth_cert(chain, key)
                    .map_err(|error| unfit("certificate_file", Some(certificate), error))?
            }
        };
        Ok(Self { config: Arc::new(config), digest: digest(files), shown, ends })
    }

    /// When the first certificate ends: ours, the one that vouches for the broker, or the
    /// broker's own, once it has shown it.
    pub fn first_end(&self) -> Option<UtcMs> {
        self.ends.iter().copied().chain(self.shown.get()).min()
    }

    pub(super) fn config(&self) -> Arc<ClientConfig> {
        Arc::clone(&self.config)
    }
}

/// The meaning of a TLS fault, and what to do.
pub(super) fn end(error: &Error) -> LinkEnd {
    LinkEnd::Unsafe(match error {
        // The words of `trust`.
        Error::General(text) => text.clone(),
        Error::InvalidMessage(_) => {
            "no TLS is spoken at this port: take the one with TLS (usually 8883), or leave \
             mqtt.tls away"
                .to_owned()
        }
        Error::PeerIncompatible(_) | Error::AlertReceived(Alert::ProtocolVersion) => {
            "the broker speaks no TLS from version 1.2 on".to_owned()
        }
        Error::AlertReceived(Alert::CertificateRequired | Alert::HandshakeFailure) => {
            "the broker wants a certificate of the box: mqtt.certificate_file and mqtt.key_file"
                .to_owned()
        }
        Error::AlertReceived(
            Alert::UnknownCA
            | Alert::BadCertificate
            | Alert::CertificateUnknown
            | Alert::CertificateExpired
            | Alert::CertificateRevoked
            | Alert::DecryptError,
        ) => "the broker does not take the certificate of the box (mqtt.certificate_file): is it \
              expired, or signed by another authority than the broker's?"
            .to_owned(),
        other => trust::fault(other),
    })
}

/// Digest of the files' content. They can be read: they were, a moment ago.
fn digest(files: &TlsFiles) -> [u8; 32] {
    let (certificate, key) = files.identity.as_ref().map(|(c, k)| (c, k)).unzip();
    let mut digest = Sha256::new();
    for file in [files.ca.as_ref(), certificate, key] {
        let bytes = file.and_then(|file| std::fs::read(file).ok()).unwrap_or_default();
        digest.update(bytes.len().to_le_bytes());
        digest.update(bytes);
    }
    digest.finalize().into()
}

fn certificates(key: &'static str, path: &Path) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    let wrong = |error: &pem::Error| unreadable(key, path, error, "certificates");
    let found: Vec<_> = CertificateDer::pem_file_iter(path)
        .and_then(Iterator::collect)
        .map_err(|error| wrong(&error))?;
    if found.is_empty() {
        return Err(wrong(&pem::Error::NoItemsFound));
    }
    Ok(found)
}

/// Why certificate and key are not taken.
fn misfit(error: &Error) -> String {
    match error {
        Error::InconsistentKeys(_) => {
            "certificate and key do not belong together: is mqtt.key_file the key of this \
             certificate?"
                .to_owned()
        }
        Error::InvalidCertificate(_) => {
            "its first certificate cannot be read: make it again (X.509 version 3, PEM)".to_owned()
        }
        // Of the key: rustls has no kind of its own for it.
        Error::General(_) => {
            "mqtt.key_file is of a kind that TLS does not take: RSA from 2048 bits on, P-256, P-384 \
             and Ed25519 are taken"
                .to_owned()
        }
        other => shown(&other.to_string()),
    }
}

fn unreadable(
    key: &'static str,
    path: &Path,
    error: &pem::Error,
    expected: &'static str,
) -> TlsError {
    let reason = match error {
        pem::Error::Io(error) => disk::unread(error).to_string(),
        pem::Error::NoItemsFound => format!("it holds no {}", expected.trim_start_matches("a ")),
        pem::Error::MissingSectionEnd { .. } => "it was cut off: an END line is missing".into(),
        _ => "a line of it is damaged: copy the file again".into(),
    };
    TlsError::Read { key, path: path.to_owned(), reason, expected }
}
