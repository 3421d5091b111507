//! Certificates: whom we trust, and who we are to a broker that asks.
//!
//! The door of the crates `rustls` and `webpki-roots`.

use rumqttc::{TlsConfiguration, Transport};
use rustls::pki_types::pem::{self, PemObject};
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::{ClientConfig, RootCertStore};
use sha2::{Digest, Sha256};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Why a connection cannot be secured.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    /// A file that cannot be read as PEM.
    #[error("{key} {}: {reason}; it must be a PEM file with {expected}", path.display())]
    Read {
        /// Which key of the configuration names it.
        key: &'static str,
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
        /// What should be in it.
        expected: &'static str,
    },
    /// Certificates that do not fit.
    #[error("mqtt.{key}: {reason}")]
    Unfit {
        /// Which key of the configuration names them.
        key: &'static str,
        /// What is wrong.
        reason: String,
    },
}

/// The files of a secured connection.
#[derive(Clone, Debug, Default)]
pub struct TlsFiles {
    /// Certificates that vouch for the broker; `None`: the public ones.
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
        let unfit = |key, error: rustls::Error| TlsError::Unfit { key, reason: error.to_string() };
        let mut roots = RootCertStore::empty();
        match &files.ca {
            None => roots.extend(webpki_roots::TLS_SERVER_ROOTS.iter().cloned()),
            Some(path) => {
                for certificate in certificates("mqtt.ca_file", path)? {
                    roots.add(certificate).map_err(|error| unfit("ca_file", error))?;
                }
            }
        }
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let config = ClientConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .map_err(|error| unfit("tls", error))?
            .with_root_certificates(roots);
        let config = match &files.identity {
            None => config.with_no_client_auth(),
            Some((certificate, key)) => {
                let chain = certificates("mqtt.certificate_file", certificate)?;
                let key = PrivateKeyDer::from_pem_file(key)
                    .map_err(|error| unreadable("mqtt.key_file", key, &error, "a private key"))?;
                config
                    .with_client_auth_cert(chain, key)
                    .map_err(|error| unfit("certificate_file", error))?
            }
        };
        Ok(Self { config: Arc::new(config), digest: digest(files) })
    }

    pub(super) fn transport(&self) -> Transport {
        Transport::tls_with_config(TlsConfiguration::Rustls(Arc::clone(&self.config)))
    }
}

/// What the files hold. They can be read: they were, a moment ago.
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

fn unreadable(
    key: &'static str,
    path: &Path,
    error: &pem::Error,
    expected: &'static str,
) -> TlsError {
    TlsError::Read { key, path: path.to_owned(), reason: error.to_string(), expected }
}
