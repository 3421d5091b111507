//! The small tables beside density: alarms, health and places.
//!
//! `ROOT/alarms/date=YYYY-MM-DD/alarms.parquet` and `ROOT/health/date=.../health.parquet` hold a day
//! (UTC) of all sites, `ROOT/places/places.parquet` every place that a site has had. Owns their
//! columns; rows are sorted by site and time. Columns that a later program adds are passed over,
//! those that an earlier one did not write are not known.

use super::date;
use arrow_array::cast::AsArray;
use arrow_array::types::{
    ArrowPrimitiveType, Float32Type, Float64Type, Int32Type, Int64Type, TimestampMillisecondType,
};
use arrow_array::{
    Array, ArrayRef, BooleanArray, Float32Array, Float64Array, Int32Array, Int64Array, RecordBatch,
    StringArray, TimestampMillisecondArray,
};
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::basic::Compression;
use parquet::file::properties::WriterProperties;
use std::fs::File;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use verge_desk::{Failure, make_parent, write_whole_with};
use verge_messages::{AlarmMessage, Health, Place};

/// An alarm that was raised, or is over.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct AlarmRow {
    /// The site.
    pub site: String,
    /// When, ms since 1970.
    pub time_ms: i64,
    /// The alarm.
    pub name: String,
    /// Raised, or over.
    pub active: bool,
}

/// The state of a sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct HealthRow {
    /// The site.
    pub site: String,
    /// When, ms since 1970.
    pub time_ms: i64,
    /// Status, a number of NTCIP 1209.
    pub status: i32,
    /// The alarm that was on.
    pub alarm: Option<String>,
    /// Whether the clock was set.
    pub clock_synced: bool,
    /// Time since start, s.
    pub uptime_s: i64,
    /// Version of the program.
    pub version: String,
    /// Whether the camera looked where it was calibrated.
    pub aim: Option<String>,
    /// The calibration in use.
    pub preset: Option<String>,
    /// `day` or `night`.
    pub light: Option<String>,
    /// How fast the line might run.
    pub pace: String,
    /// Pictures since start: measured, unchanged, damaged, missing, withheld.
    pub frames: [i64; 5],
    /// Windows that waited, were in memory alone, and were lost.
    pub windows: [i64; 3],
    /// Temperature in the enclosure, degrees Celsius.
    pub enclosure_c: Option<f32>,
    /// Faults of the program since start.
    pub stage_faults: i64,
    /// Days until the first certificate ends.
    pub certificate_days: Option<i64>,
    /// The latest fault.
    pub last_fault: Option<String>,
    /// Largest difference of the two densities, veh/km.
    pub density_difference: Option<f32>,
}

/// A place that a site has from a time on.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaceRow {
    /// The site.
    pub site: String,
    /// Beginning, ms since 1970.
    pub since_ms: i64,
    /// Position and names.
    pub place: Place,
    /// Its lanes with name and order, JSON: `[{"lane":1,"name":"slow lane","order":1}]`.
    pub lanes: String,
}

impl From<&AlarmMessage> for AlarmRow {
    fn from(message: &AlarmMessage) -> Self {
        let AlarmMessage { schema: _, site, time, name, active } = message;
        let name = name.name().to_owned();
        Self { site: site.clone(), time_ms: time.0, name, active: *active }
    }
}

impl From<&Health> for HealthRow {
    fn from(health: &Health) -> Self {
        // Checked: no counter is beyond 2^53.
        let count = |count: u64| count as i64;
        let (frames, messages) = (health.frames, health.messages);
        let camera = health.camera.as_ref();
        Self {
            site: health.site.clone(),
            time_ms: health.time.0,
            status: health.status.number().into(),
            alarm: health.alarm.map(|alarm| alarm.name().to_owned()),
            clock_synced: health.clock_synced,
            uptime_s: count(health.uptime_s),
            version: health.version.clone(),
            aim: camera.map(|camera| word(&camera.aim)),
            preset: camera.map(|camera| camera.preset.clone()),
            light: camera.and_then(|camera| camera.light).map(|light| word(&light)),
            pace: health.board.pace.name().to_owned(),
            frames: [
                frames.measured,
                frames.unchanged,
                frames.damaged,
                frames.missing,
                frames.withheld,
            ]
            .map(count),
            windows: [messages.waiting, messages.in_memory, messages.dropped].map(count),
            enclosure_c: health.board.enclosure_c,
            stage_faults: count(health.stage_faults),
            certificate_days: health.certificate_days,
            last_fault: health.last_fault.clone(),
            density_difference: health.traffic.and_then(|it| it.density_difference_veh_km),
        }
    }
}

