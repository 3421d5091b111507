//! Lowering of what is behind the last convolutions: cells of several activations, their columns.

use super::{Lowering, Rows, Value};
use crate::graph::Refusal;
use crate::tail::Part;
use std::ops::Range;
use tract_core::internal::*;
use tract_core::ops::nn::{Reduce, Reducer};
use verge_kernels::{Shape, Tensor as Activation};

impl Lowering<'_> {
    /// A value as cells.
    pub(super) fn rows(&self, value: Value) -> Result<Rows, Refusal> {
        match value {
            Value::Rows(rows) => Ok(rows),
            Value::Activation(whole) if self.builder.quant_params(whole).is_none() => {
                let channels = self.builder.shape(whole).channels;
                let (whole, first) = self.parts_of.get(&whole).copied().unwrap_or((whole, 0));
                let parts = vec![Part::Raw(first..first + channels)];
                Ok(Rows { levels: vec![whole], parts, axis: 1, flat: false })
            }
            other => Err(format!("{other:?} is not a list of cells")),
        }
    }

    fn input_rows(&mut self, node: &TypedNode, index: usize) -> Result<Rows, Refusal> {
        let value = self.input(node, index)?;
        self.rows(value)
    }

    pub(super) fn sigmoid(&mut self, node: &TypedNode) -> Result<Value, Refusal> {
        let rows = self.input_rows(node, 0)?;
        let parts: Option<Vec<Part>> = rows
            .parts
            .iter()
            .map(
                |part| {
                    if let Part::Raw(of) = part { Some(Part::Sigmoid(of.clone())) } else { None }
                },
            )
            .collect();
        let parts = parts.ok_or("a sigmoid of what is not raw")?;
        Ok(Value::Rows(Rows { parts, ..rows }))
    }

    pub(super) fn exp(&mut self, node: &TypedNode) -> Result<Value, Refusal> {
        let rows = self.input_rows(node, 0)?;
        let [Part::SubMax(of)] = &rows.parts[..] else {
            return Err("an exponential of what is not less its largest".to_owned());
        };
        let parts = vec![Part::SoftmaxNumerator(of.clone())];
        Ok(Value::Rows(Rows { parts, ..rows }))
    }

    pub(super) fn reduce(&mut self, node: &TypedNode, op: &Reduce) -> Result<Value, Refusal> {
        let rows = self.input_rows(node, 0)?;
        match &rows.parts[..] {
            [Part::Raw(of)] if op.reducer == Reducer::Max && op.axes[..] == [rows.axis] => {
                let parts = vec![Part::Max(of.clone())];
                Ok(Value::Rows(Rows { parts, ..rows }))
            }
            _ => Err("not the largest of a cell's columns".to_owned()),
        }
    }

    fn two_rows(&mut self, node: &TypedNode) -> Result<(Rows, Rows), Refusal> {
        let (a, b) = (self.input_rows(node, 0)?, self.input_rows(node, 1)?);
        if a.levels != b.levels || a.axis != b.axis || a.flat != b.flat {
            return Err("cells of different levels".to_owned());
        }
        Ok((a, b))
    }

    /// Columns less the largest of them.
    pub(super) fn sub_max(&mut self, node: &TypedNode) -> Result<Value, Refusal> {
        let (a, b) = self.two_rows(node)?;
        match (&a.parts[..], &b.parts[..]) {
            ([Part::Raw(of)], [Part::Max(same)]) if of == same => {
                let parts = vec![Part::SubMax(of.clone())];
                Ok(Value::Rows(Rows { parts, ..a }))
            }
            _ => Err("not columns less their largest".to_owned()),
        }
    }

    /// Shares scaled by objectness.
    pub(super) fn scale(&mut self, node: &TypedNode) -> Result<Value, Refusal> {
        let (a, b) = self.two_rows(node)?;
        match (&a.parts[..], &b.parts[..]) {
            ([Part::Sigmoid(gate)], [Part::SoftmaxNumerator(share)])
            | ([Part::SoftmaxNumerator(share)], [Part::Sigmoid(gate)])
                if gate.len() == 1 =>
            {
                let (gate, share) = (gate.start, share.clone());
                let parts = vec![Part::ScaledByObjectness { gate, share }];
                Ok(Value::Rows(Rows { parts, ..a }))
            }
            _ => Err("a product that is not shares by objectness".to_owned()),
        }
    }

    /// Columns behind one another, or cells of several levels.
    pub(super) fn concat_rows(&mut self, rows: Vec<Rows>, axis: usize) -> Result<Value, Refusal> {
        let first = rows[0].clone();
        let (axes, flat) = (first.axis, first.flat);
        if !rows.iter().all(|row| row.axis == axes && row.flat == flat) {
            return Err("turned cells and others".to_owned());
        }
        if axis == axes {
            if rows.iter().all(|row| row.levels == first.levels) {
                let parts = rows.iter().flat_map(|row| row.parts.clone()).collect();
                return Ok(Value::Rows(Rows { parts, ..first }));
            }
            return self.join_columns(&rows, first);
        }
        if flat && axis == 3 - axes && rows.iter().all(|row| row.parts == first.parts) {
            let levels = rows.iter().flat_map(|row| row.levels.clone()).collect();
            return Ok(Value::Rows(Rows { levels, ..first }));
        }
        Err("cells that do not belong together".to_owned())
    }

    /// Columns of different activations: these are put behind one another level by level.
    fn join_columns(&mut self, rows: &[Rows], first: Rows) -> Result<Value, Refusal> {
        let mut sources: Vec<&[Activation]> = Vec::new();
        for row in rows {
            if !sources.contains(&&row.levels[..]) {
                sources.push(&row.levels);
            }
        }
        let size = |activation: Activation| {
            let Shape { height, width, .. } = self.builder.shape(activation);
            (height, width)
        };
        let alike = |levels: &[Activation]| {
            levels.len() == first.levels.len()
                && levels.iter().zip(&first.levels).all(|(a, b)| size(*a) == size(*b))
        };
        if !sources.iter().all(|levels| alike(levels)) {
            return Err("columns of cells of different sizes".to_owned());
        }
        let mut levels = Vec::new();
        let mut offsets = Vec::new();
        for level in 0..first.levels.len() {
            let parts: Vec<Activation> = sources.iter().map(|source| source[level]).collect();
            let mut at = 0;
            let starts: Vec<usize> = parts
                .iter()
                .map(|part| {
                    at += self.builder.shape(*part).channels;
                    at - self.builder.shape(*part).channels
                })
                .collect();
            if level > 0 && offsets != starts {
                return Err("levels with different columns".to_owned());
            }
            offsets = starts;
            levels.push(self.builder.concat(&parts, None).map_err(|error| error.to_string())?);
        }
        let mut parts = Vec::new();
        for row in rows {
            let source = sources.iter().position(|levels| *levels == &row.levels[..]);
            let by = offsets[source.unwrap_or_default()];
            parts.extend(row.parts.iter().map(|part| part.shifted(by)));
        }
        Ok(Value::Rows(Rows { levels, parts, ..first }))
    }

    /// Columns `of` of cells.
    pub(super) fn slice_rows(&self, rows: &Rows, of: Range<usize>) -> Result<Value, Refusal> {
        let (mut at, mut parts) = (0, Vec::new());
        for part in &rows.parts {
            let (start, end) = (at.max(of.start), (at + part.columns()).min(of.end));
            if start < end {
                parts.push(part.slice(start - at..end - at).ok_or("a part of shares")?);
            }
            at += part.columns();
        }
        if of.end > at || parts.is_empty() {
            return Err(format!("columns {of:?} of {at}"));
        }
        Ok(Value::Rows(Rows { parts, ..rows.clone() }))
    }
}
