//! What moves, joins or enlarges pictures.

use super::super::graph::{int, ints, word};
use super::super::onnx::NodeProto;
use super::cells::Rows;
use super::{Lowering, Refusal, Value};
use verge_kernels::{Shape, Tensor};

impl<'a> Lowering<'a> {
    pub(super) fn concat(&mut self, node: &NodeProto) -> Result<Value, Refusal> {
        let inputs: Result<Vec<Value>, _> =
            (0..node.input.len()).map(|i| self.input(node, i)).collect();
        let inputs = inputs?;
        let axis = int(node, "axis", 1);
        let pictures: Option<Vec<Tensor>> = inputs
            .iter()
            .map(|value| if let Value::Picture(p) = value { Some(*p) } else { None })
            .collect();
        match (pictures, axis) {
            (Some(pictures), 1) => {
                let steps = self.out_steps(&node.output[0])?;
                if let ([a, b], true) = (&pictures[..], self.is_shuffled(&node.output[0])) {
                    let (mut a, mut b) = (*a, *b);
                    if let Some(steps) = steps {
                        let mut one =
                            |half| self.builder.requantise(half, steps).map_err(|e| e.to_string());
                        (a, b) = (one(a)?, one(b)?);
                    }
                    return Ok(Value::Halves(a, b));
                }
                let made = self.builder.concat(&pictures, steps);
                made.map(Value::Picture).map_err(|error| error.to_string())
            }
            // Columns of cells, or cells of several levels.
            (None, 1 | 2) | (Some(_), 2) => {
                let rows: Result<Vec<Rows>, _> =
                    inputs.into_iter().map(|value| self.rows(value)).collect();
                let rows = rows?;
                let (first, all) = (rows[0].clone(), || rows.iter());
                if !all().all(|row| row.axis == first.axis) {
                    return Err("turned cells and others".to_owned());
                }
                if axis == first.axis && all().all(|row| row.levels == first.levels) {
                    let parts = all().flat_map(|row| row.parts.clone()).collect();
                    Ok(Value::Rows(Rows { parts, ..first }))
                } else if axis != first.axis && all().all(|row| row.parts == first.parts) {
                    let levels = all().flat_map(|row| row.levels.clone()).collect();
                    Ok(Value::Rows(Rows { levels, ..first }))
                } else {
                    Err("cells that do not belong together".to_owned())
                }
            }
            _ => Err(format!("along axis {axis}")),
        }
    }

    /// Whether the halves behind `name` are shuffled: the first reader but rounding is a
    /// Reshape into two groups.
    fn is_shuffled(&self, name: &str) -> bool {
        let mut name = name;
        while let Some((_, reader)) = self.graph.sole_reader(name) {
            match reader.op_type.as_str() {
                "QuantizeLinear" | "DequantizeLinear" => name = &reader.output[0],
                "Reshape" => {
                    let to = reader.input.get(1).and_then(|to| self.graph.longs(to));
                    return matches!(to, Some([1, 2, _, _, _]));
                }
                _ => return false,
            }
        }
        false
    }

    pub(super) fn reshape(&mut self, node: &NodeProto) -> Result<Value, Refusal> {
        let to =
            node.input.get(1).and_then(|to| self.graph.longs(to)).ok_or("to no known shape")?;
        match (self.input(node, 0)?, to) {
            (Value::Halves(a, b), [1, 2, _, _, _]) => Ok(Value::Halves(a, b)),
            (Value::Halves(a, b), [1, _, _, _]) => {
                let made = self.builder.interleave(a, b);
                made.map(Value::Picture).map_err(|error| error.to_string())
            }
            (value @ (Value::Picture(_) | Value::Rows(Rows { axis: 1, .. })), [1, columns, _])
                if self.width(&value).is_some_and(|(_, width)| width as i64 == *columns) =>
            {
                self.rows(value).map(Value::Rows)
            }
            (value, to) => Err(format!("{value:?} to {to:?}")),
        }
    }

    pub(super) fn transpose(&mut self, node: &NodeProto) -> Result<Value, Refusal> {
        match (self.input(node, 0)?, ints(node, "perm")) {
            (halves @ Value::Halves(..), [0, 2, 1, 3, 4]) => Ok(halves),
            (Value::Rows(rows), [0, 2, 1]) => Ok(Value::Rows(Rows { axis: 3 - rows.axis, ..rows })),
            (value, order) => Err(format!("{value:?} to {order:?}")),
        }
    }

    pub(super) fn slice(&mut self, node: &NodeProto) -> Result<Value, Refusal> {
        let value = self.input(node, 0)?;
        let (axis, width) = self.width(&value).ok_or("inside a shuffle")?;
        let one = |index: usize| match node.input.get(index).and_then(|name| self.graph.longs(name))
        {
            Some([one]) => Some(*one),
            _ => None,
        };
        let (Some(start), Some(end), Some(along)) = (one(1), one(2), one(3)) else {
            return Err("along several axes, or by computed bounds".to_owned());
        };
        let step = if node.input.len() > 4 { one(4) } else { Some(1) };
        let bound = |at: i64| usize::try_from(at).ok().map(|at| at.min(width));
        match (bound(start), bound(end)) {
            (Some(start), Some(end)) if along == axis && step == Some(1) && start < end => {
                self.part(&value, start, end - start)
            }
            _ => Err(format!("{start}..{end} of {width} along axis {along}")),
        }
    }

    pub(super) fn split(&mut self, node: &'a NodeProto) -> Result<(), Refusal> {
        let value = self.input(node, 0)?;
        let (axis, width) = self.width(&value).ok_or("inside a shuffle")?;
        if int(node, "axis", 0) != axis {
            return Err("along another axis than the channels".to_owned());
        }
        let given = node.input.get(1).and_then(|name| self.graph.longs(name));
        let mut sizes = given.unwrap_or(ints(node, "split")).to_vec();
        if sizes.is_empty() {
            sizes = vec![(width / node.output.len()) as i64; node.output.len()];
        }
        let mut first = 0;
        for (name, size) in node.output.iter().zip(sizes) {
            let size = usize::try_from(size).map_err(|error| error.to_string())?;
            let part = self.part(&value, first, size)?;
            self.values.insert(name, part);
            first += size;
        }
        Ok(())
    }

    pub(super) fn resize(&mut self, node: &NodeProto) -> Result<Value, Refusal> {
        let input = self.picture(node, 0)?;
        let Shape { height, width, channels } = self.builder.shape(input);
        let scales = node.input.get(2).and_then(|name| self.graph.floats(name));
        let sizes = node.input.get(3).and_then(|name| self.graph.longs(name));
        let twice = [1, channels, 2 * height, 2 * width].map(|n| n as i64);
        let doubled = scales == Some(&[1.0, 1.0, 2.0, 2.0]) || sizes == Some(&twice);
        let centred = ["", "half_pixel", "pytorch_half_pixel"]
            .contains(&word(node, "coordinate_transformation_mode"));
        if !doubled || !centred || word(node, "mode") != "linear" {
            return Err("another enlargement than twice, linear, by pixel centres".to_owned());
        }
        Ok(Value::Picture(self.builder.double(input)))
    }

    pub(super) fn add(&mut self, node: &NodeProto) -> Result<Value, Refusal> {
        let (a, b) = (self.picture(node, 0)?, self.picture(node, 1)?);
        let steps = self.out_steps(&node.output[0])?;
        let made = self.builder.add(a, b, steps);
        made.map(Value::Picture).map_err(|error| error.to_string())
    }
}
