//! Heat: how fast the line may run at an enclosure's temperature.
//!
//! Owns the limits, what a believable reading is, and the pace that follows. Reads no
//! sensor and no clock.

/// Temperature from which every second picture is left out, degrees Celsius: commercial
/// parts inside (cameras, SD cards, supplies) are rated for 70.
pub const SLOW_C: f32 = 70.0;
/// Temperature from which nothing is measured: processors throttle or stop at 85.
pub const STOP_C: f32 = 80.0;
/// How far it must cool below a limit until it is forgotten.
pub const HYSTERESIS_C: f32 = 5.0;
/// Temperatures that an enclosure can have. LM75 and TMP102 read to 128 at both ends, where a
/// broken sensor or bus often ends up.
const BELIEVABLE_C: core::ops::RangeInclusive<f32> = -50.0..=120.0;
/// Largest change between two readings a few seconds apart: an enclosure is slow.
const MAX_STEP_C: f32 = 20.0;

/// How fast the line runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Pace {
    /// Every picture is measured.
    #[default]
    Full,
    /// Every second picture is measured.
    Half,
    /// None is.
    Stopped,
}

/// A reading that cannot be true.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unbelievable {
    /// The reading, degrees Celsius.
    pub read_c: f32,
}

/// The pace that the enclosure's temperature allows.
#[derive(Clone, Copy, Debug, Default)]
pub struct Derating {
    latest_c: Option<f32>,
    /// A reading that leapt: believed when the next one agrees.
    leapt_c: Option<f32>,
    pace: Pace,
}

impl Derating {
    /// Takes a reading, `None` where there is no sensor.
    ///
    /// # Errors
    /// [`Unbelievable`]: it is left out, and the pace stays.
    pub fn take(&mut self, reading_c: Option<f32>) -> Result<Pace, Unbelievable> {
        let Some(read_c) = reading_c else { return Ok(self.pace) };
        if !BELIEVABLE_C.contains(&read_c) {
            return Err(Unbelievable { read_c });
        }
        let near = |other_c: f32| (read_c - other_c).abs() <= MAX_STEP_C;
        if self.latest_c.is_some_and(|c| !near(c)) && !self.leapt_c.is_some_and(near) {
            self.leapt_c = Some(read_c);
            return Err(Unbelievable { read_c });
        }
        (self.latest_c, self.leapt_c) = (Some(read_c), None);
        let cooled_by = |limit_c: f32| read_c < limit_c - HYSTERESIS_C;
        self.pace = match self.pace {
            _ if read_c >= STOP_C => Pace::Stopped,
            Pace::Stopped if !cooled_by(STOP_C) => Pace::Stopped,
            _ if read_c >= SLOW_C => Pace::Half,
            Pace::Half | Pace::Stopped if !cooled_by(SLOW_C) => Pace::Half,
            _ => Pace::Full,
        };
        Ok(self.pace)
    }

    /// Forgets the temperature of a sensor that fails; the pace stays.
    pub fn lose(&mut self) {
        (self.latest_c, self.leapt_c) = (None, None);
    }

    /// The latest believable temperature.
    pub fn latest_c(&self) -> Option<f32> {
        self.latest_c
    }

    /// The pace now.
    pub fn pace(&self) -> Pace {
        self.pace
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paces(readings: &[f32]) -> std::vec::Vec<Pace> {
        let mut derating = Derating::default();
        readings.iter().filter_map(|&c| derating.take(Some(c)).ok()).collect()
    }

    #[test]
    fn it_slows_at_70_stops_at_80_and_comes_back_5_degrees_below() {
        use Pace::{Full, Half, Stopped};
        let readings = [60.0, 70.0, 66.0, 79.9, 80.0, 76.0, 74.9, 66.0, 64.9, 69.9];
        let expected = [Full, Half, Half, Half, Stopped, Stopped, Half, Half, Full, Full];
        assert_eq!(paces(&readings), expected);
        assert_eq!(paces(&[75.0, 90.0, 72.0, 60.0]), [Half, Stopped, Half, Full]);
    }

    #[test]
    fn nonsense_is_refused_and_changes_nothing() {
        let mut derating = Derating::default();
        assert_eq!(derating.take(Some(40.0)), Ok(Pace::Full));
        for nonsense in [f32::NAN, f32::INFINITY, -128.0, 127.9, 1e9] {
            assert!(derating.take(Some(nonsense)).is_err(), "{nonsense}");
        }
        assert_eq!((derating.latest_c(), derating.pace()), (Some(40.0), Pace::Full));
    }

    #[test]
    fn a_leap_is_believed_the_second_time() {
        let mut derating = Derating::default();
        assert_eq!(derating.take(Some(30.0)), Ok(Pace::Full));
        assert!(derating.take(Some(85.0)).is_err());
        assert_eq!(derating.take(Some(31.0)), Ok(Pace::Full), "it was a glitch");
        assert!(derating.take(Some(85.0)).is_err());
        assert_eq!(derating.take(Some(84.0)), Ok(Pace::Stopped), "it is true");
    }

    #[test]
    fn without_a_sensor_nothing_slows() {
        assert_eq!(Derating::default().take(None), Ok(Pace::Full));
    }
}
