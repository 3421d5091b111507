//! Density per lane over windows aligned to the clock, with its standard error.
//!
//! Owns the estimator and the life of a window. Reads no clock: each call is told the
//! time, and closed windows are handed out as values. Does not know where counts come
//! from or where reports go.
//!
//! Density is k = N / L (Hu et al., Eq. 1): the mean number of vehicles over the frames
//! of a window, divided by the lane's length.

use crate::lane::Lane;
use crate::units::{Direction, LaneId, MAX_LANES, UtcMs, VehicleClass, millis};
use core::time::Duration;
use serde::{Deserialize, Serialize};

/// Most windows that run side by side: 10 s, 60 s, 5 min, 15 min and two more.
pub const MAX_WINDOWS: usize = 6;
/// Shortest window, s: below it a window at one frame per second says nothing.
pub const MIN_WINDOW_S: u64 = 10;
/// Longest window, s (15 min, the longest that traffic centres exchange).
pub const MAX_WINDOW_S: u64 = 900;
/// A clock that is set back by more was wrong before: windows begin anew. For less the line
/// waits until the time has come that was reported already. An hour, as a clock errs that
/// takes local time for UTC.
pub const MAX_WAIT: Duration = Duration::from_secs(3600);

/// How far a reading can be used: the values of NTCIP 1209 `sampleZoneStatus` in use here.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum SampleZoneStatus {
    /// `oK`, 2.
    #[default]
    Ok,
    /// `sensorFailure`, 10: no picture.
    SensorFailure,
    /// `inputDataIntegrity`, 11: frozen, damaged or too few pictures.
    InputDataIntegrity,
    /// `poorContrast`, 12: blinded or too dark.
    PoorContrast,
    /// `detectionAutoSuspended`, 13: the camera has moved.
    DetectionAutoSuspended,
}

/// What one frame shows in one lane.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct LaneCount {
    by_class: [u16; VehicleClass::COUNT],
    occupied_m: f32,
}

/// The vehicles of one frame, counted by lane and class.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameCounts {
    lanes: [LaneCount; MAX_LANES],
}

impl FrameCounts {
    /// Counts one vehicle.
    pub fn add(&mut self, lane: LaneId, class: VehicleClass) {
        let Some(count) = self.lanes.get_mut(usize::from(lane.get()) - 1) else { return };
        count.occupied_m += class.nominal_length_m();
        if let Some(n) = count.by_class.get_mut(class.index()) {
            *n = n.saturating_add(1);
        }
    }

    /// Vehicles in that lane.
    pub fn vehicles(&self, lane: LaneId) -> u32 {
        let count = self.lanes.get(usize::from(lane.get()) - 1);
        count.map_or(0, |c| c.by_class.iter().map(|&n| u32::from(n)).sum())
    }
}

/// Sums over a window's frames, enough for mean, variance and lag-one correlation.
#[derive(Clone, Copy, Debug, Default)]
struct Series {
    n: u32,
    sum: f32,
    sum_squares: f32,
    sum_lag_one: f32,
    first: f32,
    last: f32,
    by_class: [f32; VehicleClass::COUNT],
    occupied_m: f32,
}

impl Series {
    fn push(&mut self, count: &LaneCount) {
        let x: f32 = count.by_class.iter().map(|&n| f32::from(n)).sum();
        if self.n == 0 {
            self.first = x;
        } else {
            self.sum_lag_one += self.last * x;
        }
        self.n = self.n.saturating_add(1);
        self.sum += x;
        self.sum_squares += x * x;
        self.last = x;
        self.occupied_m += count.occupied_m;
        for (sum, &n) in self.by_class.iter_mut().zip(&count.by_class) {
            *sum += f32::from(n);
        }
    }

