//! Reading one density file: the door of the crate `parquet` inwards.
//!
//! Rows come some at a time, so that a day may be larger than memory. What an older archiver did
//! not write is not known. A damaged file is an error, whatever the crate makes of it.

use super::schema::{COLUMNS, COLUMNS_WITHOUT_ERRORS, COLUMNS_WITHOUT_TRAFFIC};
use super::{Moving, Row};
use bytes::Bytes;
use parquet::column::reader::{ColumnReaderImpl, get_typed_column_reader};
use parquet::data_type::{BoolType, DataType, FloatType, Int32Type, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::reader::{FileReader, RowGroupReader, SerializedFileReader};
use std::fs::File;
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use verge_desk::Failure;

/// Rows that are read at once.
const BATCH_ROWS: usize = 1 << 13;

/// A file of at most so many bytes is read at once: that saves a system call a column.
const SMALL_BYTES: u64 = 4 << 20;

pub(super) fn open(path: &Path) -> Result<Box<dyn FileReader>, Failure> {
    let failed = |source| Failure::reading(path, source);
    let mut file = File::open(path).map_err(failed)?;
    let length = file.metadata().map_err(failed)?.len();
    let reader = if length <= SMALL_BYTES {
        let mut bytes = Vec::with_capacity(length as usize);
        file.read_to_end(&mut bytes).map_err(failed)?;
        guarded(|| Ok(Box::new(SerializedFileReader::new(Bytes::from(bytes))?) as Box<_>))
    } else {
        guarded(|| Ok(Box::new(SerializedFileReader::new(file)?) as Box<_>))
    };
    let reader: Box<dyn FileReader> = reader.map_err(|error| damaged(path, &error))?;
    let columns = reader.metadata().file_metadata().schema_descr().num_columns();
    if [COLUMNS_WITHOUT_ERRORS, COLUMNS_WITHOUT_TRAFFIC, COLUMNS].contains(&columns) {
        return Ok(reader);
    }
    Err(Failure::content(path, 0, "is not a file of verge's archive; keep others out of it"))
}

pub(super) fn damaged(path: &Path, error: &ParquetError) -> Failure {
    let reason = format!("is damaged: {error}; restore it, or move it away");
    Failure::content(path, 0, reason)
}

/// Turns a panic into an error: on a damaged file the crate does either.
pub(super) fn guarded<T>(
    read: impl FnOnce() -> Result<T, ParquetError>,
) -> Result<T, ParquetError> {
    let panicked = |_| Err(ParquetError::General("its reader panicked".into()));
    catch_unwind(AssertUnwindSafe(read)).unwrap_or_else(panicked)
}

/// Reads all rows of a file.
///
/// # Errors
/// [`Failure`] where it is not there or damaged.
pub fn read(path: &Path) -> Result<Vec<Row>, Failure> {
    Rows::open(path)?.collect()
}

/// The rows of a file, in its order; some are in memory at a time.
pub struct Rows {
    path: PathBuf,
    reader: Box<dyn FileReader>,
    next_group: usize,
    columns: Option<Columns>,
    batch: std::vec::IntoIter<Row>,
}

impl Rows {
    /// Opens a file.
    ///
    /// # Errors
    /// [`Failure`] where it is not there, damaged or another's.
    pub fn open(path: &Path) -> Result<Self, Failure> {
        Ok(Self {
            path: path.to_owned(),
            reader: open(path)?,
            next_group: 0,
            columns: None,
            batch: Vec::new().into_iter(),
        })
    }

    /// Reads on; false at the end.
    fn fill(&mut self) -> Result<bool, ParquetError> {
        loop {
            if let Some(columns) = &mut self.columns {
                let rows = columns.read(BATCH_ROWS)?;
                if !rows.is_empty() {
                    self.batch = rows.into_iter();
                    return Ok(true);
                }
            }
            if self.next_group >= self.reader.num_row_groups() {
                return Ok(false);
            }
            let group = self.reader.get_row_group(self.next_group)?;
            self.columns = Some(Columns::of(&*group)?);
            self.next_group += 1;
        }
    }
}

impl Iterator for Rows {
    type Item = Result<Row, Failure>;

    fn next(&mut self) -> Option<Self::Item> {
        if let Some(row) = self.batch.next() {
            return Some(Ok(row));
        }
        match guarded(|| self.fill()) {
            Ok(true) => self.batch.next().map(Ok),
            Ok(false) => None,
            Err(error) => {
                // There is nothing to read behind the damage.
                (self.columns, self.next_group) = (None, usize::MAX);
                Some(Err(damaged(&self.path, &error)))
            }
        }
    }
}

pub(super) type Column<T> = ColumnReaderImpl<T>;

/// The columns of a row group, read side by side.
struct Columns {
    window_s: Column<Int32Type>,
    from: Column<Int64Type>,
    lane: Column<Int32Type>,
    cell: Column<Int32Type>,
    position: Column<FloatType>,
    length: Column<FloatType>,
    density: Column<FloatType>,
    se: Column<FloatType>,
    vehicles: Column<FloatType>,
    occupancy: Column<FloatType>,
    frames_used: Column<Int32Type>,
    frames_expected: Column<Int32Type>,
    status: Column<Int32Type>,
    seq: Column<Int64Type>,
    clock_synced: Column<BoolType>,
    rel_err: Column<FloatType>,
    /// Low and high end of the interval, errors of calibration and of counting; none in a file
    /// from before.
    errors: Option<[Column<FloatType>; 4]>,
    /// Flow and speed; none in a file from before.
    traffic: Option<TrafficColumns>,
}

/// The columns of flow and speed.
struct TrafficColumns {
    status: Column<Int32Type>,
    passed: Column<Int32Type>,
    /// Flow and the ends of its interval, speed and those of its, occupancy, queue.
    floats: [Column<FloatType>; 8],
}

impl Columns {
    fn of(group: &dyn RowGroupReader) -> Result<Self, ParquetError> {
        fn column<T: DataType>(
            group: &dyn RowGroupReader,
            index: usize,
        ) -> Result<Column<T>, ParquetError> {
            Ok(get_typed_column_reader(group.get_column_reader(index)?))
        }
        Ok(Self {
            window_s: column(group, 0)?,
            from: column(group, 1)?,
            lane: column(group, 2)?,
            cell: column(group, 3)?,
            position: column(group, 4)?,
            length: column(group, 5)?,
            density: column(group, 6)?,
            se: column(group, 7)?,
            vehicles: column(group, 8)?,
            occupancy: column(group, 9)?,
            frames_used: column(group, 10)?,
            frames_expected: column(group, 11)?,
            status: column(group, 12)?,
            seq: column(group, 13)?,
            clock_synced: column(group, 14)?,
            rel_err: column(group, 15)?,
            errors: if group.num_columns() > COLUMNS_WITHOUT_ERRORS {
                Some([
                    column(group, 16)?,
                    column(group, 17)?,
                    column(group, 18)?,
                    column(group, 19)?,
                ])
            } else {
                None
            },
            traffic: if group.num_columns() > COLUMNS_WITHOUT_TRAFFIC {
                let mut floats = Vec::new();
                for index in COLUMNS_WITHOUT_TRAFFIC + 2..COLUMNS {
                    floats.push(column(group, index)?);
                }
                Some(TrafficColumns {
                    status: column(group, COLUMNS_WITHOUT_TRAFFIC)?,
                    passed: column(group, COLUMNS_WITHOUT_TRAFFIC + 1)?,
                    floats: floats.try_into().ok().expect("the schema has eight of them"),
                })
            } else {
                None
            },
        })
    }

    /// The next rows, at most so many.
    fn read(&mut self, most: usize) -> Result<Vec<Row>, ParquetError> {
        let window_s = values(&mut self.window_s, most)?.0;
        let count = window_s.len();
        let from = all(&mut self.from, count)?;
        let lane = all(&mut self.lane, count)?;
        let cell = known(&mut self.cell, count)?;
        let position = known(&mut self.position, count)?;
        let length = all(&mut self.length, count)?;
        let density = known(&mut self.density, count)?;
        let se = known(&mut self.se, count)?;
        let vehicles = known(&mut self.vehicles, count)?;
        let occupancy = known(&mut self.occupancy, count)?;
        let frames_used = all(&mut self.frames_used, count)?;
        let frames_expected = all(&mut self.frames_expected, count)?;
        let status = all(&mut self.status, count)?;
        let seq = all(&mut self.seq, count)?;
        let clock_synced = all(&mut self.clock_synced, count)?;
        let rel_err = known(&mut self.rel_err, count)?;
        let errors = match &mut self.errors {
            None => None,
            Some([low, high, calibration, counting]) => Some([
                known(low, count)?,
                known(high, count)?,
                known(calibration, count)?,
                known(counting, count)?,
            ]),
        };
        let moving = self.traffic.as_mut().map(|columns| columns.read(count)).transpose()?;
        let error = |which: usize, i: usize| errors.as_ref().and_then(|all| all[which][i]);
        let row = |i: usize| Row {
            window_s: window_s[i],
            from_ms: from[i],
            lane: lane[i],
            cell: cell[i],
            position_m: position[i],
            length_m: length[i],
            density: density[i],
            se: se[i],
            vehicles: vehicles[i],
            occupancy: occupancy[i],
            frames_used: frames_used[i],
            frames_expected: frames_expected[i],
            status: status[i],
            seq: seq[i],
            clock_synced: clock_synced[i],
            rel_err: rel_err[i],
            ci90: error(0, i).zip(error(1, i)).map(|(low, high)| [low, high]),
            calibration_se: error(2, i),
            counting_se: error(3, i),
            traffic: moving.as_ref().and_then(|all| all[i]),
        };
        Ok((0..count).map(row).collect())
    }
}

impl TrafficColumns {
    /// So many of the next rows; none where a lane's vehicles were not followed.
    fn read(&mut self, count: usize) -> Result<Vec<Option<Moving>>, ParquetError> {
        let status = known(&mut self.status, count)?;
        let passed = known(&mut self.passed, count)?;
        let mut floats = Vec::new();
        for column in &mut self.floats {
            floats.push(known(column, count)?);
        }
        let of = |row: usize| {
            let value = |which: usize| floats[which][row];
            let ends = |which: usize| value(which).zip(value(which + 1)).map(|(a, b)| [a, b]);
            Some(Moving {
                status: status[row]?,
                flow: value(0),
                flow_ci90: ends(1),
                speed: value(3),
                speed_ci90: ends(4),
                occupancy: value(6),
                queue_m: value(7),
                passed: passed[row],
            })
        };
        Ok((0..count).map(of).collect())
    }
}

/// Values of a column, and the levels that say which are known (empty: all are).
pub(super) fn values<T: DataType>(
    column: &mut Column<T>,
    most: usize,
) -> Result<(Vec<T::T>, Vec<i16>), ParquetError> {
    let (mut values, mut known) = (Vec::new(), Vec::new());
    let mut count = 0;
    while count < most {
        let read = column.read_records(most - count, Some(&mut known), None, &mut values)?.0;
        if read == 0 {
            break;
        }
        count += read;
    }
    Ok((values, known))
}

/// So many values of a column in which all are known.
pub(super) fn all<T: DataType>(
    column: &mut Column<T>,
    count: usize,
) -> Result<Vec<T::T>, ParquetError> {
    let (values, _) = values::<T>(column, count)?;
    if values.len() == count { Ok(values) } else { Err(short()) }
}

/// So many values of a column in which some may not be known.
fn known<T: DataType>(
    column: &mut Column<T>,
    count: usize,
) -> Result<Vec<Option<T::T>>, ParquetError> {
    let (values, levels) = values::<T>(column, count)?;
    let mut values = values.into_iter();
    let all: Vec<_> =
        levels.iter().map(|&level| if level > 0 { values.next() } else { None }).collect();
    if all.len() == count { Ok(all) } else { Err(short()) }
}

pub(super) fn short() -> ParquetError {
    ParquetError::General("its columns have different lengths".into())
}
