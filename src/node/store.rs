//! Settings that outlive a power cut: two slots, and only the older is ever written.
//!
//! | offset | bytes | field of a slot |
//! |---|---|---|
//! | 0 | 4 | [`MAGIC`] with the format's version |
//! | 4 | 4 | sequence, little-endian: the higher one counts |
//! | 8 | 2 | length M of the body |
//! | 10 | M | [`Settings`] in postcard |
//! | 10+M | 4 | CRC-32 (ISO-HDLC) of all bytes before |
//!
//! A slot is one erase block or more of a flash behind `embedded-storage`. A write that was cut
//! at any byte leaves a slot whose checksum is wrong; the other one holds the older settings.

use super::settings::Settings;
use crate::wire::CRC;
use embedded_storage::nor_flash::NorFlash;

/// "VGN" and version 1.
pub const MAGIC: [u8; 4] = *b"VGN\x01";
/// Bytes of a slot that are used: the settings' 169 at the most, framing, and room for more.
pub const SLOT_LEN: usize = 256;
const HEADER_LEN: usize = 10;

/// The two slots, at the beginning of a flash.
#[derive(Debug)]
pub struct Slots<F> {
    flash: F,
    /// Slot of the present settings, and their sequence number.
    current: Option<(u32, u32)>,
}

/// Content of the flash.
#[derive(Debug, PartialEq)]
pub enum Stored {
    /// Settings.
    Settings {
        /// The newest that are whole.
        settings: Settings,
        /// The other slot is damaged: a write was cut.
        damaged: bool,
    },
    /// A new flash.
    Blank,
    /// No slot is whole and one is not blank: what the outputs should do is not known.
    Lost,
}

/// The flash failed, or reads back something else than was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SaveError;

enum Slot {
    Whole(u32, Settings),
    Blank,
    Damaged,
}

impl<F: NorFlash> Slots<F> {
    /// Slots of a flash that has room for two.
    pub fn new(flash: F) -> Self {
        Self { flash, current: None }
    }

    /// Gives the flash back.
    pub fn into_flash(self) -> F {
        self.flash
    }

    /// How often settings were written; 0: never.
    pub fn sequence(&self) -> u32 {
        self.current.map_or(0, |(_, sequence)| sequence)
    }

    /// Reads both slots and takes the newer.
    pub fn load(&mut self) -> Stored {
        let (first, second) = (self.read(0), self.read(1));
        let damaged = matches!(first, Slot::Damaged) || matches!(second, Slot::Damaged);
        let (slot, sequence, settings) = match (first, second) {
            (Slot::Whole(a, settings), Slot::Whole(b, _)) if newer(a, b) => (0, a, settings),
            (_, Slot::Whole(b, settings)) => (1, b, settings),
            (Slot::Whole(a, settings), _) => (0, a, settings),
            (Slot::Blank, Slot::Blank) => return Stored::Blank,
            (_, _) => return Stored::Lost,
        };
        self.current = Some((slot, sequence));
        Stored::Settings { settings, damaged }
    }

    /// Writes settings over the older slot; the newer one stays whole until they are there.
    ///
    /// # Errors
    /// [`SaveError`]; the settings before are still the current ones.
    pub fn save(&mut self, settings: &Settings) -> Result<u32, SaveError> {
        let (slot, sequence) = match self.current {
            Some((slot, sequence)) => (1 - slot.min(1), sequence.wrapping_add(1)),
            None => (0, 1),
        };
        let mut bytes = [0xFF; SLOT_LEN];
        let len = fill(settings, sequence, &mut bytes).ok_or(SaveError)?;
        let len = len.next_multiple_of(F::WRITE_SIZE.max(1)).min(SLOT_LEN);
        let written = bytes.get(..len).ok_or(SaveError)?;
        let from = slot * Self::size();
        self.flash.erase(from, from + Self::size()).map_err(|_| SaveError)?;
        self.flash.write(from, written).map_err(|_| SaveError)?;
        match self.read(slot) {
            Slot::Whole(found, kept) if found == sequence && kept == *settings => {
                self.current = Some((slot, sequence));
                Ok(sequence)
            }
            _ => Err(SaveError),
        }
    }

    /// Bytes from one slot to the next.
    const fn size() -> u32 {
        let block = if F::ERASE_SIZE == 0 { 1 } else { F::ERASE_SIZE };
        SLOT_LEN.next_multiple_of(block) as u32
    }

    fn read(&mut self, slot: u32) -> Slot {
        let mut bytes = [0; SLOT_LEN];
        if self.flash.read(slot * Self::size(), &mut bytes).is_err() {
            return Slot::Damaged;
        }
        if bytes.iter().all(|&byte| byte == 0xFF) {
            return Slot::Blank;
        }
        parse(&bytes).map_or(Slot::Damaged, |(sequence, settings)| Slot::Whole(sequence, settings))
    }
}

/// Whether sequence `a` was written after `b`, over the wrap of the counter (RFC 1982, 3.2).
fn newer(a: u32, b: u32) -> bool {
    a != b && a.wrapping_sub(b) < 1 << 31
}

fn fill(settings: &Settings, sequence: u32, bytes: &mut [u8; SLOT_LEN]) -> Option<usize> {
    let body_len = postcard::to_slice(settings, bytes.get_mut(HEADER_LEN..)?).ok()?.len();
    bytes.get_mut(..4)?.copy_from_slice(&MAGIC);
    *bytes.get_mut(4..)?.first_chunk_mut()? = sequence.to_le_bytes();
    *bytes.get_mut(8..)?.first_chunk_mut()? = (body_len as u16).to_le_bytes();
    let (checked, rest) = bytes.split_at_mut_checked(HEADER_LEN + body_len)?;
    *rest.first_chunk_mut()? = CRC.checksum(checked).to_le_bytes();
    Some(HEADER_LEN + body_len + 4)
}

fn parse(bytes: &[u8; SLOT_LEN]) -> Option<(u32, Settings)> {
    let (magic, rest) = bytes.split_first_chunk::<4>()?;
    let (sequence, rest) = rest.split_first_chunk::<4>()?;
    let (len, _) = rest.split_first_chunk::<2>()?;
    let checked_len = HEADER_LEN + usize::from(u16::from_le_bytes(*len));
    let (checked, trailer) = bytes.split_at_checked(checked_len)?;
    let trailer = u32::from_le_bytes(*trailer.first_chunk()?);
    if *magic != MAGIC || CRC.checksum(checked) != trailer {
        return None;
    }
    match postcard::take_from_bytes::<Settings>(checked.get(HEADER_LEN..)?) {
        Ok((settings, [])) if settings.check().is_ok() => {
            Some((u32::from_le_bytes(*sequence), settings))
        }
        _ => None,
    }
}
