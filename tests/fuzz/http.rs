//! A camera on a port of this machine that gives a prescribed answer.

use super::common;
use super::runner::Target;
use std::io::{Read, Write};
use std::net::{Ipv4Addr, TcpListener};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use verge::daemon::address::Address;
use verge::daemon::capture::{CameraSettings, Captured, Source};
use verge::daemon::frame::Frame;

/// Words of HTTP.
pub const TOKENS: &[&[u8]] = &[
    b"HTTP/1.1 200 OK\r\n",
    b"HTTP/1.0 200\r\n",
    b"HTTP/1.1 100 Continue\r\n\r\n",
    b"HTTP/1.1 304 Not Modified\r\n",
    b"Content-Length: 0\r\n",
    b"Content-Length: 18446744073709551616\r\n",
    b"Content-Length: -1\r\n",
    b"Transfer-Encoding: chunked\r\n",
    b"Transfer-Encoding: gzip, chunked\r\n",
    b"Content-Encoding: gzip\r\n",
    b"Content-Type: multipart/x-mixed-replace; boundary=b\r\n",
    b"Connection: keep-alive\r\n",
    b"ETag: \"a\"\r\n",
    b"Set-Cookie: a=b\r\n",
    b"\r\n\r\n",
    b"\n\n",
    b"ffffffffffffffff\r\n",
    b"0\r\n\r\n",
    b"1;a=b\r\nx\r\n",
    b": ",
    b"\0",
];

/// Answers of cameras, right and wrong.
pub fn answers_to_begin_with() -> Vec<Vec<u8>> {
    let picture = common::jpeg(16, 8, 90);
    let head = |lines: &str| format!("HTTP/1.1 {lines}\r\n\r\n").into_bytes();
    let whole = format!("200 OK\r\nContent-Type: image/jpeg\r\nContent-Length: {}", picture.len());
    let mut chunked = head("200 OK\r\nTransfer-Encoding: chunked\r\nETag: \"7\"");
    for chunk in picture.chunks(100) {
        chunked.extend_from_slice(format!("{:x}\r\n", chunk.len()).as_bytes());
        chunked.extend_from_slice(chunk);
        chunked.extend_from_slice(b"\r\n");
    }
    chunked.extend_from_slice(b"0\r\n\r\n");
    vec![
        [head(&whole), picture.clone()].concat(),
        [head("200 OK\r\nConnection: close"), picture].concat(),
        chunked,
        head("304 Not Modified\r\nETag: \"7\""),
        head("401 Unauthorized\r\nWWW-Authenticate: Digest realm=\"x\""),
        [head("500 Oops\r\nContent-Length: 5"), b"sorry".to_vec()].concat(),
    ]
}

/// Takes the word `location` out: a test talks to this machine only.
pub fn without_redirects(answer: &mut [u8]) {
    for at in 0..answer.len().saturating_sub(7) {
        if answer[at..at + 8].eq_ignore_ascii_case(b"location") {
            answer[at] = b'x';
        }
    }
}

/// The camera; its thread lives as long as the test.
pub struct Camera {
    settings: CameraSettings,
    answer: Arc<Mutex<Vec<u8>>>,
}

impl Camera {
    pub fn start() -> Self {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
        let url = format!("http://{}/", listener.local_addr().expect("its address"));
        let answer = Arc::new(Mutex::new(Vec::new()));
        let given = Arc::clone(&answer);
        std::thread::spawn(move || {
            let mut request = [0; 4096];
            while let Ok((mut stream, _)) = listener.accept() {
                // A request is one packet here; a client that is gone needs no answer.
                let _ = stream.read(&mut request);
                let answer = given.lock().expect("nobody panics with it").clone();
                let _ = stream.write_all(&answer);
            }
        });
        let second = Duration::from_secs(1);
        let address = Address::parse(&url).expect("a right address");
        let settings = CameraSettings::new(address, second, 5 * second);
        Self { settings, answer }
    }

    /// Has a new client ask for this answer, twice where the first was a picture.
    pub fn ask(&self, answer: &[u8]) -> String {
        *self.answer.lock().expect("nobody panics with it") = answer.to_vec();
        let mut source = Source::network(self.settings.clone());
        let mut frame = Frame::default();
        match source.next(&mut frame) {
            Ok(Captured::New) => match source.next(&mut frame) {
                Ok(captured) => format!("{captured:?} after a picture"),
                Err(error) => format!("after a picture: {error}"),
            },
            Ok(captured) => format!("{captured:?}"),
            Err(error) => error.to_string(),
        }
    }
}

#[test]
fn http_answers() {
    let camera = Camera::start();
    let target = Target {
        name: "http_answers",
        executions: 300,
        corpus: answers_to_begin_with(),
        tokens: TOKENS,
        longest: 1 << 16,
    };
    target.run(|_, input| {
        without_redirects(input);
        camera.ask(input)
    });
}
