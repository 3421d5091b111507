//! TLS to the broker: the door of the crate `rustls`.

use crate::failure::Failure;
use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject;
use rustls::{ClientConfig, RootCertStore};
use std::path::Path;
use std::sync::Arc;

/// How to talk to a broker through TLS.
pub(super) struct Tls(pub(super) Arc<ClientConfig>);

/// TLS that trusts the authorities in a PEM file and no others.
///
/// # Errors
/// [`Failure`] names the file and what is wrong with it.
pub(super) fn load(ca: &Path) -> Result<Tls, Failure> {
    let text = crate::failure::read_text(ca)?;
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
        .with_root_certificates(roots)
        .with_no_client_auth();
    Ok(Tls(Arc::new(config)))
}
