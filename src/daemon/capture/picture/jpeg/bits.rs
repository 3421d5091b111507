//! The bits of coded data, and the Huffman tables that make symbols of them.

/// Bytes of padding that are passed over behind a scan's last block: some chips fill up words.
const MAX_PADDING: usize = 16;

/// A Huffman table for decoding (annex F.2.2.3), with a look-up for short codes.
pub(super) struct Huffman {
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
    pub fn new(counts: &[u8], symbols: &[u8]) -> Option<Self> {
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
pub(super) struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    buffer: u64,
    have: u32,
}

impl<'a> Bits<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
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

    pub fn take(&mut self, count: u32) -> Option<u32> {
        if self.have < count {
            self.fill();
        }
        self.have = self.have.checked_sub(count)?;
        Some((self.buffer >> self.have) as u32 & ((1 << count) - 1))
    }

    pub fn symbol(&mut self, table: &Huffman) -> Option<u8> {
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
    pub fn restart(&mut self, number: usize) -> Option<()> {
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

    /// Whether nothing is left but padding and the bytes that may stand in front of a marker (B.1.1.2).
    pub fn is_over(&mut self) -> bool {
        self.is_at_marker() && self.bytes[self.at..].iter().all(|&byte| byte == 0xff)
    }
}
