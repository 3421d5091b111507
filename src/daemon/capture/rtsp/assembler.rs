//! From RTP packets to whole pictures of H.264 (RFC 6184) or H.265 (RFC 7798).
//!
//! Owns which packets make a whole picture, and which pictures decode without others. A
//! picture with anything missing is dropped. Does not decode; what differs between the two is
//! their [`Syntax`].

use super::rtp::{Follows, Order, Packet};
use super::{Coding, MAX_UNIT, Unit};
use std::marker::PhantomData;

/// Longest parameter set, bytes, and most of each kind.
const MAX_SET: usize = 4 << 10;
const MAX_SETS: usize = 8;

/// How a codec writes its units.
pub trait Syntax {
    /// Which one it is.
    const CODING: Coding;
    /// Length of a unit's header, bytes.
    const HEADER: usize;
    /// Bits of the first byte that are the unit's type, and how far they are shifted.
    const SHIFT: u32;
    /// See [`Self::SHIFT`].
    const MASK: u8;
    /// Types of packets that hold several units, and a part of one.
    const AGGREGATE: u8;
    /// See [`Self::AGGREGATE`].
    const FRAGMENT: u8;
    /// The type of sequence sets.
    const SEQUENCE_SET: u8;

    /// The class of units of a type.
    fn class(kind: u8) -> Class;
    /// The header of the unit of this type that a fragment with this header is a part of.
    fn whole_header(header: &[u8], kind: u8) -> impl AsRef<[u8]>;
    /// Reads a slice's beginning. `None`: it is not a slice.
    fn slice(kind: u8, rest: &[u8]) -> Option<SliceHead>;
    /// The number of a parameter set. `None`: it is not one.
    fn set_number(unit: &[u8]) -> Option<u32>;
}

/// Classes of units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// A part of a picture.
    Slice,
    /// Parameters of a sequence or of pictures.
    Set,
    /// Delimiters, information, padding.
    Other,
    /// Forms that cameras do not use, and that are not read.
    Unread,
}

/// How a slice begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SliceHead {
    /// It is its picture's first.
    pub first: bool,
    /// It is coded without other pictures.
    pub alone: bool,
}

/// Collects pictures.
#[derive(Debug)]
pub struct Assembler<S> {
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
    /// Packets missing so far, and pictures that were dropped.
    pub lost: u64,
    /// See [`Self::lost`].
    pub refused: u64,
    syntax: PhantomData<S>,
}

impl<S> Default for Assembler<S> {
    fn default() -> Self {
        Self {
            order: Order::default(),
            sets: Vec::new(),
            picture: Vec::new(),
            timestamp: None,
            state: State::default(),
            fragment: None,
            marker_lies: false,
            lost: 0,
            refused: 0,
            syntax: PhantomData,
        }
    }
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

impl<S: Syntax> Assembler<S> {
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
        let Some((header, rest)) = packet.payload.split_at_checked(S::HEADER) else { return false };
        let slice = match kind::<S>(header[0]) {
            kind if kind == S::FRAGMENT => match rest {
                [mark, rest @ ..] if mark & 0x80 != 0 => S::slice(mark & S::MASK, rest),
                _ => None,
            },
            kind if kind == S::AGGREGATE => return rest.len() > 2,
            kind if S::class(kind) == Class::Slice => S::slice(kind, rest),
            _ => return true,
        };
        slice.is_some_and(|slice| slice.first)
    }

    fn carries_slice(&self, packet: &Packet<'_>) -> bool {
        packet
            .payload
            .first()
            .map(|&header| kind::<S>(header))
            .is_some_and(|kind| kind == S::FRAGMENT || S::class(kind) == Class::Slice)
    }

    fn begin(&mut self, timestamp: u32) {
        self.picture.clear();
        // A large picture's buffer is released in time.
        self.picture.shrink_to(MAX_UNIT / 4);
        self.timestamp = Some(timestamp);
        self.state = State { key: true, ..State::default() };
        self.fragment = None;
    }

