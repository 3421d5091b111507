//! RTSP against a server that others wrote: Debian's GStreamer.
//!
//! [`tests/rtsp.rs`] has a server that behaves badly; this one behaves as many cameras do. Skipped
//! where it is not installed.

mod common;

use std::io::{BufRead, BufReader};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};
use verge::daemon::address::Address;
use verge::daemon::capture::{CameraSettings, Captured, Credentials, Source};
use verge::daemon::frame::Frame;
use verge::daemon::trust::Trust;

/// The python that Debian's packages are for.
const PYTHON: &str = "/usr/bin/python3";

/// A camera that plays until the value is dropped.
struct Camera {
    process: Child,
    port: u16,
    /// It ends with its standard input.
    _input: ChildStdin,
}

impl Drop for Camera {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Camera {
    /// Starts `tests/gstreamer_camera.py`; `None` where GStreamer is not installed.
    fn start(arguments: &[&str]) -> Option<Self> {
        let needed = "import gi; gi.require_version('GstRtspServer', '1.0')";
        let check = Command::new(PYTHON).args(["-c", needed]).stderr(Stdio::null()).status();
        if !check.is_ok_and(|status| status.success()) {
            common::skip("GStreamer's RTSP server is not installed (gir1.2-gst-rtsp-server-1.0)");
            return None;
        }
        let mut process = Command::new(PYTHON)
            .arg("tests/gstreamer_camera.py")
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("python starts");
        let input = process.stdin.take().expect("its input");
        let mut line = String::new();
        let output = process.stdout.take().expect("its output");
        BufReader::new(output).read_line(&mut line).expect("a line");
        let port = line.trim().parse().expect("the camera prints its port");
        Some(Self { process, port, _input: input })
    }

