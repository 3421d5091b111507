//! Density per lane over windows aligned to the clock, with its standard error.
//!
//! Owns the estimator and the life of a window. Reads no clock: each call gets the
//! time, and closed windows are handed out as values. Does not know where counts come
//! from or where reports go.
//!
//! Density is k = N / L (Hu et al., Eq. 1): the mean number of vehicles over the frames
//! of a window, divided by the lane's length. Each cell of the lane has the same.

mod cells;
mod counts;
mod error;

pub use crate::report::{
    Cells, DensityError, LaneReport, MAX_LANE_CELLS, SampleZoneStatus, WindowReport,
};
pub use cells::Division;
pub use counts::FrameCounts;
pub use error::{Counting, Errors, LOADS, LoadBias, SiteCorrection, Spread};

use crate::lane::Lane;
use crate::picture::Light;
use crate::units::{MAX_LANES, UtcMs, millis};
use core::time::Duration;
use counts::Series;
use error::Load;

/// Most windows that run side by side: 10 s, 60 s, 5 min, 15 min and two more.
pub const MAX_WINDOWS: usize = 6;
/// Shortest window, s: below it a window at one frame per second says nothing.
pub const MIN_WINDOW_S: u64 = 10;
/// Longest window, s (15 min, the longest that traffic centres exchange).
pub const MAX_WINDOW_S: u64 = 900;
/// A clock that is set back by more was wrong before: windows start over. For less the line
/// waits until the time has come that was reported already. An hour, as a clock errs that
/// takes local time for UTC.
pub const MAX_WAIT: Duration = Duration::from_secs(3600);

/// Reports that one call closes, one a window at most.
pub type Closed<const W: usize = MAX_WINDOWS> = heapless::Vec<WindowReport, W>;

/// Treatment of the window that is running when a line starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// Live: it is dropped, the first report covers a whole window.
    AtNextWindow,
    /// Recorded: it is kept, `frames_used` tells how much of it there was.
    WithFirstFrame,
}

/// Why windows cannot be made as asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AggregateError {
    /// No window, or more than [`MAX_WINDOWS`].
    WindowCount(usize),
    /// A window outside [`MIN_WINDOW_S`] to [`MAX_WINDOW_S`], s, or one that does not
    /// divide a day, so that it cannot be aligned to the clock.
    WindowLength(Duration),
    /// The same length twice.
    Twice(Duration),
    /// Frames come less often than windows end.
    Interval {
        /// Time between frames.
        interval: Duration,
        /// The shortest window.
        window: Duration,
    },
}

impl core::fmt::Display for AggregateError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            Self::WindowCount(n) => write!(f, "{n} windows asked for, 1 to {MAX_WINDOWS} can run"),
            Self::WindowLength(length) => write!(
                f,
                "a window of {} s: give whole seconds from {MIN_WINDOW_S} to {MAX_WINDOW_S} that \
                 divide a day (10, 20, 30, 60, 120, 300, 600, 900)",
                length.as_secs_f32()
            ),
            Self::Twice(length) => {
                write!(f, "windows of {} s twice: leave one out", length.as_secs_f32())
            }
            Self::Interval { interval, window } => write!(
                f,
                "a frame every {} s cannot fill windows of {} s: make the window at least as long",
                interval.as_secs_f32(),
                window.as_secs_f32()
            ),
        }
    }
}

impl core::error::Error for AggregateError {}

