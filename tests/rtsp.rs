//! RTSP against a server that behaves badly.

mod common;

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::{Duration, Instant};
use verge::daemon::address::Address;
use verge::daemon::capture::{CameraSettings, Captured, Credentials, Source};
use verge::daemon::frame::Frame;

/// The time-out of the camera that the tests have.
const TIMEOUT: Duration = Duration::from_millis(1500);

/// Behaviour of a server on one connection.
#[derive(Clone)]
struct Server {
    /// Challenges of a 401; the next request with a login is accepted, or not.
    challenges: Vec<&'static str>,
    accepts: bool,
    description: String,
    /// Status of each answer but a 401.
    status: u16,
    /// In front of the answer to PLAY: packets and rubbish.
    rubbish: Vec<u8>,
    play: Vec<Step>,
}

#[derive(Clone)]
enum Step {
    /// A picture of this stream, by its number; packets of this size.
    Picture(&'static str, usize, usize),
    /// Leaves out this many packets.
    Gap(u16),
    Raw(Vec<u8>),
    Wait(u64),
    /// The same bytes until the client leaves.
    Endless(Vec<u8>),
}

const H264: &str = "v=0\r\ns=camera\r\nt=0 0\r\na=control:*\r\nm=audio 0 RTP/AVP 0\r\na=control:audio\r\n\
                    m=video 0 RTP/AVP 96\r\na=rtpmap:96 H264/90000\r\na=control:trackID=1\r\n";

impl Server {
    fn playing(play: Vec<Step>) -> Self {
        Self {
            challenges: Vec::new(),
            accepts: true,
            description: H264.to_owned(),
            status: 200,
            rubbish: Vec::new(),
            play,
        }
    }
}

/// Units of a recorded stream, each picture with its parameter sets.
fn pictures(name: &str) -> Vec<Vec<Vec<u8>>> {
    let stream = std::fs::read(format!("tests/data/video/{name}.h264")).expect("it ships");
    let mut starts: Vec<_> =
        (0..stream.len() - 3).filter(|&at| stream[at..at + 3] == [0, 0, 1]).collect();
    starts.push(stream.len());
    let (mut pictures, mut sets) = (Vec::<Vec<Vec<u8>>>::new(), Vec::new());
    for pair in starts.windows(2) {
        let mut unit = stream[pair[0] + 3..pair[1]].to_vec();
        while unit.last() == Some(&0) {
            unit.pop();
        }
        match unit[0] & 31 {
            1 | 5 if unit[1] & 0x80 != 0 => {
                sets.push(unit);
                pictures.push(std::mem::take(&mut sets));
            }
            1 | 5 => pictures.last_mut().expect("a picture").push(unit),
            _ => sets.push(unit),
        }
    }
    pictures
}

fn packet(channel: u8, sequence: u16, timestamp: u32, marker: bool, payload: &[u8]) -> Vec<u8> {
    let mut bytes = vec![b'$', channel];
    bytes.extend((payload.len() as u16 + 12).to_be_bytes());
    bytes.extend([0x80, if marker { 0x80 } else { 0 } | 96]);
    bytes.extend(sequence.to_be_bytes());
    bytes.extend(timestamp.to_be_bytes());
    bytes.extend([1, 2, 3, 4]);
    bytes.extend(payload);
    bytes
}

/// Serves one connection after the other on a port of this machine, then refuses; the requests.
fn serve(servers: Vec<Server>) -> (String, Receiver<String>) {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
    let address = format!("rtsp://{}/live?channel=1", listener.local_addr().expect("its address"));
    let (sender, requests) = mpsc::channel();
    thread::spawn(move || {
        for server in servers {
            let Ok((connection, _)) = listener.accept() else { return };
            let _ = one_session(connection, server, &sender);
        }
    });
    (address, requests)
}

fn one_session(
    mut connection: TcpStream,
    mut server: Server,
    requests: &mpsc::Sender<String>,
) -> std::io::Result<()> {
    let mut reader = BufReader::new(connection.try_clone()?);
    loop {
        let mut request = String::new();
        while !request.ends_with("\r\n\r\n") {
            if reader.read_line(&mut request)? == 0 {
                return Ok(());
            }
        }
        let number =
            request.lines().find_map(|line| line.strip_prefix("CSeq: ")).unwrap_or("0").to_owned();
        let has_login = request.contains("Authorization: ");
        let _ = requests.send(request.clone());
        let is_accepted = has_login && server.accepts;
        if !server.challenges.is_empty() && !is_accepted {
            let lines: String = server
                .challenges
                .iter()
                .map(|line| format!("WWW-Authenticate: {line}\r\n"))
                .collect();
            write!(connection, "RTSP/1.0 401 Unauthorized\r\nCSeq: {number}\r\n{lines}\r\n")?;
            continue;
        }
        let status = server.status;
        let mut answer = |lines: &str, body: &str| {
            write!(connection, "RTSP/1.0 {status} X\r\nCSeq: {number}\r\n{lines}\r\n{body}")
        };
        match request.split(' ').next().unwrap_or_default() {
            "DESCRIBE" => {
                let length = server.description.len();
                answer(&format!("Content-Length: {length}\r\n"), &server.description)?;
            }
            // Another channel than the one that was asked for.
            "SETUP" => answer(
                "Transport: RTP/AVP/TCP;unicast;interleaved=4-5;ssrc=1\r\nSession: 7abc;timeout=4\r\n",
                "",
            )?,
            "PLAY" => {
                connection.write_all(&std::mem::take(&mut server.rubbish))?;
                write!(connection, "RTSP/1.0 200 OK\r\nCSeq: {number}\r\n\r\n")?;
                let (stream, steps) = (connection.try_clone()?, std::mem::take(&mut server.play));
                // Requests are heard while it plays.
                thread::spawn(move || play(stream, steps));
            }
            _ => answer("", "")?,
        }
    }
}

fn play(mut stream: TcpStream, steps: Vec<Step>) -> std::io::Result<()> {
    let (mut sequence, mut timestamp) = (65_530_u16, 0_u32);
    for step in steps {
        match step {
            Step::Wait(milliseconds) => thread::sleep(Duration::from_millis(milliseconds)),
            Step::Raw(bytes) => stream.write_all(&bytes)?,
            Step::Gap(packets) => sequence = sequence.wrapping_add(packets),
            Step::Endless(bytes) => loop {
                stream.write_all(&bytes)?;
            },
            Step::Picture(name, index, size) => {
                let units = pictures(name).swap_remove(index);
                for (at, unit) in units.iter().enumerate() {
                    let last_unit = at + 1 == units.len();
                    let parts: Vec<_> = unit[1..].chunks(size).collect();
                    for (part_at, part) in parts.iter().enumerate() {
                        let last = part_at + 1 == parts.len();
                        let mark =
                            if part_at == 0 { 0x80 } else { 0 } | if last { 0x40 } else { 0 };
                        let payload = if parts.len() == 1 {
                            unit.clone()
                        } else {
                            [&[unit[0] & 0xe0 | 28, mark | unit[0] & 31], *part].concat()
                        };
                        let marker = last && last_unit;
                        stream.write_all(&packet(4, sequence, timestamp, marker, &payload))?;
                        // Reports of the sender, and the audio's channel.
                        stream.write_all(&packet(5, 1, 1, false, b"report"))?;
                        sequence = sequence.wrapping_add(1);
                    }
                }
                timestamp = timestamp.wrapping_add(18_000);
            }
        }
    }
    stream.shutdown(std::net::Shutdown::Both)
}

fn settings(url: &str) -> CameraSettings {
    let address = Address::parse(url).expect("a right address");
    CameraSettings {
        credentials: Some(Credentials { user: "box".into(), password: "s3cret".into() }),
        ..CameraSettings::new(address, Duration::from_millis(100), TIMEOUT)
    }
}

fn camera(url: &str) -> Source {
    Source::network(settings(url))
}

/// Asks until a new picture comes, and returns what was reported before.
fn until_new(camera: &mut Source, frame: &mut Frame) -> Vec<String> {
    let (begun, mut said) = (Instant::now(), Vec::new());
    loop {
        match camera.next(frame) {
            Ok(Captured::New) => return said,
            Ok(_) => {}
            Err(error) => said.push(error.to_string()),
        }
        assert!(begun.elapsed() < Duration::from_secs(15), "no picture: {said:?}");
        thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn pictures_come_and_the_session_is_ended() {
    let (url, requests) = serve(vec![Server {
        rubbish: [packet(4, 1, 1, false, b"early"), b"\0\0rubbish".to_vec()].concat(),
        ..Server::playing(vec![
            Step::Picture("high", 0, 500),
            Step::Picture("high", 1, 500),
            Step::Wait(300),
            Step::Picture("high", 2, 90),
            Step::Wait(2000),
        ])
    }]);
    let (mut camera, mut frame) = (camera(&url), Frame::default());
    assert_eq!(camera.next(&mut frame).expect("a picture"), Captured::New);
    assert_eq!((frame.picture.width, frame.picture.height), (160, 120));
    let first = frame.picture.rgb.clone();
    assert_eq!(camera.next(&mut frame).expect("the next key picture"), Captured::New);
    assert_ne!(first, frame.picture.rgb);
    let counts = camera.counts();
    assert_eq!((counts.lost, counts.flagged, counts.reopened), (0, 0, 0));
    let described = camera.video().expect("a video");
    assert!(
        described.contains("H.264 high, 160x120 px") && described.contains("a key picture each"),
        "{described}"
    );
    drop(camera);
    let methods: Vec<_> =
        requests.iter().map(|r| r.lines().next().unwrap_or_default().to_owned()).collect();
    let words: Vec<_> =
        methods.iter().map(|line| line.split(' ').next().unwrap_or_default()).collect();
    assert_eq!(words[..3], ["DESCRIBE", "SETUP", "PLAY"]);
    assert_eq!(words.last(), Some(&"TEARDOWN"), "{methods:?}");
    assert!(methods[1].ends_with("/live?channel=1/trackID=1 RTSP/1.0"), "{methods:?}");
}

#[test]
fn the_session_is_kept_alive() {
    let server = Server::playing(vec![
        Step::Picture("main", 0, 1400),
        Step::Wait(1200),
        Step::Picture("main", 2, 1400),
        Step::Wait(1200),
        Step::Picture("main", 0, 1400),
        Step::Wait(500),
    ]);
    let (url, requests) = serve(vec![server]);
    let (mut camera, mut frame) = (camera(&url), Frame::default());
    for _ in 0..3 {
        until_new(&mut camera, &mut frame);
    }
    drop(camera);
    let options = requests.iter().filter(|request| request.starts_with("OPTIONS")).count();
    assert!(options >= 1, "half of four seconds have passed");
}

#[test]
fn logins_are_answered_by_the_strongest_challenge() {
    let digest = "Digest realm=\"cam\", nonce=\"abc\", algorithm=SHA-256, qop=\"auth\"";
    for (challenges, expected) in [
        (
            vec!["Basic realm=\"cam\"", "Digest realm=\"cam\", nonce=\"abc\""],
            "Digest username=\"box\"",
        ),
        (vec![digest], "algorithm=SHA-256"),
        (vec!["Basic realm=\"cam\""], "Basic Ym94OnMzY3JldA=="),
    ] {
        let server = Server {
            challenges,
            ..Server::playing(vec![Step::Picture("baseline", 0, 700), Step::Wait(500)])
        };
        let (url, requests) = serve(vec![server]);
        let (mut camera, mut frame) = (camera(&url), Frame::default());
        camera.next(&mut frame).expect(expected);
        let requests: Vec<_> = requests.try_iter().collect();
        assert!(!requests[0].contains("Authorization"), "never unasked");
        for request in &requests[1..] {
            assert!(request.contains(expected), "{request}");
            let uri = request.split(' ').nth(1).expect("an address");
            assert!(
                !expected.starts_with("Digest") || request.contains(&format!("uri=\"{uri}\"")),
                "{request}"
            );
        }
    }
}

#[test]
fn a_refused_login_is_not_tried_again() {
    let refuse = Server {
        challenges: vec!["Digest realm=\"cam\", nonce=\"abc\""],
        accepts: false,
        ..Server::playing(Vec::new())
    };
    let (url, requests) = serve(vec![refuse; 8]);
    let (mut camera, mut frame) = (camera(&url), Frame::default());
    for _ in 0..30 {
        let error = camera.next(&mut frame).expect_err("refused").to_string();
        assert!(error.contains("refuses user \"box\"") && !error.contains("s3cret"), "{error}");
        thread::sleep(Duration::from_millis(100));
    }
    let logins = requests.try_iter().filter(|request| request.contains("Authorization")).count();
    assert_eq!(logins, 1);
}

#[test]
fn a_gap_costs_its_picture_and_is_counted() {
    let (url, _) = serve(vec![Server::playing(vec![
        Step::Picture("high", 0, 300),
        Step::Wait(400),
        Step::Gap(3),
        Step::Picture("high", 1, 300),
        Step::Picture("high", 2, 300),
        Step::Wait(500),
    ])]);
    let (mut camera, mut frame) = (camera(&url), Frame::default());
    assert!(until_new(&mut camera, &mut frame).is_empty());
    assert!(until_new(&mut camera, &mut frame).is_empty());
    let counts = camera.counts();
    assert_eq!((counts.lost, counts.reopened), (3, 0));
}

#[test]
fn a_server_that_vanishes_falls_silent_or_changes_size_is_read_again() {
    let (url, _) = serve(vec![
        Server::playing(vec![Step::Picture("high", 0, 500)]),
        Server::playing(vec![Step::Picture("high", 0, 500), Step::Wait(4000)]),
        Server::playing(vec![Step::Picture("full", 2, 500), Step::Wait(1000)]),
    ]);
    let (mut camera, mut frame) = (camera(&url), Frame::default());
    assert!(until_new(&mut camera, &mut frame).is_empty());
    let said = until_new(&mut camera, &mut frame);
    assert!(said.iter().any(|said| said.contains("closed it")), "{said:?}");
    let said = until_new(&mut camera, &mut frame);
    assert!(said.iter().any(|said| said.contains("no picture for 1.5 s")), "{said:?}");
    assert_eq!(camera.counts().reopened, 2);
}

#[test]
fn a_picture_of_another_shape_is_refused() {
    let play = vec![Step::Picture("high", 0, 500), Step::Wait(300)];
    let (url, _) = serve(vec![Server::playing(play)]);
    let mut settings = settings(&url);
    settings.size = Some((1920, 1080));
    let error = Source::network(settings).next(&mut Frame::default()).expect_err("another shape");
    assert!(error.is_damage() && error.to_string().contains("160x120"), "{error}");
}

#[test]
fn faults_are_named() {
    let described =
        |text: &str| Server { description: text.to_owned(), ..Server::playing(Vec::new()) };
    let mut missing = Server::playing(Vec::new());
    missing.status = 404;
    let only_predicted: Vec<_> =
        (0..12).flat_map(|_| [Step::Picture("high", 1, 500), Step::Wait(150)]).collect();
    for (server, expected) in [
        (missing, "RTSP status 404; check the path"),
        (described("v=0\r\nm=audio 0 RTP/AVP 0\r\n"), "no video"),
        (described("v=0\r\nm=video 0 RTP/AVP 98\r\na=rtpmap:98 VP9/90000\r\n"), "streams VP9"),
        (Server::playing(only_predicted), "no key picture among them"),
        (Server::playing(vec![Step::Wait(3000)]), "no picture"),
    ] {
        let (url, _) = serve(vec![server]);
        let said = camera(&url).next(&mut Frame::default()).expect_err(expected).to_string();
        assert!(said.contains(expected) && said.contains("/live?..."), "{said}");
    }
    // Not RTSP at all.
    for (answer, expected) in [
        (&b"HTTP/1.1 400 Bad Request\r\n\r\n"[..], "not RTSP"),
        (b"\x15\x03\x03\0\x02\x02\x28", "it is TLS"),
        (b"SSH-2.0-x\r\n\r\n", "not RTSP"),
        (b"", "closed it"),
    ] {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
        let url = format!("rtsp://{}/", listener.local_addr().expect("its address"));
        thread::spawn(move || {
            let (mut stream, _) = listener.accept().expect("a client");
            let _ = stream.read(&mut [0; 1000]);
            let _ = stream.write_all(answer);
        });
        let said = camera(&url).next(&mut Frame::default()).expect_err(expected).to_string();
        assert!(said.contains(expected), "{said}");
    }
}

/// The most memory that this program has held, bytes.
fn resident() -> usize {
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux");
    let line = status.lines().find(|line| line.starts_with("VmRSS")).expect("a line");
    line.split_whitespace().nth(1).and_then(|kb| kb.parse::<usize>().ok()).expect("a number") << 10
}

/// Answers and packets without end: bounded memory, and another try.
#[test]
fn whatever_a_server_sends_memory_is_bounded() {
    let header = b"RTSP/1.0 200 OK\r\nX: ".to_vec();
    let fragment = |kind| packet(4, 1, 1, false, &[&[28, kind][..], &[7; 60_000]].concat());
    let mut fragments = Vec::new();
    for sequence in 0..40 {
        let mut one = fragment(if sequence == 0 { 0x85 } else { 5 });
        one[6..8].copy_from_slice(&(sequence as u16).to_be_bytes());
        fragments.extend(one);
    }
    for play in [
        vec![Step::Raw(header), Step::Endless(vec![b'x'; 60_000])],
        vec![Step::Endless(b"RTSP/1.0 200 OK\r\nContent-Length: 4000000000\r\n\r\n".to_vec())],
        vec![Step::Endless(fragments)],
        vec![Step::Endless(vec![b'?'; 60_000])],
        vec![Step::Endless(packet(4, 7, 7, false, b"\x07"))],
    ] {
        let (url, _) = serve(vec![Server::playing(play)]);
        let begun = resident();
        let error = camera(&url).next(&mut Frame::default()).expect_err("no picture");
        assert!(!error.is_damage(), "{error}");
        assert!(resident() < begun + (24 << 20), "{} MB more: {error}", (resident() - begun) >> 20);
    }
}

#[test]
fn every_picture_is_decoded_where_it_is_asked_for() {
    let steps = (0..4).flat_map(|n| [Step::Picture("main", n, 400), Step::Wait(250)]).collect();
    let (url, _) = serve(vec![Server::playing(steps)]);
    let mut settings = settings(&url);
    settings.every_picture = true;
    let (mut camera, mut frame) = (Source::network(settings), Frame::default());
    let mut seen: Vec<Vec<u8>> = Vec::new();
    while seen.len() < 4 {
        assert!(until_new(&mut camera, &mut frame).is_empty(), "after {} pictures", seen.len());
        assert!(!seen.contains(&frame.picture.rgb));
        seen.push(frame.picture.rgb.clone());
    }
}

/// Pictures whose bytes are changed on the way, in the thousands: none of them is given.
#[test]
fn no_damaged_picture_is_given_in_silence() {
    let whole = pictures("main").swap_remove(0);
    let mut rng = fastrand::Rng::with_seed(3);
    let mut expected = Frame::default();
    let (url, _) =
        serve(vec![Server::playing(vec![Step::Picture("main", 0, 1400), Step::Wait(500)])]);
    camera(&url).next(&mut expected).expect("the whole one");
    let mut bytes = Vec::new();
    for (number, timestamp) in (0..500_u32).map(|n| (n, n * 3000)) {
        let units: Vec<Vec<u8>> = whole.clone();
        let mut packets: Vec<Vec<u8>> = Vec::new();
        for unit in units {
            let parts: Vec<_> = unit[1..].chunks(300).collect();
            for (at, part) in parts.iter().enumerate() {
                let mark =
                    if at == 0 { 0x80 } else { 0 } | if at + 1 == parts.len() { 0x40 } else { 0 };
                packets.push(if parts.len() == 1 {
                    unit.clone()
                } else {
                    [&[unit[0] & 0xe0 | 28, mark | unit[0] & 31], *part].concat()
                });
            }
        }
        // One packet is cut short, loses its middle, or comes twice.
        let victim = rng.usize(2..packets.len());
        match number % 3 {
            0 => {
                let keep = packets[victim].len() / 2;
                packets[victim].truncate(keep)
            }
            1 => {
                let at = packets[victim].len() / 2;
                drop(packets[victim].drain(at / 2..at))
            }
            _ => {
                let twice = packets[victim].clone();
                packets.insert(victim, twice)
            }
        }
        let count = packets.len();
        for (at, payload) in packets.iter().enumerate() {
            let sequence = (number as u16).wrapping_mul(64).wrapping_add(at as u16);
            bytes.extend(packet(4, sequence, timestamp, at + 1 == count, payload));
        }
        // The number goes on without a gap, so that nothing is noticed by it.
        for at in count..64 {
            let sequence = (number as u16).wrapping_mul(64).wrapping_add(at as u16);
            bytes.extend(packet(4, sequence, timestamp, false, &[9, 16]));
        }
    }
    let (url, _) = serve(vec![Server::playing(vec![Step::Raw(bytes), Step::Wait(300)])]);
    let (mut camera, mut frame, begun) = (camera(&url), Frame::default(), Instant::now());
    let mut told = 0;
    while begun.elapsed() < Duration::from_secs(10) {
        match camera.next(&mut frame) {
            Ok(_) => assert!(frame.picture.rgb == expected.picture.rgb, "a wrong picture"),
            Err(error) if error.is_damage() => told += 1,
            Err(_) => break,
        }
    }
    let counts = camera.counts();
    assert!(counts.flagged > 0 && told <= counts.flagged, "{told} {counts:?}");
}
