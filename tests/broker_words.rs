//! Findings of `verge check` at a broker and their words: it passes only where density will arrive.
//!
//! Each case that `tests/denial.rs` has for the running sensor, and the certificates that guides
//! make.

mod common;
#[path = "common/fake_broker.rs"]
mod fake_broker;

use common::mosquitto::Mosquitto;
use fake_broker::{FakeBroker, Manners};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;
use verge::daemon::publish::{MqttSettings, MqttVersion, Tls, TlsFiles, probe};
use verge_desk::free_port;

const WINDOWS: [Duration; 1] = [Duration::from_secs(60)];
/// Bytes that a window has.
const SIZE: usize = 2000;

fn settings(port: u16) -> MqttSettings {
    MqttSettings { version: MqttVersion::Auto, ..MqttSettings::local(port, "verge/words") }
}

fn try_fake(manners: Manners) -> Result<String, String> {
    let broker = FakeBroker::start(manners);
    let credentials = Some(("box7".to_owned(), "secret".to_owned()));
    probe(&MqttSettings { credentials, ..settings(broker.port) }, &WINDOWS, SIZE)
}

#[test]
fn it_passes_where_density_arrives_and_says_what_is_lacking() {
    let said = try_fake(Manners::default()).expect("all is well");
    assert_eq!(said, "MQTT 5");
    let said = try_fake(Manners { versions: vec![4], ..Manners::default() }).expect("well");
    assert_eq!(said, "MQTT 3.1.1");
    let nothing = Manners { keeps_nothing: true, versions: vec![4], ..Manners::default() };
    let said = try_fake(nothing).expect("windows pass");
    assert!(said.contains("without retained messages"), "{said}");
    let deaf = Manners { versions: vec![4], deaf: true, ..Manners::default() };
    let said = try_fake(deaf).expect("it cannot be known");
    assert!(said.contains("not proven"), "{said}");
    let unheard = Manners { reason: Some(("replay/", 0x10)), ..Manners::default() };
    let said = try_fake(unheard).expect("live windows pass");
    assert!(said.contains("nobody subscribes to verge/words/replay/density/60s"), "{said}");
}

#[test]
fn it_fails_where_nothing_would_arrive_and_says_why() {
    let v3 = || Manners { versions: vec![4], ..Manners::default() };
    for (manners, words) in [
        (Manners { refuses: Some(0x87), ..Manners::default() }, "refuses user \"box7\": check"),
        (Manners { refuses: Some(5), ..v3() }, "refuses user \"box7\": check"),
        (Manners { refuses: Some(2), ..v3() }, "mqtt.client_id"),
        (Manners { versions: vec![9], mute: true, ..Manners::default() }, "want TLS"),
        (Manners { reason: Some(("density/", 0x87)), ..Manners::default() }, "allow user \"box7\""),
        (Manners { reason: Some(("density/60", 0x10)), ..Manners::default() }, "nobody subscribes"),
        (Manners { drops: Some("density/"), ..v3() }, "throws it away"),
        (Manners { closes_on: Some("density/"), ..Manners::default() }, "closes the connection on"),
        (Manners { closes_on: Some("presence"), ..Manners::default() }, "presence"),
        (Manners { ignores: Some("density/"), ..Manners::default() }, "does not acknowledge"),
    ] {
        let shown = format!("{manners:?}");
        let reason = try_fake(manners).expect_err(&shown);
        assert!(reason.contains(words), "{shown}: {reason}");
        assert!(!reason.contains("secret"), "{reason}");
        assert!(!reason.contains("Error("), "{reason}");
    }
    let reason = probe(&settings(1), &WINDOWS, SIZE).expect_err("nobody is there");
    assert!(reason.contains("127.0.0.1 refuses the connection"), "{reason}");
}

#[test]
fn a_stranger_at_the_port_is_named() {
    use std::io::Write;
    for (greeting, words) in [
        (&b"HTTP/1.1 400 Bad Request\r\n\r\n"[..], "web server"),
        (b"SSH-2.0-OpenSSH_9.2\r\n", "SSH"),
        (b"\x15\x03\x01\x00\x02\x02\x46", "mqtt.tls = true"),
        (b"\x00\x01\x02\x03\x04\x05", "breaks the protocol"),
    ] {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
        let port = listener.local_addr().expect("bound").port();
        std::thread::spawn(move || {
            let mut open = Vec::new();
            for mut stream in listener.incoming().map_while(Result::ok) {
                let _ = stream.write_all(greeting);
                open.push(stream);
            }
        });
        let reason = probe(&settings(port), &WINDOWS, SIZE).expect_err("no broker");
        assert!(reason.contains(words), "{reason}");
    }
}

/// Where Debian's broker may read a key.
fn readable(path: &Path) {
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755)).expect("chmod");
}

/// A certificate as a recipe of openssl makes it, with its key; `None` where there is no openssl.
fn made(folder: &Path, recipe: &str) -> Option<(PathBuf, PathBuf)> {
    let done = Command::new("bash").args(["-ec", recipe]).current_dir(folder).output().ok()?;
    if !done.status.success() {
        common::skip(&format!("openssl: {}", String::from_utf8_lossy(&done.stderr)));
        return None;
    }
    readable(folder);
    let paths = (folder.join("server.crt"), folder.join("server.key"));
    readable(&paths.1);
    Some(paths)
}

const CA: &str = "openssl req -new -x509 -days 30 -nodes -newkey rsa:2048 -keyout ca.key \
                  -out ca.crt -subj '/CN=my CA' 2>/dev/null; \
                  openssl req -new -nodes -newkey rsa:2048 -keyout server.key -out s.csr \
                  -subj /CN=localhost 2>/dev/null;";

