//! UTC instants in milliseconds, and the two ways a recording writes them.
//!
//! Owns parsing and printing of RFC 3339 UTC times; knows no clock.

/// Milliseconds since 1970-01-01T00:00:00Z.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct UtcMs(pub i64);

const DAY_MS: i64 = 86_400_000;

impl UtcMs {
    /// Reads `YYYY-MM-DDTHH:MM:SSZ`, with optional milliseconds; `None` for anything else.
    pub fn parse(text: &str) -> Option<Self> {
        let body = text.strip_suffix('Z')?;
        let (date, time) = body.split_once('T')?;
        let number = |part: &str, digits: usize| -> Option<i64> {
            (part.len() == digits && part.bytes().all(|b| b.is_ascii_digit()))
                .then(|| part.parse().ok())?
        };
        let mut date = date.splitn(3, '-');
        let (year, month, day) =
            (number(date.next()?, 4)?, number(date.next()?, 2)?, number(date.next()?, 2)?);
        let (time, millis) = match time.split_once('.') {
            Some((time, fraction)) => (time, number(fraction, 3)?),
            None => (time, 0),
        };
        let mut time = time.splitn(3, ':');
        let (hour, minute, second) =
            (number(time.next()?, 2)?, number(time.next()?, 2)?, number(time.next()?, 2)?);
        if !(1..=12).contains(&month) || hour > 23 || minute > 59 || second > 59 {
            return None;
        }
        let days = days_from_civil(year, month, day);
        if civil_from_days(days) != (year, month, day) {
            return None;
        }
        Some(UtcMs(days * DAY_MS + ((hour * 60 + minute) * 60 + second) * 1000 + millis))
    }

    /// This instant plus a time in seconds, to the nearest millisecond.
    pub fn plus_s(self, seconds: f64) -> Self {
        UtcMs(self.0 + (seconds * 1000.0).round() as i64)
    }

    /// `YYYY-MM-DDTHH:MM:SS.mmmZ`.
    pub fn rfc3339(self) -> String {
        let (y, m, d, h, min, s, ms) = self.fields();
        format!("{y:04}-{m:02}-{d:02}T{h:02}:{min:02}:{s:02}.{ms:03}Z")
    }

    /// `YYYYMMDDTHHMMSS.mmmZ`, the stem of a frame's name.
    pub fn file_stem(self) -> String {
        let (y, m, d, h, min, s, ms) = self.fields();
        format!("{y:04}{m:02}{d:02}T{h:02}{min:02}{s:02}.{ms:03}Z")
    }

    fn fields(self) -> (i64, i64, i64, i64, i64, i64, i64) {
        let (y, m, d) = civil_from_days(self.0.div_euclid(DAY_MS));
        let ms = self.0.rem_euclid(DAY_MS);
        (y, m, d, ms / 3_600_000, ms / 60_000 % 60, ms / 1000 % 60, ms % 1000)
    }
}

/// Days since 1970-01-01 of a Gregorian date (H. Hinnant, "chrono-compatible date algorithms").
fn days_from_civil(year: i64, month: i64, day: i64) -> i64 {
    let y = if month <= 2 { year - 1 } else { year };
    let era = y.div_euclid(400);
    let year_of_era = y - era * 400;
    let day_of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    let day_of_era = year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + day_of_year;
    era * 146_097 + day_of_era - 719_468
}

/// The inverse of [`days_from_civil`].
fn civil_from_days(days: i64) -> (i64, i64, i64) {
    let z = days + 719_468;
    let era = z.div_euclid(146_097);
    let doe = z - era * 146_097;
    let yoe = (doe - doe / 1460 + doe / 36_524 - doe / 146_096) / 365;
    let doy = doe - (365 * yoe + yoe / 4 - yoe / 100);
    let mp = (5 * doy + 2) / 153;
    let month = if mp < 10 { mp + 3 } else { mp - 9 };
    (yoe + era * 400 + i64::from(month <= 2), month, doy - (153 * mp + 2) / 5 + 1)
}

#[cfg(test)]
mod tests {
    use super::UtcMs;

    #[test]
    fn times_are_read_and_printed() {
        let start = UtcMs::parse("2026-01-05T08:00:00Z").expect("a valid time");
        assert_eq!(start.0, 1_767_600_000_000);
        assert_eq!(start.plus_s(61.5).rfc3339(), "2026-01-05T08:01:01.500Z");
        assert_eq!(start.file_stem(), "20260105T080000.000Z");
        assert_eq!(
            UtcMs::parse("2024-02-29T23:59:59.999Z").unwrap().plus_s(0.001).rfc3339(),
            "2024-03-01T00:00:00.000Z"
        );
        for bad in [
            "",
            "2026-02-29T00:00:00Z",
            "2026-01-05 08:00:00Z",
            "2026-01-05T24:00:00Z",
            "2026-01-05T08:00:00",
        ] {
            assert_eq!(UtcMs::parse(bad), None, "{bad}");
        }
    }
}
