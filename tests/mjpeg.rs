//! Multipart MJPEG over HTTP against a server that behaves badly.

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

/// The time-out of the camera that the tests have.
const TIMEOUT: Duration = Duration::from_millis(600);

/// Behaviour of the server on one connection.
enum Does {
    /// Sends bytes.
    Send(Vec<u8>),
    /// Says nothing for a while.
    Wait(Duration),
}

fn head(content_type: &str) -> Does {
    let head = format!("HTTP/1.1 200 OK\r\nContent-Type: {content_type}\r\n\r\n");
    Does::Send(head.into_bytes())
}

fn stream() -> Does {
    head("multipart/x-mixed-replace; boundary=frame")
}

fn part(body: &[u8]) -> Does {
    let head =
        format!("--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", body.len());
    Does::Send([head.as_bytes(), body, b"\r\n"].concat())
}

fn pause(milliseconds: u64) -> Does {
    Does::Wait(Duration::from_millis(milliseconds))
}

/// Serves one connection after the other on a port of this machine, then refuses.
fn serve(connections: Vec<Vec<Does>>) -> (String, Receiver<String>) {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
    let address = format!("mjpeg+http://{}/video", listener.local_addr().expect("its address"));
    let (sender, requests) = mpsc::channel();
    thread::spawn(move || {
        for does in connections {
            let Ok((mut connection, _)) = listener.accept() else { return };
            let _ = sender.send(request(&connection));
            for step in does {
                let sent = match step {
                    Does::Send(bytes) => connection.write_all(&bytes),
                    Does::Wait(time) => {
                        thread::sleep(time);
                        Ok(())
                    }
                };
                if sent.is_err() {
                    break;
                }
            }
        }
    });
    (address, requests)
}

fn request(connection: &TcpStream) -> String {
    let lines = BufReader::new(connection).lines().map_while(Result::ok);
    lines.take_while(|line| !line.is_empty()).map(|line| line + "\n").collect()
}

fn camera(url: &str) -> Source {
    let address = Address::parse(url).expect("a right address");
    Source::network(CameraSettings {
        credentials: Some(Credentials { user: "box".into(), password: "s3cret".into() }),
        ..CameraSettings::new(address, Duration::from_millis(100), TIMEOUT)
    })
}

