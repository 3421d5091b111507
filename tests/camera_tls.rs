//! Cameras with a certificate of their own: refused with what to do, and trusted as configured.

mod common;

use common::jpeg;
use rustls::pki_types::{PrivateKeyDer, PrivatePkcs8KeyDer};
use rustls::{ServerConfig, ServerConnection, StreamOwned};
use sha2::{Digest, Sha256};
use std::io::{Read, Write};
use std::net::{Ipv4Addr, TcpListener};
use std::path::Path;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};
use verge::daemon::address::Address;
use verge::daemon::capture::{CameraSettings, Captured, Source};
use verge::daemon::frame::Frame;
use verge::daemon::trust::Trust;

/// A camera whose certificate is for this name and signed by itself; its address, the
/// certificate, and the same as PEM.
fn camera(name: &str) -> (String, Vec<u8>, String) {
    let key = rcgen::KeyPair::generate().expect("a key");
    let mut parameters = rcgen::CertificateParams::new(vec![name.to_owned()]).expect("a name");
    // As many cameras make it: an authority of its own, and of nothing else.
    parameters.is_ca = rcgen::IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
    let certificate = parameters.self_signed(&key).expect("a certificate");
    let der = certificate.der().clone();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ServerConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .expect("versions")
        .with_no_client_auth()
        .with_single_cert(
            vec![der.clone()],
            PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(key.serialize_der())),
        )
        .expect("a configuration");
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
    let address = format!("https://{}/x.jpg", listener.local_addr().expect("its address"));
    let config = Arc::new(config);
    thread::spawn(move || {
        while let Ok((socket, _)) = listener.accept() {
            let connection = ServerConnection::new(Arc::clone(&config)).expect("a connection");
            let mut stream = StreamOwned::new(connection, socket);
            if stream.read(&mut [0; 4096]).is_ok() {
                let picture = jpeg(32, 24, 90);
                let head = format!("HTTP/1.1 200 OK\r\nContent-Length: {}\r\n\r\n", picture.len());
                // Closed without an alert, as cameras do.
                let _ = stream.write_all(&[head.as_bytes(), &picture].concat());
                let _ = stream.flush();
            }
        }
    });
    (address, der.to_vec(), certificate.pem())
}

fn ask(url: &str, trust: Trust) -> Result<Captured, String> {
    let address = Address::parse(url).expect("a right address");
    let second = Duration::from_secs(1);
    let settings = CameraSettings { trust, ..CameraSettings::new(address, second, 5 * second) };
    Source::network(settings).next(&mut Frame::default()).map_err(|error| error.to_string())
}

#[test]
fn a_certificate_of_its_own_is_refused_with_what_to_do_and_trusted_as_configured() {
    for name in ["127.0.0.1", "camera.example"] {
        let (url, der, pem) = camera(name);
        let fingerprint: String =
            Sha256::digest(&der).iter().map(|byte| format!("{byte:02x}")).collect();
        let said = ask(&url, Trust::Public).expect_err("nobody vouches for it");
        let shown = fingerprint.to_uppercase();
        assert!(said.contains("camera.fingerprint") && said.contains("camera.ca_file"), "{said}");
        assert!(said.replace(':', "").contains(&shown) && !said.contains("OtherError"), "{said}");
        let pinned = Trust::fingerprint(&fingerprint).expect("a fingerprint");
        assert_eq!(ask(&url, pinned), Ok(Captured::New), "{name}");
        let other = Trust::fingerprint(&"ab".repeat(32)).expect("a fingerprint");
        assert!(
            ask(&url, other).expect_err("another").contains("not the one in camera.fingerprint")
        );
        let ca = Path::new("/etc/verge/ca.pem");
        let file = Trust::certificates(ca, pem.as_bytes()).expect("a file");
        assert_eq!(ask(&url, file), Ok(Captured::New), "{name}");
        let in_der = Trust::certificates(ca, &der).expect("a file");
        assert_eq!(ask(&url, in_der), Ok(Captured::New), "{name}");
        let (_, _, another) = camera(name);
        let file = Trust::certificates(ca, another.as_bytes()).expect("a file");
        let said = ask(&url, file).expect_err("another camera's");
        assert!(said.contains("camera.ca_file (/etc/verge/ca.pem)"), "{said}");
    }
    assert!(Trust::certificates(Path::new("ca.pem"), b"hello").is_err());
}

#[test]
fn plain_where_tls_is_expected_and_the_other_way_round_is_said() {
    let (url, _, _) = camera("127.0.0.1");
    let said = ask(&url.replace("https", "http"), Trust::Public).expect_err("it is TLS");
    assert!(said.contains("TLS") || said.contains("closed it"), "{said}");
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
    let url = format!("https://{}/", listener.local_addr().expect("its address"));
    thread::spawn(move || {
        let (mut stream, _) = listener.accept().expect("a client");
        let _ = stream.read(&mut [0; 1000]);
        let _ = stream.write_all(b"HTTP/1.1 400 Bad Request\r\n\r\n");
    });
    let said = ask(&url, Trust::Public).expect_err("it is not TLS");
    assert!(said.contains("does not speak TLS at this port"), "{said}");
}

/// TLS reads until a whole record is there: who sends one byte after the other must not keep the line,
/// which the watchdog would end.
#[test]
fn a_handshake_that_drips_ends_with_the_time_out() {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
    let address = format!("https://{}/x.jpg", listener.local_addr().expect("its address"));
    thread::spawn(move || {
        while let Ok((mut socket, _)) = listener.accept() {
            // A handshake record of 16 KB.
            let _ = socket.write_all(b"\x16\x03\x03\x40\x00\x02\x00\x3f\xfc");
            while socket.write_all(b"\x03").is_ok() {
                thread::sleep(Duration::from_millis(20));
            }
        }
    });
    let begun = Instant::now();
    let said = ask(&address, Trust::Public).expect_err("no answer");
    // By that pace it would be there after five minutes; the time-out is 5 s.
    assert!(begun.elapsed() < Duration::from_secs(60), "{:?}", begun.elapsed());
    assert!(said.contains("TLS handshake"), "{said}");
}
