//! Locate and aggregate: from detections to density, for each preset of the camera.
//!
//! Owns what happens to windows while the camera changes between presets: each preset has
//! windows of its own, which hold pictures of that preset alone. A window is reported by the
//! preset at which the camera looked when it ended; what other presets hold of it is dropped.

use super::exit::Failure;
use super::frame::Detection;
use super::line::LineSettings;
use super::locate::{LocateError, Located, Locator};
use crate::density::{Aggregator, Closed, SampleZoneStatus};
use crate::lane::{Description, Place};
use crate::scene::Reference;
use crate::units::{ImagePoint, UtcMs};
use std::path::Path;
use std::time::Duration;

/// Locate and aggregate with one lane table.
#[derive(Debug)]
pub struct Counting {
    locator: Locator,
    aggregator: Aggregator,
    located: Vec<Located>,
}

impl Counting {
    /// Loads the table of `settings` for a camera with this time between frames.
    ///
    /// # Errors
    /// [`Failure::Locate`] and [`Failure::Aggregate`].
    pub fn open(settings: &LineSettings, interval: Duration) -> Result<Self, Failure> {
        Self::open_table(&settings.table, settings, interval)
    }

    fn open_table(
        table: &Path,
        settings: &LineSettings,
        interval: Duration,
    ) -> Result<Self, Failure> {
        let locator = Locator::load(table, settings.camera.as_deref(), settings.anchor)?;
        let aggregator = Aggregator::new(
            &locator.description().lanes,
            locator.description().cell_length_m,
            &settings.windows,
            interval,
            settings.min_completeness,
            settings.start,
        )?;
        Ok(Self { locator, aggregator, located: Vec::new() })
    }

    /// Counts the vehicles of one picture and returns the windows that it closes.
    ///
    /// # Errors
    /// [`LocateError::Shape`] for a picture that does not belong to the table.
    pub fn count(
        &mut self,
        detections: &[Detection],
        size: (usize, usize),
        time: UtcMs,
    ) -> Result<Closed, LocateError> {
        self.count_shifted(detections, size, ImagePoint { u: 0.0, v: 0.0 }, time)
    }

    /// The same for a picture whose scene stands `shift` (px of the picture) to the right of
    /// and below where the table has it.
    ///
    /// # Errors
    /// As [`Self::count`].
    pub fn count_shifted(
        &mut self,
        detections: &[Detection],
        (width, height): (usize, usize),
        shift: ImagePoint,
        time: UtcMs,
    ) -> Result<Closed, LocateError> {
        let size = self.locator.check_size(width, height)?;
        self.locator.locate(detections, size, shift, &mut self.located);
        let mut counts = self.aggregator.counts();
        for vehicle in &self.located {
            counts.add(vehicle.place.lane, vehicle.place.s_m, vehicle.class);
        }
        Ok(self.aggregator.observe(time, &counts))
    }

    /// What the lane table says about itself.
    pub fn table(&self) -> &Description {
        self.locator.description()
    }

    /// Where a point of the table's picture lies on the road.
    pub fn place(&self, point: ImagePoint) -> Option<Place> {
        self.locator.place(point)
    }

    /// The windows, for time without pictures and the end of a recording.
    pub fn windows(&mut self) -> &mut Aggregator {
        &mut self.aggregator
    }

    /// How many vehicles of the latest picture are in the lanes.
    pub fn located(&self) -> usize {
        self.located.len()
    }
}

/// The presets of a camera.
#[derive(Debug)]
pub struct Presets {
    presets: Vec<Counting>,
    active: usize,
    reported: usize,
}

impl Presets {
    /// Loads every table of `settings`.
    ///
    /// # Errors
    /// As [`Counting::open`].
    pub fn open(settings: &LineSettings, interval: Duration) -> Result<Self, Failure> {
        let tables = std::iter::once(&settings.table).chain(&settings.presets);
        let open = |table: &std::path::PathBuf| Counting::open_table(table, settings, interval);
        let presets = tables.map(open).collect::<Result<_, _>>()?;
        Ok(Self { presets, active: 0, reported: 0 })
    }

    /// The reference of each preset's table.
    ///
    /// # Errors
    /// [`Failure::Locate`] for a wrong one, and for a missing one where there are several
    /// presets: they could not be told apart.
    pub fn references(&self) -> Result<Vec<Option<Reference>>, Failure> {
        let several = self.presets.len() > 1;
        let reference = |preset: &Counting| preset.locator.scene(several);
        Ok(self.presets.iter().map(reference).collect::<Result<_, _>>()?)
    }

    /// Each of them.
    pub fn iter(&self) -> impl Iterator<Item = &Counting> {
        self.presets.iter()
    }

    /// The preset at which the camera looks.
    pub fn active(&self) -> &Counting {
        &self.presets[self.active]
    }

    /// Checks that a picture of this size belongs to the active table.
    ///
    /// # Errors
    /// [`LocateError::Shape`].
    pub fn check_size(&self, (width, height): (usize, usize)) -> Result<(), LocateError> {
        self.active().locator.check_size(width, height).map(|_| ())
    }

    /// The table to which the windows belong that the latest call closed.
    pub fn reported(&self) -> &Description {
        self.presets[self.reported].table()
    }

    /// Counts the vehicles of a picture of that preset.
    ///
    /// # Errors
    /// [`LocateError::Shape`].
    pub fn count(
        &mut self,
        preset: usize,
        detections: &[Detection],
        size: (usize, usize),
        shift: ImagePoint,
        time: UtcMs,
    ) -> Result<Closed, LocateError> {
        let closed = self.advance(time);
        self.active = preset;
        for (number, other) in self.presets.iter_mut().enumerate() {
            if number != preset {
                other.aggregator.miss(time, SampleZoneStatus::DetectionAutoSuspended);
            }
        }
        // All windows that end at this time are closed already.
        self.presets[preset].count_shifted(detections, size, shift, time)?;
        Ok(closed)
    }

    /// Notes that at `time` there was no usable picture, and why.
    pub fn miss(&mut self, time: UtcMs, status: SampleZoneStatus) -> Closed {
        self.each(|preset| preset.aggregator.miss(time, status))
    }

    /// From now on pictures come in this interval.
    pub fn set_interval(&mut self, interval: Duration) {
        self.presets.iter_mut().for_each(|preset| preset.aggregator.set_interval(interval));
    }

    /// Closes the windows that have ended at `time`.
    pub fn advance(&mut self, time: UtcMs) -> Closed {
        self.each(|preset| preset.aggregator.advance(time))
    }

    /// Notes that the clock was set; closes the windows that it leaps over the end of.
    pub fn set_clock(&mut self, from: UtcMs, to: UtcMs) -> Closed {
        self.each(|preset| preset.aggregator.set_clock(from, to))
    }

    /// Closes what runs, at the end of a recording.
    pub fn finish(&mut self) -> Closed {
        self.each(|preset| preset.aggregator.finish())
    }

    /// Does the same to all presets; what the active one closes is reported.
    fn each(&mut self, mut act: impl FnMut(&mut Counting) -> Closed) -> Closed {
        let mut reported = Closed::new();
        for (number, preset) in self.presets.iter_mut().enumerate() {
            let closed = act(preset);
            if number == self.active {
                reported = closed;
            }
        }
        self.reported = self.active;
        reported
    }
}
