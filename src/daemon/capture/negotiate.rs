//! Choice among a camera's formats, sizes and frame rates: one rule.
//!
//! Owns the rule and knows no device. In this order:
//!
//! 1. The size: the shape (width over height) must be the wanted one; the wanted size
//!    itself, else the smallest that covers it, else the largest.
//! 2. The rate: a format that reaches [`least_rate`] at this size, before one that does not.
//! 3. The format: YUYV, NV12, MJPG, GREY. Raw pixels before compressed ones (no artefacts,
//!    no decoding), colour before grey; a camera whose bus cannot carry raw pixels at the
//!    rate does not offer that rate, so step 2 has settled it.
//! 4. Of the rates the slowest that suffices: long exposures at night, little heat.

use std::time::Duration;

/// Largest departure of width over height from the wanted shape.
const MAX_SHAPE_ERROR: f64 = 0.01;
/// Least frame rate, Hz: a picture that is asked for is at most 0.2 s old.
const LEAST_RATE: f64 = 5.0;

/// How pixels are encoded, in order of preference.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Encoding {
    /// YUYV 4:2:2.
    Yuyv,
    /// NV12 4:2:0.
    Nv12,
    /// One JPEG a frame.
    Mjpg,
    /// Luma alone.
    Grey,
}

impl Encoding {
    /// All that are read.
    pub const ALL: [Self; 4] = [Self::Yuyv, Self::Nv12, Self::Mjpg, Self::Grey];

    /// Its four-character code.
    pub const fn fourcc(self) -> [u8; 4] {
        *match self {
            Self::Yuyv => b"YUYV",
            Self::Nv12 => b"NV12",
            Self::Mjpg => b"MJPG",
            Self::Grey => b"GREY",
        }
    }
}

/// Time between two frames as drivers tell it, s: a fraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameTime {
    /// Seconds.
    pub numerator: u32,
    /// By which they are divided.
    pub denominator: u32,
}

impl FrameTime {
    /// Frames per second; `None` for a fraction that is not a time.
    pub fn rate_hz(self) -> Option<f64> {
        let whole = self.numerator > 0 && self.denominator > 0;
        whole.then(|| f64::from(self.denominator) / f64::from(self.numerator))
    }
}

/// One size in one format, with the rates that it has there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Offer {
    /// Format.
    pub encoding: Encoding,
    /// Columns and rows, px.
    pub size: (u32, u32),
    /// Rates; empty where the driver does not tell.
    pub times: Vec<FrameTime>,
}

/// The format, size and rate asked of the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Choice {
    /// Format.
    pub encoding: Encoding,
    /// Columns and rows, px.
    pub size: (u32, u32),
    /// Rate; `None` where the driver does not tell its rates.
    pub time: Option<FrameTime>,
}

/// The rate that suffices when a picture is taken each `interval`: twice as fast, so that a
/// late frame is still a new one.
pub fn least_rate(interval: Duration) -> f64 {
    (2.0 / interval.as_secs_f64().max(1e-3)).max(LEAST_RATE)
}

/// Chooses among `offers`; `None` where none has the shape of `wanted`.
pub fn choose(offers: &[Offer], wanted: (u32, u32), least_rate_hz: f64) -> Option<Choice> {
    let chosen = offers
        .iter()
        .filter(|offer| same_shape(offer.size, wanted))
        .min_by_key(|offer| (size_rank(offer.size, wanted), rate_rank(offer, least_rate_hz)))?;
    Some(Choice {
        encoding: chosen.encoding,
        size: chosen.size,
        time: slowest_that_suffices(&chosen.times, least_rate_hz),
    })
}

/// Whether two sizes differ by scale alone.
pub fn same_shape((width, height): (u32, u32), wanted: (u32, u32)) -> bool {
    let aspect = |width: u32, height: u32| f64::from(width) / f64::from(height);
    (aspect(width, height) / aspect(wanted.0, wanted.1) - 1.0).abs() < MAX_SHAPE_ERROR
}

/// The value nearest to `wanted` in a range with steps.
pub fn stepped(wanted: u32, least: u32, most: u32, step: u32) -> u32 {
    let wanted = wanted.clamp(least, most.max(least));
    least + (wanted - least).next_multiple_of(step.max(1)).min(most.max(least) - least)
}

/// Sizes that cover the wanted one by rising area, then the others by falling area.
fn size_rank((width, height): (u32, u32), wanted: (u32, u32)) -> (bool, i64) {
    let covers = width >= wanted.0 && height >= wanted.1;
    let area = i64::from(width) * i64::from(height);
    (!covers, if covers { area } else { -area })
}

/// Fast enough, of unknown rate, or too slow; the same by preferred format.
fn rate_rank(offer: &Offer, least_rate_hz: f64) -> (u8, Encoding) {
    let mut rates = offer.times.iter().filter_map(|time| time.rate_hz());
    let rank = match () {
        () if offer.times.is_empty() => 1,
        () if rates.any(|rate| rate >= least_rate_hz) => 0,
        () => 2,
    };
    (rank, offer.encoding)
}

