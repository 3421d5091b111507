//! One Parquet file of the archive: the door of the crate `parquet`.
//!
//! Owns schema, encodings and row groups. Snappy, dictionaries except for the two rising
//! columns, no page statistics: readers take whole days. Rows come and go some at a time, so
//! that a day may be larger than memory.

use super::Row;
use datafusion::arrow::datatypes::Schema;
use parquet::arrow::parquet_to_arrow_schema;
use parquet::basic::{Compression, Encoding};
use parquet::column::reader::{ColumnReaderImpl, get_typed_column_reader};
use parquet::data_type::{BoolType, DataType, FloatType, Int32Type, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::{EnabledStatistics, WriterProperties, WriterVersion};
use parquet::file::reader::{FileReader, RowGroupReader, SerializedFileReader};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::{ColumnPath, SchemaDescriptor};
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use verge_desk::{Failure, make_parent, write_whole_with};

const SCHEMA: &str = "message density {
    required int32 window_s; required int64 from (TIMESTAMP(MILLIS,true)); required int32 lane;
    optional int32 cell; optional float position_m; required float length_m;
    optional float density_veh_km; optional float density_se; optional float vehicles_mean;
    optional float space_occupancy; required int32 frames_used; required int32 frames_expected;
    required int32 status; required int64 seq; required boolean clock_synced;
    optional float calibration_rel_err;
    optional float density_low90; optional float density_high90;
    optional float calibration_se; optional float counting_se;
}";
/// Columns of the schema, in its order.
const COLUMNS: usize = 20;
/// Those of files from before the interval of a density was measured.
const COLUMNS_BEFORE: usize = 16;

/// The columns as the query engine knows them.
pub fn arrow_schema() -> Schema {
    let columns = parse_message_type(SCHEMA).expect("the schema is well-formed");
    parquet_to_arrow_schema(&SchemaDescriptor::new(Arc::new(columns)), None)
        .expect("each of its types has one in Arrow")
}

/// Rows of a row group, so that one of them takes some MB of memory.
const GROUP_ROWS: usize = 1 << 16;
/// Rows that are read at once.
const BATCH_ROWS: usize = 1 << 13;

/// Writes rows, sorted by their keys, whole or not at all.
///
/// # Errors
/// [`Failure::Write`].
pub fn write(path: &Path, rows: &[Row]) -> Result<(), Failure> {
    let mut rows = rows.iter().cloned();
    write_rows(path, || Ok(rows.next()))
}

/// The same with a function that gives one row after the other.
///
/// # Errors
/// [`Failure::Write`], and what `next` returns; an old file is then as it was.
pub fn write_rows(
    path: &Path,
    mut next: impl FnMut() -> Result<Option<Row>, Failure>,
) -> Result<(), Failure> {
    let mut broken = None;
    make_parent(path)?;
    let written = write_whole_with(path, |file| {
        let mut buffer = BufWriter::new(file);
        let mut encode = || -> Result<(), ParquetError> {
            let mut writer = Writer::begin(&mut buffer)?;
            while let Some(row) = next().unwrap_or_else(|failure| {
                broken = Some(failure);
                None
            }) {
                writer.push(row)?;
            }
            writer.finish()
        };
        encode().map_err(io::Error::other)?;
        // What was written is not the whole, and must not take the old one's place.
        if broken.is_some() { Err(io::Error::other("a row is missing")) } else { buffer.flush() }
    });
    broken.map_or(written, Err)
}

/// Writes rows into row groups: the lanes first, then the cells, each in groups of at most
/// [`GROUP_ROWS`].
struct Writer<W: Write + Send> {
    writer: SerializedFileWriter<W>,
    rows: Vec<Row>,
}

impl<W: Write + Send> Writer<W> {
    fn begin(to: W) -> Result<Self, ParquetError> {
        let rising = |name: &str| ColumnPath::from(name);
        let properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_writer_version(WriterVersion::PARQUET_2_0)
            .set_statistics_enabled(EnabledStatistics::Chunk)
            .set_column_dictionary_enabled(rising("from"), false)
            .set_column_encoding(rising("from"), Encoding::DELTA_BINARY_PACKED)
            .set_column_dictionary_enabled(rising("seq"), false)
            .set_column_encoding(rising("seq"), Encoding::DELTA_BINARY_PACKED)
            .build();
        let schema = Arc::new(parse_message_type(SCHEMA)?);
        let writer = SerializedFileWriter::new(to, schema, Arc::new(properties))?;
        Ok(Self { writer, rows: Vec::new() })
    }

