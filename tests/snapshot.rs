//! HTTP snapshots against a server that behaves badly.

mod common;

use common::jpeg;
use std::io::{BufRead, BufReader, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::{Duration, Instant};
use verge::daemon::address::Address;
use verge::daemon::capture::{CameraSettings, Captured, Credentials, Source};
use verge::daemon::frame::Frame;

/// Serves one connection per answer, on a port of this machine; returns the address and
/// the requests that came.
fn serve(answers: Vec<Vec<u8>>) -> (String, Receiver<String>) {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
    let address = format!("http://{}", listener.local_addr().expect("its address"));
    let (sender, requests) = mpsc::channel();
    thread::spawn(move || {
        for answer in answers {
            let Ok((mut stream, _)) = listener.accept() else { return };
            let _ = sender.send(request(&stream));
            let _ = stream.write_all(&answer);
        }
    });
    (address, requests)
}

fn request(stream: &TcpStream) -> String {
    let mut text = String::new();
    for line in BufReader::new(stream).lines().map_while(Result::ok) {
        if line.is_empty() {
            break;
        }
        text += &line;
        text.push('\n');
    }
    text
}

fn answer(status: &str, headers: &str, body: &[u8]) -> Vec<u8> {
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Length: {}\r\nConnection: close\r\n{headers}\r\n",
        body.len()
    );
    [head.as_bytes(), body].concat()
}

fn settings(url: &str) -> CameraSettings {
    let address = Address::parse(url).expect("a right address");
    CameraSettings {
        credentials: Some(Credentials { user: "box".into(), password: "s3cret".into() }),
        ..CameraSettings::new(address, Duration::from_secs(1), Duration::from_millis(1500))
    }
}

fn camera(url: &str) -> Source {
    Source::network(settings(url))
}

#[test]
fn a_new_picture_an_unchanged_one_and_one_not_modified() {
    let headers = "ETag: \"a\"\r\nLast-Modified: Mon, 05 Jan 2026 08:00:00 GMT\r\n";
    let (url, requests) = serve(vec![
        answer("200 OK", headers, &jpeg(32, 24, 10)),
        answer("304 Not Modified", "", b""),
        answer("200 OK", headers, &jpeg(32, 24, 10)),
        answer("200 OK", "", &jpeg(32, 24, 200)),
    ]);
    let mut camera = camera(&url);
    let mut frame = Frame::default();
    let expected = [Captured::New, Captured::Unchanged, Captured::Unchanged, Captured::New];
    for expected in expected {
        assert_eq!(camera.next(&mut frame).expect("an answer"), expected);
    }
    assert_eq!((frame.picture.width, frame.picture.height), (32, 24));
    let requests: Vec<_> = requests.iter().take(4).map(|r| r.to_lowercase()).collect();
    assert!(!requests[0].contains("authorization"), "never unasked: {}", requests[0]);
    assert!(!requests[0].contains("if-none-match"));
    assert!(requests[1].contains("if-none-match: \"a\""), "{}", requests[1]);
    assert!(requests[1].contains("if-modified-since: mon, 05 jan 2026"), "{}", requests[1]);
}

#[test]
fn redirects_are_followed_but_not_for_ever() {
    let (target, _) = serve(vec![answer("200 OK", "", &jpeg(32, 24, 10))]);
    let (url, _) = serve(vec![answer("302 Found", &format!("Location: {target}/x\r\n"), b"")]);
    let mut frame = Frame::default();
    assert_eq!(camera(&url).next(&mut frame).expect("an answer"), Captured::New);

    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
    let url = format!("http://{}/", listener.local_addr().expect("its address"));
    let there = url.clone();
    thread::spawn(move || {
        while let Ok((mut stream, _)) = listener.accept() {
            request(&stream);
            let _ = stream.write_all(&answer("302 Found", &format!("Location: {there}\r\n"), b""));
        }
    });
    let error = camera(&url).next(&mut frame).expect_err("a loop").to_string();
    assert!(error.contains("redirect"), "{error}");
}

