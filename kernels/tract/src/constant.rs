//! Weights and biases as whole numbers with their scale.
//!
//! Owns keeping them so while tract loads a model: left to itself it works out what a
//! DequantizeLinear makes of constants, and holds weights as floats of four times their size,
//! beside the bytes that the kernels take.

use std::sync::Arc;
use tract_core::internal::*;
use tract_core::ops::konst::Const;
use tract_hir::infer::rules::{InferenceResult, InferenceRulesOp, Solver, TensorProxy};
use tract_hir::infer::{InferenceModel, InferenceNode};
use tract_hir::to_typed;

/// A constant: whole numbers with their scale, or floats.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Constant {
    pub(crate) values: Arc<Tensor>,
    /// One for all, or one for each of the first axis; `None`: the values are floats as they
    /// are.
    pub(crate) scale: Option<Vec<f32>>,
}

impl Constant {
    /// Whole numbers about `zero`, where they then fit what they are stored in.
    pub(crate) fn symmetric(raw: &Arc<Tensor>, zero: i32, scale: Vec<f32>) -> Option<Self> {
        let scale = Some(scale);
        match (raw.datum_type(), zero) {
            (DatumType::I8 | DatumType::I32, 0) => Some(Self { values: raw.clone(), scale }),
            (DatumType::U8, 128) => {
                let view = raw.try_as_plain_ram().ok()?;
                let lower = |&value: &u8| (value ^ 0x80).cast_signed();
                let values: Vec<i8> = view.as_slice::<u8>().ok()?.iter().map(lower).collect();
                let values = Tensor::from_shape(raw.shape(), &values).ok()?;
                Some(Self { values: values.into_arc_tensor(), scale })
            }
            _ => None,
        }
    }

    /// The scale of each of `channels`.
    pub(crate) fn scales(&self, channels: usize) -> Option<Vec<f32>> {
        match self.scale.as_deref()? {
            [one] => Some(vec![*one; channels]),
            many if many.len() == channels => Some(many.to_vec()),
            _ => None,
        }
    }

    /// As floats, scales multiplied in along the first of `channels`.
    pub(crate) fn floats(&self, channels: usize) -> Option<Vec<f32>> {
        let values = self.values.cast_to::<f32>().ok()?;
        let mut values = values.try_as_plain_ram().ok()?.as_slice::<f32>().ok()?.to_vec();
        if self.scale.is_some() {
            let each = values.len() / channels.max(1);
            let scales = self.scales(channels)?;
            for (values, scale) in values.chunks_mut(each.max(1)).zip(scales) {
                values.iter_mut().for_each(|value| *value *= scale);
            }
        }
        Some(values)
    }

    /// Values of a symmetric signed byte.
    pub(crate) fn bytes(&self) -> Option<&[i8]> {
        let view = self.values.try_as_plain_ram().ok()?;
        self.scale.as_ref()?;
        view.as_slice::<i8>().ok()
    }
}

/// An operator without inputs: a DequantizeLinear of constants that is not worked out.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Dequantised(pub(crate) Constant);

impl Eq for Dequantised {}

impl Dequantised {
    /// Its value.
    fn floats(&self) -> TractResult<Tensor> {
        let shape = self.0.values.shape();
        let channels = shape.first().copied().unwrap_or(1);
        let floats = self.0.floats(channels).context("scales of other channels")?;
        Tensor::from_shape(shape, &floats)
    }
}

impl Op for Dequantised {
    fn name(&self) -> StaticName {
        "VergeDequantised".into()
    }

    op_as_typed_op!();
}

impl EvalOp for Dequantised {
    op_out_of_plan!();

    fn eval(&self, _ctx: &EvalContext, _inputs: TVec<TValue>) -> TractResult<TVec<TValue>> {
        Ok(tvec!(self.floats()?.into_tvalue()))
    }
}

impl TypedOp for Dequantised {
    fn output_facts(&self, _inputs: &[&TypedFact]) -> TractResult<TVec<TypedFact>> {
        Ok(tvec!(f32::fact(self.0.values.shape())))
    }

    as_op!();
}

