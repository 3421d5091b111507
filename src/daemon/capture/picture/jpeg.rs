//! Whether a JPEG is whole, found by reading its coded data without making pixels of it.
//!
//! Owns the rule that a picture with a part missing is damaged: decoders fill what is missing
//! with grey, and grey holds no vehicles. Each scan must give exactly the blocks that the header
//! promises, out of exactly the bytes that are there (ITU-T T.81, annexes F and G). Sequential
//! and progressive Huffman coding; what else there is, the decoder refuses.

use super::DecodeError;

/// Most scans of one picture: encoders write about ten.
const MAX_SCANS: usize = 100;
/// Bytes of padding that are passed over behind a scan's last block: some chips fill up words.
const MAX_PADDING: usize = 16;
/// Largest coefficient of pixels of 8 bits, with half as much for what quantisation rounds.
const LARGEST: i32 = 1024 + 512;

/// What stands in front of the coded data.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// Columns, px.
    pub width: u32,
    /// Rows, px.
    pub height: u32,
    /// Samples of all components in a row of blocks' worth, times 64 coefficients: what a decoder
    /// keeps of a progressive picture.
    pub coefficients: u64,
    /// Whether the decoder has to keep them.
    pub keeps_coefficients: bool,
    /// Which way up, as EXIF numbers it: 1 to 8.
    pub orientation: u8,
    /// Where Huffman tables are missing: in front of this byte.
    pub tables_missing_at: Option<usize>,
}

/// One component of the frame.
#[derive(Clone, Debug, Default)]
struct Component {
    id: u8,
    h: usize,
    v: usize,
    quantiser: usize,
    /// Blocks in a row and rows of blocks, in scans of this component alone and as allocated.
    blocks: (usize, usize),
    stride: usize,
    /// Progressive: which coefficients of each block are not zero.
    nonzero: Vec<u64>,
    /// The lowest bit that was sent of each coefficient so far; 255: none.
    sent: Vec<u8>,
}

#[derive(Clone, Debug, Default)]
struct Frame {
    width: usize,
    height: usize,
    progressive: bool,
    h: usize,
    v: usize,
    components: Vec<Component>,
}

/// Finds where a picture ends, behind its end mark, as its bytes arrive. Segments are passed over
/// by their length, so that a thumbnail's end is not taken for it.
#[derive(Clone, Copy, Debug)]
pub struct EndFinder {
    at: usize,
    coded: bool,
}

/// What is known of a picture's end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// It ends behind this byte.
    At(usize),
    /// It lies behind the bytes.
    Later,
    /// From this byte on it is no JPEG.
    Broken(usize),
}

impl Default for EndFinder {
    /// For a picture that begins at the front of the bytes.
    fn default() -> Self {
        Self { at: 2, coded: false }
    }
}

impl EndFinder {
    /// Looks on in `bytes`, which begin as before and may have grown.
    pub fn find(&mut self, bytes: &[u8]) -> End {
        loop {
            if self.coded {
                let rest = bytes.get(self.at..).unwrap_or_default();
                let Some(offset) = rest.iter().position(|&byte| byte == 0xff) else {
                    self.at = self.at.max(bytes.len());
                    return End::Later;
                };
                self.at += offset;
                match bytes.get(self.at + 1) {
                    None => return End::Later,
                    Some(0x00 | 0xd0..=0xd7) => self.at += 2,
                    Some(0xff) => self.at += 1,
                    Some(_) => self.coded = false,
                }
                continue;
            }
            while bytes.get(self.at..self.at + 2) == Some(&[0xff, 0xff]) {
                self.at += 1;
            }
            let (marker, next) = match marker_at(bytes, self.at) {
                Ok(found) => found,
                Err(None) => return End::Later,
                Err(Some(at)) => return End::Broken(at),
            };
            match marker {
                0xd9 => return End::At(next),
                0xd0..=0xd7 => self.at = next,
                0xd8 => return End::Broken(self.at),
                // Reserved: text behind a picture that was cut off at a 0xff.
                0x00..=0xbf => return End::Broken(next),
                _ => {
                    let Some(&[high, low]) = bytes.get(next..next + 2) else { return End::Later };
                    let length = usize::from(u16::from_be_bytes([high, low]));
                    if length < 2 {
                        return End::Broken(next);
                    }
                    (self.at, self.coded) = (next + length, marker == 0xda);
                }
            }
        }
    }
}

