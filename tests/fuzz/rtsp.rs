//! Input of an RTSP camera: descriptions, packets, whole sessions.

use super::runner::Target;
use super::{magnitude, outcome};
use std::io::{Read, Write};
use std::net::{Ipv4Addr, TcpListener};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use verge::daemon::address::Address;
use verge::daemon::capture::rtsp::assembler::{Assembler, Syntax};
#[cfg(feature = "h265")]
use verge::daemon::capture::rtsp::h265;
use verge::daemon::capture::rtsp::{Unit, h264, jpeg, rtp::Packet, sdp, video::Video};
use verge::daemon::capture::{CameraSettings, DecodeError, Source};
use verge::daemon::frame::{Frame, Picture};

/// Words of a session.
pub const WORDS: &[&[u8]] = &[
    b"RTSP/1.0 200 OK\r\n",
    b"\r\n\r\n",
    b"CSeq: 1\r\n",
    b"CSeq: 2\r\n",
    b"Content-Length: 9\r\n",
    b"$\0\0\x0c",
    b"Content-Length: 18446744073709551615\r\n",
    b"Session: ",
    b"interleaved=",
];

/// A camera's description of its video.
pub const DESCRIPTION: &str = "v=0\r\na=control:*\r\nm=video 0 RTP/AVP 96\r\na=rtpmap:96 H264/90000\r\n\
    a=fmtp:96 packetization-mode=1;sprop-parameter-sets=Z0IACpWoKDmQ,aM48gA==\r\na=framerate:12.5\r\n\
    a=control:trackID=1\r\n";

#[test]
fn descriptions() {
    let target = Target {
        name: "descriptions",
        executions: 20_000,
        corpus: vec![
            DESCRIPTION.as_bytes().to_vec(),
            b"m=video 0 RTP/AVP 26\na=control:x\n".to_vec(),
        ],
        tokens: &[
            b"m=video ",
            b"a=",
            b"rtpmap:",
            b"fmtp:",
            b"sprop-parameter-sets=",
            b"control:",
            b"H264/",
            b"JPEG/",
            b"\r\n",
            b",",
        ],
        longest: 1 << 13,
    };
    target.run(|_, input| match sdp::video(&String::from_utf8_lossy(input)) {
        Some(video) => {
            let address = sdp::resolve("rtsp://camera/x", video.control.as_deref());
            assert!(address.len() <= input.len() * 3 + 100);
            format!(
                "{:?} {} {}",
                video.codec,
                magnitude(video.sets.len()),
                video.framerate.is_some()
            )
        }
        None => "no video".to_owned(),
    });
}

/// Packets of a recorded stream, each with its length in front; `head` is that of parts of a unit
/// whose own header is so long.
fn packets(file: &str, head: impl Fn(usize) -> [u8; 3], header: usize) -> Vec<u8> {
    let stream = std::fs::read(format!("tests/data/video/{file}")).expect("it ships");
    let mut bytes = Vec::new();
    let mut starts: Vec<_> =
        (0..stream.len() - 3).filter(|&at| stream[at..at + 3] == [0, 0, 1]).collect();
    starts.truncate(6);
    for (number, pair) in starts.windows(2).enumerate() {
        let unit = &stream[pair[0] + 3..pair[1] - 1];
        for (at, part) in unit.chunks(400).enumerate() {
            let head = head(at);
            let head = if unit.len() <= 400 { &[] } else { &head[..=header] };
            let payload = [head, part].concat();
            bytes.extend((payload.len() as u16 + 12).to_be_bytes());
            bytes.extend([0x80, 96, 0, number as u8, 0, 0, 0, (number / 3) as u8, 0, 0, 0, 1]);
            bytes.extend(payload);
        }
    }
    bytes
}

