//! Finds the capture time that a file name carries.
//!
//! Owns the forms that are understood: year, month, day, hour, minute, second, and
//! milliseconds where they follow a dot, with or without `-`, `_`, `:`, `T` or a space
//! between them, anywhere in the name. The time is UTC.

use crate::units::UtcMs;
use jiff::civil;
use jiff::tz::Offset;

/// The time in `name`, if there is one.
pub fn from_name(name: &str) -> Option<UtcMs> {
    let bytes = name.as_bytes();
    (0..bytes.len()).find_map(|start| {
        let after_digit = start > 0 && bytes[start - 1].is_ascii_digit();
        if after_digit { None } else { parse_at(&bytes[start..]) }
    })
}

fn parse_at(bytes: &[u8]) -> Option<UtcMs> {
    let mut rest = bytes;
    let year = number(&mut rest, 4)?;
    if !(1970..=2199).contains(&year) {
        return None;
    }
    let mut field = || {
        if let [b'-' | b'_' | b':' | b'T' | b' ', tail @ ..] = rest {
            rest = tail;
        }
        number(&mut rest, 2)
    };
    let (month, day) = (field()?, field()?);
    let (hour, minute, second) = (field()?, field()?, field()?);
    let mut millisecond = 0;
    if let [b'.', tail @ ..] = rest {
        let mut tail = tail;
        if let Some(ms) = number(&mut tail, 3) {
            (millisecond, rest) = (ms, tail);
        }
    }
    if rest.first().is_some_and(u8::is_ascii_digit) {
        return None;
    }
    let two = |n: i32| i8::try_from(n).ok();
    let time = civil::DateTime::new(
        i16::try_from(year).ok()?,
        two(month)?,
        two(day)?,
        two(hour)?,
        two(minute)?,
        two(second)?,
        millisecond * 1_000_000,
    );
    let timestamp = Offset::UTC.to_timestamp(time.ok()?).ok()?;
    Some(UtcMs(timestamp.as_millisecond()))
}

/// Takes `digits` decimal digits off the front.
fn number(rest: &mut &[u8], digits: usize) -> Option<i32> {
    let (head, tail) = rest.split_at_checked(digits)?;
    let value = head.iter().try_fold(0, |value, byte| {
        byte.is_ascii_digit().then(|| value * 10 + i32::from(byte - b'0'))
    })?;
    *rest = tail;
    Some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_real_recordings() {
        let eight = UtcMs(1_767_600_000_000);
        for (name, expected) in [
            ("20260105T080000.000Z.jpg", Some(eight)),
            ("20260105T080000.250Z.jpg", Some(UtcMs(eight.0 + 250))),
            ("1001-2026_01_05_080000.jpg", Some(eight)),
            ("cam7 2026-01-05 08:00:00.png", Some(eight)),
            ("K109F_20260105080000.jpg", Some(eight)),
            ("vehicle_01.jpg", None),
            ("20261305T080000Z.jpg", None),
            ("20260105T0800.jpg", None),
            ("9920260105080000.jpg", None),
            ("202601050800001.jpg", None),
        ] {
            assert_eq!(from_name(name), expected, "{name}");
        }
    }
}
