//! Markers: where segments, coded data and a picture end.

/// Finds where a picture ends, behind its end mark, as its bytes arrive. Segments are passed over
/// by their length, so that a thumbnail's end is not taken for it.
#[derive(Clone, Copy, Debug)]
pub struct EndFinder {
    at: usize,
    coded: bool,
}

/// How much of a picture's end has come.
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

/// The marker at `at`, over fill bytes, and where it ends.
pub(super) fn marker_at(bytes: &[u8], at: usize) -> Result<(u8, usize), Option<usize>> {
    let fill = bytes.get(at..).ok_or(None)?.iter().take_while(|&&byte| byte == 0xff).count();
    let marker = *bytes.get(at + fill).ok_or(None)?;
    if fill == 0 { Err(Some(at)) } else { Ok((marker, at + fill + 1)) }
}

/// Where coded data end: at the first marker other than a restart.
pub(super) fn end_of_coded(bytes: &[u8], from: usize) -> Option<usize> {
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