/// Whether windows of these lengths can be kept and filled by a frame each `interval`.
///
/// # Errors
/// [`AggregateError`] names the first that cannot.
pub fn check_lengths(lengths: &[Duration], interval: Duration) -> Result<(), AggregateError> {
    if !(1..=MAX_WINDOWS).contains(&lengths.len()) {
        return Err(AggregateError::WindowCount(lengths.len()));
    }
    for (index, &length) in lengths.iter().enumerate() {
        let seconds = length.as_secs();
        let whole = length.subsec_nanos() == 0 && 86_400u64.checked_rem(seconds) == Some(0);
        if !whole || !(MIN_WINDOW_S..=MAX_WINDOW_S).contains(&seconds) {
            return Err(AggregateError::WindowLength(length));
        }
        if lengths.iter().skip(index + 1).any(|&other| other == length) {
            return Err(AggregateError::Twice(length));
        }
        if interval > length {
            return Err(AggregateError::Interval { interval, window: length });
        }
    }
    Ok(())
}

#[derive(Clone, Debug)]
struct Window {
    length: Duration,
    from: Option<UtcMs>,
    /// Slowest time between frames that it had.
    interval: Duration,
    /// How much shorter it was than its length, ms: the clock was set forward. Negative: it
    /// was set back, and showed a part of it twice.
    skipped_ms: i64,
    series: [Series; MAX_LANES],
    fault: SampleZoneStatus,
    /// Frames that it had, and how many of them were taken by night.
    frames: u32,
    by_night: u32,
}

impl Window {
    fn new(length: Duration, interval: Duration) -> Self {
        Self {
            length,
            from: None,
            interval,
            skipped_ms: 0,
            series: Default::default(),
            fault: Default::default(),
            frames: 0,
            by_night: 0,
        }
    }

    /// Starts over.
    fn begin(&mut self, from: UtcMs, interval: Duration) {
        (self.from, self.interval, self.skipped_ms) = (Some(from), interval, 0);
        self.series.fill(Series::default());
        self.fault = SampleZoneStatus::default();
        (self.frames, self.by_night) = (0, 0);
    }

    /// Frames that it has at the camera's rate.
    fn expected(&self) -> u32 {
        let length_ms = millis(self.length).saturating_sub(self.skipped_ms);
        let interval_ms = millis(self.interval).max(1);
        let expected = length_ms.saturating_add(interval_ms / 2).checked_div(interval_ms);
        expected.map_or(1, |n| n.clamp(0, i64::from(u32::MAX)) as u32)
    }
}

/// Turns counts of single frames into reports of at most `W` windows side by side. A window
/// takes 1.5 KB, and its report 1.8 KB: a microcontroller has room for what it uses.
#[derive(Clone, Debug)]
pub struct Aggregator<const W: usize = MAX_WINDOWS> {
    lanes: heapless::Vec<Lane, MAX_LANES>,
    divisions: [Division; MAX_LANES],
    windows: heapless::Vec<Window, W>,
    interval: Duration,
    min_completeness: f32,
    start: Start,
    length_rel_err: [Option<f32>; MAX_LANES],
    errors: Errors,
}

impl<const W: usize> Aggregator<W> {
    /// An aggregator for `lanes`, in cells of about `cell_m`, with windows of these lengths.
    ///
    /// `interval` is the time between frames; a window that got less than
    /// `min_completeness` (0 to 1) of its frames reports no density.
    ///
    /// # Errors
    /// [`AggregateError`] where the windows cannot be kept or never filled.
    pub fn new(
        lanes: &heapless::Vec<Lane, MAX_LANES>,
        cell_m: f32,
        window_lengths: &[Duration],
        interval: Duration,
        min_completeness: f32,
        start: Start,
    ) -> Result<Self, AggregateError> {
        check_lengths(window_lengths, interval)?;
        let mut windows = heapless::Vec::new();
        for &length in window_lengths {
            windows
                .push(Window::new(length, interval))
                .map_err(|_| AggregateError::WindowCount(window_lengths.len()))?;
        }
        let (divisions, lanes) = (Division::of_each(lanes, cell_m), lanes.clone());
        let (length_rel_err, errors) = ([None; MAX_LANES], Errors::default());
        Ok(Self {
            lanes,
            divisions,
            windows,
            interval,
            min_completeness,
            start,
            length_rel_err,
            errors,
        })
    }

