//! Streams of pictures as cameras send them, in pieces as a network gives them.

use super::runner::Target;
use super::{common, magnitude};
use verge::daemon::capture::decode;
use verge::daemon::capture::picture::scan::Pictures;
use verge::daemon::frame::Picture;

/// Streams of cameras: with and without lengths, with dashes of their own.
fn begin_with() -> Vec<Vec<u8>> {
    let picture = common::jpeg(16, 8, 90);
    let stream = |part: &str, end: &str| {
        let parts = [part.as_bytes(), &picture, end.as_bytes()].concat();
        [&parts[..], &parts, &parts, b"--b--\r\n"].concat()
    };
    let length = picture.len();
    vec![
        stream(
            &format!("--b\r\nContent-Type: image/jpeg\r\nContent-Length: {length}\r\n\r\n"),
            "\r\n",
        ),
        stream("--b\r\nContent-Type: image/jpeg\r\n\r\n", "\r\n"),
        stream("----b\nContent-type: image/jpeg\n\n", "\n"),
        stream(&format!("\r\n--b\r\nContent-Length: {}\r\n\r\n", length + 9), ""),
    ]
}

/// Bytes as a network gives them: in pieces.
struct Pieces<'a> {
    bytes: &'a [u8],
    piece: usize,
}

impl std::io::Read for Pieces<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let len = self.piece.min(self.bytes.len()).min(buffer.len());
        let (now, later) = self.bytes.split_at(len);
        buffer[..len].copy_from_slice(now);
        self.bytes = later;
        Ok(len)
    }
}

#[test]
fn streams_of_pictures() {
    let target = Target {
        name: "streams",
        executions: 20_000,
        corpus: begin_with(),
        tokens: &[
            b"--b",
            b"\r\n--b\r\n",
            b"--b--",
            b"\r\n\r\n",
            b"\n\n",
            b"Content-Length: 0\r\n",
            b"Content-Length: 8388609\r\n",
            b"Content-Length: 18446744073709551616\r\n",
            b"Content-Length: -1\r\n",
            b": ",
            b"\0",
            b"\xff\xd8\xff",
            b"\xff\xd9",
            b"\xff\xda",
            b"\xff\xe1\0\x10",
            b"\x89PNG\r\n\x1a\n",
            b"\0\0\0\0IEND",
        ],
        longest: 1 << 14,
    };
    target.run(|rng, input| {
        let piece = [1, 7, 100, 1 << 16][rng.usize(..4)];
        let mut parts = Pictures::new(Pieces { bytes: input, piece });
        let (mut part, mut picture) = (Vec::new(), Picture::default());
        let (mut given, mut right) = (0, 0);
        let error = loop {
            match parts.next(&mut part) {
                Ok(()) => given += 1,
                Err(error) => break error,
            }
            assert!(given <= input.len(), "parts out of nothing");
            right += usize::from(decode(&part, &mut picture).is_ok());
        };
        format!("{error} {} {}", magnitude(given), magnitude(right))
    });
}
