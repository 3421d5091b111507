//! One density file of a site, read for the morning: quarter hours, and what each lane says.
//!
//! Owns which columns are read, and that cells are not. Windows of the shortest length in the
//! file count; what is not known is not known.

use crate::store::DAY_MS;
use arrow_array::types::{
    ArrowPrimitiveType, Float32Type, Int32Type, Int64Type, TimestampMillisecondType,
};
use arrow_array::{Array, PrimitiveArray, RecordBatch, cast::AsArray};
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use std::fs::File;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use verge_desk::Failure;
use verge_messages::MOST_LANES;

/// Quarter hours of a day.
pub const BINS: usize = 96;
/// A quarter of an hour, ms.
pub const BIN_MS: i64 = DAY_MS / BINS as i64;
/// The columns that are read.
const COLUMNS: [&str; 11] = [
    "window_s",
    "from",
    "lane",
    "cell",
    "density_veh_km",
    "status",
    "clock_synced",
    "density_low90",
    "density_high90",
    "flow_veh_h",
    "speed_kmh",
];

/// A lane in a window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Beginning of the window, ms since 1970.
    pub from_ms: i64,
    /// From 1.
    pub lane: i32,
    /// A number of NTCIP 1209.
    pub status: i32,
    /// Whether the clock was set.
    pub clock_synced: bool,
    /// Density, veh/km.
    pub density: Option<f32>,
    /// Interval that holds it with a probability of 90 %.
    pub ci90: Option<[f32; 2]>,
    /// Flow, veh/h.
    pub flow: Option<f32>,
    /// Space-mean speed, km/h.
    pub speed: Option<f32>,
}

/// A day of a site.
#[derive(Clone, Debug, Default)]
pub struct Day {
    /// Length of its windows, s.
    pub window_s: i32,
    /// Lanes in windows, by time.
    pub readings: Vec<Reading>,
}

/// A quarter of an hour of a site.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quarter {
    /// Mean density over lanes and windows, veh/km/lane.
    pub density: Option<f32>,
    /// Ends of its interval: means of the windows' own. Their sampling errors would shrink; those
    /// of calibration and counting do not, and a mean of ends is never too narrow.
    pub ci90: Option<[f32; 2]>,
    /// Flow of the whole carriageway: the sum of its lanes' means, veh/h.
    pub flow: Option<f32>,
    /// Mean of the lanes' speeds, each weighted by its flow, km/h.
    pub speed: Option<f32>,
}

impl Day {
    /// Reads a file.
    ///
    /// # Errors
    /// [`Failure`] where it is not there or damaged.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let file = File::open(path).map_err(|source| Failure::reading(path, source))?;
        let read = || Self::of(file);
        // On a damaged file the crate returns an error, or panics.
        let panicked = |_| Err("its reader panicked".to_owned());
        catch_unwind(AssertUnwindSafe(read))
            .unwrap_or_else(panicked)
            .map_err(|reason| Failure::content(path, 0, format!("is damaged: {reason}")))
    }

    fn of(file: File) -> Result<Self, String> {
        let text = |error: parquet::errors::ParquetError| error.to_string();
        let builder = ParquetRecordBatchReaderBuilder::try_new(file).map_err(text)?;
        let mask = ProjectionMask::columns(builder.parquet_schema(), COLUMNS);
        let reader = builder.with_projection(mask).with_batch_size(8192).build().map_err(text)?;
        let mut all: Vec<(i32, Reading)> = Vec::new();
        for batch in reader {
            let batch = batch.map_err(|error| error.to_string())?;
            if !take(&batch, &mut all).ok_or("a column is missing")? {
                // Lanes stand first: the cells need not be read.
                break;
            }
        }
        let window_s = all.iter().map(|(length, _)| *length).min().unwrap_or_default();
        let shortest = all.into_iter().filter(|(length, _)| *length == window_s);
        let mut readings: Vec<_> = shortest.map(|(_, reading)| reading).collect();
        readings.sort_by_key(|reading| (reading.from_ms, reading.lane));
        Ok(Self { window_s, readings })
    }

    /// Its quarter hours (UTC).
    pub fn quarters(&self) -> Vec<Quarter> {
        let mut quarters = vec![Quarter::default(); BINS];
        let bin = |reading: &Reading| reading.from_ms.rem_euclid(DAY_MS) / BIN_MS;
        for readings in self.readings.chunk_by(|a, b| bin(a) == bin(b)) {
            quarters[bin(&readings[0]) as usize] = Quarter::of(readings);
        }
        quarters
    }
}