/// A certificate of 2020, which `openssl x509` of Debian 12 cannot make.
const EXPIRED: &str = "mkdir new; : > index; echo 01 > serial; printf '%s\\n' [ca] default_ca=d [d] \
    database=index new_certs_dir=new serial=serial default_md=sha256 policy=p [p] \
    commonName=supplied [e] subjectAltName=DNS:localhost > ca.conf; \
    openssl ca -batch -config ca.conf -extensions e -in s.csr -cert ca.crt -keyfile ca.key \
    -startdate 20200101000000Z -enddate 20210101000000Z -notext -out server.crt 2>/dev/null";
const SHORT_KEY: &str = "openssl req -new -nodes -newkey rsa:1024 -keyout server.key -out s.csr \
    -subj /CN=localhost 2>/dev/null;";

#[test]
fn certificates_as_guides_make_them() {
    let Some(mosquitto) = Mosquitto::installed() else { return };
    let sign = "openssl x509 -req -in s.csr -CA ca.crt -CAkey ca.key -CAcreateserial \
                -out server.crt -days 30 2>/dev/null";
    let own = "openssl req -x509 -newkey rsa:2048 -nodes -keyout server.key -out server.crt \
               -days 30 -subj /CN=localhost -addext subjectAltName=DNS:localhost 2>/dev/null; \
               cp server.crt ca.crt";
    for (what, recipe, words) in [
        ("with a name", format!("{CA} {sign} -extfile <(echo subjectAltName=DNS:localhost)"), None),
        ("self-signed, pinned", own.to_owned(), None),
        ("version 1, of mosquitto-tls(7)", format!("{CA} {sign}"), Some("X.509 version 1")),
        (
            "without a name",
            format!("{CA} {sign} -extfile <(echo basicConstraints=CA:FALSE)"),
            Some("subjectAltName=DNS:localhost"),
        ),
        (
            "of another authority",
            format!(
                "{CA} {sign} -extfile <(echo subjectAltName=DNS:localhost); rm ca.*; \
                 openssl req -new -x509 -days 30 -nodes -newkey rsa:2048 -keyout ca.key -out ca.crt \
                 -subj '/CN=other CA' 2>/dev/null"
            ),
            Some("neither stands in mqtt.ca_file ("),
        ),
        ("expired", format!("{CA} {EXPIRED}"), Some("has expired: renew it")),
        (
            "with a short key",
            format!("{CA} {SHORT_KEY} {sign} -extfile <(echo subjectAltName=DNS:localhost)"),
            Some("RSA below 2048 bits"),
        ),
    ] {
        let folder = common::folder();
        let Some((certificate, key)) = made(folder.path(), &recipe) else { return };
        let port = free_port();
        let config = folder.path().join("mosquitto.conf");
        let text = format!(
            "listener {port} 127.0.0.1\nallow_anonymous true\ncertfile {}\nkeyfile {}\n\
             ciphers DEFAULT:@SECLEVEL=0\n",
            certificate.display(),
            key.display()
        );
        std::fs::write(&config, text).expect("written");
        let _broker = mosquitto.start_with(port, &config);
        let files = TlsFiles { ca: Some(folder.path().join("ca.crt")), identity: None };
        let tls = Some(Tls::load(&files).expect("certificates"));
        let at = |tls| MqttSettings { host: "localhost".into(), tls, ..settings(port) };
        let outcome = probe(&at(tls), &[], SIZE);
        match (outcome, words) {
            (Ok(_), None) => {}
            (Err(reason), Some(words)) => {
                assert!(reason.contains(words), "{what}: {reason}");
                let file = format!("mqtt.ca_file ({})", folder.path().join("ca.crt").display());
                assert!(!reason.contains("neither stands") || reason.contains(&file), "{reason}");
                assert!(
                    !reason.contains("host and port") && !reason.contains("Error("),
                    "{reason}"
                );
            }
            (outcome, _) => panic!("{what}: {outcome:?}"),
        }
        let reason = probe(&at(None), &[], SIZE).expect_err("TLS is wanted");
        assert!(reason.contains("TLS"), "{what}: {reason}");
    }
}

#[test]
fn tls_where_there_is_none_is_told() {
    let broker = FakeBroker::start(Manners::default());
    let tls = Some(Tls::load(&TlsFiles::default()).expect("public authorities"));
    let reason =
        probe(&MqttSettings { tls, ..settings(broker.port) }, &[], SIZE).expect_err("no TLS");
    assert!(reason.contains("TLS"), "{reason}");
}

#[test]
fn the_access_list_of_a_real_broker() {
    let Some(mosquitto) = Mosquitto::installed() else { return };
    let folder = common::folder();
    let list = "topic write verge/words/presence\ntopic read #\n";
    std::fs::write(folder.path().join("acl"), list).expect("written");
    readable(folder.path());
    let port = free_port();
    let config = folder.path().join("mosquitto.conf");
    let text = format!(
        "listener {port} 127.0.0.1\nallow_anonymous true\nacl_file {}\n",
        folder.path().join("acl").display()
    );
    std::fs::write(&config, text).expect("written");
    let _broker = mosquitto.start_with(port, &config);
    for (version, words) in [
        (MqttVersion::V3, "acknowledges verge/words/density/60s and throws it away"),
        (MqttVersion::Auto, "refuses verge/words/density/60s"),
    ] {
        let outcome = probe(&MqttSettings { version, ..settings(port) }, &WINDOWS, SIZE);
        let reason = outcome.expect_err("the list forbids it");
        assert!(reason.contains(words), "{reason}");
    }
}
