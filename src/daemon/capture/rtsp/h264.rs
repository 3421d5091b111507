//! From RTP packets to H.264 pictures (RFC 6184): single units, STAP-A and FU-A.
//!
//! Owns which packets make a whole picture, and which pictures decode without others. A picture
//! with anything missing is dropped. Does not decode.

use super::rtp::{Follows, Order, Packet};
use super::{MAX_UNIT, Unit};

/// Longest parameter set, bytes, and most of each kind.
const MAX_SET: usize = 4 << 10;
const MAX_SETS: usize = 8;

const SLICE: u8 = 1;
const SLICE_IDR: u8 = 5;
const SEQUENCE_SET: u8 = 7;
const PICTURE_SET: u8 = 8;
const AGGREGATE: u8 = 24;
const FRAGMENT: u8 = 28;

/// Collects pictures.
#[derive(Debug, Default)]
pub struct Assembler {
    order: Order,
    sets: Vec<Set>,
    picture: Vec<u8>,
    timestamp: Option<u32>,
    /// State of the picture that is being collected.
    state: State,
    /// A fragmented unit is being collected, and began here.
    fragment: Option<usize>,
    /// The marker bit comes with other packets than a picture's last.
    marker_lies: bool,
    /// Packets missing so far, and pictures that were not given on.
    pub lost: u64,
    /// See [`Self::lost`].
    pub refused: u64,
}

#[derive(Clone, Copy, Debug, Default)]
struct State {
    slices: u32,
    /// All of its slices are coded by themselves.
    key: bool,
    broken: bool,
    ended: bool,
}

#[derive(Clone, Debug)]
struct Set {
    unit: Vec<u8>,
    /// Came in the description, or came twice: one that comes once may be damaged.
    confirmed: bool,
}

impl Assembler {
    /// For a stream whose description brings these parameter sets.
    pub fn new(sets: &[Vec<u8>]) -> Self {
        let mut assembler = Self::default();
        for set in sets {
            assembler.note_set(set, true);
        }
        assembler
    }

    /// Takes a packet. A picture that it completes, or that ended before it, is put into `unit`.
    pub fn push(&mut self, packet: &Packet<'_>, unit: &mut Unit) -> bool {
        let mut missing = false;
        if let Follows::Gap(packets) = self.order.follows(packet.sequence) {
            self.lost += u64::from(packets);
            missing = true;
            self.state.broken = true;
            self.fragment = None;
        }
        let mut given = false;
        if self.timestamp != Some(packet.timestamp) {
            given = self.finish(unit);
            let broken = self.state.broken && self.timestamp.is_some();
            self.begin(packet.timestamp);
            // Packets that are missing in front of this one may be its picture's.
            self.state.broken = broken && !self.starts_clean(packet);
        } else if self.state.ended && self.starts_clean(packet) {
            // The next picture, of a camera whose clock stands still.
            let broken = self.state.broken && missing;
            self.begin(packet.timestamp);
            self.state.broken = broken;
        } else if self.state.ended && self.carries_slice(packet) {
            // More of a picture that the marker had ended: its mark is not to be trusted.
            self.marker_lies = true;
            self.state.broken = true;
        }
        self.payload(packet.payload);
        if packet.marker && !self.marker_lies && self.state.slices > 0 && !given {
            self.state.ended = true;
            given = self.finish(unit);
        }
        given
    }

    /// Whether a picture that begins with this packet has nothing missing in front: parameter
    /// sets and the first slice come first.
    fn starts_clean(&self, packet: &Packet<'_>) -> bool {
        let first = match packet.payload {
            [header, kind, rest @ ..] if header & 31 == FRAGMENT && kind & 0x80 != 0 => {
                slice_head(kind & 31, rest)
            }
            [header, ..] if header & 31 == FRAGMENT => None,
            [header, rest @ ..] if matches!(header & 31, SLICE | SLICE_IDR) => {
                slice_head(header & 31, rest)
            }
            [header, ..] => return header & 31 != AGGREGATE || packet.payload.len() > 3,
            [] => None,
        };
        first.is_some_and(|(first_block, _)| first_block == 0)
    }

