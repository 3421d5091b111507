//! The format of a segment: the spool's files, byte by byte.
//!
//! Owns writing and scanning bytes; `segment` has the files.
//!
//! A segment begins with `VSP` and the format version, 1. Records follow each other; behind
//! the last of them the file is zero.
//!
//! | offset | bytes | field |
//! |---|---|---|
//! | 0 | 2 | `VR`, by which a reader finds its way behind a damaged record |
//! | 2 | 1 | kind: 1 window, 2 acknowledged, 3 checkpoint |
//! | 3 | 2 | length L of the body, little-endian |
//! | 5 | L | body |
//! | 5+L | 4 | CRC-32 (ISO-HDLC) of kind, length and body, little-endian |
//!
//! | kind | body |
//! |---|---|
//! | window | key (u64, little-endian), then the message as [`crate::wire`] writes it |
//! | acknowledged | keys (u64 each) that the broker has taken |
//! | checkpoint | next key (u64), then pairs of window length in s (u32) and last `seq` (u64) |

use crate::wire::{self, DensityMessage, MAX_MESSAGE};
use crc::{CRC_32_ISO_HDLC, Crc};

/// First bytes of a segment: name and format version.
pub(super) const HEAD: [u8; 4] = *b"VSP\x01";
/// Most keys in one record of acknowledgements.
pub(super) const MAX_KEYS: usize = 128;
/// Least bytes of a window's record: its key, a site of one byte, and no lanes. What was damaged
/// held at most as many windows as would fit.
pub(super) const MIN_WINDOW: usize = 64;
/// Most bytes of a body: a key with the largest message.
const MAX_BODY: usize = 8 + MAX_MESSAGE;
/// Bytes around a body.
const FRAME: usize = 9;
/// Most bytes of a record.
pub(super) const MAX_RECORD: usize = MAX_BODY + FRAME;

const SYNC: [u8; 2] = *b"VR";
const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Content of a record.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Record {
    /// A window that was accepted.
    Window { key: u64, message: Box<DensityMessage> },
    /// Windows that the broker has taken.
    Acknowledged(Vec<u64>),
    /// The numbers to go on with, at the head of each segment.
    Checkpoint(Checkpoint),
}

/// The numbers to go on with.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Checkpoint {
    /// The key of the next window.
    pub next_key: u64,
    /// The last `seq` of each window length, s.
    pub last_seq: Vec<(u32, u64)>,
}

/// Keys and numbers stay below it: readers of JSON hold larger ones as other numbers, and a box that
/// closes a window each second gets there in 285 million years.
const MAX_NUMBER: u64 = 1 << 53;

impl Record {
    /// Appends the record's bytes to `out`; `None` for a message that cannot be written.
    pub(super) fn write(&self, out: &mut Vec<u8>) -> Option<()> {
        let start = out.len();
        out.extend_from_slice(&SYNC);
        out.extend_from_slice(&[self.kind(), 0, 0]);
        match self {
            Self::Window { key, message } => {
                out.extend_from_slice(&key.to_le_bytes());
                let mut buffer = [0; MAX_MESSAGE];
                out.extend_from_slice(wire::encode(message, &mut buffer).ok()?);
            }
            Self::Acknowledged(keys) => {
                keys.iter().for_each(|key| out.extend_from_slice(&key.to_le_bytes()));
            }
            Self::Checkpoint(checkpoint) => {
                out.extend_from_slice(&checkpoint.next_key.to_le_bytes());
                for (length_s, seq) in &checkpoint.last_seq {
                    out.extend_from_slice(&length_s.to_le_bytes());
                    out.extend_from_slice(&seq.to_le_bytes());
                }
            }
        }
        let body = out.len() - start - 5;
        let len = u16::try_from(body).ok().filter(|_| body <= MAX_BODY)?;
        out[start + 3..start + 5].copy_from_slice(&len.to_le_bytes());
        let crc = CRC.checksum(&out[start + 2..]);
        out.extend_from_slice(&crc.to_le_bytes());
        Some(())
    }

    const fn kind(&self) -> u8 {
        match self {
            Self::Window { .. } => 1,
            Self::Acknowledged(_) => 2,
            Self::Checkpoint(_) => 3,
        }
    }

