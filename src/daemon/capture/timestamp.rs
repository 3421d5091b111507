//! Finds the capture time that a recorded file's name, or its folders, carry.
//!
//! Owns the forms that are understood: year, month, day (or day.month.year), hour, minute,
//! second and what follows it, with the separators that programs put between them; seconds or
//! milliseconds since 1970; and folders by day with the time of day in the name. An offset from
//! UTC counts where the name has one; without it the time is UTC, unless the caller knows better.
//! Dates that can be read in more than one way (05-01-2026, 26-01-05) are read in the order that
//! the caller asks for, and not without.

use crate::daemon::dates::Dates;
use crate::units::UtcMs;
use jiff::civil;
use jiff::tz::Offset;

/// The largest offset from UTC that a place has had, s.
const MAX_OFFSET_S: i32 = 18 * 3600;

/// The time in `path`, where its date can be read in one way alone, or where it is read in the order
/// of `dates`. Otherwise as [`from_path`].
pub fn from_path_in(path: &str, local_s: i32, dates: Dates) -> Option<UtcMs> {
    from_path(path, local_s).or_else(|| in_order(path, dates)?.time(local_s))
}

/// The time in `path`, relative and with `/` between folders. `local` is the offset from UTC of
/// names that state none, s.
pub fn from_path(path: &str, local_s: i32) -> Option<UtcMs> {
    match whole(path) {
        Some(stamp) => stamp.time(local_s),
        None => find(name_in(path), since_1970).map(|(time, _)| time),
    }
}

/// Whether the name in `path` states a fraction of a second; `.000` is one.
pub fn tells_fraction(path: &str) -> bool {
    let plain = || find(name_in(path), since_1970).map(|(_, fraction)| fraction);
    let ordered = || Dates::ALL.into_iter().find_map(|dates| in_order(path, dates));
    let told = whole(path).map(|stamp| stamp.fraction).or_else(plain);
    told.or_else(|| ordered().map(|stamp| stamp.fraction)).unwrap_or_default()
}

