//! Requests of an engineer to a node over its serial line, and its answers.
//!
//! | bytes | field |
//! |---|---|
//! | 1 | [`REQUEST`] or [`ANSWER`]; a density message begins with its small version number |
//! | M | [`Request`] or [`Answer`] in postcard |
//! | 4 | CRC-32 (ISO-HDLC) of all bytes before, little-endian |

use super::link::Fault;
use super::settings::{Settings, SettingsError};
use crate::wire::CRC;
use serde::{Deserialize, Serialize};

/// First byte of a request. The version is part of it: a changed form gets another byte.
pub const REQUEST: u8 = 0x51;
/// First byte of an answer.
pub const ANSWER: u8 = 0xA1;

/// Sent to the node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Request {
    /// Tell the settings.
    Settings,
    /// Check these settings, keep them, work by them.
    Set(Settings),
    /// Tell the counters.
    Counters,
}

/// Sent by the node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Answer {
    /// The settings that it works by and keeps, and how often they were changed.
    Settings {
        /// Rises with every change; 0: never set.
        sequence: u32,
        /// The settings.
        settings: Settings,
    },
    /// The settings sent are not acceptable; the old ones stay.
    Refused(SettingsError),
    /// The flash did not take the settings; the old ones stay.
    NotKept,
    /// Its counters since its start.
    Counters(Counters),
}

/// Counters since the start; each stops at its largest value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counters {
    /// Messages that gave an output a reading.
    pub messages: u32,
    /// Messages without a usable density for any output.
    pub unusable: u32,
    /// Messages that came twice.
    pub repeated: u32,
    /// Messages of another site.
    pub other_site: u32,
    /// Messages of another window length.
    pub other_window: u32,
    /// Messages in a format that this firmware does not read.
    pub unknown_version: u32,
    /// Frames with bytes missing.
    pub framing: u32,
    /// Frames too long, or bytes that came faster than they were read.
    pub overrun: u32,
    /// Frames that were damaged.
    pub checksum: u32,
    /// Settings that were refused.
    pub settings_refused: u32,
    /// Copies of the settings found damaged at the start.
    pub slots_damaged: u32,
    /// Starts since power came that were no power-up: by the watchdog, or a reset button.
    pub restarts: u32,
    /// Longest time from a message's last byte to its pins, µs.
    pub latency_max_us: u32,
    /// Time since the start, s.
    pub uptime_s: u32,
}

impl Counters {
    /// Counts a fault of the line.
    pub fn count_fault(&mut self, fault: Fault) {
        let counter = match fault {
            Fault::Framing => &mut self.framing,
            Fault::Overrun => &mut self.overrun,
            Fault::Checksum => &mut self.checksum,
        };
        *counter = counter.saturating_add(1);
    }
}

/// Whether a frame is meant as a request.
pub fn is_request(frame: &[u8]) -> bool {
    frame.first() == Some(&REQUEST)
}

/// Reads a request; `None`-like errors are all one: it was damaged or is not one.
///
/// # Errors
/// [`Damaged`].
pub fn read_request(frame: &[u8]) -> Result<Request, Damaged> {
    read(frame, REQUEST)
}

/// Reads an answer.
///
/// # Errors
/// [`Damaged`].
pub fn read_answer(frame: &[u8]) -> Result<Answer, Damaged> {
    read(frame, ANSWER)
}

/// Writes a request as a frame's content; `None` where `buffer` is too small.
pub fn write_request<'b>(request: &Request, buffer: &'b mut [u8]) -> Option<&'b [u8]> {
    write(REQUEST, request, buffer)
}

/// Writes an answer as a frame's content; `None` where `buffer` is too small.
pub fn write_answer<'b>(answer: &Answer, buffer: &'b mut [u8]) -> Option<&'b [u8]> {
    write(ANSWER, answer, buffer)
}

/// A request or answer that was damaged on the line, or of another form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Damaged;

fn read<'f, T: Deserialize<'f>>(frame: &'f [u8], first: u8) -> Result<T, Damaged> {
    let (checked, trailer) = frame.split_last_chunk::<4>().ok_or(Damaged)?;
    if CRC.checksum(checked) != u32::from_le_bytes(*trailer) {
        return Err(Damaged);
    }
    match checked.split_first() {
        Some((&found, body)) if found == first => match postcard::take_from_bytes(body) {
            Ok((value, [])) => Ok(value),
            _ => Err(Damaged),
        },
        _ => Err(Damaged),
    }
}

fn write<'b, T: Serialize>(first: u8, value: &T, buffer: &'b mut [u8]) -> Option<&'b [u8]> {
    let (start, rest) = buffer.split_first_mut()?;
    *start = first;
    let len = 1 + postcard::to_slice(value, rest).ok()?.len();
    let (checked, rest) = buffer.split_at_mut_checked(len)?;
    *rest.first_chunk_mut::<4>()? = CRC.checksum(checked).to_le_bytes();
    buffer.get(..len + 4)
}