    /// Mean vehicles per frame and its standard error; `None` without a frame.
    ///
    /// The spread is the frames' own plus one pseudo-observation of a Poisson count
    /// (mean + 1/2), so that two equal frames do not claim certainty. Frames close in
    /// time repeat each other: the number of independent ones is n (1-r)/(1+r) for a
    /// lag-one correlation r (Bayley and Hammersley 1946), with r corrected for its small
    /// sample bias of -(1+3r)/n (Kendall 1954). Sampling error only: detection and
    /// calibration have their own.
    fn mean_and_error(&self) -> Option<(f32, f32)> {
        if self.n == 0 {
            return None;
        }
        let n = self.n as f32;
        let mean = self.sum / n;
        let squares = (self.sum_squares - n * mean * mean).max(0.0);
        let lagged = self.sum_lag_one - mean * (2.0 * self.sum - self.first - self.last)
            + (n - 1.0) * mean * mean;
        let raw = if squares > 0.0 { lagged / squares } else { 0.0 };
        let most = (n - 1.0) / (n + 1.0);
        let correlation = (raw + (1.0 + 3.0 * raw) / n).max(0.0).min(most);
        let independent = n * (1.0 - correlation) / (1.0 + correlation);
        let variance = (squares + mean + 0.5) / n;
        Some((mean, libm::sqrtf(variance / independent)))
    }
}

/// One lane in one window. `None` where nothing can be said, never 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LaneReport {
    /// The lane.
    pub lane: LaneId,
    /// Which way its traffic moves.
    pub direction: Direction,
    /// Density k, veh/km.
    pub density_veh_km: Option<f32>,
    /// One standard error of the density from sampling, veh/km.
    pub density_se: Option<f32>,
    /// Mean number of vehicles in the lane.
    pub vehicles_mean: Option<f32>,
    /// The same by class, in the order of [`VehicleClass::ALL`].
    pub by_class: Option<[f32; VehicleClass::COUNT]>,
    /// Share of the lane's length that vehicles cover (nominal lengths), 0 to 1.
    pub space_occupancy: Option<f32>,
    /// The lane's length, m.
    pub length_m: f32,
    /// Frames that were used.
    pub frames_used: u32,
    /// Frames that the window would have at the camera's rate.
    pub frames_expected: u32,
    /// How far this reading can be used.
    pub status: SampleZoneStatus,
}

/// All lanes in one window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WindowReport {
    /// Its beginning, a multiple of its length since 1970.
    pub from: UtcMs,
    /// Its end.
    pub to: UtcMs,
    /// One entry a lane, by rising number.
    pub lanes: heapless::Vec<LaneReport, MAX_LANES>,
}

/// Reports that one call closes, one a window at most.
pub type Closed = heapless::Vec<WindowReport, MAX_WINDOWS>;

/// What a line started in the middle of a window does with that window.
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
}

impl Window {
    fn new(length: Duration, from: Option<UtcMs>, interval: Duration) -> Self {
        Self {
            length,
            from,
            interval,
            skipped_ms: 0,
            series: Default::default(),
            fault: Default::default(),
        }
    }

    /// Frames that it has at the camera's rate.
    fn expected(&self) -> u32 {
        let length_ms = millis(self.length).saturating_sub(self.skipped_ms);
        let interval_ms = millis(self.interval).max(1);
        let expected = length_ms.saturating_add(interval_ms / 2).checked_div(interval_ms);
        expected.map_or(1, |n| n.clamp(0, i64::from(u32::MAX)) as u32)
    }
}

/// Turns counts of single frames into reports of windows.
#[derive(Clone, Debug)]
pub struct Aggregator {
    lanes: heapless::Vec<Lane, MAX_LANES>,
    windows: heapless::Vec<Window, MAX_WINDOWS>,
    interval: Duration,
    min_completeness: f32,
    start: Start,
}

