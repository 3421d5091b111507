//! The same model in other forms: over another input size, or without rounding in between.

use crate::graph::View;
use std::collections::HashMap;
use tract_core::internal::*;
use tract_core::model::translator::Translate;
use tract_core::ops::binary::TypedBinOp;
use tract_core::ops::source::TypedSource;
use tract_onnx_opl::resize::Resize;

type Typed = Box<dyn TypedOp>;

/// `model` with the last two axes of its first input, height and width, changed: the same
/// weights over a larger or smaller picture. Shapes that the file holds as constants follow.
///
/// # Errors
/// Where a constant belongs to one size alone, such as a grid of cells that a head adds.
pub fn with_input_size(model: &TypedModel, size: [usize; 2]) -> TractResult<TypedModel> {
    InputSize(size).translate_model(model)
}

#[derive(Debug)]
struct InputSize([usize; 2]);

impl Translate<TypedFact, Typed, TypedFact, Typed> for InputSize {
    fn translate_node(
        &self,
        source: &TypedModel,
        node: &TypedNode,
        target: &mut TypedModel,
        mapping: &HashMap<OutletId, OutletId>,
    ) -> TractResult<TVec<OutletId>> {
        if node.op_is::<TypedSource>() {
            let mut fact = node.outputs[0].fact.clone();
            if source.inputs.first() == Some(&OutletId::new(node.id, 0)) {
                let rank = fact.rank();
                ensure!(rank >= 2, "an input of {rank} axes");
                for (axis, length) in (rank - 2..rank).zip(self.0) {
                    fact.shape.set(axis, length.to_dim());
                }
            }
            return Ok(tvec!(target.add_source(&node.name, fact)?));
        }
        let mut inputs: TVec<OutletId> = node.inputs.iter().map(|input| mapping[input]).collect();
        let mut op = node.op.clone();
        if let Some(AxisOp::Reshape(at, from, to)) = node.op_as::<AxisOp>() {
            let shape = target.outlet_fact(inputs[0])?.shape.to_tvec();
            let here: TVec<TDim> = shape[*at..at + from.len()].into();
            if here != *from {
                ensure!(to.len() == 1, "{:?} of the file is split into {:?}", from, to);
                let whole: TDim = here.iter().product();
                op = Box::new(AxisOp::Reshape(*at, here, tvec!(whole)));
            }
        }
        if let Some(sizes) = node.op_as::<Resize>().and_then(|op| op.optional_sizes_input) {
            let view = View { model: source };
            let from = view.shape(node.inputs[0]).context("a size that is not known")?;
            let to = view.shape(OutletId::new(node.id, 0)).context("a size that is not known")?;
            let here = target.outlet_fact(inputs[0])?.shape.clone();
            let here = here.as_concrete().context("a size that is not known")?;
            let scaled = |((&to, &from), &here): ((&usize, &usize), &usize)| {
                ensure!(here * to % from == 0, "{from} to {to} does not scale with {here}");
                Ok((here * to / from) as i64)
            };
            let lengths: Vec<i64> =
                to.iter().zip(from).zip(here).map(scaled).collect::<TractResult<_>>()?;
            let name = format!("{}.sizes", node.name);
            inputs[sizes] = target.add_const(name, tensor1(&lengths))?;
        }
        if node.op_is::<TypedBinOp>() {
            // A constant grid of the file's size would be taken for what is repeated.
            let shapes = inputs.iter().map(|input| Ok(target.outlet_fact(*input)?.shape.to_tvec()));
            let shapes: TVec<TVec<TDim>> = shapes.collect::<TractResult<_>>()?;
            for (a, b) in shapes[0].iter().zip(&shapes[1]) {
                let fits = a == b || *a == 1.to_dim() || *b == 1.to_dim();
                ensure!(fits, "{node}: {:?} and {:?} together", shapes[0], shapes[1]);
            }
        }
        target.wire_node(&node.name, op, &inputs)
    }
}

/// `model` without quantisation of computed values: the same weights in floats.
///
/// # Errors
/// tract's, where the model is not in order.
pub fn without_rounding(model: &TypedModel) -> TractResult<TypedModel> {
    WithoutRounding.translate_model(model)
}

#[derive(Debug)]
struct WithoutRounding;

impl Translate<TypedFact, Typed, TypedFact, Typed> for WithoutRounding {
    fn translate_node(
        &self,
        source: &TypedModel,
        node: &TypedNode,
        target: &mut TypedModel,
        mapping: &HashMap<OutletId, OutletId>,
    ) -> TractResult<TVec<OutletId>> {
        if node.op_is::<TypedSource>() {
            return Ok(tvec!(target.add_source(&node.name, node.outputs[0].fact.clone())?));
        }
        let view = View { model: source };
        let rounds = view.quantise(node).is_some()
            || (view.dequantise(node).is_some() && view.konst(node.inputs[0]).is_none());
        if rounds {
            return Ok(tvec!(mapping[&node.inputs[0]]));
        }
        let inputs: TVec<OutletId> = node.inputs.iter().map(|input| mapping[input]).collect();
        target.wire_node(&node.name, node.op.clone(), &inputs)
    }
}