    fn carries_slice(&self, packet: &Packet<'_>) -> bool {
        matches!(packet.payload, [header, ..] if matches!(header & 31, SLICE | SLICE_IDR | FRAGMENT))
    }

    fn begin(&mut self, timestamp: u32) {
        self.picture.clear();
        // A large picture's buffer is released in time.
        self.picture.shrink_to(MAX_UNIT / 4);
        self.timestamp = Some(timestamp);
        self.state = State { key: true, ..State::default() };
        self.fragment = None;
    }

    /// Hands the picture over, where it is whole and decodes without others.
    fn finish(&mut self, unit: &mut Unit) -> bool {
        let State { slices, key, broken, .. } = self.state;
        if self.timestamp.is_none() || slices == 0 {
            return false;
        }
        self.state.slices = 0;
        if broken || self.fragment.is_some() {
            self.refused += 1;
            return false;
        }
        unit.jpeg = false;
        unit.key = key;
        unit.bytes.clear();
        let confirmed = self.sets.iter().filter(|set| set.confirmed);
        for set in confirmed {
            push_unit(&mut unit.bytes, &set.unit);
        }
        unit.bytes.extend_from_slice(&self.picture);
        self.picture.clear();
        true
    }

    fn payload(&mut self, payload: &[u8]) {
        let Some((&header, rest)) = payload.split_first() else { return };
        // Some cameras put start codes into packets, where none belong.
        if header == 0
            && let Some(at) = payload.windows(3).take(4).position(|bytes| bytes == [0, 0, 1])
        {
            let units = &payload[at + 3..];
            for part in split(units) {
                self.unit(part);
            }
            return;
        }
        match header & 31 {
            AGGREGATE => {
                let mut rest = rest;
                while let Some((&[high, low], tail)) = rest.split_first_chunk::<2>() {
                    let length = usize::from(u16::from_be_bytes([high, low]));
                    let Some((part, tail)) = tail.split_at_checked(length) else {
                        self.state.broken = true;
                        return;
                    };
                    self.unit(part);
                    rest = tail;
                }
            }
            FRAGMENT => self.fragment(header, rest),
            1..=23 => self.unit(payload),
            // Interleaved modes, which cameras do not use.
            _ => self.state.broken = true,
        }
    }

    fn fragment(&mut self, header: u8, rest: &[u8]) {
        let Some((&kind, data)) = rest.split_first() else { return };
        let (first, last) = (kind & 0x80 != 0, kind & 0x40 != 0);
        match (first, self.fragment) {
            (true, None) => {
                self.fragment = Some(self.picture.len());
                push_unit(&mut self.picture, &[header & 0xe0 | kind & 31]);
            }
            (false, Some(_)) => {}
            // A beginning within another, or a middle without one.
            _ => {
                self.state.broken = true;
                self.fragment = None;
                return;
            }
        }
        self.picture.extend_from_slice(data);
        if self.picture.len() > MAX_UNIT {
            self.state.broken = true;
            self.fragment = None;
            self.picture = Vec::new();
            return;
        }
        if last && let Some(at) = self.fragment.take() {
            // Behind its start code. A unit that is not a slice is handled by its type.
            let whole = self.picture.split_off(at);
            self.unit(&whole[4..]);
        }
    }

    /// Takes a whole unit.
    fn unit(&mut self, unit: &[u8]) {
        let Some((&header, rest)) = unit.split_first() else { return };
        match header & 31 {
            SEQUENCE_SET | PICTURE_SET => self.note_set(unit, false),
            kind @ (SLICE | SLICE_IDR) => {
                match slice_head(kind, rest) {
                    Some((_, coded_alone)) => self.state.key &= coded_alone,
                    None => self.state.broken = true,
                }
                self.state.slices += 1;
                if self.picture.len() + unit.len() > MAX_UNIT {
                    self.state.broken = true;
                    return;
                }
                push_unit(&mut self.picture, unit);
            }
            // Data partitions, which need all three.
            2..=4 => self.state.broken = true,
            // Delimiters, information, padding.
            _ => {}
        }
    }

