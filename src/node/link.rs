//! Frames on the serial line: COBS, with a zero before and behind each.
//!
//! | bytes | field |
//! |---|---|
//! | 1 | 0, ends whatever noise came before |
//! | N | the frame, COBS-encoded (Cheshire and Baker, "Consistent Overhead Byte Stuffing", 1999): no zero |
//! | 1 | 0 |
//!
//! A frame is a [`crate::wire`] message as it is, or a request or answer of
//! [`super::protocol`]; their first bytes differ, and each ends in a CRC-32 of its own. Owns
//! delimiting only. Our own code, since it must link without a panic path.

use crate::wire::MAX_DENSITY_MESSAGE;

/// Most bytes of a decoded frame.
pub const MAX_FRAME: usize = MAX_DENSITY_MESSAGE;
/// Most bytes of a frame on the line: one code byte for every 254, one more, two zeros.
pub const MAX_ENCODED: usize = MAX_FRAME + MAX_FRAME / 254 + 1 + 2;

/// Why bytes on the line did not become a frame's content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// A zero came inside a block: bytes are missing.
    Framing,
    /// Longer than [`MAX_FRAME`], or the board could not keep up.
    Overrun,
    /// The content's checksum does not match.
    Checksum,
}

/// Collects bytes into frames.
#[derive(Debug)]
pub struct Receiver {
    buffer: [u8; MAX_FRAME],
    len: usize,
    /// Bytes that the present block still has.
    block_left: u8,
    /// A zero belongs between this block and the next.
    zero_follows: bool,
    /// Bytes have come since the last zero.
    begun: bool,
    /// Bytes are skipped until the next zero.
    skipping: bool,
}

impl Default for Receiver {
    fn default() -> Self {
        Self {
            buffer: [0; MAX_FRAME],
            len: 0,
            block_left: 0,
            zero_follows: false,
            begun: false,
            skipping: false,
        }
    }
}

impl Receiver {
    /// Takes one byte; a zero completes a frame.
    pub fn push(&mut self, byte: u8) -> Option<Result<&[u8], Fault>> {
        if byte == 0 {
            return self.end();
        }
        self.begun = true;
        if self.skipping {
            return None;
        }
        if self.block_left == 0 {
            if self.zero_follows && !self.keep(0) {
                return Some(Err(Fault::Overrun));
            }
            self.block_left = byte - 1;
            self.zero_follows = byte != u8::MAX;
            return None;
        }
        self.block_left -= 1;
        if self.keep(byte) { None } else { Some(Err(Fault::Overrun)) }
    }

    /// Passes over everything up to the next zero.
    pub fn skip(&mut self) {
        self.skipping = true;
    }

    fn end(&mut self) -> Option<Result<&[u8], Fault>> {
        let whole = self.block_left == 0;
        let (begun, skipped, len) = (self.begun, self.skipping, self.len);
        (self.len, self.block_left, self.zero_follows) = (0, 0, false);
        (self.begun, self.skipping) = (false, false);
        if !begun || skipped {
            return None;
        }
        Some(if whole { self.buffer.get(..len).ok_or(Fault::Overrun) } else { Err(Fault::Framing) })
    }

    fn keep(&mut self, byte: u8) -> bool {
        let Some(place) = self.buffer.get_mut(self.len) else {
            self.skipping = true;
            return false;
        };
        *place = byte;
        self.len += 1;
        true
    }
}

/// Writes `content` as one frame for the line and returns its bytes; `None` where `line` is too
/// small ([`MAX_ENCODED`] bytes hold every frame).
pub fn encode<'l>(content: &[u8], line: &'l mut [u8]) -> Option<&'l [u8]> {
    let mut len = 0;
    put(line, &mut len, 0)?;
    let mut rest = content;
    loop {
        let run = rest.iter().take(254).take_while(|&&byte| byte != 0).count();
        let (block, after) = rest.split_at_checked(run)?;
        put(line, &mut len, run as u8 + 1)?;
        for &byte in block {
            put(line, &mut len, byte)?;
        }
        // A full block stands for no zero; any other one for the zero that ended it.
        rest = match after.split_first() {
            None => break,
            Some(_) if run == 254 => after,
            Some((_, behind)) => behind,
        };
        if rest.is_empty() && run != 254 {
            put(line, &mut len, 1)?;
            break;
        }
    }
    put(line, &mut len, 0)?;
    line.get(..len)
}

fn put(line: &mut [u8], len: &mut usize, byte: u8) -> Option<()> {
    *line.get_mut(*len)? = byte;
    *len += 1;
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn round(content: &[u8]) -> Vec<u8> {
        let mut line = [0; MAX_ENCODED];
        let bytes = encode(content, &mut line).expect("it fits");
        assert_eq!(bytes.iter().filter(|&&byte| byte == 0).count(), 2, "zeros only outside");
        let mut receiver = Receiver::default();
        let mut got = None;
        for &byte in bytes {
            if let Some(frame) = receiver.push(byte) {
                assert!(got.is_none());
                got = Some(frame.expect("whole").to_vec());
            }
        }
        got.expect("one frame")
    }

    #[test]
    fn every_length_and_zero_comes_back() {
        for len in (1..600).chain([MAX_FRAME - 1, MAX_FRAME]) {
            for zero_every in [1, 2, 253, 254, 255, 256, usize::MAX] {
                let content: Vec<u8> = (0..len)
                    .map(|at| if (at + 1) % zero_every == 0 { 0 } else { (at % 255) as u8 + 1 })
                    .collect();
                assert_eq!(round(&content), content, "{len} bytes, a zero every {zero_every}");
            }
        }
    }

    #[test]
    fn the_examples_of_the_paper() {
        let mut line = [0; MAX_ENCODED];
        assert_eq!(encode(&[0], &mut line), Some(&[0, 1, 1, 0][..]));
        assert_eq!(
            encode(&[0x11, 0x22, 0, 0x33], &mut line),
            Some(&[0, 3, 0x11, 0x22, 2, 0x33, 0][..])
        );
        assert_eq!(encode(&[0x11, 0, 0, 0], &mut line), Some(&[0, 2, 0x11, 1, 1, 1, 0][..]));
    }

    #[test]
    fn a_cut_frame_and_a_long_one_are_faults_and_the_next_is_whole() {
        let mut receiver = Receiver::default();
        let mut line = [0; MAX_ENCODED];
        let whole = encode(&[7, 0, 8], &mut line).expect("it fits").to_vec();
        let mut faults = Vec::new();
        let mut frames = Vec::new();
        let long = [1u8; 3].iter().chain(&[255u8; 3000]).chain(&[0]).copied();
        for byte in [5, 1, 2, 0].into_iter().chain(long).chain(whole) {
            match receiver.push(byte) {
                Some(Ok(frame)) => frames.push(frame.to_vec()),
                Some(Err(fault)) => faults.push(fault),
                None => {}
            }
        }
        assert_eq!(faults, [Fault::Framing, Fault::Overrun]);
        assert_eq!(frames, [[7, 0, 8]]);
    }
}