    /// Hands the picture over where it is whole.
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
        unit.coding = S::CODING;
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
        let Some((header, rest)) = payload.split_at_checked(S::HEADER) else { return };
        // Some cameras put start codes into packets, where none belong.
        if header[0] == 0
            && let Some(at) = payload.windows(3).take(4).position(|bytes| bytes == [0, 0, 1])
        {
            let units = &payload[at + 3..];
            for part in split(units) {
                self.unit(part);
            }
            return;
        }
        let kind = kind::<S>(header[0]);
        if kind == S::AGGREGATE {
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
        } else if kind == S::FRAGMENT {
            self.fragment(header, rest);
        } else {
            self.unit(payload);
        }
    }

    fn fragment(&mut self, header: &[u8], rest: &[u8]) {
        let Some((&mark, data)) = rest.split_first() else { return };
        let (first, last) = (mark & 0x80 != 0, mark & 0x40 != 0);
        match (first, self.fragment) {
            (true, None) => {
                self.fragment = Some(self.picture.len());
                push_unit(&mut self.picture, S::whole_header(header, mark & S::MASK).as_ref());
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
        let Some((header, rest)) = unit.split_at_checked(S::HEADER) else { return };
        let kind = kind::<S>(header[0]);
        match S::class(kind) {
            Class::Set => self.note_set(unit, false),
            Class::Slice => {
                match S::slice(kind, rest) {
                    Some(slice) => self.state.key &= slice.alone,
                    None => self.state.broken = true,
                }
                self.state.slices += 1;
                if self.picture.len() + unit.len() > MAX_UNIT {
                    self.state.broken = true;
                    return;
                }
                push_unit(&mut self.picture, unit);
            }
            Class::Unread => self.state.broken = true,
            Class::Other => {}
        }
    }

    /// Keeps a parameter set. It replaces the one of its number when it has come twice.
    fn note_set(&mut self, unit: &[u8], confirmed: bool) {
        if unit.len() <= S::HEADER || unit.len() > MAX_SET {
            return;
        }
        // What a slice cannot name is of no use.
        let Some(number) = S::set_number(unit) else { return };
        let of = |unit: &[u8]| kind::<S>(unit[0]);
        let kind = of(unit);
        let is_rival = |set: &Set| {
            set.unit != unit && of(&set.unit) == kind && S::set_number(&set.unit) == Some(number)
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
        if self.sets.iter().filter(|set| of(&set.unit) == kind).count() < MAX_SETS {
            self.sets.push(Set { unit: unit.to_vec(), confirmed });
            // Sequence sets first, for picture sets build on them.
            self.sets.sort_by_key(|set| of(&set.unit));
        }
    }

    /// The sequence set of the stream, as it came.
    pub fn sequence_set(&self) -> Option<&[u8]> {
        let is_one = |set: &&Set| kind::<S>(set.unit[0]) == S::SEQUENCE_SET && set.confirmed;
        self.sets.iter().find(is_one).map(|set| set.unit.as_slice())
    }
}

/// A unit's type, by its first byte.
fn kind<S: Syntax>(header: u8) -> u8 {
    header >> S::SHIFT & S::MASK
}

fn push_unit(picture: &mut Vec<u8>, unit: &[u8]) {
    picture.extend_from_slice(&[0, 0, 0, 1]);
    picture.extend_from_slice(unit);
}

/// Units between start codes.
pub fn split(bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
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

/// Unsigned Exp-Golomb numbers (9.1).
pub struct Golomb<'a> {
    bytes: &'a [u8],
    bit: usize,
}

impl<'a> Golomb<'a> {
    /// Reads the bits of these bytes.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, bit: 0 }
    }

    fn one(&mut self) -> Option<u32> {
        let byte = self.bytes.get(self.bit / 8)?;
        let bit = byte >> (7 - self.bit % 8) & 1;
        self.bit += 1;
        Some(u32::from(bit))
    }

    /// The next number.
    pub fn number(&mut self) -> Option<u32> {
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
#[path = "assembler_tests.rs"]
mod tests;
