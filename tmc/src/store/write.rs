//! Writing one density file: the door of the crate `parquet` outwards.
//!
//! Owns encodings and row groups. Snappy, dictionaries except for the two rising columns, no page
//! statistics: readers take whole days. Rows come some at a time, so that a day may be larger
//! than memory.

use super::schema::SCHEMA;
use super::{Moving, Row};
use parquet::basic::{Compression, Encoding};
use parquet::data_type::{BoolType, DataType, FloatType, Int32Type, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::{EnabledStatistics, WriterProperties, WriterVersion};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::ColumnPath;
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::sync::Arc;
use verge_desk::{Failure, make_parent, write_whole_with};

/// Rows of a row group, so that one of them takes some MB of memory.
pub(super) const GROUP_ROWS: usize = 1 << 16;

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
        // A part that was written must not take the old file's place.
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
        put_known::<Int32Type, W>(&mut group, rows, |row| Some(row.traffic?.status))?;
        put_known::<Int32Type, W>(&mut group, rows, |row| row.traffic?.passed)?;
        let floats: [fn(&Moving) -> Option<f32>; 8] = [
            |it| it.flow,
            |it| it.flow_ci90.map(|[low, _]| low),
            |it| it.flow_ci90.map(|[_, high]| high),
            |it| it.speed,
            |it| it.speed_ci90.map(|[low, _]| low),
            |it| it.speed_ci90.map(|[_, high]| high),
            |it| it.occupancy,
            |it| it.queue_m,
        ];
        for value in floats {
            put_known::<FloatType, W>(&mut group, rows, |row| value(row.traffic.as_ref()?))?;
        }
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
    value: impl Fn(&Row) -> Option<T::T>,
) -> Result<(), ParquetError> {
    let values: Vec<T::T> = rows.iter().filter_map(&value).collect();
    let known: Vec<i16> = rows.iter().map(|row| i16::from(value(row).is_some())).collect();
    let mut column = group.next_column()?.expect("the schema has this column");
    column.typed::<T>().write_batch(&values, Some(&known), None)?;
    column.close()
}