    /// The record at the beginning of `bytes` and its length; `None` where there is none.
    pub(super) fn read(bytes: &[u8]) -> Option<(Self, usize)> {
        let head = bytes.first_chunk::<5>().filter(|head| head.starts_with(&SYNC))?;
        let len = usize::from(u16::from_le_bytes([head[3], head[4]]));
        let whole = bytes.get(..len.checked_add(FRAME)?).filter(|_| len <= MAX_BODY)?;
        let (checked, crc) = whole.get(2..)?.split_last_chunk::<4>()?;
        if CRC.checksum(checked) != u32::from_le_bytes(*crc) {
            return None;
        }
        let body = &checked[3..];
        let record = match head[2] {
            1 => {
                let (key, message) = body.split_first_chunk::<8>()?;
                let message = Box::new(wire::decode(message).ok()?);
                Self::Window { key: u64::from_le_bytes(*key), message }
            }
            2 => Self::Acknowledged(keys(body)?),
            3 => {
                let (next_key, rest) = body.split_first_chunk::<8>()?;
                let pairs = rest.chunks_exact(12);
                if !pairs.remainder().is_empty() {
                    return None;
                }
                let pair = |pair: &[u8]| {
                    let (length_s, seq) = pair.split_first_chunk::<4>()?;
                    let seq = u64::from_le_bytes(*seq.first_chunk::<8>()?);
                    Some((u32::from_le_bytes(*length_s), seq))
                };
                let last_seq = pairs.map(pair).collect::<Option<_>>()?;
                let next_key = u64::from_le_bytes(*next_key);
                Self::Checkpoint(Checkpoint { next_key, last_seq })
            }
            _ => return None,
        };
        record.has_possible_numbers().then_some((record, len + FRAME))
    }

    /// Whether this program can have written its numbers: counting on from them comes to no end.
    fn has_possible_numbers(&self) -> bool {
        let is_possible = |number: u64| number < MAX_NUMBER;
        match self {
            Self::Window { key, message } => is_possible(*key) && is_possible(message.seq),
            Self::Acknowledged(_) => true,
            Self::Checkpoint(Checkpoint { next_key, last_seq }) => {
                is_possible(*next_key) && last_seq.iter().all(|&(_, seq)| is_possible(seq))
            }
        }
    }
}

fn keys(body: &[u8]) -> Option<Vec<u64>> {
    let keys = body.chunks_exact(8);
    if !keys.remainder().is_empty() {
        return None;
    }
    keys.map(|key| Some(u64::from_le_bytes(*key.first_chunk()?))).collect()
}

/// Result of a segment's scan.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Scan {
    /// Offset and content of each good record.
    pub records: Vec<(usize, Record)>,
    /// Where the next record goes.
    pub end: usize,
    /// Stretches of damage with good records behind them.
    pub damaged: u64,
    /// How many bytes those stretches have, and where the last of them ends.
    pub damaged_bytes: usize,
    /// See [`Self::damaged_bytes`].
    pub damaged_until: usize,
    /// Bytes behind the end, up to the last that is not zero: a record that was not written to
    /// its end, or damage.
    pub tail: usize,
}

impl Scan {
    /// Whether bytes stand behind the end.
    pub(super) const fn is_torn(&self) -> bool {
        self.tail > 0
    }

    /// Whether what stands behind the end can be no more than one append that was cut short.
    pub(super) fn is_cut_append(&self) -> bool {
        !self.records.is_empty() && self.tail <= MAX_RECORD + FRAME + 8 * MAX_KEYS
    }
}