    /// Keeps a parameter set. It replaces the one of its number when it has come twice.
    fn note_set(&mut self, unit: &[u8], confirmed: bool) {
        if unit.len() < 2 || unit.len() > MAX_SET {
            return;
        }
        let (kind, number) = (unit[0] & 31, set_number(unit));
        let is_rival = |set: &Set| {
            set.unit != unit && set.unit[0] & 31 == kind && set_number(&set.unit) == number
        };
        if let Some(known) = self.sets.iter_mut().find(|known| known.unit == unit) {
            // Again the old one: what came in between was damaged. Twice the new one: it counts.
            known.confirmed = true;
            self.sets.retain(|set| !is_rival(set));
            return;
        }
        // The first of its kind has nothing to differ from.
        let confirmed = confirmed || !self.sets.iter().any(is_rival);
        self.sets.retain(|set| set.confirmed || !is_rival(set));
        if self.sets.iter().filter(|set| set.unit[0] & 31 == kind).count() < MAX_SETS {
            self.sets.push(Set { unit: unit.to_vec(), confirmed });
            // Sequence sets first, for picture sets build on them.
            self.sets.sort_by_key(|set| set.unit[0] & 31);
        }
    }

    /// The sequence set of the stream, as it came.
    pub fn sequence_set(&self) -> Option<&[u8]> {
        let set = self.sets.iter().find(|set| set.unit[0] & 31 == SEQUENCE_SET && set.confirmed)?;
        Some(&set.unit)
    }
}

fn push_unit(picture: &mut Vec<u8>, unit: &[u8]) {
    picture.extend_from_slice(&[0, 0, 0, 1]);
    picture.extend_from_slice(unit);
}

/// Units between start codes.
fn split(bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    let mut rest = Some(bytes);
    std::iter::from_fn(move || {
        let bytes = rest?;
        match bytes.windows(3).position(|window| window == [0, 0, 1]) {
            Some(at) => {
                rest = Some(&bytes[at + 3..]);
                Some(bytes[..at].strip_suffix(&[0]).unwrap_or(&bytes[..at]))
            }
            None => {
                rest = None;
                Some(bytes)
            }
        }
    })
}

/// The number of a parameter set, which its kind's first fields give.
fn set_number(unit: &[u8]) -> Option<u32> {
    let skip = if unit[0] & 31 == SEQUENCE_SET { 4 } else { 1 };
    Golomb::new(unit.get(skip..)?).next()
}

/// The first macroblock of a slice, and whether it is coded without other pictures (7.3.3).
fn slice_head(kind: u8, rest: &[u8]) -> Option<(u32, bool)> {
    let mut head = Golomb::new(&rest[..rest.len().min(16)]);
    let first = head.next()?;
    let slice_type = head.next().filter(|&slice_type| slice_type <= 9)?;
    let coded_alone = slice_type % 5 == 2;
    // An IDR picture has no others to be coded from.
    (coded_alone || kind != SLICE_IDR).then_some((first, coded_alone))
}

/// Unsigned Exp-Golomb numbers (9.1).
struct Golomb<'a> {
    bytes: &'a [u8],
    bit: usize,
}

impl<'a> Golomb<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, bit: 0 }
    }

    fn one(&mut self) -> Option<u32> {
        let byte = self.bytes.get(self.bit / 8)?;
        let bit = byte >> (7 - self.bit % 8) & 1;
        self.bit += 1;
        Some(u32::from(bit))
    }

    fn next(&mut self) -> Option<u32> {
        let mut zeros = 0;
        while self.one()? == 0 {
            zeros += 1;
            if zeros > 31 {
                return None;
            }
        }
        let mut value = 1_u32;
        for _ in 0..zeros {
            value = value << 1 | self.one()?;
        }
        Some(value - 1)
    }
}

#[cfg(test)]
#[path = "h264_tests.rs"]
mod tests;
