//! Until when a certificate is valid.
//!
//! Owns the way through its DER form to one date (RFC 5280, section 4.1), and nothing else of it:
//! whether it is to be trusted is `rustls`'.

use crate::units::UtcMs;
use jiff::civil;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

/// Tags of the two forms of a time.
const UTC_TIME: u8 = 0x17;
const GENERALIZED_TIME: u8 = 0x18;

/// The end of a certificate's validity, "not after"; `None` for what is not a certificate, and for one
/// that does not end (99991231235959Z).
pub fn not_after(der: &[u8]) -> Option<UtcMs> {
    let (tag, time) = end_of(der)?;
    time_of(tag, time)
}

/// Whether this has the form of a certificate, whatever it says.
pub fn is_certificate(der: &[u8]) -> bool {
    end_of(der).is_some_and(|(tag, _)| matches!(tag, UTC_TIME | GENERALIZED_TIME))
}

/// The end of the validity as it stands there, with its tag.
fn end_of(der: &[u8]) -> Option<(u8, &[u8])> {
    let (_, certificate, _) = element(der)?;
    let (_, mut rest, _) = element(certificate)?;
    // Version, where it is not the first: an explicit tag 0.
    let (tag, _, behind) = element(rest)?;
    if tag == 0xa0 {
        rest = behind;
    }
    // Serial number, algorithm, issuer.
    for _ in 0..3 {
        (_, _, rest) = element(rest)?;
    }
    let (_, validity, _) = element(rest)?;
    let (_, _, rest) = element(validity)?;
    let (tag, time, _) = element(rest)?;
    Some((tag, time))
}

/// Tag, content, and what follows.
fn element(der: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&tag, rest) = der.split_first()?;
    let (&first, rest) = rest.split_first()?;
    let (len, rest) = if first < 0x80 {
        (usize::from(first), rest)
    } else {
        let (bytes, rest) = rest.split_at_checked(usize::from(first & 0x7f))?;
        if bytes.is_empty() || bytes.len() > 4 {
            return None;
        }
        (bytes.iter().fold(0, |len, &byte| len << 8 | usize::from(byte)), rest)
    };
    let (content, behind) = rest.split_at_checked(len)?;
    Some((tag, content, behind))
}

/// `UTCTime` (two digits of the year, RFC 5280, 4.1.2.5.1) or `GeneralizedTime`.
fn time_of(tag: u8, text: &[u8]) -> Option<UtcMs> {
    let text = std::str::from_utf8(text).ok()?.strip_suffix('Z')?;
    let (year, rest) = match tag {
        UTC_TIME => {
            let (year, rest) = text.split_at_checked(2)?;
            let year: i16 = year.parse().ok()?;
            (if year < 50 { 2000 + year } else { 1900 + year }, rest)
        }
        GENERALIZED_TIME => {
            let (year, rest) = text.split_at_checked(4)?;
            (year.parse().ok()?, rest)
        }
        _ => return None,
    };
    let digits = |at: usize| rest.get(at..at + 2)?.parse::<i8>().ok();
    let date = civil::date(year, 1, 1).with().month(digits(0)?).day(digits(2)?).build().ok()?;
    let time = civil::Time::new(digits(4)?, digits(6)?, digits(8)?, 0).ok()?;
    let stamp = date.to_datetime(time).to_zoned(jiff::tz::TimeZone::UTC).ok()?;
    Some(UtcMs(stamp.timestamp().as_millisecond()))
}

/// When the certificate that a peer has shown last ends; shared with who asks.
#[derive(Clone, Debug)]
pub struct End(Arc<AtomicI64>);

impl Default for End {
    fn default() -> Self {
        Self(Arc::new(AtomicI64::new(i64::MAX)))
    }
}

impl End {
    /// A peer has shown this certificate.
    pub fn note(&self, der: &[u8]) {
        self.0.store(not_after(der).map_or(i64::MAX, |end| end.0), Ordering::Relaxed);
    }

    /// Its end; `None` while none was shown.
    pub fn get(&self) -> Option<UtcMs> {
        Some(self.0.load(Ordering::Relaxed)).filter(|&end| end != i64::MAX).map(UtcMs)
    }
}

/// Whole days from `now` to the end; negative when it is over.
pub fn days_left(not_after: UtcMs, now: UtcMs) -> i64 {
    (not_after.0 - now.0).div_euclid(86_400_000)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn made(year: i32) -> Vec<u8> {
        let mut parameters = rcgen::CertificateParams::new(["box".to_owned()]).expect("a name");
        parameters.not_after = rcgen::date_time_ymd(year, 11, 30);
        let key = rcgen::KeyPair::generate().expect("a key");
        parameters.self_signed(&key).expect("a certificate").der().to_vec()
    }

    #[test]
    fn the_end_is_read_in_both_forms() {
        for (year, expected) in [(2027, 1_827_532_800_000), (2061, 2_900_534_400_000)] {
            assert_eq!(not_after(&made(year)), Some(UtcMs(expected)), "{year}");
        }
        assert_eq!(days_left(UtcMs(86_400_000 * 3), UtcMs(1)), 2);
        assert_eq!(days_left(UtcMs(0), UtcMs(1)), -1);
    }

    #[test]
    fn no_bytes_make_the_reader_panic() {
        let whole = made(2027);
        for len in 0..whole.len() {
            assert_eq!(not_after(&whole[..len]), None);
        }
        let mut random = fastrand::Rng::with_seed(4);
        for _ in 0..2000 {
            let mut bytes = whole.clone();
            bytes[random.usize(..200)] = random.u8(..);
            let _ = not_after(&bytes);
        }
    }
}