/// The word that a value has in messages.
fn word(value: &impl serde::Serialize) -> String {
    serde_json::to_value(value)
        .ok()
        .and_then(|value| value.as_str().map(str::to_owned))
        .unwrap_or_default()
}

/// The alarms of a day since 1970.
pub fn alarms_path(root: &Path, day: i64) -> PathBuf {
    root.join("alarms").join(format!("date={}", date(day))).join("alarms.parquet")
}

/// The states of a day since 1970.
pub fn health_path(root: &Path, day: i64) -> PathBuf {
    root.join("health").join(format!("date={}", date(day))).join("health.parquet")
}

/// The places of all sites.
pub fn places_path(root: &Path) -> PathBuf {
    root.join("places").join("places.parquet")
}

/// A row that makes a table with others.
pub trait Record: Sized {
    /// The columns of rows.
    fn columns(rows: &[Self]) -> Vec<(&'static str, ArrayRef)>;

    /// A row of a batch; none where a column that each of them has is missing.
    fn of(batch: &RecordBatch, row: usize) -> Option<Self>;
}

/// Writes a table, whole or not at all.
///
/// # Errors
/// [`Failure::Write`].
pub fn write_table<R: Record>(path: &Path, rows: &[R]) -> Result<(), Failure> {
    make_parent(path)?;
    let columns = R::columns(rows).into_iter().map(|(name, array)| (name, array, true));
    let batch =
        RecordBatch::try_from_iter_with_nullable(columns).expect("all columns have a value a row");
    let properties = WriterProperties::builder().set_compression(Compression::SNAPPY).build();
    write_whole_with(path, |file| {
        let encode = || {
            let mut writer = ArrowWriter::try_new(file, batch.schema(), Some(properties.clone()))?;
            writer.write(&batch)?;
            writer.close()
        };
        encode().map(drop).map_err(std::io::Error::other)
    })
}

/// Reads a table; one that is not there has no rows.
///
/// # Errors
/// [`Failure`] where it is damaged or another's.
pub fn read_table<R: Record>(path: &Path) -> Result<Vec<R>, Failure> {
    let file = match File::open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(source) => return Err(Failure::reading(path, source)),
    };
    let wrong = |reason: String| Failure::content(path, 0, format!("is damaged: {reason}"));
    let read = || -> Result<Vec<R>, String> {
        let reader = ParquetRecordBatchReaderBuilder::try_new(file)
            .and_then(|builder| builder.build())
            .map_err(|error| error.to_string())?;
        let mut rows = Vec::new();
        for batch in reader {
            let batch = batch.map_err(|error| error.to_string())?;
            for row in 0..batch.num_rows() {
                rows.push(R::of(&batch, row).ok_or("a column is missing")?);
            }
        }
        Ok(rows)
    };
    // On a damaged file the crate returns an error, or panics.
    let panicked = |_| Err("its reader panicked".to_owned());
    catch_unwind(AssertUnwindSafe(read)).unwrap_or_else(panicked).map_err(wrong)
}

fn texts<'r, R>(rows: &'r [R], of: impl Fn(&'r R) -> Option<&'r str>) -> ArrayRef {
    Arc::new(rows.iter().map(of).collect::<StringArray>())
}

fn integers<R>(rows: &[R], of: impl Fn(&R) -> Option<i64>) -> ArrayRef {
    Arc::new(rows.iter().map(of).collect::<Int64Array>())
}

fn floats<R>(rows: &[R], of: impl Fn(&R) -> Option<f32>) -> ArrayRef {
    Arc::new(rows.iter().map(of).collect::<Float32Array>())
}

