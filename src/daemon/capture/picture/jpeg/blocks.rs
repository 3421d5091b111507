//! The coefficients of one block, sequential or progressive.

use super::bits::{Bits, Huffman};

/// Largest coefficient of pixels of 8 bits, with half as much for what quantisation rounds.
const LARGEST: i32 = 1024 + 512;

/// The coefficients of a scan and the bits of them.
#[derive(Clone, Copy)]
pub(super) struct Band {
    pub start: usize,
    pub stop: usize,
    pub high: u8,
    pub low: u8,
}

pub(super) struct Tables<'a> {
    pub dc: Option<&'a Huffman>,
    pub ac: Option<&'a Huffman>,
    pub mean: &'a mut i32,
    /// Progressive: blocks that follow without a coefficient.
    pub run: &'a mut u32,
    pub quantiser: &'a [u16; 64],
    pub low: u32,
    /// Whether no coefficient was larger than pixels of 8 bits can give.
    pub is_in_range: bool,
}

impl Tables<'_> {
    fn check(&mut self, k: usize, value: i32) {
        let factor = i32::from(self.quantiser[k].max(1));
        let value = value.saturating_mul(factor).saturating_mul(1 << self.low);
        self.is_in_range &= value.abs() <= LARGEST + factor;
    }
}

/// A value as it is coded: its sign is in its first bit (F.2.2.1, EXTEND).
fn value(bits: &mut Bits<'_>, size: u32) -> Option<i32> {
    let value = bits.take(size)? as i32;
    Some(if size > 0 && value < 1 << (size - 1) { value - (1 << size) + 1 } else { value })
}

fn read_mean(bits: &mut Bits<'_>, tables: &mut Tables<'_>) -> Option<()> {
    let size = bits.symbol(tables.dc?)?;
    if size > 11 {
        return None;
    }
    *tables.mean += value(bits, u32::from(size))?;
    tables.check(0, *tables.mean);
    Some(())
}

/// A block of a sequential picture (F.2.2).
pub(super) fn sequential(bits: &mut Bits<'_>, tables: &mut Tables<'_>) -> Option<()> {
    read_mean(bits, tables)?;
    let ac = tables.ac?;
    let mut k = 1;
    while k < 64 {
        let symbol = bits.symbol(ac)?;
        let (zeros, size) = (usize::from(symbol >> 4), u32::from(symbol & 15));
        match (zeros, size) {
            (15, 0) => k += 16,
            (_, 0) => break,
            _ => {
                k += zeros + 1;
                if k > 64 {
                    return None;
                }
                let value = value(bits, size)?;
                tables.check(k - 1, value);
            }
        }
    }
    Some(())
}

/// A block of a progressive picture's scan (annex G.1.2).
pub(super) fn progressive(
    bits: &mut Bits<'_>,
    tables: &mut Tables<'_>,
    band: Band,
    nonzero: &mut u64,
) -> Option<()> {
    if band.start == 0 {
        return if band.high == 0 { read_mean(bits, tables) } else { bits.take(1).map(|_| ()) };
    }
    let mut k = band.start;
    if *tables.run == 0 {
        let ac = tables.ac?;
        while k <= band.stop {
            let symbol = bits.symbol(ac)?;
            let (mut zeros, size) = (usize::from(symbol >> 4), u32::from(symbol & 15));
            if size == 0 && zeros < 15 {
                *tables.run = (1 << zeros) + bits.take(zeros as u32)?;
                break;
            }
            if band.high == 0 {
                k += zeros;
                if size > 0 {
                    if k > band.stop {
                        return None;
                    }
                    let value = value(bits, size)?;
                    tables.check(k, value);
                    *nonzero |= 1 << k;
                }
                k += 1;
                continue;
            }
            if size > 1 {
                return None;
            }
            bits.take(size)?;
            // A new coefficient behind that many which stay zero; the others get one bit more.
            while k <= band.stop {
                if *nonzero & (1 << k) != 0 {
                    bits.take(1)?;
                } else if zeros == 0 {
                    if size > 0 {
                        *nonzero |= 1 << k;
                    }
                    k += 1;
                    break;
                } else {
                    zeros -= 1;
                }
                k += 1;
            }
        }
    }
    if *tables.run > 0 {
        if band.high > 0 {
            for k in k..=band.stop {
                if *nonzero & (1 << k) != 0 {
                    bits.take(1)?;
                }
            }
        }
        *tables.run -= 1;
    }
    Some(())
}