/// Reads the header, up to the first scan.
pub fn header(bytes: &[u8]) -> Result<Header, DecodeError> {
    let mut walk = Walk::new(bytes);
    let mut header = Header { orientation: 1, ..Header::default() };
    let scan = loop {
        let segment = walk.segment()?;
        match segment.marker {
            0xe1 => header.orientation = orientation(segment.body).unwrap_or(header.orientation),
            0xda => break segment,
            0xd9 => return Err(damaged("it has no coded data")),
            _ => walk.note(&segment)?,
        }
    };
    let frame = walk.frame.as_ref().ok_or_else(|| damaged("its size is not given"))?;
    (header.width, header.height) = (frame.width as u32, frame.height as u32);
    let coefficients = |c: &Component| (c.stride * c.blocks.1.next_multiple_of(c.v) * 64) as u64;
    header.coefficients = frame.components.iter().map(coefficients).sum();
    let in_scan = usize::from(scan.body.first().copied().unwrap_or_default());
    header.keeps_coefficients = frame.progressive || in_scan < frame.components.len();
    if walk.dc.iter().chain(&walk.ac).all(Option::is_none) {
        header.tables_missing_at = Some(scan.at);
    }
    Ok(header)
}

/// Checks that nothing is missing from the coded data.
pub fn verify(bytes: &[u8]) -> Result<(), DecodeError> {
    let mut walk = Walk::new(bytes);
    let mut scans = 0;
    loop {
        let segment = walk.segment()?;
        match segment.marker {
            0xd9 => break,
            0xda => {
                scans += 1;
                if scans > MAX_SCANS {
                    return Err(damaged("it has more scans than a picture needs"));
                }
                let body = segment.body.to_vec();
                walk.scan(&body)?;
            }
            _ => walk.note(&segment)?,
        }
    }
    let frame = walk.frame.ok_or_else(|| damaged("its size is not given"))?;
    let whole = |component: &Component| {
        let needed = if frame.progressive { 64 } else { 1 };
        component.sent.iter().take(needed).all(|&bit| bit == 0)
    };
    if frame.components.iter().all(whole) { Ok(()) } else { Err(damaged("scans are missing")) }
}

fn damaged(what: &str) -> DecodeError {
    DecodeError::Damaged(what.to_owned())
}

/// The marker at `at`, over fill bytes, and where it ends.
fn marker_at(bytes: &[u8], at: usize) -> Result<(u8, usize), Option<usize>> {
    let fill = bytes.get(at..).ok_or(None)?.iter().take_while(|&&byte| byte == 0xff).count();
    let marker = *bytes.get(at + fill).ok_or(None)?;
    if fill == 0 { Err(Some(at)) } else { Ok((marker, at + fill + 1)) }
}

/// Where coded data end: at the first marker that is no restart.
fn end_of_coded(bytes: &[u8], from: usize) -> Option<usize> {
    let mut at = from;
    loop {
        at += bytes.get(at..)?.iter().position(|&byte| byte == 0xff)?;
        match bytes.get(at + 1)? {
            0x00 | 0xd0..=0xd7 => at += 2,
            0xff => at += 1,
            _ => return Some(at),
        }
    }
}

struct Segment<'a> {
    marker: u8,
    /// Where its marker begins.
    at: usize,
    body: &'a [u8],
}

struct Walk<'a> {
    bytes: &'a [u8],
    at: usize,
    frame: Option<Frame>,
    dc: [Option<Huffman>; 4],
    ac: [Option<Huffman>; 4],
    /// What each coefficient is multiplied by, in the order in which they come.
    quantisers: [Option<[u16; 64]>; 4],
    restart_interval: usize,
}