#[test]
fn packets_of_video() {
    let target = Target {
        name: "packets",
        executions: 10_000,
        corpus: vec![packets("main.h264", |at| [0x7c, if at == 0 { 0x85 } else { 5 }, 0], 1)],
        tokens: &[
            b"\x67\x64\0",
            b"\x68\xee",
            b"\x65\x88",
            b"\x7c\x85",
            b"\x7c\x45",
            b"\x78\0\x04",
            b"\0\0\0\x01",
            b"\x80\xe0",
            b"\x90\x60",
        ],
        longest: 1 << 14,
    };
    target.run(|_, input| put_together(input, h264::Assembler::default()));
}

/// Packets of H.265, as of the stream that ships.
#[cfg(feature = "h265")]
#[test]
fn packets_of_h265() {
    let target = Target {
        name: "h265",
        executions: 10_000,
        corpus: vec![packets(
            "main.h265",
            |part| [0x62, 1, if part == 0 { 0x94 } else { 0x14 }],
            2,
        )],
        tokens: &[b"\x42\x01", b"\x44\x01", b"\x26\x01\xaf", b"\x62\x01\x94", b"\x60\x01\0\x04"],
        longest: 1 << 14,
    };
    target.run(|_, input| put_together(input, h265::Assembler::default()));
}

/// What becomes of packets, each with its length in front.
fn put_together<S: Syntax>(input: &[u8], mut video: Assembler<S>) -> String {
    let mut pictures = jpeg::Assembler::default();
    let (mut unit, mut picture, mut rest) = (Unit::default(), Picture::default(), input);
    let (mut given, mut said) = (0, String::new());
    while let Some((&[high, low], tail)) = rest.split_first_chunk::<2>() {
        let length = usize::from(u16::from_be_bytes([high, low])).min(tail.len());
        let (bytes, tail) = tail.split_at(length);
        rest = tail;
        let Some(packet) = Packet::parse(bytes) else { continue };
        pictures.push(&packet, &mut unit);
        if video.push(&packet, &mut unit) {
            given += 1;
            let result = Video::alone(unit.coding).decode(&unit.bytes, None, &mut picture);
            assert!(!matches!(result, Err(DecodeError::Decoder)), "the decoder panics");
            said = outcome(result, |()| magnitude(picture.rgb.len()));
        }
    }
    format!("{} {said}", magnitude(given))
}

#[test]
fn sessions() {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
    let url = format!("rtsp://{}/", listener.local_addr().expect("its address"));
    let answer = Arc::new(Mutex::new(Vec::new()));
    let given = Arc::clone(&answer);
    std::thread::spawn(move || {
        while let Ok((mut stream, _)) = listener.accept() {
            let _ = stream.read(&mut [0; 4096]);
            let answer = given.lock().expect("nobody panics with it").clone();
            let _ = stream.write_all(&answer);
        }
    });
    let described = format!(
        "RTSP/1.0 200 OK\r\nCSeq: 1\r\nContent-Length: {}\r\n\r\n{DESCRIPTION}",
        DESCRIPTION.len()
    );
    let whole = described
        + "RTSP/1.0 200 OK\r\nCSeq: 2\r\nSession: 7;timeout=9\r\nTransport: interleaved=0-1\r\n\r\n\
           $\0\0\x03abcRTSP/1.0 200 OK\r\nCSeq: 3\r\n\r\n$\0\0\x03abc";
    let target = Target {
        name: "sessions",
        executions: 100,
        corpus: vec![whole.into_bytes(), b"RTSP/1.0 401 X\r\nCSeq: 1\r\nWWW-Authenticate: Digest realm=\"x\", nonce=\"y\"\r\n\r\n".to_vec()],
        tokens: WORDS,
        longest: 1 << 13,
    };
    target.run(|_, input| {
        // A test talks to this machine only.
        for at in 0..input.len().saturating_sub(7) {
            if input[at..at + 8].eq_ignore_ascii_case(b"location") {
                input[at] = b'x';
            }
        }
        *answer.lock().expect("nobody panics with it") = input.to_vec();
        let address = Address::parse(&url).expect("a right address");
        let settings = CameraSettings::new(address, Duration::from_secs(1), Duration::from_secs(2));
        match Source::network(settings).next(&mut Frame::default()) {
            Ok(captured) => format!("{captured:?}"),
            Err(error) => error.to_string(),
        }
    });
}
