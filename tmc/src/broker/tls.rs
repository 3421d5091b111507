//! TLS to the broker: the door of the crate `rustls`.

use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::{ClientConfig, RootCertStore};
use std::path::Path;
use std::sync::Arc;
use verge_desk::Failure;

/// How to talk to a broker through TLS.
pub(super) struct Tls(pub(super) Arc<ClientConfig>);

/// TLS that trusts the authorities in a PEM file and no others, and shows the broker a
/// certificate where one is given with its key.
///
/// # Errors
/// [`Failure`] names the file and what is wrong with it.
pub(super) fn load(ca: &Path, client: Option<(&Path, &Path)>) -> Result<Tls, Failure> {
    let text = verge_desk::read_text(ca)?;
    let wrong =
        |reason: String| Failure::content(ca, 0, format!("{reason}; give PEM certificates"));
    let mut roots = RootCertStore::empty();
    for certificate in CertificateDer::pem_slice_iter(text.as_bytes()) {
        let certificate = certificate.map_err(|error| wrong(error.to_string()))?;
        roots.add(certificate).map_err(|error| wrong(error.to_string()))?;
    }
    if roots.is_empty() {
        return Err(wrong("has no certificate".into()));
    }
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(|error| wrong(error.to_string()))?
        .with_root_certificates(roots);
    let Some((certificate, key)) = client else {
        return Ok(Tls(Arc::new(config.with_no_client_auth())));
    };
    let own =
        |path: &Path, reason: String| Failure::content(path, 0, format!("{reason}; give PEM"));
    let text = verge_desk::read_text(certificate)?;
    let chain = CertificateDer::pem_slice_iter(text.as_bytes())
        .collect::<Result<Vec<_>, _>>()
        .map_err(|error| own(certificate, error.to_string()))?;
    let text = verge_desk::read_text(key)?;
    let secret = PrivateKeyDer::from_pem_slice(text.as_bytes())
        .map_err(|error| own(key, error.to_string()))?;
    let config = config.with_client_auth_cert(chain, secret);
    Ok(Tls(Arc::new(config.map_err(|error| own(certificate, error.to_string()))?)))
}