fn degrees<R>(rows: &[R], of: impl Fn(&R) -> Option<f64>) -> ArrayRef {
    Arc::new(rows.iter().map(of).collect::<Float64Array>())
}

fn truths<R>(rows: &[R], of: impl Fn(&R) -> bool) -> ArrayRef {
    Arc::new(rows.iter().map(|row| Some(of(row))).collect::<BooleanArray>())
}

fn times<R>(rows: &[R], of: impl Fn(&R) -> i64) -> ArrayRef {
    let times: TimestampMillisecondArray = rows.iter().map(|row| Some(of(row))).collect();
    Arc::new(times.with_timezone("UTC"))
}

fn number<T: ArrowPrimitiveType>(batch: &RecordBatch, name: &str, row: usize) -> Option<T::Native> {
    let column = batch.column_by_name(name)?.as_primitive_opt::<T>()?;
    column.is_valid(row).then(|| column.value(row))
}

fn time(batch: &RecordBatch, name: &str, row: usize) -> Option<i64> {
    number::<TimestampMillisecondType>(batch, name, row)
}

fn text(batch: &RecordBatch, name: &str, row: usize) -> Option<String> {
    let column = batch.column_by_name(name)?.as_string_opt::<i32>()?;
    column.is_valid(row).then(|| column.value(row).to_owned())
}

fn truth(batch: &RecordBatch, name: &str, row: usize) -> Option<bool> {
    let column = batch.column_by_name(name)?.as_boolean_opt()?;
    column.is_valid(row).then(|| column.value(row))
}

impl Record for AlarmRow {
    fn columns(rows: &[Self]) -> Vec<(&'static str, ArrayRef)> {
        vec![
            ("site", texts(rows, |row| Some(&row.site))),
            ("time", times(rows, |row| row.time_ms)),
            ("name", texts(rows, |row| Some(&row.name))),
            ("active", truths(rows, |row| row.active)),
        ]
    }

    fn of(batch: &RecordBatch, row: usize) -> Option<Self> {
        Some(Self {
            site: text(batch, "site", row)?,
            time_ms: time(batch, "time", row)?,
            name: text(batch, "name", row)?,
            active: truth(batch, "active", row)?,
        })
    }
}

const FRAMES: [&str; 5] =
    ["frames_measured", "frames_unchanged", "frames_damaged", "frames_missing", "frames_withheld"];
const WINDOWS: [&str; 3] = ["windows_waiting", "windows_in_memory", "windows_dropped"];

impl Record for HealthRow {
    fn columns(rows: &[Self]) -> Vec<(&'static str, ArrayRef)> {
        let status: Int32Array = rows.iter().map(|row| Some(row.status)).collect();
        let mut columns = vec![
            ("site", texts(rows, |row| Some(&row.site))),
            ("time", times(rows, |row| row.time_ms)),
            ("status", Arc::new(status) as ArrayRef),
            ("alarm", texts(rows, |row| row.alarm.as_deref())),
            ("clock_synced", truths(rows, |row| row.clock_synced)),
            ("uptime_s", integers(rows, |row| Some(row.uptime_s))),
            ("version", texts(rows, |row| Some(&row.version))),
            ("aim", texts(rows, |row| row.aim.as_deref())),
            ("preset", texts(rows, |row| row.preset.as_deref())),
            ("light", texts(rows, |row| row.light.as_deref())),
            ("pace", texts(rows, |row| Some(&row.pace))),
            ("enclosure_c", floats(rows, |row| row.enclosure_c)),
            ("stage_faults", integers(rows, |row| Some(row.stage_faults))),
            ("certificate_days", integers(rows, |row| row.certificate_days)),
            ("last_fault", texts(rows, |row| row.last_fault.as_deref())),
            ("density_difference_veh_km", floats(rows, |row| row.density_difference)),
        ];
        for (which, name) in FRAMES.into_iter().enumerate() {
            columns.push((name, integers(rows, |row| Some(row.frames[which]))));
        }
        for (which, name) in WINDOWS.into_iter().enumerate() {
            columns.push((name, integers(rows, |row| Some(row.windows[which]))));
        }
        columns
    }