fn name_in(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// A time whose date can be read in one way.
fn whole(path: &str) -> Option<Stamp> {
    let whole = |bytes: &[u8]| stamp(bytes, date);
    find(name_in(path), whole).or_else(|| find(path, whole)).or_else(|| by_day(path, date))
}

/// A time whose date is read in this order.
fn in_order(path: &str, dates: Dates) -> Option<Stamp> {
    let ordered = |bytes: &[u8]| stamp(bytes, |rest| short_date(rest, dates));
    find(name_in(path), ordered).or_else(|| by_day(path, |rest| short_date(rest, dates)))
}

/// An offset from UTC as people write it: `+01:00`, `-0530`, `+1`, `Z`.
pub fn offset_s(text: &str) -> Option<i32> {
    let mut rest = text.trim().as_bytes();
    if matches!(rest, b"Z" | b"z" | b"0") {
        return Some(0);
    }
    if let [sign @ (b'+' | b'-'), hour @ b'0'..=b'9'] = rest {
        let hours = i32::from(hour - b'0') * 3600;
        return Some(if *sign == b'-' { -hours } else { hours });
    }
    let offset = read_offset(&mut rest, true)?;
    rest.is_empty().then_some(offset)
}

/// Tries each place in `text` that does not follow a digit.
fn find<T>(text: &str, parse: impl Fn(&[u8]) -> Option<T>) -> Option<T> {
    let bytes = text.as_bytes();
    (0..bytes.len()).find_map(|start| {
        let after_digit = start > 0 && bytes[start - 1].is_ascii_digit();
        if after_digit { None } else { parse(&bytes[start..]) }
    })
}

struct Stamp {
    civil: civil::DateTime,
    offset_s: Option<i32>,
    /// Whether the name states a fraction of a second.
    fraction: bool,
}

impl Stamp {
    fn time(&self, local_s: i32) -> Option<UtcMs> {
        let offset = Offset::from_seconds(self.offset_s.unwrap_or(local_s)).ok()?;
        let timestamp = offset.to_timestamp(self.civil).ok()?;
        Some(UtcMs(timestamp.as_millisecond()))
    }
}

fn stamp(bytes: &[u8], date: impl Fn(&mut &[u8]) -> Option<civil::Date>) -> Option<Stamp> {
    let mut rest = bytes;
    let date = date(&mut rest)?;
    let between = rest;
    skip(&mut rest, b" ");
    if let Some(tail) = rest.strip_prefix(b"at ") {
        rest = tail;
    } else {
        rest = between;
        (0..3).for_each(|_| skip(&mut rest, b"-_ .,:/Tt@"));
    }
    let iso = bytes[..bytes.len() - rest.len()].ends_with(b"T");
    time_of_day(date, &mut rest, iso)
}

/// Year, month, day; or day, month, year with dots between them.
fn date(rest: &mut &[u8]) -> Option<civil::Date> {
    let begun = *rest;
    if let (Some(day), true) = (number(rest, 2), rest.first() == Some(&b'.')) {
        skip(rest, b".");
        let month = number(rest, 2);
        skip(rest, b".");
        if let (Some(month), Some(year)) = (month, number(rest, 4)) {
            return whole_date(year, month, day);
        }
    }
    *rest = begun;
    let year = number(rest, 4)?;
    skip(rest, b"-_.:/");
    let month = number(rest, 2)?;
    skip(rest, b"-_.:/");
    whole_date(year, month, number(rest, 2)?)
}

/// The first year that a date of two digits can have: no recording to measure is older.
const FIRST_YEAR: i32 = 2010;

/// Three numbers with one kind of separator between them, in the order of `dates`; day and month may
/// have one digit beside a whole year, as in 1-5-2026.
fn short_date(rest: &mut &[u8], dates: Dates) -> Option<civil::Date> {
    let first = up_to_two(rest)?;
    let separator = *rest.first().filter(|byte| b"-_./ ".contains(byte))?;
    skip(rest, &[separator]);
    let second = up_to_two(rest)?;
    if rest.first() != Some(&separator) {
        return None;
    }
    skip(rest, &[separator]);
    let digits = rest.iter().take_while(|byte| byte.is_ascii_digit()).count();
    let third = number(rest, if digits >= 4 { 4 } else { 2 })?;
    let whole = |(number, digits): (i32, usize)| (digits == 2).then_some(number);
    let (year, month, day) = match (dates, digits) {
        (Dates::DayFirst, 4) => (third, second.0, first.0),
        (Dates::MonthFirst, 4) => (third, first.0, second.0),
        (Dates::YearFirst, 2) => (2000 + whole(first)?, whole(second)?, third),
        (Dates::DayFirst, 2) => (2000 + third, whole(second)?, whole(first)?),
        (Dates::MonthFirst, 2) => (2000 + third, whole(first)?, whole(second)?),
        _ => return None,
    };
    whole_date(year, month, day).filter(|_| year >= FIRST_YEAR)
}

/// One or two digits, and how many.
fn up_to_two(rest: &mut &[u8]) -> Option<(i32, usize)> {
    let digits = rest.iter().take_while(|byte| byte.is_ascii_digit()).count();
    if !(1..=2).contains(&digits) {
        return None;
    }
    Some((number(rest, digits)?, digits))
}

fn whole_date(year: i32, month: i32, day: i32) -> Option<civil::Date> {
    if !(1970..=2199).contains(&year) {
        return None;
    }
    let small = |n: i32| i8::try_from(n).ok();
    civil::Date::new(i16::try_from(year).ok()?, small(month)?, small(day)?).ok()
}

/// Hour, minute, second, and what follows them. With `iso` a `-` begins an offset.
fn time_of_day(date: civil::Date, rest: &mut &[u8], iso: bool) -> Option<Stamp> {
    let begun = *rest;
    let hour = match number(rest, 2) {
        Some(hour) => hour,
        // Of a clock with twelve hours.
        None => {
            *rest = begun;
            let hour = number(rest, 1)?;
            if !rest.starts_with(b".") && !rest.starts_with(b"-") {
                return None;
            }
            hour
        }
    };
    skip(rest, b"-_.:/h");
    let minute = number(rest, 2)?;
    skip(rest, b"-_.:/m");
    let second = number(rest, 2)?;
    let nanosecond = fraction(rest);
    let fraction = nanosecond.is_some();
    skip(rest, b"s");
    if rest.first().is_some_and(u8::is_ascii_digit) {
        return None;
    }
    let mut hour = hour;
    let half = rest.trim_ascii_start().get(..2).map(<[u8]>::to_ascii_uppercase);
    match half.as_deref() {
        Some(b"AM") if hour == 12 => hour = 0,
        Some(b"PM") if hour < 12 => hour += 12,
        _ => {}
    }
    let small = |n: i32| i8::try_from(n).ok();
    let time =
        civil::Time::new(small(hour)?, small(minute)?, small(second)?, nanosecond.unwrap_or(0));
    let time = time.ok()?;
    let offset_s = offset_behind(rest, iso);
    Some(Stamp { civil: date.to_datetime(time), offset_s, fraction })
}

/// Three digits (milliseconds) or six (microseconds), directly behind the seconds or behind one
/// separator, as nanoseconds. Other digits are counters.
fn fraction(rest: &mut &[u8]) -> Option<i32> {
    let separated = matches!(rest.first(), Some(b'.' | b',' | b'_' | b'-'));
    let tail = if separated { &rest[1..] } else { *rest };
    let digits = tail.iter().take_while(|byte| byte.is_ascii_digit()).count();
    let mut read = tail;
    match (digits, number(&mut read, digits)) {
        (3, Some(milliseconds)) => {
            *rest = read;
            Some(milliseconds * 1_000_000)
        }
        (6, Some(microseconds)) if separated && rest[0] == b'.' => {
            *rest = read;
            Some(microseconds * 1000)
        }
        _ => None,
    }
}

/// The offset behind a time. A `-` begins one in ISO's form only: elsewhere it begins a counter.
fn offset_behind(rest: &[u8], iso: bool) -> Option<i32> {
    let mut tail = rest;
    if matches!(tail.first(), Some(b'Z' | b'z')) {
        return Some(0);
    }
    if matches!(tail, [b'_' | b' ', b'+', ..]) {
        tail = &tail[1..];
    }
    for name in [&b"UTC"[..], b"GMT", b"_UTC", b"_GMT", b" UTC", b" GMT"] {
        if let Some(behind) = tail.strip_prefix(name) {
            let mut behind = behind;
            let hours = match behind {
                [_, hour @ b'0'..=b'9', next, ..] if !next.is_ascii_digit() => {
                    i32::from(hour - b'0')
                }
                _ => 0,
            };
            let short = match behind.first() {
                Some(b'+') => hours * 3600,
                Some(b'-') => -hours * 3600,
                _ => 0,
            };
            return Some(read_offset(&mut behind, true).unwrap_or(short));
        }
    }
    let colon = tail.get(3) == Some(&b':');
    read_offset(&mut tail, iso || colon)
}

/// `+0100`, `+01:00`, `+01-00` or `+01`; with `minus` also those with a minus.
fn read_offset(rest: &mut &[u8], minus: bool) -> Option<i32> {
    let sign = match rest.first()? {
        b'+' => 1,
        b'-' if minus => -1,
        _ => return None,
    };
    let mut tail = &rest[1..];
    let hours = number(&mut tail, 2)?;
    let mut with_minutes = tail;
    skip(&mut with_minutes, b":-");
    let minutes = match number(&mut with_minutes, 2) {
        Some(minutes) if minutes % 15 == 0 && minutes < 60 => {
            tail = with_minutes;
            minutes
        }
        Some(_) => return None,
        None => 0,
    };
    if tail.first().is_some_and(u8::is_ascii_digit) {
        return None;
    }
    let offset = hours * 3600 + minutes * 60;
    *rest = tail;
    (offset <= MAX_OFFSET_S).then_some(sign * offset)
}

/// A day in a folder's name, or in three, and a time of day behind it.
fn by_day(path: &str, date: impl Fn(&mut &[u8]) -> Option<civil::Date>) -> Option<Stamp> {
    let starts = std::iter::once(0).chain(path.match_indices('/').map(|(at, _)| at + 1));
    for start in starts {
        let mut rest = &path.as_bytes()[start..];
        let Some(date) = date(&mut rest).filter(|_| rest.first() == Some(&b'/')) else { continue };
        let behind = &path[path.len() - rest.len() + 1..];
        let name_at = behind.rfind('/').map_or(0, |at| at + 1);
        let parts = std::iter::once(0).chain(behind.match_indices('/').map(|(at, _)| at + 1));
        // At a part's beginning, or anywhere in the name where it has separators.
        let at_part = parts.filter_map(|at| {
            let mut rest = &behind.as_bytes()[at..];
            time_of_day(date, &mut rest, false)
        });
        let in_name = || {
            find(&behind[name_at..], |bytes| {
                let separated = bytes.get(2).is_some_and(|byte| !byte.is_ascii_digit());
                let mut rest = bytes;
                if separated { time_of_day(date, &mut rest, false) } else { None }
            })
        };
        // The name tells most: folders may stand for the hour as well, as in 08/08.00.00.jpg.
        let stamp =
            in_name().or_else(|| at_part.into_iter().next()).or_else(|| by_hour(date, behind));
        if stamp.is_some() {
            return stamp;
        }
    }
    None
}

/// A folder by hour, and minute and second in the name, whatever stands between: `08/camera/00.05.jpg`.
fn by_hour(date: civil::Date, behind: &str) -> Option<Stamp> {
    let (folders, name) = behind.rsplit_once('/')?;
    let (hour, _) = folders.split_once('/').unwrap_or((folders, ""));
    let name = name.split_once('.').map_or(name, |_| name.rsplit_once('.').map_or(name, |n| n.0));
    let bytes = format!("{hour}-{name}").into_bytes();
    let mut rest = bytes.as_slice();
    let separated = bytes.len() == 8 && bytes[2] == b'-' && !bytes[5].is_ascii_digit();
    if separated { time_of_day(date, &mut rest, false).filter(|_| rest.is_empty()) } else { None }
}

/// Seconds since 1970, with milliseconds behind a dot, or milli-, micro- or nanoseconds: the years 2001
/// to 2100. And whether they state a fraction of a second.
fn since_1970(bytes: &[u8]) -> Option<(UtcMs, bool)> {
    let digits = bytes.iter().take_while(|byte| byte.is_ascii_digit()).count();
    let value: i64 = std::str::from_utf8(bytes.get(..digits)?).ok()?.parse().ok()?;
    let seconds = 1_000_000_000..4_102_444_800;
    match digits {
        10 if seconds.contains(&value) => {
            let mut rest = &bytes[digits..];
            let separated = rest.first() == Some(&b'.');
            let nanoseconds = if separated { fraction(&mut rest) } else { None };
            let milliseconds = i64::from(nanoseconds.unwrap_or(0) / 1_000_000);
            Some((UtcMs(value * 1000 + milliseconds), nanoseconds.is_some()))
        }
        13 if seconds.contains(&(value / 1000)) => Some((UtcMs(value), true)),
        16 if seconds.contains(&(value / 1_000_000)) => Some((UtcMs(value / 1000), true)),
        19 if seconds.contains(&(value / 1_000_000_000)) => Some((UtcMs(value / 1_000_000), true)),
        _ => None,
    }
}

/// Takes one of these bytes off the front, if one is there.
fn skip(rest: &mut &[u8], any: &[u8]) {
    if let [first, tail @ ..] = rest
        && any.contains(first)
    {
        *rest = tail;
    }
}

/// Takes `digits` decimal digits off the front.
fn number(rest: &mut &[u8], digits: usize) -> Option<i32> {
    let (head, tail) = rest.split_at_checked(digits)?;
    let value = head.iter().try_fold(0_i32, |value, byte| {
        let digit = byte.is_ascii_digit().then(|| i32::from(byte - b'0'))?;
        value.checked_mul(10)?.checked_add(digit)
    })?;
    *rest = tail;
    Some(value)
}

#[cfg(test)]
#[path = "timestamp_tests.rs"]
mod tests;