    fn push(&mut self, row: Row) -> Result<(), ParquetError> {
        let kind = |row: &Row| row.cell.is_some();
        let is_other = self.rows.last().is_some_and(|last| kind(last) != kind(&row));
        if is_other || self.rows.len() >= GROUP_ROWS {
            self.write_group()?;
        }
        self.rows.push(row);
        Ok(())
    }

    fn finish(mut self) -> Result<(), ParquetError> {
        self.write_group()?;
        self.writer.close().map(drop)
    }

    fn write_group(&mut self) -> Result<(), ParquetError> {
        let rows = std::mem::take(&mut self.rows);
        if rows.is_empty() {
            return Ok(());
        }
        let (rows, mut group) = (rows.as_slice(), self.writer.next_row_group()?);
        put::<Int32Type, W>(&mut group, rows, |row| row.window_s)?;
        put::<Int64Type, W>(&mut group, rows, |row| row.from_ms)?;
        put::<Int32Type, W>(&mut group, rows, |row| row.lane)?;
        put_known::<Int32Type, W>(&mut group, rows, |row| row.cell)?;
        put_known::<FloatType, W>(&mut group, rows, |row| row.position_m)?;
        put::<FloatType, W>(&mut group, rows, |row| row.length_m)?;
        put_known::<FloatType, W>(&mut group, rows, |row| row.density)?;
        put_known::<FloatType, W>(&mut group, rows, |row| row.se)?;
        put_known::<FloatType, W>(&mut group, rows, |row| row.vehicles)?;
        put_known::<FloatType, W>(&mut group, rows, |row| row.occupancy)?;
        put::<Int32Type, W>(&mut group, rows, |row| row.frames_used)?;
        put::<Int32Type, W>(&mut group, rows, |row| row.frames_expected)?;
        put::<Int32Type, W>(&mut group, rows, |row| row.status)?;
        put::<Int64Type, W>(&mut group, rows, |row| row.seq)?;
        put::<BoolType, W>(&mut group, rows, |row| row.clock_synced)?;
        put_known::<FloatType, W>(&mut group, rows, |row| row.rel_err)?;
        put_known::<FloatType, W>(&mut group, rows, |row| row.ci90.map(|[low, _]| low))?;
        put_known::<FloatType, W>(&mut group, rows, |row| row.ci90.map(|[_, high]| high))?;
        put_known::<FloatType, W>(&mut group, rows, |row| row.calibration_se)?;
        put_known::<FloatType, W>(&mut group, rows, |row| row.counting_se)?;
        group.close().map(drop)
    }
}

fn put<T: DataType, W: Write + Send>(
    group: &mut SerializedRowGroupWriter<'_, W>,
    rows: &[Row],
    value: fn(&Row) -> T::T,
) -> Result<(), ParquetError> {
    let values: Vec<T::T> = rows.iter().map(value).collect();
    let mut column = group.next_column()?.expect("the schema has this column");
    column.typed::<T>().write_batch(&values, None, None)?;
    column.close()
}

fn put_known<T: DataType, W: Write + Send>(
    group: &mut SerializedRowGroupWriter<'_, W>,
    rows: &[Row],
    value: fn(&Row) -> Option<T::T>,
) -> Result<(), ParquetError> {
    let values: Vec<T::T> = rows.iter().filter_map(value).collect();
    let known: Vec<i16> = rows.iter().map(|row| i16::from(value(row).is_some())).collect();
    let mut column = group.next_column()?.expect("the schema has this column");
    column.typed::<T>().write_batch(&values, Some(&known), None)?;
    column.close()
}

fn open(path: &Path) -> Result<SerializedFileReader<File>, Failure> {
    let file = File::open(path).map_err(|source| Failure::reading(path, source))?;
    let reader = guarded(|| SerializedFileReader::new(file));
    let reader = reader.map_err(|error| damaged(path, &error))?;
    let columns = reader.metadata().file_metadata().schema_descr().num_columns();
    if [COLUMNS_BEFORE, COLUMNS].contains(&columns) {
        return Ok(reader);
    }
    Err(Failure::content(path, 0, "is no file of verge's archive; keep others out of it"))
}

fn damaged(path: &Path, error: &ParquetError) -> Failure {
    let reason = format!("is damaged: {error}; restore it, or move it away");
    Failure::content(path, 0, reason)
}

