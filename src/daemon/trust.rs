//! Certificates that a camera or a broker may show, and the error where it shows another.
//!
//! Owns three rules: public authorities, a file of certificates, or one certificate's
//! fingerprint. A certificate that stands in the file itself, or whose fingerprint is pinned, is
//! taken as it is: cameras make their own, for no name and long expired.

use super::certificate::{End, not_after};
use super::foreign::shown;
use rustls::client::WebPkiServerVerifier;
use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::crypto::CryptoProvider;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName, UnixTime};
use rustls::{
    CertificateError, ClientConfig, DigitallySignedStruct, Error, RootCertStore, SignatureScheme,
};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Certificates that are accepted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Trust {
    /// One of a public authority.
    #[default]
    Public,
    /// One of a file's, or one that an authority among them vouches for.
    Certificates(Arc<Known>),
    /// The one with this SHA-256 of its DER form.
    Fingerprint([u8; 32]),
}

/// The certificates of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Known {
    /// The file, for the words.
    pub file: PathBuf,
    /// What it holds.
    pub certificates: Vec<CertificateDer<'static>>,
}

/// Who shows a certificate, for the words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Peer {
    /// The camera.
    Camera,
    /// The broker.
    Broker,
}

impl Trust {
    /// The certificates of a file in PEM, or of one in DER: its content.
    ///
    /// # Errors
    /// The fault of the file.
    pub fn certificates(file: &Path, content: &[u8]) -> Result<Self, String> {
        let pem: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(content).collect();
        let mut certificates = pem.map_err(|_| {
            "a certificate in it is damaged or cut off: copy the file again".to_owned()
        })?;
        if certificates.is_empty() && content.first() == Some(&0x30) {
            certificates.push(CertificateDer::from(content.to_vec()));
        }
        if certificates.is_empty() {
            let none = "no certificate is in it, which begins with -----BEGIN CERTIFICATE-----";
            return Err(none.to_owned());
        }
        // A key or a bundle in DER begins as a certificate does.
        if certificates.iter().all(|certificate| not_after(certificate).is_none()) {
            return Err("what is in it is not a certificate: export that alone, as PEM".to_owned());
        }
        Ok(Self::Certificates(Arc::new(Known { file: file.to_owned(), certificates })))
    }

    /// The key of a configuration that names its file, with the file where there is one.
    fn named(&self, key: &str) -> String {
        match self {
            Self::Certificates(known) => format!("{key} ({})", known.file.display()),
            _ => key.to_owned(),
        }
    }

    /// Reads a fingerprint as `openssl x509 -noout -fingerprint -sha256` or a browser shows it.
    ///
    /// # Errors
    /// The expected form.
    pub fn fingerprint(text: &str) -> Result<Self, String> {
        let text = text.trim();
        let text = text.rsplit_once(['=']).map_or(text, |(_, digits)| digits);
        let text = text.strip_prefix("sha256:").or(text.strip_prefix("SHA256:")).unwrap_or(text);
        let digits: Vec<u8> = text.bytes().filter(|byte| !matches!(byte, b':' | b' ')).collect();
        let mut fingerprint = [0; 32];
        let pairs = digits.chunks(2).map(|pair| {
            let pair = std::str::from_utf8(pair).ok().filter(|pair| pair.len() == 2)?;
            u8::from_str_radix(pair, 16).ok()
        });
        let bytes: Option<Vec<u8>> = pairs.collect();
        match bytes {
            Some(bytes) if bytes.len() == 32 => {
                fingerprint.copy_from_slice(&bytes);
                Ok(Self::Fingerprint(fingerprint))
            }
            _ => Err("a SHA-256 fingerprint has 64 hexadecimal digits, with or without colons"
                .to_owned()),
        }
    }

    /// How TLS is done with it, with a camera.
    ///
    /// # Errors
    /// An error of the TLS library.
    pub fn config(&self) -> Result<ClientConfig, Error> {
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let verifier = self.verifier(Peer::Camera, &provider, End::default())?;
        Ok(ClientConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()?
            .dangerous()
            .with_custom_certificate_verifier(verifier)
            .with_no_client_auth())
    }

    /// Judges a certificate, finds words for it, and notes the end of one that is accepted.
    ///
    /// # Errors
    /// An error of the TLS library.
    pub fn verifier(
        &self,
        peer: Peer,
        provider: &Arc<CryptoProvider>,
        end: End,
    ) -> Result<Arc<dyn ServerCertVerifier>, Error> {
        Ok(Arc::new(Verifier { end, ..Verifier::new(self, peer, provider)? }))
    }
}

