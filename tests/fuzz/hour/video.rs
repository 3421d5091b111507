//! The camera that plays video: sessions and packets, right and wrong, with pictures of 4K.

use super::camera::{send, serve};
use super::{SIZE, mutate, rtsp};
use std::io::{BufRead, BufReader};
use std::time::Duration;

/// Words of RTP and of the units of H.264.
const PACKET_WORDS: &[&[u8]] = &[
    b"$\0\0\x0c",
    b"\x67\x64\0",
    b"\x68\xee",
    b"\x65\x88",
    b"\x7c\x85",
    b"\x78\0\x04",
    b"\x80\xe0",
];

/// RTSP: right answers and wrong ones, then video of 4K and small, whole and damaged.
pub fn video() -> String {
    let large = large_picture();
    let recorded = std::fs::read("tests/data/video/high.h264").expect("it ships");
    let small = units(&recorded);
    let port = serve(move |stream, rng| {
        let mut request = BufReader::new(stream.try_clone()?);
        loop {
            let (mut line, mut head) = (String::new(), String::new());
            while line != "\r\n" {
                line.clear();
                if request.read_line(&mut line)? == 0 {
                    return Ok(());
                }
                head += &line;
            }
            let number = head.lines().find_map(|l| l.strip_prefix("CSeq: ")).unwrap_or("0");
            let body = if head.starts_with("DESCRIBE") { rtsp::DESCRIPTION } else { "" };
            let right = format!(
                "RTSP/1.0 200 OK\r\nCSeq: {number}\r\nSession: 7;timeout=9\r\nTransport: \
                 RTP/AVP/TCP;unicast;interleaved=0-1\r\nContent-Length: {}\r\n\r\n{body}",
                body.len()
            );
            let answer = match rng.u8(..10) {
                0 => mutate::mutated(rng, &[right.into_bytes()], rtsp::WORDS, 1 << 16),
                _ => right.into_bytes(),
            };
            send(stream, rng, &answer)?;
            if head.starts_with("PLAY") {
                break;
            }
        }
        for number in 0..rng.u32(1..200) {
            let units = if rng.bool() { &large } else { &small };
            let mut packets = packets(units, number);
            if rng.bool() {
                packets = mutate::mutated(rng, &[packets], PACKET_WORDS, 4 << 20);
            }
            send(stream, rng, &packets)?;
            std::thread::sleep(Duration::from_millis(300));
        }
        Ok(())
    });
    format!("rtsp://127.0.0.1:{port}/video")
}

/// The units of a stream in Annex B's form, to the end of its second picture.
fn units(stream: &[u8]) -> Vec<Vec<u8>> {
    let starts: Vec<_> =
        (0..stream.len() - 3).filter(|&at| stream[at..at + 3] == [0, 0, 1]).collect();
    let unit = |pair: &[usize]| stream[pair[0] + 3..pair[1] - 1].to_vec();
    starts.windows(2).take(6).map(unit).collect()
}

/// Units in packets of a picture (RFC 6184), each behind its channel and length.
fn packets(units: &[Vec<u8>], picture: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut sequence = (picture as u16).wrapping_mul(100);
    for (number, unit) in units.iter().enumerate() {
        let parts: Vec<_> = unit[1..].chunks(1400).collect();
        for (at, part) in parts.iter().enumerate() {
            let last = at + 1 == parts.len();
            let mark = if at == 0 { 0x80 } else { 0 } | if last { 0x40 } else { 0 };
            let head = match parts.len() {
                1 => vec![unit[0]],
                _ => vec![unit[0] & 0xe0 | 28, mark | unit[0] & 31],
            };
            let marker = if last && number + 1 == units.len() { 0x80 } else { 0 };
            bytes.extend(b"$\0");
            bytes.extend(((12 + head.len() + part.len()) as u16).to_be_bytes());
            bytes.extend([0x80, marker | 96]);
            bytes.extend(sequence.to_be_bytes());
            bytes.extend((picture * 18_000).to_be_bytes());
            bytes.extend([0, 0, 0, 1]);
            bytes.extend(head);
            bytes.extend(*part);
            sequence = sequence.wrapping_add(1);
        }
    }
    bytes
}

/// Bits, the highest first.
#[derive(Default)]
struct Bits(Vec<u8>, usize);

impl Bits {
    fn put(&mut self, bits: usize, value: u32) -> &mut Self {
        for bit in (0..bits).rev() {
            if self.1 == 0 {
                self.0.push(0);
            }
            let last = self.0.last_mut().expect("pushed");
            *last |= ((value >> bit & 1) as u8) << (7 - self.1);
            self.1 = (self.1 + 1) % 8;
        }
        self
    }

    /// Exp-Golomb (H.264, section 9.1).
    fn ue(&mut self, value: u32) -> &mut Self {
        let bits = (value + 1).ilog2() as usize;
        self.put(bits, 0).put(bits + 1, value + 1)
    }

    /// The unit: a stop bit, and a 3 wherever zeros would look like a start (section 7.4.1).
    fn unit(&mut self, header: u8) -> Vec<u8> {
        self.put(1, 1);
        let (mut unit, mut zeros) = (vec![header], 0);
        for &byte in &self.0 {
            if zeros == 2 && byte <= 3 {
                unit.push(3);
                zeros = 0;
            }
            zeros = if byte == 0 { zeros + 1 } else { 0 };
            unit.push(byte);
        }
        unit
    }
}

/// A grey picture of [`SIZE`]: parameter sets and one slice of whole macroblocks without residual.
fn large_picture() -> Vec<Vec<u8>> {
    let (across, down) = (SIZE.0 / 16, SIZE.1 / 16);
    // Section 7.3.2.1.1: baseline, level 5.1, one reference, frames only.
    let mut sequence = Bits::default();
    sequence.put(8, 66).put(8, 0).put(8, 51).ue(0).ue(0).ue(0).ue(0).ue(1).put(1, 0);
    sequence.ue(across - 1).ue(down - 1).put(1, 1).put(1, 1).put(1, 0).put(1, 0);
    // Section 7.3.2.2: CAVLC, one slice group, and the deblocking filter can be switched off.
    let mut picture = Bits::default();
    picture.ue(0).ue(0).put(1, 0).put(1, 0).ue(0).ue(0).ue(0).put(1, 0).put(2, 0);
    picture.ue(0).ue(0).ue(0).put(1, 1).put(1, 0).put(1, 0);
    // Section 7.3.3: an IDR picture of one I slice.
    let mut slice = Bits::default();
    slice.ue(0).ue(7).ue(0).put(4, 0).ue(0).put(1, 0).put(1, 0).ue(0).ue(1);
    for _ in 0..across * down {
        // I_16x16 predicted from its mean, chroma likewise, no change of QP, no coefficients.
        slice.ue(3).ue(0).ue(0).ue(0);
    }
    vec![sequence.unit(0x67), picture.unit(0x68), slice.unit(0x65)]
}
