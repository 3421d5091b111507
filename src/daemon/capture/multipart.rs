//! Parts of a `multipart/x-mixed-replace` answer, as cameras send them.
//!
//! Owns the format (RFC 2046, section 5.1) with what cameras make of it: boundaries that
//! begin with dashes of their own, lines that end in a bare newline, no line break before a
//! boundary, lengths that are missing or wrong. Bounded in memory whatever comes. Knows no
//! network.
//!
//! ```text
//! --name CRLF  header: value CRLF ...  CRLF  body  CRLF --name CRLF ...
//! ```

use super::MAX_PICTURE_BYTES;
use std::io::Read;

/// Largest headers of one part, bytes.
pub const MAX_HEADERS: usize = 8 << 10;
/// Longest boundary, bytes. RFC 2046 allows 70.
const MAX_BOUNDARY: usize = 200;
/// Bytes that are read at once.
const CHUNK: usize = 64 << 10;

/// Why no further part can be read from a stream.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PartError {
    /// It ended, between two parts or within one.
    #[error("the stream ended")]
    Ended,
    /// It broke off.
    #[error("the stream broke off: {0}")]
    Broken(String),
    /// No boundary within the largest picture.
    #[error("{} bytes without a boundary", MAX_PICTURE_BYTES)]
    NoBoundary,
    /// A part's headers do not end.
    #[error("a part with more than {} bytes of headers", MAX_HEADERS)]
    Headers,
    /// A part that is larger than any picture.
    #[error("a part of {bytes} bytes or more; at most {} are read", MAX_PICTURE_BYTES)]
    TooLarge {
        /// Its size as far as it is known.
        bytes: usize,
    },
}

/// The boundary that a `Content-Type` names, without the dashes in front.
pub fn boundary(content_type: &str) -> Option<&str> {
    let (kind, parameters) = content_type.split_once(';')?;
    if !kind.trim().to_ascii_lowercase().starts_with("multipart/") {
        return None;
    }
    let value = parameters.split(';').find_map(|parameter| {
        let (name, value) = parameter.split_once('=')?;
        name.trim().eq_ignore_ascii_case("boundary").then_some(value)
    })?;
    let name = value.trim().trim_matches('"').trim_start_matches('-');
    (!name.is_empty() && name.len() <= MAX_BOUNDARY).then_some(name)
}

/// Reads part after part.
#[derive(Debug)]
pub struct Parts<R> {
    reader: R,
    marker: Vec<u8>,
    buffer: Vec<u8>,
    /// Where each read ends up first: zeroed once and not before every read.
    chunk: Box<[u8]>,
    /// A boundary may stand at the very front of the buffer.
    may_begin: bool,
}

impl<R: Read> Parts<R> {
    /// The parts of `reader` between boundaries named `name`.
    pub fn new(reader: R, name: &str) -> Self {
        let marker = [b"--", name.as_bytes()].concat();
        let chunk = vec![0; CHUNK].into_boxed_slice();
        Self { reader, marker, buffer: Vec::new(), chunk, may_begin: true }
    }

    /// Puts the next part's body into `part`. A part that is cut off by a boundary is given
    /// as far as it goes.
    ///
    /// # Errors
    /// [`PartError`]: nothing more can be read from this stream.
    pub fn next(&mut self, part: &mut Vec<u8>) -> Result<(), PartError> {
        self.skip_boundary()?;
        let declared = self.read_headers()?;
        let end = match declared {
            Some(bytes) if bytes > MAX_PICTURE_BYTES => return Err(PartError::TooLarge { bytes }),
            Some(bytes) => {
                while self.buffer.len() < bytes {
                    self.fill()?;
                }
                self.find_marker(0, bytes).map_or(bytes, |(start, _)| start)
            }
            None => self.find_end()?,
        };
        part.clear();
        part.extend_from_slice(&self.buffer[..end]);
        self.drop_front(end);
        self.may_begin = true;
        if declared.is_none() {
            let body = part.strip_suffix(b"\n").unwrap_or(part);
            part.truncate(body.strip_suffix(b"\r").unwrap_or(body).len());
        }
        Ok(())
    }

    /// Drops everything up to the end of the next boundary.
    fn skip_boundary(&mut self) -> Result<(), PartError> {
        let mut skipped = 0;
        loop {
            if let Some((_, end)) = self.find_marker(0, self.buffer.len()) {
                let closing = self.buffer[end..].starts_with(b"--");
                self.drop_front(end);
                return if closing { Err(PartError::Ended) } else { Ok(()) };
            }
            // A boundary may be half here, with dashes of its own in front.
            let kept = self.buffer.len().min(self.marker.len() + 16);
            let dropped = self.buffer.len() - kept;
            if dropped > 0 {
                self.drop_front(dropped);
                self.may_begin = false;
            }
            skipped += dropped;
            if skipped > MAX_PICTURE_BYTES {
                return Err(PartError::NoBoundary);
            }
            self.fill()?;
        }
    }

