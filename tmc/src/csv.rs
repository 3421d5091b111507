//! Tables of comma-separated values: columns by name, errors by line and column.
//!
//! Fields may be in double quotes; a quoted field ends on its line. Our own, and short: each error
//! names its line, a quote that does not end too, for which a reader of whole files (the crate `csv`)
//! would take all the rest as one field.

use crate::gzip::read_text;
use std::path::{Path, PathBuf};
use verge_desk::Failure;

/// A table with a header line.
#[derive(Debug)]
pub struct Table {
    path: PathBuf,
    text: String,
    header: Vec<String>,
}

/// One line of a table.
#[derive(Debug)]
pub struct Row<'a> {
    path: &'a Path,
    /// Line in the file, from 1.
    pub line: usize,
    fields: Vec<String>,
}

/// A column that a table has.
#[derive(Clone, Debug)]
pub struct Column {
    index: usize,
    name: String,
}

impl Table {
    /// Reads a file, also a gzipped one.
    ///
    /// # Errors
    /// [`Failure`] where it is not there or no text, or has no header.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let text = read_text(path)?;
        let header = text.trim_start_matches('\u{feff}').lines().next().unwrap_or_default();
        if header.trim().is_empty() {
            return Err(Failure::content(path, 1, "is empty; the names of the columns go first"));
        }
        let header = split(header).map_err(|reason| Failure::content(path, 1, reason))?;
        Ok(Self { path: path.to_owned(), text, header })
    }

    /// The column of that name.
    ///
    /// # Errors
    /// [`Failure::Content`] with the columns that there are.
    pub fn column(&self, name: &str) -> Result<Column, Failure> {
        self.find(name).ok_or_else(|| {
            let found = self.header.join(", ");
            let reason = format!("has no column {name}; its columns are {found}");
            Failure::content(&self.path, 1, reason)
        })
    }

    /// The column of that name, where there is one.
    pub fn find(&self, name: &str) -> Option<Column> {
        let index = self.header.iter().position(|column| column == name)?;
        Some(Column { index, name: name.to_owned() })
    }

    /// The lines below the header; empty ones are left out.
    pub fn rows(&self) -> impl Iterator<Item = Result<Row<'_>, Failure>> {
        let lines = self.text.lines().enumerate().skip(1);
        lines.filter(|(_, line)| !line.trim().is_empty()).map(|(index, line)| {
            let row = row(&self.path, index + 1, line)?;
            if row.fields.len() == self.header.len() {
                return Ok(row);
            }
            let (found, expected) = (row.fields.len(), self.header.len());
            let reason = format!("has {found} columns, the header has {expected}");
            Err(Failure::content(&self.path, index + 1, reason))
        })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// One line of a file without a header.
///
/// # Errors
/// [`Failure::Content`] where a quote does not end.
pub fn row<'a>(path: &'a Path, line: usize, text: &str) -> Result<Row<'a>, Failure> {
    let fields = split(text).map_err(|reason| Failure::content(path, line, reason))?;
    Ok(Row { path, line, fields })
}

fn split(line: &str) -> Result<Vec<String>, &'static str> {
    if !line.contains('"') {
        return Ok(line.split(',').map(|field| field.trim().to_owned()).collect());
    }
    let (mut fields, mut field, mut quoted) = (Vec::new(), String::new(), false);
    for part in line.chars() {
        match part {
            '"' => quoted = !quoted,
            ',' if !quoted => fields.push(std::mem::take(&mut field).trim().to_owned()),
            other => field.push(other),
        }
    }
    if quoted {
        return Err("has a quote that does not end");
    }
    fields.push(field.trim().to_owned());
    Ok(fields)
}

impl Column {
    /// Column number `index` (from 0) of a file without a header.
    pub fn numbered(index: usize, name: &str) -> Self {
        Self { index, name: name.to_owned() }
    }
}

impl Row<'_> {
    /// How many fields there are.
    pub fn len(&self) -> usize {
        self.fields.len()
    }

    /// Whether there is no field.
    pub fn is_empty(&self) -> bool {
        self.fields.is_empty()
    }

    /// The text of a field; empty where the line has no such field.
    pub fn text(&self, column: &Column) -> &str {
        self.fields.get(column.index).map_or("", String::as_str)
    }

    /// A number that is finite and not negative.
    ///
    /// # Errors
    /// [`Failure::Content`] with line and column.
    pub fn quantity(&self, column: &Column) -> Result<f64, Failure> {
        let text = self.text(column);
        let wrong = |what: &str| self.wrong(column, what);
        match text.parse::<f64>() {
            Ok(value) if value.is_nan() => Err(wrong("is not a number; leave such lines out")),
            Ok(value) if value.is_infinite() => Err(wrong("is infinite; give a finite number")),
            Ok(value) if value < 0.0 => Err(wrong("is negative; give a number from 0")),
            Ok(value) => Ok(value),
            Err(_) => Err(wrong("is not a number; give one with a decimal point")),
        }
    }

    /// The same, or nothing where the field is empty.
    ///
    /// # Errors
    /// [`Failure::Content`] with line and column.
    pub fn maybe_quantity(&self, column: &Column) -> Result<Option<f64>, Failure> {
        if self.text(column).is_empty() { Ok(None) } else { self.quantity(column).map(Some) }
    }

    /// The failure for a wrong field.
    pub fn wrong(&self, column: &Column, what: &str) -> Failure {
        let reason = format!("column {}: {:?} {what}", column.name, self.text(column));
        Failure::content(self.path, self.line, reason)
    }
}