    fn of(batch: &RecordBatch, row: usize) -> Option<Self> {
        let count = |name: &str| number::<Int64Type>(batch, name, row).unwrap_or_default();
        Some(Self {
            site: text(batch, "site", row)?,
            time_ms: time(batch, "time", row)?,
            status: number::<Int32Type>(batch, "status", row)?,
            alarm: text(batch, "alarm", row),
            clock_synced: truth(batch, "clock_synced", row)?,
            uptime_s: count("uptime_s"),
            version: text(batch, "version", row)?,
            aim: text(batch, "aim", row),
            preset: text(batch, "preset", row),
            light: text(batch, "light", row),
            pace: text(batch, "pace", row)?,
            frames: FRAMES.map(count),
            windows: WINDOWS.map(count),
            enclosure_c: number::<Float32Type>(batch, "enclosure_c", row),
            stage_faults: count("stage_faults"),
            certificate_days: number::<Int64Type>(batch, "certificate_days", row),
            last_fault: text(batch, "last_fault", row),
            density_difference: number::<Float32Type>(batch, "density_difference_veh_km", row),
        })
    }
}

impl Record for PlaceRow {
    fn columns(rows: &[Self]) -> Vec<(&'static str, ArrayRef)> {
        vec![
            ("site", texts(rows, |row| Some(&row.site))),
            ("since", times(rows, |row| row.since_ms)),
            ("name", texts(rows, |row| row.place.name.as_deref())),
            ("road", texts(rows, |row| row.place.road.as_deref())),
            ("direction", texts(rows, |row| row.place.direction.as_deref())),
            ("latitude", degrees(rows, |row| row.place.latitude)),
            ("longitude", degrees(rows, |row| row.place.longitude)),
            ("bearing", degrees(rows, |row| row.place.bearing)),
            ("lanes", texts(rows, |row| Some(&row.lanes))),
        ]
    }

    fn of(batch: &RecordBatch, row: usize) -> Option<Self> {
        let degrees = |name: &str| number::<Float64Type>(batch, name, row);
        Some(Self {
            site: text(batch, "site", row)?,
            since_ms: time(batch, "since", row)?,
            place: Place {
                name: text(batch, "name", row),
                road: text(batch, "road", row),
                direction: text(batch, "direction", row),
                latitude: degrees("latitude"),
                longitude: degrees("longitude"),
                bearing: degrees("bearing"),
            },
            lanes: text(batch, "lanes", row).unwrap_or_default(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{Message, read_any, tests::health};

    #[test]
    fn tables_come_back_as_they_were() {
        let folder = tempfile::tempdir().unwrap();
        let text = health("a", "2026-01-05T08:00:00.000Z", false);
        let Ok(Message::Health(message)) = read_any(text.as_bytes()) else { panic!("health") };
        let row = HealthRow::from(&*message);
        let moved =
            HealthRow { aim: Some("moved".into()), certificate_days: Some(-3), ..row.clone() };
        let path = health_path(folder.path(), 20_458);
        write_table(&path, &[row.clone(), moved.clone()]).unwrap();
        assert_eq!(read_table::<HealthRow>(&path).unwrap(), [row, moved]);
        let place = PlaceRow {
            site: "a".into(),
            since_ms: 7,
            place: Place { latitude: Some(22.362_51), longitude: Some(-1.0), ..Place::default() },
            lanes: "[]".into(),
        };
        let path = places_path(folder.path());
        assert_eq!(read_table::<PlaceRow>(&path).unwrap(), [], "no file, no row");
        write_table(&path, std::slice::from_ref(&place)).unwrap();
        assert_eq!(read_table::<PlaceRow>(&path).unwrap(), [place]);
        assert!(
            read_table::<AlarmRow>(&path).unwrap_err().to_string().contains("a column is missing")
        );
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        assert!(read_table::<PlaceRow>(&path).unwrap_err().to_string().contains("is damaged"));
    }
}