/// Asks until a new picture comes, and returns how often there was none before.
fn until_new(camera: &mut Source, frame: &mut Frame) -> u32 {
    let begun = Instant::now();
    let mut failures = 0;
    loop {
        match camera.next(frame) {
            Ok(Captured::New) => return failures,
            Ok(_) => {}
            Err(_) => failures += 1,
        }
        assert!(begun.elapsed() < Duration::from_secs(10), "no picture in ten seconds");
        thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn pictures_come_one_after_the_other_and_the_latest_is_taken() {
    let (url, requests) = serve(vec![vec![
        stream(),
        part(&jpeg(32, 24, 10)),
        pause(200),
        part(&jpeg(32, 24, 10)),
        pause(200),
        part(&jpeg(32, 24, 90)),
        part(&jpeg(48, 24, 200)),
        pause(2000),
    ]]);
    let (mut camera, mut frame) = (camera(&url), Frame::default());
    assert_eq!(camera.next(&mut frame).expect("a picture"), Captured::New);
    assert_eq!(camera.next(&mut frame).expect("a picture"), Captured::Unchanged);
    thread::sleep(Duration::from_millis(300));
    assert_eq!(camera.next(&mut frame).expect("a picture"), Captured::New);
    assert_eq!(frame.picture.width, 48, "the latest of two");
    let request = requests.recv().expect("a request").to_lowercase();
    assert!(!request.contains("authorization"), "never unasked: {request}");
}

#[test]
fn a_part_that_is_cut_off_is_damage_and_the_next_one_is_whole() {
    let whole = jpeg(32, 24, 10);
    let truncated =
        Does::Send([b"--frame\r\nContent-Length: 99999\r\n\r\n", &whole[..300], b"\r\n"].concat());
    // Without a length, and with rubbish in front.
    let bare = Does::Send([b"rubbish\r\n--frame\r\n\r\n", &whole[..], b"\r\n--frame\r\n"].concat());
    let long = Does::Send(vec![b' '; 100_000]);
    let (url, _) =
        serve(vec![vec![stream(), truncated, bare, pause(300), part(&whole), long, pause(10_000)]]);
    let (mut camera, mut frame) = (camera(&url), Frame::default());
    // The thread may have read the whole part before the cut one was asked for.
    match camera.next(&mut frame) {
        Err(error) => {
            assert!(error.is_damage() && error.to_string().contains("cut off"), "{error}")
        }
        Ok(captured) => assert_eq!(captured, Captured::New),
    }
    until_new_or_unchanged(&mut camera, &mut frame);
    assert_eq!(camera.counts().reopened, 0, "the stream itself was never lost");
}

fn until_new_or_unchanged(camera: &mut Source, frame: &mut Frame) {
    let begun = Instant::now();
    while camera.next(frame).is_err() {
        assert!(begun.elapsed() < Duration::from_secs(5), "no picture");
    }
    assert_eq!((frame.picture.width, frame.picture.height), (32, 24));
}

#[test]
fn a_server_that_vanishes_stalls_or_floods_is_left_and_asked_again() {
    let flood = Does::Send(b"--frame\r\nContent-Length: 4000000000\r\n\r\n".to_vec());
    let (url, _) = serve(vec![
        vec![stream(), part(&jpeg(32, 24, 10))],
        vec![stream(), part(&jpeg(32, 24, 40)), pause(1500)],
        vec![stream(), flood, pause(100)],
        vec![stream(), part(&jpeg(32, 24, 90)), pause(500)],
    ]);
    let (mut camera, mut frame) = (camera(&url), Frame::default());
    assert_eq!(until_new(&mut camera, &mut frame), 0, "the first connection");
    assert!(until_new(&mut camera, &mut frame) > 0, "it vanished");
    let begun = Instant::now();
    assert!(until_new(&mut camera, &mut frame) > 0, "it stalled, and the next one flooded");
    assert!(begun.elapsed() < Duration::from_secs(8), "{:?}", begun.elapsed());
    assert_eq!(camera.counts().reopened, 3);
}

#[test]
fn faults_are_named_and_waited_out() {
    let status = |text: &str| {
        vec![Does::Send(format!("HTTP/1.1 {text}\r\nContent-Length: 0\r\n\r\n").into_bytes())]
    };
    for (does, expected) in [
        (status("401 Unauthorized"), "does not say which"),
        (status("404 Not Found"), "check the path in the address"),
        (vec![head("image/jpeg"), pause(50)], "leave mjpeg+ away"),
        (vec![stream()], "the stream ended"),
        (vec![stream(), Does::Send(b"--frame--\r\n".to_vec())], "the stream ended"),
        (vec![stream(), Does::Send(vec![b'x'; 9 << 20])], "without a picture"),
        (vec![stream(), Does::Send(b"<html>Login</html>".to_vec())], "an html page"),
        (vec![pause(900)], "timeout"),
    ] {
        let (url, _) = serve(vec![does]);
        let (mut camera, begun) = (camera(&url), Instant::now());
        let said = camera.next(&mut Frame::default()).expect_err(expected).to_string();
        assert!(said.to_lowercase().contains(expected) || said.contains("no picture"), "{said}");
        assert!(said.contains(&url) && !said.contains("s3cret"), "{said}");
        let first = begun.elapsed();
        assert!(first < Duration::from_secs(4), "{expected}: {first:?}");
        // Asked again at once, it does not ask the server.
        let begun = Instant::now();
        camera.next(&mut Frame::default()).expect_err("still the same");
        assert!(begun.elapsed() < Duration::from_millis(100), "{expected}");
    }
}

#[test]
fn a_server_that_drips_ends_with_the_time_out() {
    let mut does = vec![stream(), Does::Send(b"--frame\r\nContent-Length: 500\r\n\r\n".to_vec())];
    for _ in 0..30 {
        does.extend([Does::Send(b"x".to_vec()), pause(100)]);
    }
    let (url, _) = serve(vec![does, vec![stream(), part(&jpeg(32, 24, 10)), pause(500)]]);
    let (mut camera, mut frame) = (camera(&url), Frame::default());
    let begun = Instant::now();
    let error = camera.next(&mut frame).expect_err("no picture").to_string();
    assert!(error.contains("no picture for 0.6 s"), "{error}");
    assert!(begun.elapsed() < TIMEOUT * 2, "{:?}", begun.elapsed());
    until_new(&mut camera, &mut frame);
}