/// Takes a batch's lanes; false where its cells begin, none where a column is missing.
fn take(batch: &RecordBatch, all: &mut Vec<(i32, Reading)>) -> Option<bool> {
    let integers = |name| primitive::<Int32Type>(batch, name);
    let (lengths, lanes) = (integers("window_s")?, integers("lane")?);
    let (cells, statuses) = (integers("cell")?, integers("status")?);
    let times = batch.column_by_name("from")?;
    let times = match times.as_primitive_opt::<TimestampMillisecondType>() {
        Some(times) => times.values(),
        None => times.as_primitive_opt::<Int64Type>()?.values(),
    };
    let clocks = batch.column_by_name("clock_synced")?.as_boolean_opt()?;
    let floats = |name| primitive::<Float32Type>(batch, name);
    let (density, low, high) =
        (floats("density_veh_km")?, floats("density_low90"), floats("density_high90"));
    let (flow, speed) = (floats("flow_veh_h"), floats("speed_kmh"));
    for row in 0..batch.num_rows() {
        if cells.is_valid(row) {
            return Some(false);
        }
        let known = |column: Option<&PrimitiveArray<Float32Type>>| {
            column.filter(|column| column.is_valid(row)).map(|column| column.value(row))
        };
        let lane = lanes.value(row);
        if !(1..=i32::from(MOST_LANES)).contains(&lane) {
            continue;
        }
        let reading = Reading {
            from_ms: times[row],
            lane,
            status: statuses.value(row),
            clock_synced: clocks.value(row),
            density: known(Some(density)).filter(|density| (0.0..=10_000.0).contains(density)),
            ci90: known(low).zip(known(high)).map(|(low, high)| [low, high]),
            flow: known(flow),
            speed: known(speed),
        };
        all.push((lengths.value(row), reading));
    }
    Some(true)
}

fn primitive<'b, T: ArrowPrimitiveType>(
    batch: &'b RecordBatch,
    name: &str,
) -> Option<&'b PrimitiveArray<T>> {
    batch.column_by_name(name)?.as_primitive_opt::<T>()
}

/// A mean of what is known.
fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0u32);
    for value in values {
        sum += value;
        count += 1;
    }
    (count > 0).then(|| sum / f64::from(count))
}

impl Quarter {
    /// Of some readings.
    pub fn of(readings: &[Reading]) -> Self {
        let known = || readings.iter().filter_map(|it| Some((it, f64::from(it.density?))));
        let end = |which: usize| {
            let all = known().map(|(it, _)| it.ci90.map(|ends| f64::from(ends[which])));
            all.collect::<Option<Vec<_>>>().and_then(|all| mean(all.into_iter()))
        };
        let lanes = 1..=i32::from(MOST_LANES);
        let flows: Vec<_> = lanes
            .filter_map(|lane| {
                let of = readings.iter().filter(|it| it.lane == lane);
                mean(of.filter_map(|it| it.flow.map(f64::from)))
            })
            .collect();
        let weights = || readings.iter().filter_map(|it| Some((f64::from(it.flow?), it.speed?)));
        let weight: f64 = weights().map(|(flow, _)| flow).sum();
        let weighted: f64 = weights().map(|(flow, speed)| flow * f64::from(speed)).sum();
        Self {
            density: mean(known().map(|(_, density)| density)).map(|mean| mean as f32),
            ci90: end(0).zip(end(1)).map(|(low, high)| [low as f32, high as f32]),
            flow: (!flows.is_empty()).then(|| flows.iter().sum::<f64>() as f32),
            speed: (weight > 0.0).then(|| (weighted / weight) as f32),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(minute: i64, lane: i32, density: Option<f32>) -> Reading {
        Reading {
            from_ms: minute * 60_000,
            lane,
            status: 2,
            clock_synced: true,
            density,
            ci90: density.map(|density| [density - 1.0, density + 3.0]),
            flow: density.map(|density| density * 50.0),
            speed: density.map(|_| 50.0),
        }
    }

    #[test]
    fn quarters_are_means_of_what_is_known() {
        let day = Day {
            window_s: 60,
            readings: vec![
                at(0, 1, Some(10.0)),
                at(0, 2, None),
                at(14, 1, Some(20.0)),
                at(15, 1, None),
            ],
        };
        let quarters = day.quarters();
        let first = quarters[0];
        assert_eq!((first.density, first.ci90), (Some(15.0), Some([14.0, 18.0])));
        assert_eq!((first.flow, first.speed), (Some(750.0), Some(50.0)));
        assert_eq!(quarters[1], Quarter::default());
        let two = Quarter::of(&[at(0, 1, Some(10.0)), at(0, 2, Some(30.0))]);
        assert_eq!((two.density, two.flow), (Some(20.0), Some(2000.0)), "a carriageway's flow");
    }
}