impl InferenceRulesOp for Dequantised {
    fn rules<'r, 'p: 'r, 's: 'r>(
        &'s self,
        solver: &mut Solver<'r>,
        _inputs: &'p [TensorProxy],
        outputs: &'p [TensorProxy],
    ) -> InferenceResult {
        solver.equals(&outputs[0].datum_type, f32::datum_type())?;
        let shape: TVec<TDim> = self.0.values.shape().iter().map(|n| n.to_dim()).collect();
        solver.equals(&outputs[0].shape, shape)
    }

    as_op!();
    to_typed!();
}

/// Has the weights and biases of a quantised `model` stay whole numbers through its analysis, for
/// [`KernelTransform`](crate::KernelTransform). To be used on a model as it was read; what the
/// transform then leaves to tract gets its floats.
pub fn keep_quantised(model: &mut InferenceModel) {
    let kept = model.nodes().iter().filter_map(|node| Some((node.id, constant(model, node)?)));
    for (id, constant) in kept.collect::<Vec<_>>() {
        for input in std::mem::take(&mut model.nodes[id].inputs) {
            let successors = &mut model.nodes[input.node].outputs[input.slot].successors;
            successors.retain(|reader| reader.node != id);
        }
        model.nodes[id].op = Box::new(Dequantised(constant));
    }
}

/// The constant that `node` dequantises, if it is a DequantizeLinear of constants that only
/// convolutions read.
fn constant(model: &InferenceModel, node: &InferenceNode) -> Option<Constant> {
    let readers = &node.outputs.first()?.successors;
    let by_conv =
        |reader: &InletId| reader.slot > 0 && model.node(reader.node).op.name() == "ConvHir";
    if node.op.name() != "DequantizeLinear"
        || readers.is_empty()
        || !readers.iter().all(by_conv)
        || model.outputs.contains(&OutletId::new(node.id, 0))
    {
        return None;
    }
    let konst = |outlet: &OutletId| Some(model.node(outlet.node).op_as::<Const>()?.val().clone());
    let inputs: Vec<Arc<Tensor>> = node.inputs.iter().map(konst).collect::<Option<_>>()?;
    let (raw, scale) = (inputs.first()?, inputs.get(1)?);
    let zeros = match inputs.get(2) {
        Some(zero) => zero.cast_to::<i32>().ok()?.into_owned(),
        None => tensor0(0i32),
    };
    let zeros = zeros.try_as_plain_ram().ok()?.as_slice::<i32>().ok()?.to_vec();
    let zero = *zeros.first()?;
    let scale = scale.try_as_plain_ram().ok()?.as_slice::<f32>().ok()?.to_vec();
    let along_first = scale.len() == 1 || runs_along_first(node, raw, &inputs[1..], scale.len());
    if zeros.iter().any(|other| *other != zero) || !along_first {
        return None;
    }
    Constant::symmetric(raw, zero, scale)
}

/// Whether the scales of a DequantizeLinear of `raw` run along the first axis. tract does not tell
/// which axis it was given; one value for each scale shows it.
fn runs_along_first(
    node: &InferenceNode,
    raw: &Tensor,
    parameters: &[Arc<Tensor>],
    scales: usize,
) -> bool {
    let mut shape = vec![1; raw.rank()];
    let Some(first) = shape.first_mut() else { return false };
    *first = scales;
    if raw.shape()[0] != scales {
        return false;
    }
    let Ok(sample) = Tensor::zero_dt(raw.datum_type(), &shape) else { return false };
    let mut inputs: TVec<TValue> = tvec!(sample.into_tvalue());
    inputs.extend(parameters.iter().map(|parameter| parameter.clone().into_tvalue()));
    let made = node.op.eval_out_of_plan(inputs);
    matches!(made, Ok(Some(made)) if made.len() == 1 && made[0].shape() == shape)
}

/// Gives tract the floats of constants in `model` that were kept as whole numbers.
pub(crate) fn make_floats(model: &mut TypedModel) -> TractResult<()> {
    for node in &mut model.nodes {
        if let Some(op) = node.op_as::<Dequantised>() {
            let floats = op.floats()?.into_arc_tensor();
            node.outputs[0].fact = TypedFact::try_from(&floats)?;
            node.op = Box::new(Const::new(floats)?);
        }
    }
    Ok(())
}
