//! The end of the line: windows into the spool, and from there to the broker.
//!
//! Owns the order of spool and publish, and names both so that they need not know each other.

use super::publish::{Delivery, Format, Identity, MqttSettings, Publisher};
use super::serial::{SerialOutput, SerialSettings};
use super::spool::{Spool, SpoolCounts};
use crate::sensor::ClosedWindow;
use std::time::{Duration, Instant};

/// Time after which a window that the broker did not take, or the disk did not give, is tried again.
const RETRY: Duration = Duration::from_secs(30);

/// The end of the line: windows into the spool, and from there to the broker.
///
/// Windows that close while a session is open are sent at once; those that closed before it, or
/// were on their way when an earlier one broke, follow as replay.
#[derive(Debug)]
pub struct Outlet {
    identity: Identity,
    spool: Spool,
    publisher: Publisher,
    serial: Option<SerialOutput>,
    /// Windows that serial lines before this one have lost.
    lost_before: u64,
    /// Next try of what was put off.
    retry_at: Instant,
}

impl Outlet {
    /// Starts publishing; an absent broker is not an error.
    pub fn start(broker: MqttSettings, format: Format, identity: Identity, spool: Spool) -> Self {
        let mut publisher = Publisher::start(broker, format);
        publisher.locate(identity.located().cloned());
        let (serial, lost_before, retry_at) = (None, 0, Instant::now() + RETRY);
        Self { identity, spool, publisher, serial, lost_before, retry_at }
    }

    /// The same without a disk: what has not arrived ends with the program.
    pub fn in_memory(broker: MqttSettings, format: Format, identity: Identity) -> Self {
        Self::start(broker, format, identity, Spool::in_memory())
    }

    /// Windows go to an I/O node too, or no longer; a line that stays the same is not touched.
    pub fn serve_node(&mut self, settings: Option<SerialSettings>) {
        if self.serial.as_ref().map(SerialOutput::settings) != settings.as_ref() {
            self.lost_before = self.lost_to_node().unwrap_or(self.lost_before);
            self.serial = settings.map(SerialOutput::start);
        }
    }

    /// Windows that did not leave for the I/O node since start; `None` where none is connected.
    pub fn lost_to_node(&self) -> Option<u64> {
        self.serial.as_ref().map(|serial| self.lost_before + serial.lost())
    }

    /// Takes a window. It outlives the program from here on, unless the disk refuses it.
    pub fn density(&mut self, window: ClosedWindow<'_>, clock_synced: bool) {
        let (identity, report) = (&self.identity, window.report);
        let length_s = report.to.saturating_since(report.from).as_secs();
        let length_s = u32::try_from(length_s).unwrap_or(u32::MAX);
        let number = |seq| identity.message(window, clock_synced, seq);
        let (key, message) = self.spool.accept(length_s, number);
        if let Some(serial) = &self.serial {
            serial.window(&message);
        }
        self.hear();
        if self.publisher.live(key, &message) {
            self.spool.give(key);
        }
    }

    /// From here on windows are of another line, and go to this broker; waiting windows and their
    /// numbers stay. The spool keeps `windows` of them.
    pub fn change(
        &mut self,
        broker: MqttSettings,
        format: Format,
        identity: Identity,
        windows: u64,
    ) {
        self.publisher.locate(identity.located().cloned());
        self.identity = identity;
        self.spool.keep(windows);
        self.publisher.change(broker, format);
    }

    /// Hears what the broker has taken and sends what an outage has left; to be called a few
    /// times a second.
    pub fn tend(&mut self) {
        self.hear();
        if Instant::now() >= self.retry_at {
            self.retry_at = Instant::now() + RETRY;
            self.spool.resume();
        }
        for _ in 0..self.publisher.arrears_wanted() {
            let Some(arrear) = self.spool.next_arrear() else { return };
            self.publisher.arrear(arrear.key, &arrear.message, arrear.is_last);
        }
    }

    fn hear(&mut self) {
        while let Some(delivery) = self.publisher.delivery() {
            match delivery {
                Delivery::Opened => self.spool.rewind(),
                Delivery::Closed => {}
                Delivery::Taken { key, replayed } => {
                    if replayed {
                        // One was tried, and has passed: so may the others.
                        self.spool.resume_like(key);
                    }
                    self.spool.acknowledge(key);
                }
                Delivery::PutOff(key) => self.spool.put_off(key),
            }
        }
    }

    /// Whether a session with the broker is open.
    pub fn is_open(&self) -> bool {
        self.publisher.is_open()
    }

    /// For messages other than windows: health and alarms.
    pub fn publisher(&self) -> &Publisher {
        &self.publisher
    }

    /// Counts of waiting and of lost windows.
    pub fn counts(&self) -> SpoolCounts {
        self.spool.counts()
    }

    /// Why windows are in memory alone; `None` while the disk takes them.
    pub fn fault(&self) -> Option<&str> {
        self.spool.fault()
    }

    /// Says goodbye to the broker. What it has not taken waits on the disk for a next run.
    pub fn stop(mut self) {
        self.hear();
        self.publisher.stop().for_each(|key| self.spool.acknowledge(key));
        self.spool.note_acknowledged();
        let SpoolCounts { waiting, in_memory, .. } = self.spool.counts();
        if in_memory > 0 {
            log::error!("{in_memory} windows are lost: neither broker nor disk took them");
        }
        if waiting > in_memory {
            log::info!("{} windows wait on the disk", waiting - in_memory);
        }
    }
}
