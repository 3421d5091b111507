//! Words of TLS, forms of fingerprints, and files that hold no certificate.

use super::*;

#[test]
fn faults_of_tls_are_words() {
    use rustls::{AlertDescription as Alert, CertificateError as Wrong, OtherError};
    let other = Wrong::Other(OtherError(Arc::new(std::fmt::Error)));
    for (error, said) in [
        (Error::AlertReceived(Alert::UnknownCA), "TLS was ended there: unknown ca"),
        (Error::InvalidCertificate(Wrong::BadEncoding), "cannot be taken: bad encoding"),
        (Error::InvalidCertificate(other), "cannot be taken: error"),
        (Error::DecryptError, "another service"),
    ] {
        let words = fault(&error);
        assert!(words.contains(said) && !words.contains('('), "{words}");
    }
}

#[test]
fn fingerprints_as_programs_print_them() {
    let digits = "AB:".repeat(32);
    let expected = Trust::Fingerprint([0xab; 32]);
    for text in [
        digits.trim_end_matches(':').to_owned(),
        "ab".repeat(32),
        format!("sha256:{}", "ab".repeat(32)),
        format!("sha256 Fingerprint={}", digits.trim_end_matches(':')),
    ] {
        assert_eq!(Trust::fingerprint(&text).as_ref(), Ok(&expected), "{text}");
    }
    for text in ["", "ab", "abz", &"ab".repeat(20), &"é".repeat(32)] {
        assert!(Trust::fingerprint(text).is_err(), "{text}");
    }
}

#[test]
fn a_file_without_a_certificate_is_refused() {
    let refused =
        |content: &[u8]| Trust::certificates(Path::new("ca.pem"), content).expect_err("it is none");
    assert!(refused(b"hello").contains("no certificate is in it"));
    // DER, as a key or a PKCS #12 bundle is.
    assert!(refused(b"\x30\x03\x02\x01\x03").contains("not a certificate"));
    let pem = "-----BEGIN CERTIFICATE-----\nMAMCAQM=\n-----END CERTIFICATE-----\n";
    assert!(refused(pem.as_bytes()).contains("not a certificate"));
}
