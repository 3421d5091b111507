//! The columns of a density file that averages are made of, some rows at a time.
//!
//! Owns which columns those are, and which need not be read: a row group of lanes has no places, one
//! of cells no errors. No [`Row`](super::Row) is made of them: a year of a city has 140 million.

use super::read::{Column, all, damaged, guarded, open, short, values};
use super::schema::COLUMNS_WITHOUT_ERRORS;
use parquet::column::reader::get_typed_column_reader;
use parquet::data_type::{DataType, FloatType, Int32Type, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::RowGroupMetaData;
use parquet::file::reader::RowGroupReader;
use std::path::Path;
use verge_desk::Failure;

/// Rows that are read at once.
const BATCH_ROWS: usize = 1 << 13;
/// Places of columns in the schema.
const WINDOW: usize = 0;
const FROM: usize = 1;
const LANE: usize = 2;
const CELL: usize = 3;
const POSITION: usize = 4;
const LENGTH: usize = 5;
const DENSITY: usize = 6;
const SAMPLING: usize = 7;
const CALIBRATION: usize = 18;
const COUNTING: usize = 19;

/// Some rows of a file, column by column. What is not known is not a number.
#[derive(Debug, Default)]
pub struct Densities {
    /// Lengths of the windows, s.
    pub window_s: Vec<i32>,
    /// Their beginnings, ms since 1970.
    pub from_ms: Vec<i64>,
    /// Lanes, from 1.
    pub lane: Vec<i32>,
    /// Densities, veh/km.
    pub density: Vec<f32>,
    /// Standard errors from sampling, calibration and counting, veh/km; empty where none is known.
    pub errors: [Vec<f32>; 3],
    /// Of cells, where they begin along the lane and how long they are, m; not numbers for rows of
    /// whole lanes, empty where there are no others.
    pub places: [Vec<f32>; 2],
    /// Marks rows that are cells; empty where none is.
    pub is_cell: Vec<bool>,
}

/// Reads a file and gives its rows to `take`, batch after batch.
///
/// # Errors
/// [`Failure`] where it is not there, damaged or another's; `take` may have had rows before that.
pub fn each(path: &Path, mut take: impl FnMut(&Densities)) -> Result<(), Failure> {
    let reader = open(path)?;
    let groups = || {
        for index in 0..reader.num_row_groups() {
            let group = reader.get_row_group(index)?;
            let mut columns = Columns::of(&*group)?;
            let mut left = usize::try_from(group.metadata().num_rows()).map_err(|_| short())?;
            while left > 0 {
                let count = left.min(BATCH_ROWS);
                take(&columns.read(count)?);
                left -= count;
            }
        }
        Ok(())
    };
    guarded(groups).map_err(|error| damaged(path, &error))
}

/// The columns of a row group, read side by side.
struct Columns {
    window_s: Column<Int32Type>,
    from: Column<Int64Type>,
    lane: Column<Int32Type>,
    density: Column<FloatType>,
    /// None in a file from before they were kept, and of cells.
    errors: Option<[Column<FloatType>; 3]>,
    /// Cell, position and length; none where all rows are whole lanes.
    places: Option<(Column<Int32Type>, [Column<FloatType>; 2])>,
}

impl Columns {
    fn of(group: &dyn RowGroupReader) -> Result<Self, ParquetError> {
        let floats = |index| column::<FloatType>(group, index);
        let nulls = nulls(group.metadata(), CELL);
        let (no_cells, no_lanes) = (nulls == Some(group.metadata().num_rows()), nulls == Some(0));
        let has_errors = group.num_columns() > COLUMNS_WITHOUT_ERRORS && !no_lanes;
        Ok(Self {
            window_s: column(group, WINDOW)?,
            from: column(group, FROM)?,
            lane: column(group, LANE)?,
            density: floats(DENSITY)?,
            errors: if has_errors {
                Some([floats(SAMPLING)?, floats(CALIBRATION)?, floats(COUNTING)?])
            } else {
                None
            },
            places: if no_cells {
                None
            } else {
                Some((column(group, CELL)?, [floats(POSITION)?, floats(LENGTH)?]))
            },
        })
    }

    /// So many of the next rows.
    fn read(&mut self, count: usize) -> Result<Densities, ParquetError> {
        let mut read = Densities {
            window_s: all(&mut self.window_s, count)?,
            from_ms: all(&mut self.from, count)?,
            lane: all(&mut self.lane, count)?,
            density: numbers(&mut self.density, count)?,
            ..Densities::default()
        };
        if let Some([sampling, calibration, counting]) = &mut self.errors {
            read.errors = [
                numbers(sampling, count)?,
                numbers(calibration, count)?,
                numbers(counting, count)?,
            ];
        }
        if let Some((cells, [position, length])) = &mut self.places {
            let (_, known) = values::<Int32Type>(cells, count)?;
            read.is_cell = known.iter().map(|level| *level > 0).collect();
            read.places = [numbers(position, count)?, all(length, count)?];
            if read.is_cell.len() != count {
                return Err(short());
            }
        }
        Ok(read)
    }
}

fn column<T: DataType>(
    group: &dyn RowGroupReader,
    index: usize,
) -> Result<Column<T>, ParquetError> {
    Ok(get_typed_column_reader(group.get_column_reader(index)?))
}

/// How many rows of a group have nothing in a column; none where the file does not say.
fn nulls(group: &RowGroupMetaData, index: usize) -> Option<i64> {
    let nulls = group.column(index).statistics()?.null_count_opt()?;
    i64::try_from(nulls).ok()
}

/// So many values of a column; those that are not known are not numbers.
fn numbers(column: &mut Column<FloatType>, count: usize) -> Result<Vec<f32>, ParquetError> {
    let (values, levels) = values::<FloatType>(column, count)?;
    if levels.len() != count {
        return Err(short());
    }
    if values.len() == count {
        return Ok(values);
    }
    let mut values = values.into_iter();
    let value = |level: &i16| if *level > 0 { values.next() } else { Some(f32::NAN) };
    levels.iter().map(value).collect::<Option<_>>().ok_or_else(short)
}
