//! Types for what crosses a module border: instants, image points, lanes, classes.
//!
//! Owns units and identities. Knows nothing of files, cameras or messages.
//!
//! Image coordinates are continuous and in pixels: the picture's top left corner is
//! (0, 0), pixel (i, j) covers `[i, i+1) x [j, j+1)` and has its centre at
//! (i + 0.5, j + 0.5). Every file of the project uses this convention.

use core::time::Duration;
use serde::{Deserialize, Serialize};

/// Most lanes that one table describes. A camera over a road sees two carriageways of
/// four lanes at the most before far lanes fall under a pixel or two in width.
pub const MAX_LANES: usize = 8;

/// The lane's number as painted in the lane file, 1 to [`MAX_LANES`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub struct LaneId(u8);

impl LaneId {
    /// A lane number, or `None` outside 1 to [`MAX_LANES`].
    pub const fn new(number: u8) -> Option<Self> {
        if number >= 1 && number as usize <= MAX_LANES { Some(Self(number)) } else { None }
    }

    /// The number, 1 to [`MAX_LANES`].
    pub const fn get(self) -> u8 {
        self.0
    }
}

impl<'de> Deserialize<'de> for LaneId {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let number = u8::deserialize(deserializer)?;
        Self::new(number).ok_or_else(|| serde::de::Error::custom("lane number outside 1 to 8"))
    }
}

/// Direction of a lane's traffic, as the camera sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Direction {
    /// The lane file does not say.
    Unknown,
    /// Vehicles come towards the camera: it sees their fronts.
    Toward,
    /// Vehicles drive away from the camera: it sees their backs.
    Away,
}

/// An instant, in milliseconds of UTC since 1970-01-01 (negative before).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct UtcMs(pub i64);

impl UtcMs {
    /// This instant moved later by `by`, held at the last one that can be written.
    #[must_use]
    pub const fn saturating_add(self, by: Duration) -> Self {
        Self(self.0.saturating_add(millis(by)))
    }

    /// The time from `earlier` to this instant; zero where the clock ran backwards.
    pub const fn saturating_since(self, earlier: Self) -> Duration {
        let ms = self.0.saturating_sub(earlier.0);
        Duration::from_millis(if ms > 0 { ms as u64 } else { 0 })
    }

    /// The last multiple of `period` since 1970 that is not after this instant.
    #[must_use]
    pub const fn floor_to(self, period: Duration) -> Self {
        let period_ms = if millis(period) > 0 { millis(period) } else { 1 };
        match self.0.checked_rem_euclid(period_ms) {
            Some(past) => Self(self.0.saturating_sub(past)),
            None => self,
        }
    }
}

/// A duration as whole milliseconds, held at `i64::MAX`.
pub(crate) const fn millis(duration: Duration) -> i64 {
    let ms = duration.as_millis();
    if ms > i64::MAX as u128 { i64::MAX } else { ms as i64 }
}

/// A point in the picture, in pixels (see the convention above).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImagePoint {
    /// To the right, px.
    pub u: f32,
    /// Down, px.
    pub v: f32,
}

/// Picture size in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImageSize {
    /// Columns, px.
    pub width: u16,
    /// Rows, px.
    pub height: u16,
}

impl core::fmt::Display for ImageSize {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

/// Kind of vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum VehicleClass {
    /// A vehicle whose kind the model does not tell.
    Vehicle,
    /// Passenger car, taxi.
    Car,
    /// Van, minibus.
    Van,
    /// Bus, coach.
    Bus,
    /// Lorry.
    Truck,
    /// Motorcycle, scooter.
    Motorcycle,
}

impl VehicleClass {
    /// Number of classes.
    pub const COUNT: usize = 6;

    /// Every class, in the order of its index.
    pub const ALL: [Self; Self::COUNT] =
        [Self::Vehicle, Self::Car, Self::Van, Self::Bus, Self::Truck, Self::Motorcycle];

    /// Position in [`Self::ALL`].
    pub const fn index(self) -> usize {
        self as usize
    }

    /// The name in files and messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Vehicle => "vehicle",
            Self::Car => "car",
            Self::Van => "van",
            Self::Bus => "bus",
            Self::Truck => "truck",
            Self::Motorcycle => "motorcycle",
        }
    }

    /// Whether it is a car or a van, or may be one.
    pub const fn is_car_sized(self) -> bool {
        matches!(self, Self::Vehicle | Self::Car | Self::Van)
    }

    /// The class of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|class| class.name() == name)
    }

    /// Length on the road that space occupancy counts for a vehicle of this class, m.
    ///
    /// Design vehicles: passenger car 4.6 m (mean of the paper's five models), van 5.5 m,
    /// single-unit bus and truck as in the AASHTO Green Book (12.2 m, 9.1 m), motorcycle
    /// 2.2 m. A vehicle of unknown class counts as a car.
    pub const fn nominal_length_m(self) -> f32 {
        match self {
            Self::Vehicle | Self::Car => 4.6,
            Self::Van => 5.5,
            Self::Bus => 12.2,
            Self::Truck => 9.1,
            Self::Motorcycle => 2.2,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn floor_is_aligned_before_and_after_1970() {
        let minute = Duration::from_secs(60);
        assert_eq!(UtcMs(61_000).floor_to(minute), UtcMs(60_000));
        assert_eq!(UtcMs(60_000).floor_to(minute), UtcMs(60_000));
        assert_eq!(UtcMs(-1).floor_to(minute), UtcMs(-60_000));
        assert_eq!(UtcMs(7).floor_to(Duration::ZERO), UtcMs(7));
    }

    #[test]
    fn time_saturates_instead_of_wrapping() {
        assert_eq!(UtcMs(i64::MAX).saturating_add(Duration::MAX), UtcMs(i64::MAX));
        assert_eq!(UtcMs(5).saturating_since(UtcMs(9)), Duration::ZERO);
    }

    #[test]
    fn classes_are_indexed_in_order_and_named_once() {
        for (index, class) in VehicleClass::ALL.into_iter().enumerate() {
            assert_eq!(class.index(), index);
            assert_eq!(VehicleClass::from_name(class.name()), Some(class));
        }
        assert_eq!(VehicleClass::from_name("tram"), None);
    }

    #[test]
    fn lane_numbers_are_bounded() {
        assert!(LaneId::new(0).is_none());
        assert!(LaneId::new(MAX_LANES as u8 + 1).is_none());
        assert_eq!(LaneId::new(3).map(LaneId::get), Some(3));
    }
}