    /// Drops the headers and returns the length that they declare.
    fn read_headers(&mut self) -> Result<Option<usize>, PartError> {
        loop {
            if let Some(end) = end_of_headers(&self.buffer) {
                let declared = content_length(&self.buffer[..end]);
                self.drop_front(end);
                self.may_begin = false;
                return Ok(declared);
            }
            if self.buffer.len() > MAX_HEADERS {
                return Err(PartError::Headers);
            }
            self.fill()?;
        }
    }

    /// Where a body of unknown length ends: at the next boundary.
    fn find_end(&mut self) -> Result<usize, PartError> {
        let mut from = 0;
        loop {
            if let Some((start, _)) = self.find_marker(from, self.buffer.len()) {
                return Ok(start);
            }
            if self.buffer.len() > MAX_PICTURE_BYTES {
                return Err(PartError::TooLarge { bytes: self.buffer.len() });
            }
            from = self.buffer.len().saturating_sub(self.marker.len() + 16);
            self.fill()?;
        }
    }

    /// The first boundary that begins in `from..to`: its first dash, and its end.
    ///
    /// It counts where a line begins, or directly behind a JPEG's end-of-image marker, and
    /// only with a byte behind it that cannot belong to its name.
    fn find_marker(&self, from: usize, to: usize) -> Option<(usize, usize)> {
        let window = self.buffer.get(from..)?;
        let found = window.windows(self.marker.len()).enumerate().find_map(|(offset, bytes)| {
            if bytes != self.marker {
                return None;
            }
            let at = from + offset;
            let end = at + self.marker.len();
            let dashes = self.buffer[..at].iter().rev().take_while(|&&byte| byte == b'-').count();
            let start = at - dashes;
            let before = &self.buffer[..start];
            let begins = match before {
                [] => self.may_begin,
                _ => before.ends_with(b"\n") || before.ends_with(&[0xff, 0xd9]),
            };
            let ends = matches!(self.buffer.get(end)?, b'\r' | b'\n' | b'-' | b' ' | b'\t');
            (begins && ends).then_some((start, end))
        });
        found.filter(|&(start, _)| start < to.max(1))
    }

    fn drop_front(&mut self, bytes: usize) {
        self.buffer.drain(..bytes);
    }

    fn fill(&mut self) -> Result<(), PartError> {
        match self.reader.read(&mut self.chunk) {
            Ok(0) => Err(PartError::Ended),
            Ok(bytes) => {
                self.buffer.extend_from_slice(&self.chunk[..bytes]);
                Ok(())
            }
            Err(error) => Err(PartError::Broken(error.to_string())),
        }
    }
}

/// The index behind the empty line that ends the headers. `buffer` begins with the rest of
/// the boundary's line.
fn end_of_headers(buffer: &[u8]) -> Option<usize> {
    let line_ends = buffer.iter().enumerate().filter(|&(_, &byte)| byte == b'\n');
    line_ends.map(|(at, _)| at + 1).find_map(|next| match buffer.get(next..)? {
        [b'\n', ..] => Some(next + 1),
        [b'\r', b'\n', ..] => Some(next + 2),
        _ => None,
    })
}