/// What a damaged file makes the crate do: return an error, or panic.
fn guarded<T>(read: impl FnOnce() -> Result<T, ParquetError>) -> Result<T, ParquetError> {
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
    reader: SerializedFileReader<File>,
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

type Column<T> = ColumnReaderImpl<T>;

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
            errors: if group.num_columns() == COLUMNS {
                Some([
                    column(group, 16)?,
                    column(group, 17)?,
                    column(group, 18)?,
                    column(group, 19)?,
                ])
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
        };
        Ok((0..count).map(row).collect())
    }
}

/// Values of a column, and the levels that say which are known (empty: all are).
fn values<T: DataType>(
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
fn all<T: DataType>(column: &mut Column<T>, count: usize) -> Result<Vec<T::T>, ParquetError> {
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

fn short() -> ParquetError {
    ParquetError::General("its columns have different lengths".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(from_ms: i64, lane: i32, cell: Option<i32>) -> Row {
        let known = lane == 1;
        Row {
            window_s: 60,
            from_ms,
            lane,
            cell,
            position_m: cell.map(|cell| cell as f32 * 10.0),
            length_m: 10.0,
            density: known.then_some(from_ms as f32),
            se: known.then_some(0.5),
            vehicles: None,
            occupancy: known.then_some(0.25),
            frames_used: 3,
            frames_expected: 4,
            status: if known { 2 } else { 10 },
            seq: from_ms / 60_000,
            clock_synced: known,
            rel_err: known.then_some(0.02),
            ci90: known.then_some([1.0, 2.5]),
            calibration_se: known.then_some(0.125),
            counting_se: None,
        }
    }

    #[test]
    fn rows_come_back_as_they_were() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.parquet");
        let mut rows: Vec<Row> = (0..500)
            .flat_map(|i| {
                let of = move |lane, cell| row(i * 60_000, lane, cell);
                [of(1, None), of(2, None), of(1, Some(0)), of(1, Some(1))]
            })
            .collect();
        rows.sort_by_key(Row::key);
        write(&path, &rows).unwrap();
        assert_eq!(read(&path).unwrap(), rows);
    }

    #[test]
    fn a_day_of_many_row_groups_comes_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.parquet");
        let most = 2 * GROUP_ROWS as i64 + 7;
        let mut rows = (0..most).map(|i| row(i * 60_000, 1 + (i % 2) as i32, None));
        write_rows(&path, || Ok(rows.next())).unwrap();
        let mut expected = (0..most).map(|i| row(i * 60_000, 1 + (i % 2) as i32, None));
        for row in Rows::open(&path).unwrap() {
            assert_eq!(row.unwrap(), expected.next().unwrap());
        }
        assert!(expected.next().is_none());
        // A row that cannot be had leaves the old file.
        let gone = || Failure::content(Path::new("x"), 0, "is gone");
        let mut count = 0;
        let failed = write_rows(&path, || {
            count += 1;
            if count < 9 { Ok(Some(row(0, 1, None))) } else { Err(gone()) }
        });
        assert_eq!(failed.unwrap_err().to_string(), gone().to_string());
        assert_eq!(read(&path).unwrap().len() as i64, most);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn damage_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.parquet");
        write(&path, &[row(0, 1, None)]).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("is damaged"));
        assert!(matches!(read(&folder.path().join("b")), Err(Failure::Missing { .. })));
    }

    #[test]
    fn whatever_is_damaged_is_an_error_or_rows_and_never_a_panic() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.parquet");
        let rows: Vec<Row> = (0..40).map(|i| row(i * 60_000, 1, (i > 20).then_some(3))).collect();
        write(&path, &rows).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let said = std::panic::take_hook();
        std::panic::set_hook(Box::new(|_| {}));
        let (mut damaged, mut panicked) = (0, 0);
        for bit in (0..whole.len() * 8).step_by(37) {
            let mut wrong = whole.clone();
            wrong[bit / 8] ^= 1 << (bit % 8);
            std::fs::write(&path, &wrong).unwrap();
            let read = read(&path);
            damaged += usize::from(read.is_err());
            panicked += usize::from(read.is_err_and(|e| e.to_string().contains("panicked")));
        }
        std::panic::set_hook(said);
        assert!(damaged > 100 && panicked > 0, "{damaged}, {panicked}");
    }
}