fn slowest_that_suffices(times: &[FrameTime], least_rate_hz: f64) -> Option<FrameTime> {
    let by_rate = |a: &&FrameTime, b: &&FrameTime| a.rate_hz().partial_cmp(&b.rate_hz());
    let order = |a: &&FrameTime, b: &&FrameTime| by_rate(a, b).unwrap_or(std::cmp::Ordering::Equal);
    let usable = || times.iter().filter(|time| time.rate_hz().is_some());
    usable()
        .filter(|time| time.rate_hz().is_some_and(|rate| rate >= least_rate_hz))
        .min_by(order)
        .or_else(|| usable().max_by(order))
        .copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn offer(encoding: Encoding, size: (u32, u32), rates: &[u32]) -> Offer {
        let time = |&rate| FrameTime { numerator: 1, denominator: rate };
        Offer { encoding, size, times: rates.iter().map(time).collect() }
    }

    fn chosen(offers: &[Offer], wanted: (u32, u32), least_rate_hz: f64) -> String {
        match choose(offers, wanted, least_rate_hz) {
            Some(Choice { encoding, size: (width, height), time }) => {
                let rate = time.map_or("?".to_owned(), |t| t.denominator.to_string());
                format!("{encoding:?} {width}x{height} {rate}")
            }
            None => "nothing".to_owned(),
        }
    }

    #[test]
    fn the_rule_on_cameras_as_they_are() {
        use Encoding::{Grey, Mjpg, Nv12, Yuyv};
        // A webcam on USB 2: raw pixels are slow where they are large.
        let webcam = [
            offer(Mjpg, (640, 480), &[30]),
            offer(Mjpg, (1280, 720), &[30]),
            offer(Mjpg, (1920, 1080), &[30]),
            offer(Yuyv, (320, 240), &[30, 15]),
            offer(Yuyv, (640, 480), &[30, 15, 10, 5]),
            offer(Yuyv, (1920, 1080), &[3]),
        ];
        let thermal = [offer(Grey, (640, 480), &[9]), offer(Yuyv, (640, 480), &[9])];
        let silent = [offer(Nv12, (640, 480), &[])];
        for (offers, wanted, rate, expected) in [
            (&webcam[..], (640, 480), 5.0, "Yuyv 640x480 5"),
            (&webcam, (640, 480), 12.0, "Yuyv 640x480 15"),
            (&webcam, (640, 480), 50.0, "Yuyv 640x480 30"),
            (&webcam, (320, 240), 5.0, "Yuyv 320x240 15"),
            (&webcam, (400, 300), 5.0, "Yuyv 640x480 5"),
            (&webcam, (1920, 1080), 5.0, "Mjpg 1920x1080 30"),
            (&webcam, (3840, 2160), 5.0, "Mjpg 1920x1080 30"),
            (&webcam, (500, 500), 5.0, "nothing"),
            (&thermal, (640, 480), 5.0, "Yuyv 640x480 9"),
            (&silent, (640, 480), 5.0, "Nv12 640x480 ?"),
            (&[], (640, 480), 5.0, "nothing"),
        ] {
            assert_eq!(chosen(offers, wanted, rate), expected, "{wanted:?} at {rate} Hz");
        }
    }

    #[test]
    fn the_order_of_offers_does_not_matter() {
        let mut offers: Vec<_> = Encoding::ALL
            .iter()
            .flat_map(|&e| [(320, 240), (640, 480)].map(|size| offer(e, size, &[30, 5])))
            .collect();
        let first = chosen(&offers, (640, 480), 5.0);
        for _ in 0..offers.len() {
            offers.rotate_left(1);
            assert_eq!(chosen(&offers, (640, 480), 5.0), first);
        }
    }

    #[test]
    fn fractions_that_are_no_time_are_passed_over() {
        let broken = Offer {
            encoding: Encoding::Yuyv,
            size: (640, 480),
            times: vec![
                FrameTime { numerator: 0, denominator: 30 },
                FrameTime { numerator: 1, denominator: 0 },
                FrameTime { numerator: 1001, denominator: 30_000 },
            ],
        };
        let choice = choose(&[broken], (640, 480), 5.0).expect("one rate is whole");
        assert_eq!(choice.time, Some(FrameTime { numerator: 1001, denominator: 30_000 }));
    }

    #[test]
    fn the_rate_follows_the_measuring_interval() {
        assert_eq!(least_rate(Duration::from_secs(120)), 5.0);
        assert_eq!(least_rate(Duration::from_millis(100)), 20.0);
        assert!(least_rate(Duration::ZERO).is_finite());
    }

    #[test]
    fn steps_are_kept() {
        assert_eq!(stepped(640, 48, 1920, 2), 640);
        assert_eq!(stepped(641, 48, 1920, 16), 656);
        assert_eq!(stepped(9, 48, 1920, 0), 48);
        assert_eq!(stepped(4000, 48, 1920, 16), 1920);
    }
}
