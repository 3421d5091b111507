//! One Parquet file of the archive: the door of the crate `parquet`.
//!
//! Owns schema, encodings and row groups. Snappy, dictionaries except for the two rising
//! columns, no page statistics: readers take whole days.

use super::Row;
use crate::failure::Failure;
use crate::whole;
use datafusion::arrow::datatypes::Schema;
use parquet::arrow::parquet_to_arrow_schema;
use parquet::basic::{Compression, Encoding};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl, get_typed_column_reader};
use parquet::data_type::{BoolType, DataType, FloatType, Int32Type, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::{EnabledStatistics, WriterProperties, WriterVersion};
use parquet::file::reader::{FileReader, RowGroupReader, SerializedFileReader};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::{ColumnPath, SchemaDescriptor};
use std::fs::File;
use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;

const SCHEMA: &str = "message density {
    required int32 window_s; required int64 from (TIMESTAMP(MILLIS,true)); required int32 lane;
    optional int32 cell; optional float position_m; required float length_m;
    optional float density_veh_km; optional float density_se; optional float vehicles_mean;
    optional float space_occupancy; required int32 frames_used; required int32 frames_expected;
    required int32 status; required int64 seq; required boolean clock_synced;
    optional float calibration_rel_err;
}";
/// Columns of the schema, in its order.
const COLUMNS: usize = 16;

/// The columns as the query engine knows them.
pub fn arrow_schema() -> Schema {
    let columns = parse_message_type(SCHEMA).expect("the schema is well-formed");
    parquet_to_arrow_schema(&SchemaDescriptor::new(Arc::new(columns)), None)
        .expect("each of its types has one in Arrow")
}

/// Writes rows, sorted by their keys, whole or not at all.
///
/// # Errors
/// [`Failure::Write`].
pub fn write(path: &Path, rows: &[Row]) -> Result<(), Failure> {
    whole::write_with(path, |file| encode(file, rows).map_err(io::Error::other))
}

fn encode(file: &mut File, rows: &[Row]) -> Result<(), ParquetError> {
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
    let mut buffer = Vec::new();
    let mut writer = SerializedFileWriter::new(&mut buffer, schema, Arc::new(properties))?;
    let cells = rows.partition_point(|row| row.cell.is_none());
    for rows in [&rows[..cells], &rows[cells..]] {
        if rows.is_empty() {
            continue;
        }
        let mut group = writer.next_row_group()?;
        put::<Int32Type>(&mut group, rows, |row| row.window_s)?;
        put::<Int64Type>(&mut group, rows, |row| row.from_ms)?;
        put::<Int32Type>(&mut group, rows, |row| row.lane)?;
        put_known::<Int32Type>(&mut group, rows, |row| row.cell)?;
        put_known::<FloatType>(&mut group, rows, |row| row.position_m)?;
        put::<FloatType>(&mut group, rows, |row| row.length_m)?;
        put_known::<FloatType>(&mut group, rows, |row| row.density)?;
        put_known::<FloatType>(&mut group, rows, |row| row.se)?;
        put_known::<FloatType>(&mut group, rows, |row| row.vehicles)?;
        put_known::<FloatType>(&mut group, rows, |row| row.occupancy)?;
        put::<Int32Type>(&mut group, rows, |row| row.frames_used)?;
        put::<Int32Type>(&mut group, rows, |row| row.frames_expected)?;
        put::<Int32Type>(&mut group, rows, |row| row.status)?;
        put::<Int64Type>(&mut group, rows, |row| row.seq)?;
        put::<BoolType>(&mut group, rows, |row| row.clock_synced)?;
        put_known::<FloatType>(&mut group, rows, |row| row.rel_err)?;
        group.close()?;
    }
    writer.close()?;
    file.write_all(&buffer).map_err(|error| ParquetError::External(Box::new(error)))
}

type Group<'a, 'b> = SerializedRowGroupWriter<'a, &'b mut Vec<u8>>;

