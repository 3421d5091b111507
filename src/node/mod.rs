//! The I/O node: density messages in from a serial line, contact closures out.
//!
//! A signal controller takes closures, not MQTT. A microcontroller beside the box runs this: it
//! reads [`crate::wire`] messages in COBS frames, and closes up to [`MAX_OUTPUTS`] outputs by a
//! lane's density, with hysteresis and a least time on. Whatever is not a fresh, usable reading
//! (silence, damage, a status other than `oK`, a null density) leads to the output's fail-safe
//! state, never to the last value for longer than the hold time.
//!
//! Owns the frames ([`link`]), the decision ([`outputs`]), the settings and where they are kept
//! ([`settings`], [`store`]). Knows no register: time, bytes and flash come in, pin states and
//! answers go out.

pub mod link;
pub mod outputs;
pub mod protocol;
pub mod settings;
pub mod store;

pub use outputs::Outputs;
pub use protocol::{Answer, Counters, Request};
pub use settings::{MAX_OUTPUTS, Output, Settings, SettingsError};

use crate::wire::{self, WireError};
use core::time::Duration;
use embedded_storage::nor_flash::NorFlash;
use link::{Fault, MAX_FRAME, Receiver};
use outputs::Heard;
use store::{Slots, Stored};

/// The whole node: feed it bytes and time.
#[derive(Debug)]
pub struct Node<F> {
    receiver: Receiver,
    outputs: Outputs,
    slots: Slots<F>,
    counters: Counters,
}

impl<F: NorFlash> Node<F> {
    /// A node that has just started, with the settings that its flash holds. Every output is in
    /// its fail-safe state until a message arrives; where both copies of the settings are
    /// damaged, every output is on, since nobody knows which one may be off.
    pub fn start(flash: F) -> Self {
        let mut slots = Slots::new(flash);
        let mut counters = Counters::default();
        let (outputs, damaged) = match slots.load() {
            Stored::Settings { settings, damaged } => (Outputs::new(settings), damaged),
            Stored::Blank => (Outputs::new(Settings::default()), false),
            Stored::Lost => (Outputs::lost(), true),
        };
        if damaged {
            counters.slots_damaged = 1;
        }
        Self { receiver: Receiver::default(), outputs, slots, counters }
    }

    /// Takes one byte of the serial line. Returns what to send back, if it completed a request.
    pub fn byte(&mut self, now: Duration, byte: u8) -> Option<Answer> {
        let frame = match self.receiver.push(byte)? {
            Ok(frame) => frame,
            Err(fault) => {
                self.counters.count_fault(fault);
                return None;
            }
        };
        if protocol::is_request(frame) {
            let Ok(request) = protocol::read_request(frame) else {
                self.counters.count_fault(Fault::Checksum);
                return None;
            };
            return Some(self.answer(now, request));
        }
        match wire::decode(frame) {
            Ok(message) => match self.outputs.hear(now, &message) {
                Heard::Used => bump(&mut self.counters.messages),
                Heard::Unusable => bump(&mut self.counters.unusable),
                Heard::Repeated => bump(&mut self.counters.repeated),
                Heard::OtherSite => bump(&mut self.counters.other_site),
                Heard::OtherWindow => bump(&mut self.counters.other_window),
            },
            Err(WireError::Version { .. }) => bump(&mut self.counters.unknown_version),
            Err(_) => self.counters.count_fault(Fault::Checksum),
        }
        None
    }

    /// The states that the pins have to have now: bit 0 is output 1, set is closed (a call).
    pub fn pins(&mut self, now: Duration) -> u8 {
        self.outputs.pins(now)
    }

    /// Messages that gave an output a reading, since the start.
    pub fn messages(&self) -> u32 {
        self.counters.messages
    }

    /// The board lost bytes of the serial line before this program read them.
    pub fn bytes_lost(&mut self) {
        self.counters.count_fault(Fault::Overrun);
        self.receiver.skip();
    }

    /// The board's own figures, told with the counters: its uptime, the longest time from a
    /// message's last byte to its pins, and its starts since power came.
    pub fn board(&mut self, uptime: Duration, latency_us: u32, restarts: u32) {
        self.counters.uptime_s = u32::try_from(uptime.as_secs()).unwrap_or(u32::MAX);
        self.counters.latency_max_us = self.counters.latency_max_us.max(latency_us);
        self.counters.restarts = restarts;
    }

    fn answer(&mut self, now: Duration, request: Request) -> Answer {
        match request {
            Request::Settings => Answer::Settings {
                sequence: self.slots.sequence(),
                settings: self.outputs.settings().clone(),
            },
            Request::Set(settings) => match settings.check() {
                Ok(()) => match self.slots.save(&settings) {
                    Ok(sequence) => {
                        self.outputs.replace(now, settings.clone());
                        Answer::Settings { sequence, settings }
                    }
                    Err(store::SaveError) => Answer::NotKept,
                },
                Err(reason) => {
                    bump(&mut self.counters.settings_refused);
                    Answer::Refused(reason)
                }
            },
            Request::Counters => Answer::Counters(self.counters),
        }
    }
}

/// Most bytes of an answer's frame on the line.
pub const MAX_ANSWER: usize = 256;
const _: () = assert!(MAX_ANSWER < MAX_FRAME);

fn bump(counter: &mut u32) {
    *counter = counter.saturating_add(1);
}

#[cfg(test)]
mod tests;
