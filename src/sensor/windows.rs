//! The windows of every preset of the camera.
//!
//! Owns what happens to windows while the camera changes between presets: each preset has
//! windows of its own, which hold pictures of that preset alone. A window is reported by the
//! preset at which the camera looked when it ended, with the calibration of that preset; what
//! other presets hold of it is dropped.

use super::Outcome;
use super::takeover::common_period;
use crate::density::{
    AggregateError, Aggregator, Closed, Errors, FrameCounts, MAX_WINDOWS, SampleZoneStatus, Start,
    WindowReport,
};
use crate::lane::Description;
use crate::track::LaneMoves;
use crate::traffic;
use crate::units::{MAX_LANES, UtcMs};
use crate::wire::CalibrationRef;
use core::time::Duration;

/// One preset of the camera: the windows of its lane table.
#[derive(Clone, Debug)]
pub struct Preset<const W: usize = MAX_WINDOWS> {
    calibration: CalibrationRef,
    aggregator: Aggregator<W>,
    /// Flow and speed, where vehicles are followed.
    traffic: Option<traffic::Windows<W>>,
    /// All windows end at its multiples.
    period: Duration,
}

impl<const W: usize> Preset<W> {
    /// Windows over the lanes of a table; the rest as for [`Aggregator::new`].
    ///
    /// # Errors
    /// [`AggregateError`] where the windows cannot be kept or never filled.
    pub fn new(
        table: &Description,
        lengths: &[Duration],
        interval: Duration,
        min_completeness: f32,
        start: Start,
    ) -> Result<Self, AggregateError> {
        let (lanes, cell_m) = (&table.lanes, table.cell_length_m);
        let aggregator =
            Aggregator::new(lanes, cell_m, lengths, interval, min_completeness, start)?;
        let period = common_period(lengths);
        Ok(Self { calibration: CalibrationRef::of(table), aggregator, traffic: None, period })
    }

    /// From now on windows have flow and speed too, where vehicles are followed with pictures at
    /// most `longest` apart; lengths and completeness as for [`Self::new`].
    pub fn follow(&mut self, lengths: &[Duration], longest: Duration, min_completeness: f32) {
        self.traffic = Some(traffic::Windows::new(lengths, longest, min_completeness));
    }

    /// From now on reports have an interval from these errors ([`Aggregator::set_errors`]).
    pub fn set_errors(&mut self, length_rel_err: [Option<f32>; MAX_LANES], errors: Errors) {
        if let Some(traffic) = &mut self.traffic {
            let is_corrected = errors.site.as_ref().is_some_and(|site| !site.by_load.is_empty());
            // One error for all lanes there: the largest.
            let largest = length_rel_err.iter().copied().flatten().reduce(f32::max);
            traffic.set_errors(largest, errors.of_those_that_drive(), is_corrected);
        }
        self.aggregator.set_errors(length_rel_err, errors);
    }

    /// The table that it measures with.
    pub const fn calibration(&self) -> &CalibrationRef {
        &self.calibration
    }

    /// Counts of a frame to fill, for [`Outcome::Measured`].
    pub fn counts(&self) -> FrameCounts {
        self.aggregator.counts()
    }
}

/// A window that has closed, with the table it was measured with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClosedWindow<'a> {
    /// The measurement.
    pub report: &'a WindowReport,
    /// The table.
    pub calibration: &'a CalibrationRef,
}

/// The presets of a camera, at least one. `P` holds them: a vector in the daemon, an array
/// where there is no heap.
#[derive(Clone, Debug)]
pub struct Windows<P, const W: usize = MAX_WINDOWS> {
    presets: P,
    active: usize,
}

impl<const W: usize, P: AsRef<[Preset<W>]> + AsMut<[Preset<W>]>> Windows<P, W> {
    /// The windows of these presets; the camera is taken to look at the first.
    pub const fn new(presets: P) -> Self {
        Self { presets, active: 0 }
    }

    /// The table of the preset at which the camera looks.
    pub fn calibration(&self) -> Option<&CalibrationRef> {
        self.presets.as_ref().get(self.active).map(|preset| &preset.calibration)
    }

    /// At the multiples of this all windows end.
    pub fn period(&self) -> Duration {
        self.presets.as_ref().first().map_or(Duration::from_secs(1), |preset| preset.period)
    }

    /// Takes what came of a frame at `time`; hands out the windows that end there.
    pub fn take(
        &mut self,
        time: UtcMs,
        outcome: &Outcome<'_>,
        closed: &mut dyn FnMut(ClosedWindow<'_>),
    ) {
        let status = match *outcome {
            Outcome::Measured { preset, counts, moves } => {
                return self.count(preset, time, (counts, moves), closed);
            }
            Outcome::Missing => SampleZoneStatus::SensorFailure,
            Outcome::Unchanged | Outcome::Damaged | Outcome::StageFault => {
                SampleZoneStatus::InputDataIntegrity
            }
            Outcome::PassedOver | Outcome::NotAsked => SampleZoneStatus::DetectionAutoSuspended,
            Outcome::Withheld(alarm) => alarm.status(),
        };
        self.each(closed, |windows| windows.miss(time, status));
    }

    fn count(
        &mut self,
        preset: usize,
        time: UtcMs,
        (counts, moves): (&FrameCounts, Option<&LaneMoves>),
        closed: &mut dyn FnMut(ClosedWindow<'_>),
    ) {
        self.advance(time, closed);
        self.active = preset;
        // All windows that end at this time are closed already.
        for (number, Preset { aggregator, traffic, .. }) in
            self.presets.as_mut().iter_mut().enumerate()
        {
            if number == preset {
                aggregator.observe(time, counts);
                if let (Some(traffic), Some(moves)) = (traffic, moves) {
                    traffic.add(time, moves);
                }
            } else {
                aggregator.miss(time, SampleZoneStatus::DetectionAutoSuspended);
            }
        }
    }

    /// From now on pictures come in this interval.
    pub fn set_interval(&mut self, interval: Duration) {
        let presets = self.presets.as_mut().iter_mut();
        presets.for_each(|preset| preset.aggregator.set_interval(interval));
    }

    /// Hands out the windows that have ended at `time`.
    pub fn advance(&mut self, time: UtcMs, closed: &mut dyn FnMut(ClosedWindow<'_>)) {
        self.each(closed, |windows| windows.advance(time));
    }

    /// Notes that the clock was set; hands out the windows that it leaps over the end of. To be
    /// called after [`Self::advance`] to `from`.
    pub fn set_clock(&mut self, from: UtcMs, to: UtcMs, closed: &mut dyn FnMut(ClosedWindow<'_>)) {
        self.each(closed, |windows| windows.set_clock(from, to));
    }

    /// Hands out what runs, at the end of a recording.
    pub fn finish(&mut self, closed: &mut dyn FnMut(ClosedWindow<'_>)) {
        self.each(closed, Aggregator::finish);
    }

    /// Does the same to all presets; what the active one closes is handed out.
    fn each(
        &mut self,
        closed: &mut dyn FnMut(ClosedWindow<'_>),
        mut act: impl FnMut(&mut Aggregator<W>) -> Closed<W>,
    ) {
        for (number, preset) in self.presets.as_mut().iter_mut().enumerate() {
            let mut reports = act(&mut preset.aggregator);
            if number == self.active {
                if let Some(traffic) = &preset.traffic {
                    reports.iter_mut().for_each(|report| traffic.complete(report));
                }
                let calibration = &preset.calibration;
                reports.iter().for_each(|report| closed(ClosedWindow { report, calibration }));
            }
        }
    }
}