fn content_length(headers: &[u8]) -> Option<usize> {
    headers.split(|&byte| byte == b'\n').find_map(|line| {
        let (name, value) = std::str::from_utf8(line).ok()?.split_once(':')?;
        if !name.trim().eq_ignore_ascii_case("content-length") {
            return None;
        }
        value.trim().parse().ok()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A reader that gives `step` bytes at a time.
    struct Drip<'a>(&'a [u8], usize);

    impl Read for Drip<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
            let n = self.1.min(self.0.len()).min(buffer.len());
            buffer[..n].copy_from_slice(&self.0[..n]);
            self.0 = &self.0[n..];
            Ok(n)
        }
    }

    /// All parts of `bytes`, which arrive `step` at a time, and how the stream ends.
    fn parts(bytes: &[u8], name: &str, step: usize) -> (Vec<String>, PartError) {
        let (mut reader, mut part, mut all) =
            (Parts::new(Drip(bytes, step), name), Vec::new(), Vec::new());
        loop {
            match reader.next(&mut part) {
                Ok(()) => all.push(String::from_utf8_lossy(&part).into_owned()),
                Err(error) => return (all, error),
            }
        }
    }

    #[test]
    fn boundaries_as_cameras_name_them() {
        for (content_type, expected) in [
            ("multipart/x-mixed-replace; boundary=frame", Some("frame")),
            ("multipart/x-mixed-replace;boundary=\"frame\"", Some("frame")),
            ("Multipart/X-Mixed-Replace; charset=utf-8; Boundary=--myboundary", Some("myboundary")),
            ("multipart/x-mixed-replace", None),
            ("multipart/x-mixed-replace; boundary=--", None),
            ("image/jpeg; boundary=frame", None),
            ("text/html", None),
        ] {
            assert_eq!(boundary(content_type), expected, "{content_type}");
        }
    }

    #[test]
    fn parts_as_cameras_send_them_however_they_arrive() {
        let expected = ["one", "two--", "three"].map(String::from).to_vec();
        for (form, stream) in [
            (
                "with lengths",
                "--f\r\nContent-Length: 3\r\n\r\none\r\n--f\r\ncontent-length:5\r\n\r\ntwo--\r\n\
                 --f\r\nContent-Length: 3\r\nContent-Length: 5\r\n\r\n",
            ),
            ("without", "--f\r\nA: b\r\n\r\none\r\n--f\r\n\r\ntwo--\r\n--f\r\n\r\nthree\r\n--f--"),
            ("bare newlines", "--f\nA: b\n\none\n--f\n\ntwo--\n--f\n\nthree\n--f--\n"),
            (
                "dashes of their own",
                "----f\r\n\r\none\r\n----f\r\n\r\ntwo--\r\n----f\r\n\r\nthree\r\n----f--",
            ),
            (
                "a preamble",
                "hello --f world\r\n--f \r\n\r\none\r\n--f\r\n\r\ntwo--\r\n--f\r\n\r\nthree\r\n--f--",
            ),
        ] {
            for step in [1, 2, 7, 1000] {
                let (all, error) = parts(stream.as_bytes(), "f", step);
                assert_eq!(error, PartError::Ended, "{form}, {step} at a time");
                if form == "with lengths" {
                    assert_eq!(all, expected[..2], "the third part is cut off, {step} at a time");
                } else {
                    assert_eq!(all, expected, "{form}, {step} at a time");
                }
            }
        }
    }

    #[test]
    fn a_length_that_is_too_long_costs_its_own_part_only() {
        let stream = b"--f\r\nContent-Length: 30\r\n\r\nshort\r\n--f\r\nContent-Length: 5\r\n\r\n\
                       whole\r\n--f\r\nContent-Length: 3\r\n\r\nabcdefg\r\n--f\r\n\r\nlast\r\n--f--";
        let (all, _) = parts(stream, "f", 11);
        assert_eq!(all, ["short\r\n", "whole", "abc", "last"]);
    }

    #[test]
    fn a_boundary_directly_behind_a_picture_counts() {
        let stream = b"--f\r\n\r\n\xff\xd8 -- \xff\xd9--f\r\n\r\nnext\r\n--f--";
        let mut reader = Parts::new(&stream[..], "f");
        let mut part = Vec::new();
        reader.next(&mut part).expect("a part");
        assert_eq!(part, b"\xff\xd8 -- \xff\xd9");
        reader.next(&mut part).expect("a part");
        assert_eq!(part, b"next");
    }

    /// Never ends, and never has a boundary.
    struct Endless(&'static [u8]);

    impl Read for Endless {
        fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
            if self.0.is_empty() {
                buffer.fill(b'-');
                return Ok(buffer.len());
            }
            self.0.read(buffer)
        }
    }

    #[test]
    fn memory_is_bounded_whatever_comes() {
        for (beginning, expected) in [
            ("", PartError::NoBoundary),
            ("--f\r\nX: ", PartError::Headers),
            (
                "--f\r\nContent-Length: 99999999999\r\n\r\n",
                PartError::TooLarge { bytes: 99_999_999_999 },
            ),
        ] {
            let mut reader = Parts::new(Endless(beginning.as_bytes()), "f");
            assert_eq!(reader.next(&mut Vec::new()), Err(expected), "{beginning:?}");
            assert!(reader.buffer.capacity() <= 4 * (MAX_PICTURE_BYTES + CHUNK), "{beginning:?}");
        }
        let mut reader = Parts::new(Endless(b"--f\r\n\r\n"), "f");
        let error = reader.next(&mut Vec::new()).expect_err("no end");
        assert!(
            matches!(error, PartError::TooLarge { bytes } if bytes <= MAX_PICTURE_BYTES + CHUNK)
        );
        assert!(reader.buffer.capacity() <= 4 * (MAX_PICTURE_BYTES + CHUNK));
    }

    #[test]
    fn rubbish_never_panics() {
        let mut rng = fastrand::Rng::with_seed(7);
        let alphabet = b"--f\r\n:\xff\xd9 Content-Length: 3";
        for _ in 0..2000 {
            let bytes: Vec<u8> =
                (0..rng.usize(..200)).map(|_| alphabet[rng.usize(..alphabet.len())]).collect();
            let _ = parts(&bytes, "f", rng.usize(1..9));
        }
    }
}