/// Reads all good records of a segment, whatever its bytes are.
pub(super) fn scan(bytes: &[u8]) -> Scan {
    let mut scan = Scan { end: HEAD.len().min(bytes.len()), ..Scan::default() };
    let mut at = scan.end;
    loop {
        if let Some((record, len)) = bytes.get(at..).and_then(Record::read) {
            scan.records.push((at, record));
            at += len;
            scan.end = at;
            continue;
        }
        let rest = bytes.get(at..).unwrap_or_default();
        let Some(last) = rest.iter().rposition(|&byte| byte != 0) else { return scan };
        let next = (1..=last).find(|&skip| Record::read(&rest[skip..]).is_some());
        let Some(skip) = next else {
            scan.tail = last + 1;
            return scan;
        };
        scan.damaged += 1;
        scan.damaged_bytes += skip;
        at += skip;
        scan.damaged_until = at;
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::density::WindowReport;
    use crate::lane::Name;
    use crate::units::UtcMs;
    use crate::wire::{CalibrationRef, ModelRef};

    pub(in super::super) fn message(length_s: i64, seq: u64) -> DensityMessage {
        let name = |text| Name::try_from(text).expect("short");
        let lanes = heapless::Vec::new();
        DensityMessage {
            site: name("k1"),
            seq,
            clock_synced: true,
            report: WindowReport { from: UtcMs(0), to: UtcMs(length_s * 1000), lanes },
            calibration: CalibrationRef { id: name("c"), sha256: [1; 32], rel_err: None },
            model: ModelRef { name: name("m"), sha256: [2; 32] },
        }
    }

    /// A segment with one window, whose message stands there in these bytes.
    pub(in super::super) fn segment_of(key: u64, message: &[u8]) -> Vec<u8> {
        let body = [&key.to_le_bytes(), message].concat();
        let len = u16::try_from(body.len()).expect("short").to_le_bytes();
        let checked = [&[1][..], &len, &body].concat();
        let crc = CRC.checksum(&checked).to_le_bytes();
        [&HEAD[..], &SYNC, &checked, &crc].concat()
    }

    fn records() -> Vec<Record> {
        vec![
            Record::Checkpoint(Checkpoint { next_key: 7, last_seq: vec![(60, 3), (900, 1)] }),
            Record::Window { key: 7, message: Box::new(message(60, 4)) },
            Record::Acknowledged(vec![5, 7]),
            Record::Window { key: 8, message: Box::new(message(60, 5)) },
        ]
    }

    /// The records of [`records`] as a segment, with where each begins.
    fn segment() -> (Vec<u8>, Vec<usize>) {
        let (mut bytes, mut starts) = (HEAD.to_vec(), Vec::new());
        for record in records() {
            starts.push(bytes.len());
            record.write(&mut bytes).expect("it fits");
        }
        starts.push(bytes.len());
        (bytes, starts)
    }

    #[test]
    fn golden_bytes() {
        let mut bytes = Vec::new();
        Record::Acknowledged(vec![258]).write(&mut bytes).expect("it fits");
        let golden = [b'V', b'R', 2, 8, 0, 2, 1, 0, 0, 0, 0, 0, 0];
        assert_eq!(bytes[..13], golden);
        assert_eq!(bytes[13..], CRC.checksum(&golden[2..]).to_le_bytes());
    }

    #[test]
    fn what_is_written_is_read() {
        let (mut bytes, starts) = segment();
        bytes.resize(bytes.len() + 100, 0);
        let scan = scan(&bytes);
        let expected: Vec<_> = starts.iter().copied().zip(records()).collect();
        assert_eq!(scan.records, expected);
        assert_eq!((scan.end, scan.damaged, scan.tail), (starts[4], 0, 0));
    }

    #[test]
    fn a_torn_tail_is_cut_at_every_byte() {
        let (whole, starts) = segment();
        for len in starts[3] + 1..starts[4] {
            let mut bytes = whole[..len].to_vec();
            bytes.resize(whole.len() + 50, 0);
            let scan = scan(&bytes);
            assert_eq!((scan.records.len(), scan.end), (3, starts[3]), "{len}");
            assert!(scan.is_torn() && scan.is_cut_append(), "{len}");
        }
    }

    #[test]
    fn a_garbled_byte_costs_no_other_record() {
        let (whole, starts) = segment();
        for at in starts[0]..starts[4] {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x55;
            let scan = scan(&bytes);
            let hit = starts.iter().rposition(|&start| start <= at).expect("behind the head");
            let expected: Vec<_> = (0..4).filter(|&n| n != hit).collect();
            let found: Vec<_> = scan
                .records
                .iter()
                .map(|(start, _)| starts.iter().position(|s| s == start).expect("a start"))
                .collect();
            assert_eq!(found, expected, "byte {at}");
            let told = (scan.damaged, scan.is_torn());
            assert_eq!(told, if hit == 3 { (0, true) } else { (1, false) });
        }
    }
}