    /// From now on reports have an interval from these errors: of the length of each lane by its
    /// number (one standard error, as a part), and of counting. A site's correction multiplies its
    /// counts.
    pub fn set_errors(&mut self, length_rel_err: [Option<f32>; MAX_LANES], errors: Errors) {
        (self.length_rel_err, self.errors) = (length_rel_err, errors);
    }

    /// Counts of a frame to fill, for [`Self::observe`].
    pub fn counts(&self) -> FrameCounts {
        FrameCounts::of(self.divisions)
    }

    /// From now on a frame comes each `interval`. Running windows expect as many frames as
    /// the slowest pace gives that they had.
    pub fn set_interval(&mut self, interval: Duration) {
        self.interval = interval;
        for window in &mut self.windows {
            window.interval = window.interval.max(interval);
        }
    }

    /// Takes the counts of a frame captured at `time` and returns the windows that it
    /// closes. A frame from before the running window is left out of it.
    pub fn observe(&mut self, time: UtcMs, counts: &FrameCounts) -> Closed<W> {
        let closed = self.advance(time);
        for window in &mut self.windows {
            if window.from.is_some_and(|from| from <= time) {
                window.frames = window.frames.saturating_add(1);
                if counts.light() == Light::Night {
                    window.by_night = window.by_night.saturating_add(1);
                }
                for (series, count) in window.series.iter_mut().zip(counts.lanes()) {
                    series.push(count);
                }
            }
        }
        closed
    }

    /// Notes that at `time` no usable frame came, and why; returns the windows that end.
    pub fn miss(&mut self, time: UtcMs, status: SampleZoneStatus) -> Closed<W> {
        let closed = self.advance(time);
        for window in &mut self.windows {
            if window.from.is_some_and(|from| from <= time) {
                window.fault = status;
            }
        }
        closed
    }

    /// Returns the windows that have ended at `time`.
    ///
    /// Called at least once a window, a window without frames is reported as such. A leap
    /// over several windows reports the running one and goes on in the one of `time`.
    pub fn advance(&mut self, time: UtcMs) -> Closed<W> {
        let mut closed = Closed::new();
        for index in 0..self.windows.len() {
            let Some(window) = self.windows.get_mut(index) else { break };
            let aligned = time.floor_to(window.length);
            let Some(from) = window.from else {
                let whole = aligned == time || self.start == Start::WithFirstFrame;
                let first = if whole { aligned } else { aligned.saturating_add(window.length) };
                window.from = Some(first);
                continue;
            };
            if time < from.saturating_add(window.length) {
                if from.saturating_since(time) > MAX_WAIT {
                    let next = aligned.saturating_add(window.length);
                    window.begin(next, self.interval);
                }
                continue;
            }
            // Reported where it is: a copy would be the largest thing on a small stack.
            let Some(ended) = self.windows.get(index) else { break };
            // Of a window that the clock has leapt over there is nothing to report.
            let is_empty = ended.series.iter().all(|series| series.n == 0);
            if ended.expected() > 0 || !is_empty {
                // One report a window and as many places as windows: there is always room.
                let _ = closed.push(self.report(ended, from));
            }
            if let Some(window) = self.windows.get_mut(index) {
                window.begin(aligned, self.interval);
            }
        }
        closed
    }

    /// Notes that the clock was set from `from`, to which windows were advanced, to `to`. Of
    /// the time that never was no frames are missing, and of that which is there twice more
    /// are expected. Returns the windows that it ends.
    pub fn set_clock(&mut self, from: UtcMs, to: UtcMs) -> Closed<W> {
        for window in &mut self.windows {
            let Some(begin) = window.from else { continue };
            let end = begin.saturating_add(window.length).min(to);
            let skipped = millis(end.saturating_since(begin.max(from)));
            let twice = millis(from.saturating_since(begin.max(to)));
            window.skipped_ms = window.skipped_ms.saturating_add(skipped).saturating_sub(twice);
        }
        let closed = self.advance(to);
        for window in &mut self.windows {
            if let Some(begin) = window.from.filter(|&begin| begin > from) {
                window.skipped_ms = millis(to.saturating_since(begin));
            }
        }
        closed
    }