#[derive(Debug)]
struct Verifier {
    trust: Trust,
    peer: Peer,
    end: End,
    authorities: Option<Arc<WebPkiServerVerifier>>,
    provider: Arc<CryptoProvider>,
}

impl Verifier {
    fn new(trust: &Trust, peer: Peer, provider: &Arc<CryptoProvider>) -> Result<Self, Error> {
        let mut roots = RootCertStore::empty();
        match trust {
            Trust::Public => roots.extend(webpki_roots::TLS_SERVER_ROOTS.iter().cloned()),
            // A certificate that is not an authority's is trusted as it is.
            Trust::Certificates(known) => {
                roots.add_parsable_certificates(known.certificates.iter().cloned());
            }
            Trust::Fingerprint(_) => {}
        }
        let provider = Arc::clone(provider);
        let authorities = if roots.is_empty() {
            None
        } else {
            let builder =
                WebPkiServerVerifier::builder_with_provider(roots.into(), provider.clone());
            Some(builder.build().map_err(|error| Error::General(error.to_string()))?)
        };
        Ok(Self { trust: trust.clone(), peer, end: End::default(), authorities, provider })
    }

    /// A signature of the handshake that is not taken. `ring` refuses short keys without a reason of
    /// their own.
    fn weak(&self, error: Error) -> Error {
        let Error::InvalidCertificate(_) = error else { return error };
        let whose = match self.peer {
            Peer::Camera => "camera",
            Peer::Broker => "broker",
        };
        Error::General(format!(
            "the {whose}'s certificate has a key that is not safe today (RSA below 2048 bits), or the \
             {whose} does not hold its key: make a new key and certificate there (RSA 2048 or P-256)"
        ))
    }

    /// Whether this very certificate is trusted.
    fn is_pinned(&self, certificate: &CertificateDer<'_>) -> bool {
        match &self.trust {
            Trust::Public => false,
            Trust::Certificates(known) => {
                known.certificates.iter().any(|known| known.as_ref() == certificate.as_ref())
            }
            Trust::Fingerprint(known) => *known == <[u8; 32]>::from(Sha256::digest(certificate)),
        }
    }
}