    fn settings(&self, scheme: &str) -> CameraSettings {
        let url = format!("{scheme}://127.0.0.1:{}/live", self.port);
        let address = Address::parse(&url).expect("a right address");
        CameraSettings::new(address, Duration::from_millis(200), Duration::from_secs(10))
    }
}

fn login(password: &str) -> Option<Credentials> {
    Some(Credentials { user: "box".into(), password: password.into() })
}

/// Asks until a new picture comes; what was reported before.
fn until_new(source: &mut Source, frame: &mut Frame) -> Vec<String> {
    let (begun, mut said) = (Instant::now(), Vec::new());
    loop {
        match source.next(frame) {
            Ok(Captured::New) => return said,
            Ok(_) => {}
            Err(error) => said.push(error.to_string()),
        }
        assert!(begun.elapsed() < Duration::from_secs(60), "no picture: {said:?}");
        thread::sleep(Duration::from_millis(50));
    }
}

/// The seven bars of SMPTE at 75 %, from white to blue: which channels are bright in each.
fn assert_shows_bars(frame: &Frame) {
    let picture = &frame.picture;
    let expected = [0b111, 0b110, 0b011, 0b010, 0b101, 0b100, 0b001];
    for (bar, bright) in expected.into_iter().enumerate() {
        let (u, v) = (picture.width * (2 * bar + 1) / 14, picture.height / 3);
        let at = 3 * (v * picture.width + u);
        let rgb = &picture.rgb[at..at + 3];
        for (channel, &level) in rgb.iter().enumerate() {
            let is_bright = bright >> (2 - channel) & 1 == 1;
            let expected = if is_bright { 191 } else { 0 };
            assert!(level.abs_diff(expected) < 24, "bar {bar}: {rgb:?}");
        }
    }
}

#[test]
fn pictures_come_in_their_colours() {
    for (codec, every_picture, named) in [
        ("h264", false, "H.264 baseline, 320x240 px"),
        ("h264", true, "H.264 baseline, 320x240 px"),
        ("jpeg", false, "JPEG"),
    ] {
        let Some(camera) = Camera::start(&[codec]) else { return };
        let settings = CameraSettings { every_picture, ..camera.settings("rtsp") };
        let mut source = Source::network(settings);
        let mut frame = Frame::default();
        for _ in 0..3 {
            assert_eq!(until_new(&mut source, &mut frame), [""; 0], "{codec}");
            assert_eq!((frame.picture.width, frame.picture.height), (320, 240));
            assert_shows_bars(&frame);
        }
        let described = source.video().expect("a video");
        assert!(described.contains(named), "{described}");
        let counts = source.counts();
        assert_eq!((counts.lost, counts.flagged, counts.reopened), (0, 0, 0), "{codec}");
    }
}

#[test]
fn it_asks_for_a_login_as_cameras_do() {
    let Some(camera) = Camera::start(&["h264", "--login", "box:s3cret"]) else { return };
    let mut frame = Frame::default();
    let settings = CameraSettings { credentials: login("s3cret"), ..camera.settings("rtsp") };
    let mut source = Source::network(settings);
    assert_eq!(until_new(&mut source, &mut frame), [""; 0]);
    assert_shows_bars(&frame);
    assert!(source.video().expect("a video").contains("Digest"), "{:?}", source.video());
    for (credentials, word) in [(None, "wants a login"), (login("opensesame"), "refuses")] {
        let settings = CameraSettings { credentials, ..camera.settings("rtsp") };
        let said = Source::network(settings).next(&mut frame).expect_err("refused").to_string();
        assert!(said.contains(word) && !said.contains("opensesame"), "{said}");
    }
}

#[test]
fn it_speaks_tls_with_a_certificate_of_its_own() {
    let key = rcgen::KeyPair::generate().expect("a key");
    let parameters = rcgen::CertificateParams::new(vec!["camera".to_owned()]).expect("a name");
    let certificate = parameters.self_signed(&key).expect("a certificate");
    let folder = common::folder();
    let file = folder.path().join("camera.pem");
    std::fs::write(&file, certificate.pem() + &key.serialize_pem()).expect("a file");
    let path = file.to_str().expect("a plain path");
    let arguments = ["h264", "--certificate", path, "--login", "box:s3cret", "--basic"];
    let Some(camera) = Camera::start(&arguments) else { return };
    let trusted = Trust::certificates(&file, certificate.pem().as_bytes()).expect("a file");
    let mut frame = Frame::default();
    let settings = CameraSettings { credentials: login("s3cret"), ..camera.settings("rtsps") };
    let said = Source::network(settings.clone()).next(&mut frame).expect_err("who are you?");
    assert!(said.to_string().contains("camera.fingerprint"), "{said}");
    let mut source = Source::network(CameraSettings { trust: trusted, ..settings });
    assert_eq!(until_new(&mut source, &mut frame), [""; 0]);
    assert_shows_bars(&frame);
}

#[test]
fn it_ends_and_comes_back() {
    let Some(camera) = Camera::start(&["h264"]) else { return };
    let settings = CameraSettings { timeout: Duration::from_secs(3), ..camera.settings("rtsp") };
    let port = camera.port.to_string();
    let (mut source, mut frame) = (Source::network(settings), Frame::default());
    assert_eq!(until_new(&mut source, &mut frame), [""; 0]);
    drop(camera);
    let ended = loop {
        match source.next(&mut frame) {
            Err(error) => break error.to_string(),
            // What had come before it ended.
            Ok(_) => thread::sleep(Duration::from_millis(50)),
        }
    };
    assert!(ended.contains("closed") || ended.contains("no picture"), "{ended}");
    let Some(_camera) = Camera::start(&["h264", "--port", &port]) else { return };
    let said = until_new(&mut source, &mut frame);
    assert_shows_bars(&frame);
    assert!(source.counts().reopened > 0, "{said:?}");
}

#[test]
fn h265_is_read_where_it_was_built_in() {
    let Some(camera) = Camera::start(&["h265"]) else { return };
    for every_picture in [false, true] {
        let settings = CameraSettings { every_picture, ..camera.settings("rtsp") };
        let (mut source, mut frame) = (Source::network(settings), Frame::default());
        if cfg!(not(feature = "h265")) {
            let said = source.next(&mut frame).expect_err("H.265").to_string();
            assert!(said.contains("H265") && said.contains("to H.264"), "{said}");
            continue;
        }
        assert_eq!(until_new(&mut source, &mut frame), [""; 0], "{every_picture}");
        assert_eq!((frame.picture.width, frame.picture.height), (320, 240));
        assert_shows_bars(&frame);
        let described = source.video().expect("a video");
        assert!(described.contains("H.265 main, 320x240 px"), "{described}");
        assert_eq!(source.counts().flagged, 0);
    }
}