fn put<T: DataType>(
    group: &mut Group<'_, '_>,
    rows: &[Row],
    value: fn(&Row) -> T::T,
) -> Result<(), ParquetError> {
    let values: Vec<T::T> = rows.iter().map(value).collect();
    let mut column = group.next_column()?.expect("the schema has this column");
    column.typed::<T>().write_batch(&values, None, None)?;
    column.close()
}

fn put_known<T: DataType>(
    group: &mut Group<'_, '_>,
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
    let reader = SerializedFileReader::new(file).map_err(|error| damaged(path, &error))?;
    if reader.metadata().file_metadata().schema_descr().num_columns() == COLUMNS {
        return Ok(reader);
    }
    Err(Failure::content(path, 0, "is no file of verge's archive; keep others out of it"))
}

fn damaged(path: &Path, error: &ParquetError) -> Failure {
    let reason = format!("is damaged: {error}; restore it, or move it away");
    Failure::content(path, 0, reason)
}

/// Reads all rows of a file.
///
/// # Errors
/// [`Failure`] where it is not there or damaged.
pub fn read(path: &Path) -> Result<Vec<Row>, Failure> {
    let reader = open(path)?;
    let mut rows = Vec::new();
    for index in 0..reader.num_row_groups() {
        let group = reader.get_row_group(index).map_err(|error| damaged(path, &error))?;
        rows.extend(group_rows(&*group).map_err(|error| damaged(path, &error))?);
    }
    Ok(rows)
}

fn group_rows(group: &dyn RowGroupReader) -> Result<Vec<Row>, ParquetError> {
    let column = |index: usize| group.get_column_reader(index);
    let window_s = all::<Int32Type>(column(0)?)?;
    let from = all::<Int64Type>(column(1)?)?;
    let lane = all::<Int32Type>(column(2)?)?;
    let cell = known::<Int32Type>(column(3)?)?;
    let position = known::<FloatType>(column(4)?)?;
    let length = all::<FloatType>(column(5)?)?;
    let density = known::<FloatType>(column(6)?)?;
    let se = known::<FloatType>(column(7)?)?;
    let vehicles = known::<FloatType>(column(8)?)?;
    let occupancy = known::<FloatType>(column(9)?)?;
    let frames_used = all::<Int32Type>(column(10)?)?;
    let frames_expected = all::<Int32Type>(column(11)?)?;
    let status = all::<Int32Type>(column(12)?)?;
    let seq = all::<Int64Type>(column(13)?)?;
    let clock_synced = all::<BoolType>(column(14)?)?;
    let rel_err = known::<FloatType>(column(15)?)?;
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
    };
    Ok((0..window_s.len()).map(row).collect())
}

/// Values of a column, and the levels that say which are known (empty: all are).
fn levels<T: DataType>(column: ColumnReader) -> Result<(Vec<T::T>, Vec<i16>), ParquetError> {
    let mut column: ColumnReaderImpl<T> = get_typed_column_reader(column);
    let (mut values, mut known) = (Vec::new(), Vec::new());
    while column.read_records(1 << 16, Some(&mut known), None, &mut values)?.0 > 0 {}
    Ok((values, known))
}

fn all<T: DataType>(column: ColumnReader) -> Result<Vec<T::T>, ParquetError> {
    Ok(levels::<T>(column)?.0)
}

fn known<T: DataType>(column: ColumnReader) -> Result<Vec<Option<T::T>>, ParquetError> {
    let (values, levels) = levels::<T>(column)?;
    let mut values = values.into_iter();
    Ok(levels.iter().map(|&level| if level > 0 { values.next() } else { None }).collect())
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
    fn damage_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.parquet");
        write(&path, &[row(0, 1, None)]).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("is damaged"));
        assert!(matches!(read(&folder.path().join("b")), Err(Failure::Missing { .. })));
    }
}
