//! HTTP snapshots against a server that behaves badly.

mod common;

use common::jpeg;
use std::io::{BufRead, BufReader, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::{Duration, Instant};
use verge::daemon::capture::{Captured, Credentials, Snapshot, SnapshotSettings, Source};
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

fn camera(url: &str) -> Source {
    let settings = SnapshotSettings {
        url: url.to_owned(),
        credentials: Some(Credentials { user: "box".into(), password: "s3cret".into() }),
        interval: Duration::from_secs(1),
        timeout: Duration::from_millis(700),
    };
    Source::Snapshot(Box::new(Snapshot::new(settings).expect("a right address")))
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
    assert!(requests[0].contains("authorization: basic ym94onmzy3jlda=="), "{}", requests[0]);
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

/// What is said when this is the answer.
fn fault(answers: Vec<Vec<u8>>) -> String {
    let (url, _) = serve(answers);
    camera(&url).next(&mut Frame::default()).expect_err("no picture").to_string()
}

#[test]
fn faults_are_named() {
    for (answer, expected) in [
        (answer("401 Unauthorized", "", b""), "camera.password_file"),
        (answer("404 Not Found", "", b""), "camera.source"),
        (answer("500 Oops", "", b"sorry"), "500"),
        (answer("200 OK", "", b"<html>login</html>"), "neither JPEG nor PNG"),
        (answer("200 OK", "", b""), "empty"),
        (answer("200 OK", "", &jpeg(32, 24, 10)[..300]), "cut off"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 9999\r\n\r\nabc".to_vec(), "broke off"),
        (b"rubbish\r\n\r\n".to_vec(), "http://127.0.0.1"),
        (answer("200 OK", "", &vec![0; 9 << 20]), "more than"),
    ] {
        let said = fault(vec![answer]);
        assert!(said.contains(expected), "{expected}: {said}");
        assert!(!said.contains("s3cret"), "{said}");
    }
}

/// Found by fuzzing: the HTTP client panics on it.
#[test]
fn a_redirect_that_breaks_off_costs_one_picture() {
    let (url, _) = serve(vec![
        b"HTTP/1.1 302 Found\r\nLocation: /x\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n".to_vec(),
        answer("200 OK", "", &jpeg(32, 24, 10)),
    ]);
    let (mut camera, mut frame) = (camera(&url), Frame::default());
    let error = camera.next(&mut frame).expect_err("no picture");
    assert!(error.to_string().contains(&url) && !error.is_damage(), "{error}");
    assert_eq!(camera.next(&mut frame).expect("a picture"), Captured::New);
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

#[test]
fn an_address_that_is_none_is_refused() {
    for url in ["ftp://camera/x.jpg", "camera", "http://"] {
        let settings = SnapshotSettings {
            url: url.into(),
            credentials: None,
            interval: Duration::from_secs(1),
            timeout: Duration::from_secs(1),
        };
        assert!(Snapshot::new(settings).is_err(), "{url}");
    }
}
