//! What follows the last convolutions: cells of several pictures and their columns.

use super::super::graph::{int, ints};
use super::super::onnx::NodeProto;
use super::super::tail::Part;
use super::{Lowering, Refusal, Value};
use verge_kernels::Tensor;

/// Cells of several pictures, one behind the other, with what happens to their columns.
#[derive(Clone, Debug)]
pub(super) struct Rows {
    pub(super) levels: Vec<Tensor>,
    pub(super) parts: Vec<Part>,
    /// Which axis the columns are: 1 as they come, 2 when turned.
    pub(super) axis: i64,
}

impl Rows {
    pub(super) fn columns(&self) -> usize {
        self.parts.iter().map(Part::columns).sum()
    }
}

impl<'a> Lowering<'a> {
    /// A picture of floats as cells.
    pub(super) fn rows(&self, value: Value) -> Result<Rows, Refusal> {
        match value {
            Value::Rows(rows) => Ok(rows),
            Value::Picture(picture) if self.builder.quant_params(picture).is_none() => {
                let channels = self.builder.shape(picture).channels;
                let (whole, first) = self.parts_of.get(&picture).copied().unwrap_or((picture, 0));
                let parts = vec![Part::Raw(first..first + channels)];
                Ok(Rows { levels: vec![whole], parts, axis: 1 })
            }
            other => Err(format!("{other:?} is no list of cells")),
        }
    }

    /// What happens to cells behind the last convolutions.
    pub(super) fn cell_wise(&mut self, node: &NodeProto) -> Result<Value, Refusal> {
        let first = self.rows(self.input(node, 0)?)?;
        let second = match node.input.get(1) {
            Some(_) => Some(self.rows(self.input(node, 1)?)?),
            None => None,
        };
        if second.as_ref().is_some_and(|s| s.levels != first.levels || s.axis != first.axis) {
            return Err("cells of different levels".to_owned());
        }
        let second = second.as_ref().map(|rows| &rows.parts[..]);
        let along = |axes: &[i64]| axes == [first.axis];
        let part = match (node.op_type.as_str(), &first.parts[..], second) {
            ("Sigmoid", [Part::Raw(of)], None) => Part::Sigmoid(of.clone()),
            ("ReduceMax", [Part::Raw(of)], None)
                if int(node, "keepdims", 1) == 1 && along(ints(node, "axes")) =>
            {
                Part::Most(of.clone())
            }
            ("Sub", [Part::Raw(of)], Some([Part::Most(same)])) if of == same => {
                Part::Lowered(of.clone())
            }
            ("Exp", [Part::Lowered(of)], None) => Part::Share(of.clone()),
            ("Mul", [Part::Sigmoid(gate)], Some([Part::Share(share)])) if gate.len() == 1 => {
                Part::Gated { gate: gate.start, share: share.clone() }
            }
            _ => return Err("not a known end of a detector".to_owned()),
        };
        Ok(Value::Rows(Rows { parts: vec![part], ..first }))
    }
}
