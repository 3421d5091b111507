//! RTP packets (RFC 3550) in their order.
//!
//! Owns the fixed header and what is missing between sequence numbers. Knows no codec.

/// Larger leaps of the sequence number are a stream that began again.
const LARGEST_GAP: u16 = 3000;

/// A packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet<'a> {
    /// Whether it is the last of its picture.
    pub marker: bool,
    /// Number of the packet.
    pub sequence: u16,
    /// When its picture was taken, in ticks of the stream's clock.
    pub timestamp: u32,
    /// Its content.
    pub payload: &'a [u8],
}

impl<'a> Packet<'a> {
    /// Reads a packet; `None` where the bytes are not one.
    pub fn parse(bytes: &'a [u8]) -> Option<Self> {
        let (header, mut payload) = bytes.split_first_chunk::<12>()?;
        if header[0] >> 6 != 2 {
            return None;
        }
        payload = payload.get(4 * usize::from(header[0] & 15)..)?;
        if header[0] & 0x10 != 0 {
            let (extension, rest) = payload.split_first_chunk::<4>()?;
            let words = usize::from(u16::from_be_bytes([extension[2], extension[3]]));
            payload = rest.get(4 * words..)?;
        }
        if header[0] & 0x20 != 0 {
            let padding = usize::from(*payload.last()?);
            payload = payload.get(..payload.len().checked_sub(padding.max(1))?)?;
        }
        Some(Self {
            marker: header[1] & 0x80 != 0,
            sequence: u16::from_be_bytes([header[2], header[3]]),
            timestamp: u32::from_be_bytes([header[4], header[5], header[6], header[7]]),
            payload,
        })
    }
}

/// Counts what is missing between packets.
#[derive(Clone, Copy, Debug, Default)]
pub struct Order {
    last: Option<u16>,
}

/// How a packet follows the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Follows {
    /// Directly.
    Next,
    /// After this many that are missing; 0: the stream began again, or goes back.
    Gap(u16),
}

impl Order {
    /// Takes the number of the next packet.
    pub fn follows(&mut self, sequence: u16) -> Follows {
        let last = self.last.replace(sequence);
        match last.map(|last| sequence.wrapping_sub(last)) {
            None | Some(1) => Follows::Next,
            Some(0) => Follows::Gap(0),
            Some(step) if step <= LARGEST_GAP => Follows::Gap(step - 1),
            Some(_) => Follows::Gap(0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_with_everything_that_they_may_have() {
        let mut bytes = vec![0x80 | 0x20 | 0x10 | 1, 0x80 | 96, 0, 7, 0, 0, 0, 9, 1, 2, 3, 4];
        bytes.extend([9, 9, 9, 9]);
        bytes.extend([0, 0, 0, 1, 8, 8, 8, 8]);
        bytes.extend([1, 2, 3, 0, 0, 3]);
        let packet = Packet::parse(&bytes).expect("a packet");
        let expected = Packet { marker: true, sequence: 7, timestamp: 9, payload: &[1, 2, 3] };
        assert_eq!(packet, expected);
        for len in 0..bytes.len() {
            let _ = Packet::parse(&bytes[..len]);
        }
        assert_eq!(Packet::parse(&[0; 12]), None);
    }

    #[test]
    fn gaps_are_counted() {
        let mut order = Order::default();
        assert_eq!(order.follows(65_534), Follows::Next);
        assert_eq!(order.follows(65_535), Follows::Next);
        assert_eq!(order.follows(2), Follows::Gap(2));
        assert_eq!(order.follows(2), Follows::Gap(0));
        assert_eq!(order.follows(40_000), Follows::Gap(0));
    }
}
