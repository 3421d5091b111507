//! Lowering of operators that move, join or enlarge activations.

use super::{Lowering, Value};
use crate::graph::Refusal;
use tract_core::internal::*;
use tract_core::ops::array::{Slice, StridedSlice};
use tract_core::ops::nn::resize::{CoordTransformer, Interpolator};
use tract_onnx_opl::resize::{CoordTransform, Resize};
use verge_kernels::{Shape, Tensor as Activation};

/// Dimensions that are numbers.
fn numbers(dims: &[TDim]) -> Option<TVec<usize>> {
    dims.iter().map(|dim| dim.to_usize().ok()).collect()
}

impl Lowering<'_> {
    pub(super) fn concat(&mut self, node: &TypedNode, axis: usize) -> Result<Value, Refusal> {
        let values: Result<Vec<Value>, _> =
            (0..node.inputs.len()).map(|i| self.input(node, i)).collect();
        let values = values?;
        let activations: Option<Vec<Activation>> = values
            .iter()
            .map(|value| if let Value::Activation(a) = value { Some(*a) } else { None })
            .collect();
        let Some(activations) = activations else {
            let rows: Result<Vec<_>, _> = values.into_iter().map(|v| self.rows(v)).collect();
            return self.concat_rows(rows?, axis);
        };
        if axis != 1 {
            return Err(format!("joined along axis {axis}"));
        }
        let failed = |error: verge_kernels::PlanError| error.to_string();
        let quant = self.out_quant(node);
        if let ([a, b], true) = (&activations[..], self.is_shuffled(node)) {
            let (mut a, mut b) = (*a, *b);
            if let Some(quant) = quant {
                a = self.builder.requantise(a, quant).map_err(failed)?;
                b = self.builder.requantise(b, quant).map_err(failed)?;
            }
            return Ok(Value::Halves(a, b, 0));
        }
        self.builder.concat(&activations, quant).map(Value::Activation).map_err(failed)
    }

    /// Whether two equal halves are joined to be shuffled: the first reader but rounding groups
    /// channels by two, then turns and joins them.
    fn is_shuffled(&self, node: &TypedNode) -> bool {
        let mut outlet = OutletId::new(node.id, 0);
        while let Some(next) = self.next(outlet) {
            outlet = OutletId::new(next.id, 0);
            let op = next.op_as::<AxisOp>();
            if op.is_none() && (self.view.quantise(next).or(self.view.dequantise(next))).is_some() {
                continue;
            }
            let groups = |to: &[TDim]| numbers(to).is_some_and(|to| to.len() == 2 && to[0] == 2);
            return matches!(op, Some(AxisOp::Reshape(1, _, to)) if groups(to));
        }
        false
    }

    pub(super) fn axes(&mut self, node: &TypedNode, op: &AxisOp) -> Result<Value, Refusal> {
        let value = self.input(node, 0)?;
        let turned = matches!(op, AxisOp::Move(1, 2) | AxisOp::Move(2, 1));
        match (value, op) {
            (Value::Halves(a, b, 0), AxisOp::Reshape(1, _, to))
                if numbers(to).is_some_and(|to| to.len() == 2 && to[0] == 2) =>
            {
                Ok(Value::Halves(a, b, 1))
            }
            (Value::Halves(a, b, 1), _) if turned => Ok(Value::Halves(a, b, 2)),
            (Value::Halves(a, b, 2), AxisOp::Reshape(1, from, to))
                if from.len() == 2 && to.len() == 1 =>
            {
                let made = self.builder.interleave(a, b);
                made.map(Value::Activation).map_err(|error| error.to_string())
            }
            (value @ (Value::Activation(_) | Value::Rows(_)), AxisOp::Reshape(2, from, to))
                if from.len() == 2 && to.len() == 1 =>
            {
                let mut rows = self.rows(value)?;
                if rows.axis != 1 || rows.flat {
                    return Err("turned cells".to_owned());
                }
                rows.flat = true;
                Ok(Value::Rows(rows))
            }
            (Value::Rows(mut rows), _) if turned && rows.flat => {
                rows.axis = 3 - rows.axis;
                Ok(Value::Rows(rows))
            }
            (value, op) => Err(format!("{value:?} by {op:?}")),
        }
    }

    /// Bounds of a slice: axis, first index, and the one past the last.
    pub(super) fn bounds(&self, node: &TypedNode) -> Option<[usize; 3]> {
        if let Some(slice) = node.op_as::<Slice>() {
            return Some([slice.axis, slice.start.to_usize().ok()?, slice.end.to_usize().ok()?]);
        }
        let op = node.op_as::<StridedSlice>()?;
        let konst = |index: usize| self.view.konst(*node.inputs.get(index)?);
        let one = |index: usize| {
            let values = konst(index)?.cast_to::<i64>().ok()?;
            let view = values.try_as_plain_ram().ok()?;
            if let [one] = view.as_slice::<i64>().ok()? { Some(*one) } else { None }
        };
        let rank = self.view.shape(node.inputs[0])?.len();
        let axis = op.optional_axes_input.map_or(Some(0), one)?;
        let axis = if axis < 0 { axis + rank as i64 } else { axis };
        let axis = usize::try_from(axis).ok().filter(|&axis| axis < rank)?;
        let step = op.optional_steps_input.map_or(Some(1), one)?;
        if step != 1 || op.shrink_axis_mask != 0 || konst(1)?.len() != 1 {
            return None;
        }
        let length = self.view.shape(node.inputs[0])?[axis].to_dim();
        let dim = op.prepare_one_dim(0, &length, konst(1)?, konst(2)?, &[1]).ok()?;
        Some([axis, dim.begin.to_usize().ok()?, dim.end.to_usize().ok()?])
    }

    pub(super) fn slice(&mut self, node: &TypedNode) -> Result<Value, Refusal> {
        let [axis, start, end] =
            self.bounds(node).ok_or("by computed bounds, or along several axes")?;
        match self.input(node, 0)? {
            Value::Activation(whole) if axis == 1 && start < end => {
                let made = self.builder.slice(whole, start, end - start);
                let made = made.map_err(|error| error.to_string())?;
                self.parts_of.insert(made, (whole, start));
                Ok(Value::Activation(made))
            }
            Value::Rows(rows) if axis == rows.axis => self.slice_rows(&rows, start..end),
            _ => Err(format!("{start}..{end} along axis {axis}")),
        }
    }

    pub(super) fn resize(&mut self, node: &TypedNode, op: &Resize) -> Result<Value, Refusal> {
        let input = self.activation(node, 0)?;
        let Shape { height, width, channels } = self.builder.shape(input);
        let doubled = [1, channels, 2 * height, 2 * width];
        let is_doubled = self.view.shape(OutletId::new(node.id, 0)) == Some(&doubled[..]);
        let centred = matches!(
            op.coord_transformer,
            CoordTransform::Plain(
                CoordTransformer::HalfPixel
                    | CoordTransformer::PytorchHalfPixel
                    | CoordTransformer::HalfPixelSymmetric
            )
        );
        if !is_doubled || !centred || op.interpolator != Interpolator::Linear || op.antialias {
            return Err("another enlargement than twice, linear, by pixel centres".to_owned());
        }
        Ok(Value::Activation(self.builder.double(input)))
    }

    pub(super) fn add(&mut self, node: &TypedNode) -> Result<Value, Refusal> {
        let shape = self.view.shape(OutletId::new(node.id, 0));
        if node.inputs.iter().any(|input| self.view.shape(*input) != shape) {
            return Err("a sum over a repeated axis".to_owned());
        }
        let (a, b) = (self.activation(node, 0)?, self.activation(node, 1)?);
        let quant = self.out_quant(node);
        let made = self.builder.add(a, b, quant);
        made.map(Value::Activation).map_err(|error| error.to_string())
    }
}