impl ServerCertVerifier for Verifier {
    fn verify_server_cert(
        &self,
        certificate: &CertificateDer<'_>,
        intermediates: &[CertificateDer<'_>],
        name: &ServerName<'_>,
        ocsp: &[u8],
        now: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        self.end.note(certificate);
        if self.is_pinned(certificate) {
            return Ok(ServerCertVerified::assertion());
        }
        let own = fingerprint_text(certificate);
        let Some(authorities) = &self.authorities else {
            return Err(Error::General(match self.trust {
                Trust::Fingerprint(_) => format!(
                    "the camera's certificate is not the one in camera.fingerprint: it has {own}. Was \
                     the camera replaced or reset?"
                ),
                _ => match self.peer {
                    Peer::Camera => {
                        let file = self.trust.named("camera.ca_file");
                        format!("the camera's certificate is not in {file}; it has {own}")
                    }
                    Peer::Broker => {
                        let file = self.trust.named("mqtt.ca_file");
                        format!("the broker's certificate is not in {file}")
                    }
                },
            }));
        };
        let judged = authorities.verify_server_cert(certificate, intermediates, name, ocsp, now);
        judged.map_err(|error| {
            Error::General(match self.peer {
                Peer::Camera => refusal(&error, &self.trust, &own),
                Peer::Broker => broker_refusal(&error, &self.trust, name),
            })
        })
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        let known = &self.provider.signature_verification_algorithms;
        rustls::crypto::verify_tls12_signature(message, certificate, signed, known)
            .map_err(|error| self.weak(error))
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        let known = &self.provider.signature_verification_algorithms;
        rustls::crypto::verify_tls13_signature(message, certificate, signed, known)
            .map_err(|error| self.weak(error))
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.provider.signature_verification_algorithms.supported_schemes()
    }
}

fn fingerprint_text(certificate: &CertificateDer<'_>) -> String {
    let digits: Vec<_> =
        Sha256::digest(certificate).iter().map(|byte| format!("{byte:02X}")).collect();
    format!("sha256:{}", digits.join(":"))
}

/// The fault of a certificate, and what to do.
fn refusal(error: &Error, trust: &Trust, own: &str) -> String {
    let remedy = format!(
        "If {own} is what the camera's own page shows, write it into camera.fingerprint, or save the \
         certificate and name it in camera.ca_file"
    );
    match error {
        Error::InvalidCertificate(
            CertificateError::Expired | CertificateError::ExpiredContext { .. },
        ) => {
            format!("the camera's certificate has expired (is the box's clock right?). {remedy}")
        }
        Error::InvalidCertificate(
            CertificateError::NotValidForName | CertificateError::NotValidForNameContext { .. },
        ) => format!("the camera's certificate is for another name. {remedy}"),
        _ => {
            let by = match trust {
                Trust::Public => {
                    "no public authority vouches for the camera's certificate".to_owned()
                }
                _ => format!(
                    "the camera's certificate neither stands in {} nor is signed by one that does",
                    trust.named("camera.ca_file")
                ),
            };
            format!("{by}: cameras make their own. {remedy}")
        }
    }
}

/// The fault of a broker's certificate, and how to make a right one.
fn broker_refusal(error: &Error, trust: &Trust, name: &ServerName<'_>) -> String {
    use CertificateError as Wrong;
    let host = name.to_str();
    let kind = if matches!(name, ServerName::IpAddress(_)) { "IP" } else { "DNS" };
    let remedy = format!(
        "make a new one with `openssl x509 -req ... -extfile <(echo subjectAltName={kind}:{host})`, or \
         name the certificate itself in mqtt.ca_file"
    );
    let Error::InvalidCertificate(wrong) = error else { return fault(error) };
    match wrong {
        Wrong::Expired | Wrong::ExpiredContext { .. } => {
            "the broker's certificate has expired: renew it (or is the box's clock wrong?)"
                .to_owned()
        }
        Wrong::NotValidYet | Wrong::NotValidYetContext { .. } => {
            "the broker's certificate is not valid yet: is the box's clock right?".to_owned()
        }
        Wrong::NotValidForName | Wrong::NotValidForNameContext { .. } => format!(
            "the broker's certificate is not for {host}: set mqtt.host to a name that it holds, or \
             {remedy}"
        ),
        Wrong::UnknownIssuer => match trust {
            Trust::Public => "no public authority vouches for the broker's certificate: name the \
                              authority's, or the broker's own, in mqtt.ca_file"
                .to_owned(),
            _ => format!(
                "the broker's certificate neither stands in {} nor is signed by one that does",
                trust.named("mqtt.ca_file")
            ),
        },
        other if format!("{other:?}").contains("UnsupportedCertVersion") => format!(
            "the broker's certificate is of X.509 version 1, as `openssl x509 -req` without \
             extensions makes it, which is not safe to take: {}",
            remedy.split(", or name").next().unwrap_or_default()
        ),
        other if format!("{other:?}").contains("CaUsedAsEndEntity") => {
            "the broker's certificate is one that it made itself: name it in mqtt.ca_file"
                .to_owned()
        }
        other => format!("the broker's certificate cannot be taken ({}): {remedy}", named(other)),
    }
}

/// A fault of TLS that has no remedy of its own.
pub fn fault(error: &Error) -> String {
    match error {
        Error::AlertReceived(alert) => format!("TLS was ended there: {}", named(alert)),
        Error::InvalidCertificate(wrong) => {
            format!("the certificate cannot be taken: {}", named(wrong))
        }
        Error::PeerMisbehaved(_)
        | Error::InappropriateMessage { .. }
        | Error::InappropriateHandshakeMessage { .. } => {
            "what comes does not follow the rules of TLS: is another service there?".to_owned()
        }
        Error::DecryptError => {
            "what comes cannot be decrypted: is another service there?".to_owned()
        }
        other => format!("TLS: {}", shown(&other.to_string())),
    }
}

/// The name that TLS has for something, as words: `UnknownCA` is "unknown ca". Of an error inside
/// another, the innermost.
fn named(value: &impl std::fmt::Debug) -> String {
    let text = format!("{value:?}");
    let outer = text.split([' ', '{']).next().unwrap_or_default().trim_end_matches(')');
    let name = outer.rsplit('(').next().unwrap_or(outer);
    let (mut words, mut was_lower) = (String::new(), false);
    for letter in name.chars() {
        if letter.is_uppercase() && was_lower {
            words.push(' ');
        }
        was_lower = letter.is_lowercase();
        words.extend(letter.to_lowercase());
    }
    words
}

#[cfg(test)]
#[path = "trust_tests.rs"]
mod tests;