impl Aggregator {
    /// An aggregator for `lanes` with windows of these lengths.
    ///
    /// `interval` is the time between frames; a window that got less than
    /// `min_completeness` (0 to 1) of its frames reports no density.
    ///
    /// # Errors
    /// [`AggregateError`] where the windows cannot be kept or never filled.
    pub fn new(
        lanes: &heapless::Vec<Lane, MAX_LANES>,
        window_lengths: &[Duration],
        interval: Duration,
        min_completeness: f32,
        start: Start,
    ) -> Result<Self, AggregateError> {
        let mut windows = heapless::Vec::new();
        for &length in window_lengths {
            let seconds = length.as_secs();
            let whole = length.subsec_nanos() == 0 && 86_400u64.checked_rem(seconds) == Some(0);
            if !whole || !(MIN_WINDOW_S..=MAX_WINDOW_S).contains(&seconds) {
                return Err(AggregateError::WindowLength(length));
            }
            if interval > length {
                return Err(AggregateError::Interval { interval, window: length });
            }
            windows
                .push(Window::new(length, None, interval))
                .map_err(|_| AggregateError::WindowCount(window_lengths.len()))?;
        }
        if windows.is_empty() {
            return Err(AggregateError::WindowCount(0));
        }
        Ok(Self { lanes: lanes.clone(), windows, interval, min_completeness, start })
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
    pub fn observe(&mut self, time: UtcMs, counts: &FrameCounts) -> Closed {
        let closed = self.advance(time);
        for window in &mut self.windows {
            if window.from.is_some_and(|from| from <= time) {
                for (series, count) in window.series.iter_mut().zip(&counts.lanes) {
                    series.push(count);
                }
            }
        }
        closed
    }

    /// Notes that at `time` no usable frame came, and why; returns the windows that end.
    pub fn miss(&mut self, time: UtcMs, status: SampleZoneStatus) -> Closed {
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
    pub fn advance(&mut self, time: UtcMs) -> Closed {
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
                    *window = Window::new(window.length, Some(next), self.interval);
                }
                continue;
            }
            let next = Window::new(window.length, Some(aligned), self.interval);
            let ended = core::mem::replace(window, next);
            // Of a window that the clock has leapt over there is nothing to report.
            let is_empty = ended.series.iter().all(|series| series.n == 0);
            if ended.expected() == 0 && is_empty {
                continue;
            }
            // One report a window and as many places as windows: there is always room.
            let _ = closed.push(self.report(&ended, from));
        }
        closed
    }

    /// Notes that the clock was set from `from`, to which windows were advanced, to `to`. Of
    /// the time that never was no frames are missing, and of that which is there twice more
    /// are expected. Returns the windows that it ends.
    pub fn set_clock(&mut self, from: UtcMs, to: UtcMs) -> Closed {
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
    pub fn finish(&mut self) -> Closed {
        let mut closed = Closed::new();
        for index in 0..self.windows.len() {
            let Some(window) = self.windows.get_mut(index) else { break };
            let Some(from) = window.from.take() else { continue };
            let ended = Window { from: Some(from), ..window.clone() };
            window.series = Default::default();
            window.fault = Default::default();
            if ended.series.iter().any(|series| series.n > 0) {
                let _ = closed.push(self.report(&ended, from));
            }
        }
        closed
    }

    fn report(&self, window: &Window, from: UtcMs) -> WindowReport {
        let expected = window.expected().max(1);
        let mut lanes = heapless::Vec::new();
        for lane in &self.lanes {
            if let Some(series) = window.series.get(usize::from(lane.id.get()) - 1) {
                // As many places as lanes: there is always room.
                let _ = lanes.push(self.lane_report(lane, series, expected, window.fault));
            }
        }
        WindowReport { from, to: from.saturating_add(window.length), lanes }
    }

    fn lane_report(
        &self,
        lane: &Lane,
        series: &Series,
        frames_expected: u32,
        fault: SampleZoneStatus,
    ) -> LaneReport {
        let enough = series.n as f32 >= self.min_completeness * frames_expected as f32;
        let estimate = series.mean_and_error().filter(|_| enough);
        let status = match (estimate, fault) {
            (Some(_), _) => SampleZoneStatus::Ok,
            (None, SampleZoneStatus::Ok) if series.n == 0 => SampleZoneStatus::SensorFailure,
            (None, SampleZoneStatus::Ok) => SampleZoneStatus::InputDataIntegrity,
            (None, fault) => fault,
        };
        let n = series.n as f32;
        let length_km = lane.length_m / 1000.0;
        LaneReport {
            lane: lane.id,
            direction: lane.direction,
            density_veh_km: estimate.map(|(mean, _)| mean / length_km),
            density_se: estimate.map(|(_, error)| error / length_km),
            vehicles_mean: estimate.map(|(mean, _)| mean),
            by_class: estimate.map(|_| series.by_class.map(|sum| sum / n)),
            space_occupancy: estimate.map(|_| (series.occupied_m / n / lane.length_m).min(1.0)),
            length_m: lane.length_m,
            frames_used: series.n,
            frames_expected,
            status,
        }
    }
}

#[cfg(test)]
mod tests;