impl<'a> Walk<'a> {
    fn new(bytes: &'a [u8]) -> Self {
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

    fn segment(&mut self) -> Result<Segment<'a>, DecodeError> {
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
    fn note(&mut self, segment: &Segment<'_>) -> Result<(), DecodeError> {
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
    fn scan(&mut self, body: &[u8]) -> Result<(), DecodeError> {
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

impl Frame {
    fn read(body: &[u8], progressive: bool) -> Result<Self, DecodeError> {
        let wrong = || damaged("a frame header that is none");
        let &[precision, h1, h0, w1, w0, count, ref rest @ ..] = body else { return Err(wrong()) };
        if precision != 8 {
            return Err(damaged("a JPEG of more than 8 bits: set the camera to baseline"));
        }
        let height = usize::from(u16::from_be_bytes([h1, h0]));
        let width = usize::from(u16::from_be_bytes([w1, w0]));
        let specifications = rest.get(..3 * usize::from(count)).ok_or_else(wrong)?;
        let mut frame = Self { width, height, progressive, h: 1, v: 1, components: Vec::new() };
        for specification in specifications.chunks_exact(3) {
            let (h, v) = (usize::from(specification[1] >> 4), usize::from(specification[1] & 15));
            if !(1..=4).contains(&h) || !(1..=4).contains(&v) {
                return Err(wrong());
            }
            (frame.h, frame.v) = (frame.h.max(h), frame.v.max(v));
            let (id, quantiser) = (specification[0], usize::from(specification[2]));
            frame.components.push(Component { id, h, v, quantiser, ..Component::default() });
        }
        if !(1..=4).contains(&frame.components.len()) || width == 0 || height == 0 {
            return Err(damaged(&format!("it has {width}x{height} px in {count} components")));
        }
        super::check_size(width as u32, height as u32)?;
        for component in &mut frame.components {
            let blocks =
                |size: usize, own: usize, most: usize| (size * own).div_ceil(most).div_ceil(8);
            component.blocks =
                (blocks(width, component.h, frame.h), blocks(height, component.v, frame.v));
            component.stride = width.div_ceil(8 * frame.h) * component.h;
            component.sent = vec![255; 64];
            if progressive {
                let rows = height.div_ceil(8 * frame.v) * component.v;
                component.nonzero = vec![0; component.stride * rows];
            }
        }
        Ok(frame)
    }
}

/// The coefficients of a scan and the bits of them.
#[derive(Clone, Copy)]
struct Band {
    start: usize,
    stop: usize,
    high: u8,
    low: u8,
}

struct Tables<'a> {
    dc: Option<&'a Huffman>,
    ac: Option<&'a Huffman>,
    mean: &'a mut i32,
    /// Progressive: blocks that follow without a coefficient.
    run: &'a mut u32,
    quantiser: &'a [u16; 64],
    low: u32,
    /// Whether no coefficient was larger than pixels of 8 bits can give.
    is_in_range: bool,
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
fn sequential(bits: &mut Bits<'_>, tables: &mut Tables<'_>) -> Option<()> {
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
fn progressive(
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

/// A Huffman table for decoding (annex F.2.2.3), with a look-up for short codes.
struct Huffman {
    /// For each beginning of [`FAST`] bits: symbol and length, or length 0.
    fast: Vec<(u8, u8)>,
    /// For each length: the first code behind this length's, shifted to 16 bits.
    limits: [u32; 17],
    /// For each length: what to add to a code for its symbol's index.
    offsets: [i32; 17],
    symbols: Vec<u8>,
}

const FAST: u32 = 9;

impl Huffman {
    fn new(counts: &[u8], symbols: &[u8]) -> Option<Self> {
        let (mut code, mut index) = (0_u32, 0_usize);
        let mut table = Self {
            fast: vec![(0, 0); 1 << FAST],
            limits: [0; 17],
            offsets: [0; 17],
            symbols: symbols.to_vec(),
        };
        for length in 1..=16_u32 {
            let count = u32::from(counts[length as usize - 1]);
            table.offsets[length as usize] = index as i32 - code as i32;
            for _ in 0..count {
                if code >= 1 << length {
                    return None;
                }
                if length <= FAST {
                    let first = (code << (FAST - length)) as usize;
                    let entry = (*symbols.get(index)?, length as u8);
                    table.fast[first..first + (1 << (FAST - length))].fill(entry);
                }
                code += 1;
                index += 1;
            }
            table.limits[length as usize] = code << (16 - length);
            code <<= 1;
        }
        Some(table)
    }
}

/// The bits of coded data, up to a restart marker or the end.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    buffer: u64,
    have: u32,
}

impl<'a> Bits<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0, buffer: 0, have: 0 }
    }

    fn fill(&mut self) {
        while self.have <= 48 {
            let Some(&byte) = self.bytes.get(self.at) else { return };
            if byte == 0xff {
                // A byte of data, or a marker, at which data end.
                if self.bytes.get(self.at + 1) != Some(&0) {
                    return;
                }
                self.at += 1;
            }
            self.at += 1;
            self.buffer = self.buffer << 8 | u64::from(byte);
            self.have += 8;
        }
    }

    fn take(&mut self, count: u32) -> Option<u32> {
        if self.have < count {
            self.fill();
        }
        self.have = self.have.checked_sub(count)?;
        Some((self.buffer >> self.have) as u32 & ((1 << count) - 1))
    }

    fn symbol(&mut self, table: &Huffman) -> Option<u8> {
        if self.have < 16 {
            self.fill();
        }
        // Behind the end there are zeros to look at, none to take.
        let ahead = if self.have >= 16 {
            (self.buffer >> (self.have - 16)) as u32 & 0xffff
        } else {
            (self.buffer << (16 - self.have)) as u32 & 0xffff
        };
        let (symbol, length) = table.fast[(ahead >> (16 - FAST)) as usize];
        if length > 0 {
            self.have = self.have.checked_sub(u32::from(length))?;
            return Some(symbol);
        }
        let length = (FAST as usize + 1..=16).find(|&length| ahead < table.limits[length])?;
        self.have = self.have.checked_sub(length as u32)?;
        let code = (ahead >> (16 - length)) as i32;
        table.symbols.get(usize::try_from(code + table.offsets[length]).ok()?).copied()
    }

    /// Whether nothing but padding is left in front of the next marker.
    fn is_at_marker(&mut self) -> bool {
        let whole = self.have / 8;
        let mut left: Vec<u8> = (0..whole).rev().map(|n| (self.buffer >> (8 * n)) as u8).collect();
        let end = self.bytes[self.at..].windows(2).position(|pair| pair[0] == 0xff && pair[1] != 0);
        let end = end.unwrap_or(self.bytes.len() - self.at);
        left.extend(&self.bytes[self.at..self.at + end]);
        self.at += end;
        (self.buffer, self.have) = (0, 0);
        left.len() <= MAX_PADDING
            && (left.iter().all(|&byte| byte == 0) || left.iter().all(|&byte| byte == 0xff))
    }

    /// Goes on behind the restart marker of this number, where data end at it.
    fn restart(&mut self, number: usize) -> Option<()> {
        if !self.is_at_marker() {
            return None;
        }
        let fill = self.bytes[self.at..].iter().take_while(|&&byte| byte == 0xff).count();
        let marker = *self.bytes.get(self.at + fill)?;
        if usize::from(marker) != 0xd0 + number {
            return None;
        }
        self.at += fill + 1;
        Some(())
    }

    fn is_over(&mut self) -> bool {
        self.is_at_marker() && self.at >= self.bytes.len()
    }
}

/// The orientation that an APP1 segment states (Exif 2.32, section 4.6.4, tag 0x0112).
fn orientation(app1: &[u8]) -> Option<u8> {
    exif_orientation(app1.strip_prefix(b"Exif\0\0")?)
}

/// The orientation in EXIF data, which are a TIFF without pictures.
pub fn exif_orientation(tiff: &[u8]) -> Option<u8> {
    let big = match tiff.get(..4)? {
        b"MM\0*" => true,
        b"II*\0" => false,
        _ => return None,
    };
    let two = |at: usize| {
        let bytes: [u8; 2] = tiff.get(at..at + 2)?.try_into().ok()?;
        Some(if big { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) })
    };
    let four = |at: usize| {
        let bytes: [u8; 4] = tiff.get(at..at + 4)?.try_into().ok()?;
        Some(if big { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
    };
    let first = usize::try_from(four(4)?).ok()?;
    let entries = usize::from(two(first)?);
    let entry = (0..entries).map(|n| first + 2 + 12 * n).find(|&at| two(at) == Some(0x0112))?;
    u8::try_from(two(entry + 8)?).ok().filter(|orientation| (1..=8).contains(orientation))
}

#[cfg(test)]
#[path = "jpeg_tests.rs"]
mod tests;
