//! The walk through a picture's segments, with the tables in force, and through each scan.

use super::bits::{Bits, Huffman};
use super::blocks::{Band, Tables, progressive, sequential};
use super::frame::Frame;
use super::markers::{end_of_coded, marker_at};
use super::{DecodeError, damaged};

pub(super) struct Segment<'a> {
    pub marker: u8,
    /// Where its marker begins.
    pub at: usize,
    pub body: &'a [u8],
}

pub(super) struct Walk<'a> {
    bytes: &'a [u8],
    at: usize,
    pub frame: Option<Frame>,
    pub dc: [Option<Huffman>; 4],
    pub ac: [Option<Huffman>; 4],
    /// Factors of the coefficients, in the order of the stream.
    quantisers: [Option<[u16; 64]>; 4],
    restart_interval: usize,
}

impl<'a> Walk<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self {
            bytes,
            at: 2,
            frame: None,
            dc: [const { None }; 4],
            ac: [const { None }; 4],
            quantisers: [None; 4],
            restart_interval: 0,
        }
    }

    pub fn segment(&mut self) -> Result<Segment<'a>, DecodeError> {
        let cut = || DecodeError::Truncated { bytes: self.bytes.len() };
        loop {
            let found = marker_at(self.bytes, self.at);
            let (marker, next) = found
                .map_err(|at| at.map_or_else(cut, |_| damaged("bytes between its segments")))?;
            let at = self.at;
            match marker {
                0xd9 => return Ok(Segment { marker, at, body: &[] }),
                0x01 | 0xd0..=0xd7 => self.at = next,
                0x00 | 0xd8 => return Err(damaged("another picture begins within it")),
                _ => {
                    let length = self.bytes.get(next..next + 2).ok_or_else(cut)?;
                    let length = usize::from(u16::from_be_bytes([length[0], length[1]]));
                    let body = self.bytes.get(next + 2..next + length.max(2)).ok_or_else(cut)?;
                    if length < 2 {
                        return Err(damaged("a segment without a length"));
                    }
                    self.at = next + length;
                    return Ok(Segment { marker, at, body });
                }
            }
        }
    }

    /// Takes what a segment in front of a scan says.
    pub fn note(&mut self, segment: &Segment<'_>) -> Result<(), DecodeError> {
        let body = segment.body;
        match segment.marker {
            0xc4 => self.tables(body),
            0xdb => self.note_quantisers(body),
            0xdd => {
                let interval = body.get(..2).ok_or_else(|| damaged("a short restart interval"))?;
                self.restart_interval = usize::from(u16::from_be_bytes([interval[0], interval[1]]));
                Ok(())
            }
            0xc0..=0xc2 => {
                if self.frame.is_some() {
                    return Err(damaged("it has two frames"));
                }
                self.frame = Some(Frame::read(body, segment.marker == 0xc2)?);
                Ok(())
            }
            0xc3 | 0xc5..=0xc7 | 0xc9..=0xcf => Err(damaged(
                "a lossless, hierarchical or arithmetic JPEG: set the camera to baseline",
            )),
            _ => Ok(()),
        }
    }

    fn tables(&mut self, mut body: &[u8]) -> Result<(), DecodeError> {
        let wrong = || damaged("a Huffman table that is none");
        while let Some((&class_and_id, rest)) = body.split_first() {
            let (counts, rest) = rest.split_at_checked(16).ok_or_else(wrong)?;
            let symbols = counts.iter().map(|&count| usize::from(count)).sum::<usize>();
            let (symbols, rest) = rest.split_at_checked(symbols).ok_or_else(wrong)?;
            let table = Huffman::new(counts, symbols).ok_or_else(wrong)?;
            let class = if class_and_id >> 4 == 0 { &mut self.dc } else { &mut self.ac };
            *class.get_mut(usize::from(class_and_id & 15)).ok_or_else(wrong)? = Some(table);
            body = rest;
        }
        Ok(())
    }

    fn note_quantisers(&mut self, mut body: &[u8]) -> Result<(), DecodeError> {
        let wrong = || damaged("a quantisation table that is none");
        while let Some((&precision_and_id, rest)) = body.split_first() {
            let wide = precision_and_id >> 4 != 0;
            let (table, rest) =
                rest.split_at_checked(if wide { 128 } else { 64 }).ok_or_else(wrong)?;
            let mut factors = [0; 64];
            for (k, factor) in factors.iter_mut().enumerate() {
                *factor = if wide {
                    u16::from_be_bytes([table[2 * k], table[2 * k + 1]])
                } else {
                    u16::from(table[k])
                };
            }
            *self.quantisers.get_mut(usize::from(precision_and_id & 15)).ok_or_else(wrong)? =
                Some(factors);
            body = rest;
        }
        Ok(())
    }

    /// Reads one scan; `body` is its header.
    pub fn scan(&mut self, body: &[u8]) -> Result<(), DecodeError> {
        let wrong = || damaged("a scan's header that is none");
        let frame = self.frame.as_mut().ok_or_else(wrong)?;
        let count = usize::from(*body.first().ok_or_else(wrong)?);
        let selectors = body.get(1..1 + 2 * count).ok_or_else(wrong)?;
        let &[start, stop, bits] = body.get(1 + 2 * count..).ok_or_else(wrong)? else {
            return Err(wrong());
        };
        if !(1..=4).contains(&count) {
            return Err(wrong());
        }
        let band = if frame.progressive {
            Band {
                start: usize::from(start),
                stop: usize::from(stop),
                high: bits >> 4,
                low: bits & 15,
            }
        } else {
            Band { start: 0, stop: 63, high: 0, low: 0 }
        };
        let is_right = band.start <= band.stop && band.stop < 64 && band.low < 14;
        let dc_alone = !frame.progressive || (band.start == 0) == (band.stop == 0);
        if !is_right || !dc_alone || (frame.progressive && band.start > 0 && count > 1) {
            return Err(wrong());
        }
        let mut parts = Vec::new();
        for selector in selectors.chunks_exact(2) {
            let index = frame.components.iter().position(|component| component.id == selector[0]);
            let index = index.ok_or_else(wrong)?;
            parts.push((index, usize::from(selector[1] >> 4), usize::from(selector[1] & 15)));
        }
        let (mcus, per_row, alone) = if let [(index, ..)] = parts.as_slice() {
            let (columns, rows) = frame.components[*index].blocks;
            (columns * rows, columns, true)
        } else {
            let columns = frame.width.div_ceil(8 * frame.h);
            (columns * frame.height.div_ceil(8 * frame.v), columns, false)
        };
        let coded = &self.bytes[self.at..];
        let length = end_of_coded(self.bytes, self.at).map_or(coded.len(), |end| end - self.at);
        self.at += length;
        let mut bits = Bits::new(&coded[..length]);
        let interval = if self.restart_interval == 0 { mcus } else { self.restart_interval };
        let mut means = [0_i32; 4];
        let mut run = 0_u32;
        let cut = || damaged("its coded data end before the picture does, or a part is missing");
        let changed = || damaged("its coded data are wrong: a part is missing or was changed");
        for mcu in 0..mcus {
            if mcu > 0 && mcu % interval == 0 {
                bits.restart((mcu / interval - 1) % 8).ok_or_else(cut)?;
                means = [0; 4];
                run = 0;
            }
            for &(index, dc, ac) in &parts {
                let component = &mut frame.components[index];
                let quantiser = self.quantisers.get(component.quantiser).and_then(Option::as_ref);
                let (across, down) = if alone { (1, 1) } else { (component.h, component.v) };
                for block in 0..across * down {
                    let x = mcu % per_row * across + block % across;
                    let y = mcu / per_row * down + block / across;
                    let mut tables = Tables {
                        dc: self.dc.get(dc).and_then(Option::as_ref),
                        ac: self.ac.get(ac).and_then(Option::as_ref),
                        mean: &mut means[index.min(3)],
                        run: &mut run,
                        quantiser: quantiser.unwrap_or(&[1; 64]),
                        low: u32::from(band.low),
                        is_in_range: true,
                    };
                    if !frame.progressive {
                        sequential(&mut bits, &mut tables).ok_or_else(cut)?;
                    } else {
                        let at = y * component.stride + x;
                        let nonzero = component.nonzero.get_mut(at).ok_or_else(cut)?;
                        progressive(&mut bits, &mut tables, band, nonzero).ok_or_else(cut)?;
                    }
                    if !tables.is_in_range {
                        return Err(changed());
                    }
                }
            }
        }
        if !bits.is_over() {
            return Err(damaged(
                "its coded data go on behind the picture: a part is missing or was changed",
            ));
        }
        for &(index, ..) in &parts {
            for sent in &mut frame.components[index].sent[band.start..=band.stop] {
                if band.high != 0 && *sent != band.high {
                    return Err(damaged("a scan is missing"));
                }
                *sent = band.low;
            }
        }
        Ok(())
    }
}
