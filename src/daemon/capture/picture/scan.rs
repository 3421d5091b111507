//! Finds the pictures in a stream of bytes.
//!
//! Owns how a stream is read: by the pictures in it, and by nothing that stands around them.
//! `multipart/x-mixed-replace` (RFC 2046, section 5.1) promises a delimiter and lengths, and
//! cameras send other delimiters than they announce, none at all, lengths that are wrong, other
//! parts first, or pictures one behind the other. A picture tells by itself where it ends. That
//! is why this is ours: a library for multipart trusts what cameras get wrong. Bounded in memory
//! whatever comes, and each byte is looked at once. Knows no network.

use super::jpeg::{End, EndFinder};
use super::kind::{self, Kind, PNG};
use crate::daemon::capture::MAX_PICTURE_BYTES;
use std::io::Read;

/// Bytes that are read at once.
const CHUNK: usize = 32 << 10;
/// Bytes in front of the first picture that are kept, to say what came.
const MAX_PREAMBLE: usize = 2 << 10;

/// Why no further picture can be read from a stream.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StreamError {
    /// It ended, before the first picture.
    #[error("the stream ended without a picture: {0}")]
    Nothing(String),
    /// It ended behind pictures.
    #[error("the stream ended")]
    Ended,
    /// It broke off.
    #[error("the stream broke off: {0}")]
    Broken(String),
    /// No picture within the largest one's bytes.
    #[error("{MAX_PICTURE_BYTES} bytes without a picture: {0}")]
    NoPicture(String),
    /// A picture that is larger than any camera's.
    #[error("a picture of more than {MAX_PICTURE_BYTES} bytes")]
    TooLarge,
}

/// Reads picture after picture.
#[derive(Debug)]
pub struct Pictures<R> {
    reader: R,
    buffer: Vec<u8>,
    /// Start of the part of the buffer that is still to be searched.
    start: usize,
    /// Where each read ends up first: zeroed once and not before every read.
    chunk: Box<[u8]>,
    /// The first bytes that are not a picture.
    preamble: Vec<u8>,
    passed: usize,
    found: u64,
}

impl<R: Read> Pictures<R> {
    /// The pictures of `reader`.
    pub fn new(reader: R) -> Self {
        let chunk = vec![0; CHUNK].into_boxed_slice();
        Self {
            reader,
            buffer: Vec::new(),
            start: 0,
            chunk,
            preamble: Vec::new(),
            passed: 0,
            found: 0,
        }
    }

    /// How many pictures were found.
    pub fn found(&self) -> u64 {
        self.found
    }

    /// Puts the next picture into `picture`. One that breaks off where another begins is given
    /// as far as it goes.
    ///
    /// # Errors
    /// [`StreamError`]: nothing more can be read from this stream.
    pub fn next(&mut self, picture: &mut Vec<u8>) -> Result<(), StreamError> {
        let kind = self.find_start()?;
        let mut finder = EndFinder::default();
        let mut chunk_at = PNG.len();
        let end = loop {
            let bytes = &self.buffer[self.start..];
            let end = match kind {
                Kind::Jpeg => finder.find(bytes),
                Kind::Png => png_end(bytes, &mut chunk_at),
            };
            match end {
                // At least its beginning: what comes behind it may be another's.
                End::At(end) | End::Broken(end) => break end.max(3),
                End::Later if bytes.len() > MAX_PICTURE_BYTES => return Err(StreamError::TooLarge),
                End::Later => self.fill()?,
            }
        };
        picture.clear();
        picture.extend_from_slice(&self.buffer[self.start..self.start + end]);
        self.start += end;
        self.passed = 0;
        self.found += 1;
        Ok(())
    }

    /// Skips what is not a picture.
    fn find_start(&mut self) -> Result<Kind, StreamError> {
        loop {
            let bytes = &self.buffer[self.start..];
            let candidate = |&(at, &byte): &(usize, &u8)| {
                (byte == 0xff || byte == PNG[0]) && Kind::of(&bytes[at..]).is_some()
            };
            let found = bytes.iter().enumerate().find(candidate).map(|(at, _)| at);
            // A beginning may be half here.
            let skip = found.unwrap_or(bytes.len().saturating_sub(PNG.len() - 1));
            let room = MAX_PREAMBLE.saturating_sub(self.preamble.len()).min(skip);
            if self.found == 0 {
                self.preamble.extend_from_slice(&bytes[..room]);
            }
            let kind = Kind::of(&bytes[skip..]);
            self.passed += skip;
            self.start += skip;
            match (found, kind) {
                (Some(_), Some(kind)) => return Ok(kind),
                _ if self.passed > MAX_PICTURE_BYTES => {
                    return Err(StreamError::NoPicture(self.described()));
                }
                _ => self.fill()?,
            }
        }
    }

    /// Words for the bytes that came in place of pictures.
    fn described(&self) -> String {
        let mut bytes = self.preamble.clone();
        if self.found == 0 {
            bytes.extend_from_slice(
                &self.buffer[self.start..self.buffer.len().min(self.start + 16)],
            );
        }
        // A part's own headers do not say what it is.
        if kind::is_multipart(&bytes) {
            return match crate::daemon::capture::network::head::end(&bytes) {
                Some((_, body)) if body < bytes.len() => {
                    format!("its first part is {}", kind::described(&bytes[body..]))
                }
                _ => "parts without a body".to_owned(),
            };
        }
        kind::described(&bytes)
    }

    fn fill(&mut self) -> Result<(), StreamError> {
        if self.start > CHUNK && self.start >= self.buffer.len() / 2 {
            self.buffer.drain(..self.start);
            self.start = 0;
        }
        match self.reader.read(&mut self.chunk) {
            Ok(0) if self.found == 0 => Err(StreamError::Nothing(self.described())),
            Ok(0) => Err(StreamError::Ended),
            Ok(bytes) => {
                self.buffer.extend_from_slice(&self.chunk[..bytes]);
                Ok(())
            }
            Err(error) => Err(StreamError::Broken(error.to_string())),
        }
    }
}

/// Where a PNG ends, as far as its bytes have arrived. `at` is where its next chunk begins.
fn png_end(bytes: &[u8], at: &mut usize) -> End {
    loop {
        let Some(head) = bytes.get(*at..*at + 8) else { return End::Later };
        let length = u32::from_be_bytes([head[0], head[1], head[2], head[3]]) as usize;
        let name = &head[4..];
        if !name.iter().all(u8::is_ascii_alphabetic) {
            return End::Broken(*at);
        }
        let end = at.saturating_add(length).saturating_add(12);
        if name == b"IEND" {
            return if end <= bytes.len() { End::At(end) } else { End::Later };
        }
        if length > MAX_PICTURE_BYTES {
            return End::Broken(*at);
        }
        *at = end;
    }
}

/// Whether `bytes` hold a whole picture at their front.
pub fn is_whole(bytes: &[u8]) -> bool {
    let bytes = kind::trimmed(bytes);
    match Kind::of(bytes) {
        Some(Kind::Jpeg) => matches!(EndFinder::default().find(bytes), End::At(_)),
        Some(Kind::Png) => matches!(png_end(bytes, &mut PNG.len().clone()), End::At(_)),
        None => false,
    }
}

#[cfg(test)]
#[path = "scan_tests.rs"]
mod tests;