    /// Reports what the running windows hold, and empties them. For the end of a recording.
    pub fn finish(&mut self) -> Closed<W> {
        let mut closed = Closed::new();
        for index in 0..self.windows.len() {
            let Some(window) = self.windows.get_mut(index) else { break };
            let Some(from) = window.from.take() else { continue };
            let ended = Window { from: Some(from), ..window.clone() };
            window.series = Default::default();
            window.fault = Default::default();
            (window.frames, window.by_night) = (0, 0);
            if ended.series.iter().any(|series| series.n > 0) {
                let _ = closed.push(self.report(&ended, from));
            }
        }
        closed
    }

    fn report(&self, window: &Window, from: UtcMs) -> WindowReport {
        let expected = window.expected().max(1);
        let length_m: f32 = self.lanes.iter().map(|lane| lane.length_m).sum();
        let vehicles = window.series.iter().filter_map(Series::mean).sum();
        let frames = if window.frames > 0 { window.frames as f32 } else { 1.0 };
        let night = window.by_night as f32 / frames;
        let mut lanes = heapless::Vec::new();
        for lane in &self.lanes {
            let index = usize::from(lane.id.get()) - 1;
            let (series, division) = (window.series.get(index), self.divisions.get(index));
            if let (Some(series), Some(&division)) = (series, division) {
                let load = Load { vehicles, night, share: lane.length_m / length_m };
                let of = (lane, division, load);
                let report = self.lane_report(of, series, expected, window.fault);
                // As many places as lanes: there is always room.
                let _ = lanes.push(report);
            }
        }
        WindowReport { from, to: from.saturating_add(window.length), lanes }
    }

    fn lane_report(
        &self,
        (lane, division, load): (&Lane, Division, Load),
        series: &Series,
        frames_expected: u32,
        fault: SampleZoneStatus,
    ) -> LaneReport {
        let enough = series.n as f32 >= self.min_completeness * frames_expected as f32;
        let factor = self.errors.factor(load);
        let estimate = series.mean_and_error().filter(|_| enough);
        let estimate = estimate.map(|(mean, error)| (mean * factor, error * factor));
        let status = match (estimate, fault) {
            (Some(_), _) => SampleZoneStatus::Ok,
            (None, SampleZoneStatus::Ok) if series.n == 0 => SampleZoneStatus::SensorFailure,
            (None, SampleZoneStatus::Ok) => SampleZoneStatus::InputDataIntegrity,
            (None, fault) => fault,
        };
        let n = series.n as f32;
        let length_km = lane.length_m / 1000.0;
        let rel_err = self.length_rel_err.get(usize::from(lane.id.get()) - 1).copied().flatten();
        let length = (length_km, rel_err);
        let occupied = series.occupied_m * factor / n / lane.length_m;
        LaneReport {
            lane: lane.id,
            direction: lane.direction,
            density_veh_km: estimate.map(|(mean, _)| mean / length_km),
            density_se: estimate.map(|(_, error)| error / length_km),
            vehicles_mean: estimate.map(|(mean, _)| mean),
            by_class: estimate.map(|_| series.by_class.map(|sum| sum * factor / n)),
            space_occupancy: estimate.map(|_| occupied.min(1.0)),
            length_m: lane.length_m,
            frames_used: series.n,
            frames_expected,
            status,
            cells: Some(series.cells(division, estimate.map(|_| factor))),
            error: estimate.and_then(|(mean, error)| {
                let mean = (mean, series.hidden_part());
                self.errors.of(mean, error / length_km, length, load)
            }),
            traffic: None,
        }
    }
}

#[cfg(test)]
mod tests;
