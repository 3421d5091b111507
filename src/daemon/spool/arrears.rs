//! Windows that wait, and which of them is sent next.
//!
//! Owns the order: the oldest first, each once in a session, and again when something has changed.

use super::record::Record;
use super::{Entry, Place, Spool};
use crate::daemon::disk;
use crate::wire::DensityMessage;
use std::collections::BTreeSet;
use std::io;

/// A window to send, and what to call it in [`Spool::acknowledge`].
#[derive(Clone, Debug, PartialEq)]
pub struct Waiting {
    /// Its key in the spool.
    pub key: u64,
    /// The window.
    pub message: DensityMessage,
    /// No older window of its length waits behind it.
    pub is_last: bool,
}

/// Whether a window was given out since the latest [`Spool::rewind`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Given {
    No,
    Yes,
    /// It was, and the broker would not have it now.
    PutOff,
    /// It could not be, for the disk gave an error.
    Unreadable,
}

impl Spool {
    /// Begins again at the oldest window: a new session knows nothing of an earlier one.
    pub fn rewind(&mut self) {
        self.entries.iter_mut().for_each(|entry| entry.given = Given::No);
    }

    /// Notes that a window that was just accepted is being sent: it is not backlog.
    pub fn give(&mut self, key: u64) {
        if let Some(index) = self.find(key) {
            self.entries[index].given = Given::Yes;
        }
    }

    /// The broker would not have this window now: it waits until [`Self::resume`].
    pub fn put_off(&mut self, key: u64) {
        if let Some(index) = self.find(key) {
            self.entries[index].given = Given::PutOff;
        }
    }

    /// Tries again what the disk would not give, and of what was put off the oldest one of each
    /// length, to see.
    pub fn resume(&mut self) {
        let mut tried = BTreeSet::new();
        for entry in &mut self.entries {
            let again = match entry.given {
                Given::Unreadable => true,
                Given::PutOff => tried.insert(entry.window_s),
                Given::No | Given::Yes => false,
            };
            if again {
                entry.given = Given::No;
            }
        }
    }

    /// Tries again all that was put off and is as long as the window with this key.
    pub fn resume_like(&mut self, key: u64) {
        let Some(index) = self.find(key) else { return };
        let window_s = self.entries[index].window_s;
        let alike = |entry: &&mut Entry| entry.given == Given::PutOff && entry.window_s == window_s;
        self.entries.iter_mut().filter(alike).for_each(|entry| entry.given = Given::No);
    }

    /// The oldest window that was not given out yet.
    pub fn next_arrear(&mut self) -> Option<Waiting> {
        loop {
            let index = self.entries.iter().position(|entry| entry.given == Given::No)?;
            let Entry { key, window_s, .. } = self.entries[index];
            match self.read(&self.entries[index].place) {
                Ok(Some(message)) => {
                    self.unreadable_said = false;
                    self.entries[index].given = Given::Yes;
                    let same =
                        |entry: &Entry| entry.given == Given::No && entry.window_s == window_s;
                    let is_last = !self.entries.range(index..).any(same);
                    return Some(Waiting { key, message, is_last });
                }
                Ok(None) => {
                    log::error!("a window is lost: its record on the disk is damaged");
                    self.counts.damaged += 1;
                    // Nobody has taken it, and so nothing says that one did.
                    self.entries.remove(index);
                    self.sweep();
                }
                Err(error) => {
                    if !std::mem::replace(&mut self.unreadable_said, true) {
                        log::error!(
                            "spool: a window cannot be read now and stays: {}",
                            disk::unread(&error)
                        );
                    }
                    self.entries[index].given = Given::Unreadable;
                }
            }
        }
    }

    /// The window at a place; `None` where its record is damaged.
    fn read(&self, place: &Place) -> io::Result<Option<DensityMessage>> {
        let (segment, offset) = match place {
            Place::Memory(message) => return Ok(Some(message.as_ref().clone())),
            Place::Disk { segment, offset } => (segment, *offset),
        };
        let segment = self.segments.get(segment).ok_or(io::ErrorKind::NotFound)?;
        Ok(match segment.read(offset)? {
            Some(Record::Window { message, .. }) => Some(*message),
            _ => None,
        })
    }
}