/// The message when this is the answer.
fn fault(answers: Vec<Vec<u8>>) -> String {
    let (url, _) = serve(answers);
    camera(&url).next(&mut Frame::default()).expect_err("no picture").to_string()
}

#[test]
fn faults_are_named() {
    for (answer, expected) in [
        (answer("401 Unauthorized", "", b""), "does not say which"),
        (answer("401 X", "WWW-Authenticate: Negotiate\r\n", b""), "Negotiate"),
        (answer("403 Forbidden", "", b""), "camera.password_file"),
        (answer("404 Not Found", "", b""), "check the path in the address"),
        // Of a picture that it never gave.
        (answer("304 Not Modified", "", b""), "HTTP status 304"),
        (answer("500 Oops", "", b"sorry"), "500"),
        (answer("200 OK", "", b"<html>please log in</html>"), "an HTML page"),
        (answer("200 OK", "", b"{\"error\":-6}"), "JSON in place of a picture ({\"error\":-6})"),
        (answer("200 OK", "", b"RIFF\0\0\0\0WEBPVP8 "), "a WebP picture"),
        (
            answer("200 OK", "Content-Type: multipart/x-mixed-replace; boundary=f\r\n", b"--f"),
            "mjpeg+",
        ),
        (answer("200 OK", "", b"--f\r\nContent-Type: image/jpeg\r\n\r\n\xff\xd8"), "mjpeg+"),
        (answer("200 OK", "Content-Type: video/mp4\r\n", b"\0\0\0\x18ftypisom"), "rtsp://"),
        (answer("200 OK", "", &[&[0, 0, 0, 1, 0x67][..], &vec![7; 9 << 20]].concat()), "H.264"),
        (answer("200 OK", "", b"#EXTM3U\n#EXT-X-VERSION:3\n"), "an HLS playlist"),
        (answer("200 OK", "", b"/9j/4AAQSkZJRgABAQAAAQABAAD/"), "base64"),
        (answer("200 OK", "", b""), "empty"),
        (answer("200 OK", "", &jpeg(32, 24, 10)[..300]), "cut off"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 9999\r\n\r\nabc".to_vec(), "text in place"),
        (b"rubbish\r\n\r\n".to_vec(), "not HTTP (it begins \"rubbish"),
        (b"\x15\x03\x03\0\x02\x02\x28".to_vec(), "it is TLS"),
        (b"".to_vec(), "without an answer"),
        (
            answer("302 Found", "Location: http://elsewhere.example/\r\n", b""),
            "camera.redirect_hosts",
        ),
        (
            answer("302 Found", "Location: file:///etc/passwd\r\n", b""),
            "not the address of a picture",
        ),
        (answer("200 OK", "", &vec![0; 9 << 20]), "more than"),
    ] {
        let said = fault(vec![answer]);
        assert!(said.contains(expected), "{expected}: {said}");
        assert!(!said.contains("s3cret"), "{said}");
    }
}

/// Answers that are not quite HTTP, as browsers and curl read them.
#[test]
fn answers_as_cameras_give_them() {
    let picture = jpeg(32, 24, 10);
    let long = picture.len() + 48;
    let with = |head: &str| [head.as_bytes(), &picture].concat();
    let chunks = |step: usize| {
        let mut bytes = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n".to_vec();
        for chunk in picture.chunks(step) {
            bytes.extend(format!("{:x};x=y\r\n", chunk.len()).bytes());
            bytes.extend(chunk);
            bytes.extend(b"\r\n");
        }
        [bytes, b"0\r\n\r\n".to_vec()].concat()
    };
    for bytes in [
        with("HTTP/1.0 200 OK\r\n\r\n"),
        with("HTTP/1.1 200\nContent-Type : image/jpeg\n\n"),
        with("ICY 200 OK\r\n\r\n"),
        with("HTTP/1.1 200 OK\r\nContent-Type: image/jpeg;\r\n folded=yes\r\nrubbish\r\n\r\n"),
        with(&format!("HTTP/1.1 200 OK\r\nContent-Length: {long}\r\n\r\n")),
        with(&format!("HTTP/1.1 200 OK\r\nContent-Length: {}\r\n\r\n", picture.len() - 48)),
        with("HTTP/1.1 200 OK\r\nContent-Length: many\r\n\r\n"),
        with("HTTP/1.1 206 Partial Content\r\n\r\n"),
        with("HTTP/1.1 100 Continue\r\n\r\nHTTP/1.1 200 OK\r\n\r\n\r\n"),
        [with("HTTP/1.1 200 OK\r\n\r\n"), vec![0; 70_000]].concat(),
        chunks(100),
        chunks(1),
    ] {
        let head = String::from_utf8_lossy(&bytes[..bytes.len().min(80)]).into_owned();
        let (url, _) = serve(vec![bytes]);
        let mut frame = Frame::default();
        let captured =
            camera(&url).next(&mut frame).unwrap_or_else(|error| panic!("{head}: {error}"));
        assert_eq!((captured, frame.picture.width), (Captured::New, 32), "{head}");
    }
}

/// A length that is too large on a connection that stays open, and a stream at a snapshot's
/// address.
#[test]
fn a_connection_that_stays_open_costs_no_picture() {
    let picture = jpeg(32, 24, 10);
    let head = format!("HTTP/1.1 200 OK\r\nContent-Length: {}\r\n\r\n", picture.len() + 9);
    let once = [head.as_bytes(), &picture].concat();
    let (url, _) = serve_slowly(vec![once]);
    assert_eq!(camera(&url).next(&mut Frame::default()).expect("a picture"), Captured::New);
    let part = [&b"HTTP/1.1 200 OK\r\n\r\n"[..], &picture].concat();
    let (url, _) = serve_slowly([vec![part], vec![picture; 30]].concat());
    let error = camera(&url).next(&mut Frame::default()).expect_err("a stream").to_string();
    assert!(error.contains("mjpeg+"), "{error}");
}

/// Serves these pieces to one client, a fifth of a second apart, and then waits.
fn serve_slowly(pieces: Vec<Vec<u8>>) -> (String, thread::JoinHandle<()>) {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
    let address = format!("http://{}", listener.local_addr().expect("its address"));
    let thread = thread::spawn(move || {
        let Ok((mut stream, _)) = listener.accept() else { return };
        request(&stream);
        for piece in pieces {
            if stream.write_all(&piece).is_err() {
                return;
            }
            thread::sleep(Duration::from_millis(200));
        }
        thread::sleep(Duration::from_secs(3));
    });
    (address, thread)
}

const DIGEST: &str = "WWW-Authenticate: Digest realm=\"cam\", nonce=\"abc\"\r\n";
const BASIC: &str = "WWW-Authenticate: Basic realm=\"cam\"\r\n";

#[test]
fn a_login_is_answered_by_digest_and_remembered() {
    let picture = |grey| answer("200 OK", "", &jpeg(32, 24, grey));
    let (url, requests) = serve(vec![
        answer("401 Unauthorized", &format!("{BASIC}{DIGEST}"), b""),
        picture(10),
        picture(90),
    ]);
    let (mut camera, mut frame) = (camera(&format!("{url}/x?y=z")), Frame::default());
    assert_eq!(camera.next(&mut frame).expect("a picture"), Captured::New);
    assert_eq!(camera.next(&mut frame).expect("a picture"), Captured::New);
    let requests: Vec<_> = requests.iter().take(3).collect();
    assert!(!requests[0].to_lowercase().contains("authorization"), "{}", requests[0]);
    // MD5(MD5("box:cam:s3cret") ":abc:" MD5("GET:/x?y=z")), RFC 2069.
    let response = "response=\"4262ae6d521bbbc66d565c91fdcf57bc\"";
    assert!(requests[1].contains(response) && requests[2].contains(response), "{requests:?}");
    assert!(requests.iter().all(|request| !request.contains("Basic")), "{requests:?}");
}

#[test]
fn basic_is_sent_where_nothing_else_is_offered_and_never_unasked() {
    let (url, requests) = serve(vec![
        answer("401 Unauthorized", BASIC, b""),
        answer("200 OK", "", &jpeg(32, 24, 10)),
    ]);
    assert_eq!(camera(&url).next(&mut Frame::default()).expect("a picture"), Captured::New);
    let requests: Vec<_> = requests.iter().take(2).map(|r| r.to_lowercase()).collect();
    assert!(!requests[0].contains("authorization"), "{}", requests[0]);
    assert!(requests[1].contains("authorization: basic ym94onmzy3jlda=="), "{}", requests[1]);
}

#[test]
fn a_refused_login_is_not_tried_again_for_a_minute() {
    let refuse = || answer("401 Unauthorized", DIGEST, b"");
    let (url, requests) = serve((0..9).map(|_| refuse()).collect());
    let (mut camera, mut frame) = (camera(&url), Frame::default());
    for _ in 0..5 {
        let error = camera.next(&mut frame).expect_err("refused");
        assert!(!error.is_damage());
        let error = error.to_string();
        assert!(error.contains("refuses user \"box\"") && error.contains("1 minute"), "{error}");
    }
    let logins = requests.try_iter().filter(|request| request.contains("Digest")).count();
    assert_eq!(logins, 1, "logins in five turns");
}

#[test]
fn a_login_goes_to_no_other_host() {
    let (target, requests) = serve(vec![answer("401 Unauthorized", BASIC, b"")]);
    let (url, _) = serve(vec![answer("302 Found", &format!("Location: {target}/x\r\n"), b"")]);
    let error = camera(&url).next(&mut Frame::default()).expect_err("another port");
    assert!(error.to_string().contains("401"), "{error}");
    let request = requests.recv().expect("a request").to_lowercase();
    assert!(!request.contains("authorization"), "{request}");
    // Another name of this machine is another host, until it is allowed.
    let (target, _) = serve(vec![answer("200 OK", "", &jpeg(32, 24, 10))]);
    let target = target.replace("127.0.0.1", "localhost");
    let redirect = || answer("302 Found", &format!("Location: {target}/x\r\n"), b"");
    let (url, _) = serve(vec![redirect(), redirect()]);
    let error = camera(&url).next(&mut Frame::default()).expect_err("another host").to_string();
    assert!(error.contains("redirects to localhost"), "{error}");
    let mut allowed = settings(&url);
    allowed.redirect_hosts = vec!["localhost".to_owned()];
    let captured = Source::network(allowed).next(&mut Frame::default());
    assert_eq!(captured.expect("a picture"), Captured::New);
}

#[test]
fn nothing_of_a_login_or_a_query_is_said() {
    let (url, _) = serve((0..4).map(|_| answer("503 Busy", "", b"")).collect());
    let url = url.replace("http://", "http://admin:Hunter2@") + "/snap?pwd=Tok3n";
    let source = Source::network(settings(&url));
    let mut camera = source;
    let error = camera.next(&mut Frame::default()).expect_err("busy").to_string();
    assert!(error.contains("/snap?...: HTTP status 503"), "{error}");
    for said in [error, format!("{camera:?}"), format!("{:?}", settings(&url))] {
        for secret in ["Hunter2", "Tok3n", "s3cret"] {
            assert!(!said.contains(secret), "{said}");
        }
    }
}

/// A page, or a picture that cannot be used, does not count as a frozen picture.
#[test]
fn a_fault_that_repeats_stays_the_same_fault() {
    let page = answer("200 OK", "", b"<html>login</html>");
    let half = answer("200 OK", "", &jpeg(32, 24, 10)[..300]);
    for (bytes, damage) in [(page, false), (half, true)] {
        let (url, _) = serve(vec![bytes.clone(), bytes.clone(), bytes]);
        let (mut camera, mut frame) = (camera(&url), Frame::default());
        for _ in 0..3 {
            let error = camera.next(&mut frame).expect_err("no picture");
            assert_eq!(error.is_damage(), damage, "{error}");
        }
    }
}

/// Text from a camera reaches log and messages short, and without control characters.
#[test]
fn what_a_camera_says_is_cut_short() {
    let host = "x".repeat(3000) + ".example";
    let (url, _) = serve(vec![answer("302 Found", &format!("Location: http://{host}/\r\n"), b"")]);
    let error = camera(&url).next(&mut Frame::default()).expect_err("elsewhere").to_string();
    assert!(error.len() < 600, "{} bytes", error.len());
    let said =
        fault(vec![answer("200 OK", "", b"no\x1b[2J picture\nhere ".repeat(5000).as_slice())]);
    assert!(said.len() < 600 && !said.contains(['\u{1b}', '\n']), "{said}");
}

#[test]
fn a_silent_camera_costs_its_time_out_and_no_more() {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
    let url = format!("http://{}", listener.local_addr().expect("its address"));
    let begun = Instant::now();
    assert!(camera(&url).next(&mut Frame::default()).is_err());
    assert!(begun.elapsed() < Duration::from_secs(5));
    drop(listener);
    assert!(camera(&url).next(&mut Frame::default()).is_err(), "nobody listens");
}

/// Runs `verge collect` on this address for a second.
fn collect(address: &str, frames: &std::path::Path) -> std::process::Output {
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_verge"))
        .args(["collect", "--camera", "-", "--interval", "0.1", "--for", "1", "--frames"])
        .arg(frames)
        .stdin(std::process::Stdio::piped())
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .expect("verge");
    let mut stdin = child.stdin.take().expect("a pipe");
    writeln!(stdin, "{address}").expect("it reads");
    child.wait_with_output().expect("it ends")
}

#[test]
fn pictures_are_collected_under_their_time_and_a_camera_that_is_away_is_named() {
    let pictures = (0..3).map(|k| answer("200 OK", "", &jpeg(32, 24, 40 * k + 20))).collect();
    let (url, _requests) = serve(pictures);
    let folder = tempfile::tempdir().expect("a folder");
    let frames = folder.path().join("frames");
    let address = url.replace("http://", "http://box:s3cret@");
    let output = collect(&address, &frames);
    assert!(output.status.success(), "{output:?}");
    let said = String::from_utf8_lossy(&[output.stdout.clone(), output.stderr.clone()].concat())
        .into_owned();
    assert!(!said.contains("s3cret"), "{said}");
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    let last = errors.lines().last().expect("a last line");
    let counted: Vec<usize> = last.split([' ', ';']).filter_map(|word| word.parse().ok()).collect();
    let [saved, requests, repeated, failed] = counted[..] else { panic!("{last}") };
    assert!(last.contains("3 pictures saved") && last.contains(" requests; "), "{last}");
    assert!(failed > 0 && saved + repeated + failed == requests, "{last}");
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    let mut names: Vec<String> = std::fs::read_dir(&frames)
        .expect("the folder was made")
        .map(|entry| entry.expect("a file").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    assert_eq!(printed.lines().collect::<Vec<_>>(), names, "what is printed is there");
    assert_eq!(names.len(), 3, "the camera then went away, which is said: {said}");
    let recorded = verge::daemon::capture::Recorded::open(&frames, None).expect("a recording");
    let mut recorded = Source::Recorded(recorded);
    let mut frame = Frame::default();
    assert_eq!(recorded.next(&mut frame).expect("a picture"), Captured::New);
    assert!(frame.time > verge::units::UtcMs(1_700_000_000_000), "named by the time");
    for (challenge, status) in
        [("WWW-Authenticate: Basic realm=\"x\"\r\n", "401 Unauthorized"), ("", "403 Forbidden")]
    {
        let (url, _requests) = serve(vec![answer(status, challenge, b"")]);
        let login = collect(&url, &folder.path().join("none"));
        let said = String::from_utf8_lossy(&login.stderr).into_owned();
        assert!(said.contains("user:password@") && !said.contains("camera.user"), "{said}");
    }
    let login = collect("http://a:b#c@127.0.0.1/", &folder.path().join("none"));
    let said = String::from_utf8_lossy(&login.stderr).into_owned();
    assert!(said.contains("%23") && !said.contains("camera.user"), "{said}");
    // Nobody listens on the discard port.
    let away = collect("http://127.0.0.1:9/a.jpg", &folder.path().join("none"));
    assert_eq!(away.status.code(), Some(69), "{away:?}");
    assert!(String::from_utf8_lossy(&away.stderr).contains("is the camera on"), "{away:?}");
}
