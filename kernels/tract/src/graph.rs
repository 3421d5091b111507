//! What a typed model says: constants behind a value, quantisation, who reads what.
//!
//! Owns how tract writes these; knows nothing of the kernels but their [`QuantParams`].

use std::collections::HashMap;
use tract_core::internal::*;
use tract_core::ops::binary::TypedBinOp;
use tract_core::ops::cast::Cast;
use tract_core::ops::element_wise::ElementWiseOp;
use tract_core::ops::konst::Const;
use tract_core::ops::math::{Mul, Sub};
use tract_core::ops::quant::{DequantizeLinearF32, QuantizeLinearI8, QuantizeLinearU8};
use tract_hir::infer::InferenceModel;
use verge_kernels::QuantParams;

/// Why a node stays with tract.
pub(crate) type Refusal = String;

/// A constant: whole numbers with their scale, or floats.
#[derive(Clone, Debug)]
pub(crate) struct Constant {
    pub(crate) values: Arc<Tensor>,
    /// One for all, or one for each of the first axis; `None`: the values are floats as they
    /// are.
    pub(crate) scale: Option<Vec<f32>>,
}

impl Constant {
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
    pub(crate) fn bytes(&self) -> Option<Vec<i8>> {
        let view = self.values.try_as_plain_ram().ok()?;
        self.scale.as_ref()?;
        Some(view.as_slice::<i8>().ok()?.to_vec())
    }
}

/// The whole numbers behind constants that a model dequantises, by the name of the node that
/// does. tract works such constants out while it analyses a model, so that a typed model may
/// hold the floats alone.
#[derive(Clone, Debug, Default)]
pub struct QuantisedConstants(HashMap<String, Constant>);

impl QuantisedConstants {
    /// Those of a model that has not been analysed.
    pub fn of(model: &InferenceModel) -> Self {
        let konst = |outlet: &OutletId| {
            let node = model.node(outlet.node);
            Some(node.op_as::<Const>()?.val().clone())
        };
        let found = model.nodes().iter().filter(|node| node.op.name() == "DequantizeLinear");
        let found = found.filter_map(|node| {
            let raw = konst(node.inputs.first()?)?;
            let scale = konst(node.inputs.get(1)?)?;
            let zero = match node.inputs.get(2) {
                Some(zero) => konst(zero)?.cast_to::<i32>().ok()?.into_owned(),
                None => tensor0(0i32),
            };
            let zeros = zero.try_as_plain_ram().ok()?.as_slice::<i32>().ok()?.to_vec();
            let zero = *zeros.first()?;
            let scale = scale.try_as_plain_ram().ok()?.as_slice::<f32>().ok()?.to_vec();
            let constant = symmetric(&raw, zero, scale)?;
            zeros.iter().all(|other| *other == zero).then(|| (node.name.clone(), constant))
        });
        Self(found.collect())
    }

    /// What node `name` of a typed model, which holds `floats`, was made from.
    fn behind(&self, name: &str, floats: &Tensor) -> Option<Constant> {
        let constant = self.0.get(name.strip_suffix(".0").unwrap_or(name))?;
        // Scales run along the first axis here; another axis gives other floats.
        let channels = constant.values.shape().first().copied().unwrap_or(1);
        let made = constant.floats(channels)?;
        let view = floats.try_as_plain_ram().ok()?;
        let floats = view.as_slice::<f32>().ok()?;
        let near = |(a, b): (&f32, &f32)| (a - b).abs() <= 1e-5 * b.abs().max(1e-20);
        (made.len() == floats.len() && made.iter().zip(floats).all(near)).then(|| constant.clone())
    }
}

/// A typed model with questions that recognising asks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View<'a> {
    pub(crate) model: &'a TypedModel,
    pub(crate) quantised: &'a QuantisedConstants,
}

impl<'a> View<'a> {
    pub(crate) fn node(&self, outlet: OutletId) -> &'a TypedNode {
        self.model.node(outlet.node)
    }

    pub(crate) fn shape(&self, outlet: OutletId) -> Option<&'a [usize]> {
        self.model.outlet_fact(outlet).ok()?.shape.as_concrete()
    }

    pub(crate) fn kind(&self, outlet: OutletId) -> Option<DatumType> {
        Some(self.model.outlet_fact(outlet).ok()?.datum_type)
    }

    pub(crate) fn konst(&self, outlet: OutletId) -> Option<&'a Arc<Tensor>> {
        self.model.outlet_fact(outlet).ok()?.konst.as_ref()
    }

    /// The one number that a constant of floats holds everywhere.
    pub(crate) fn scalar(&self, outlet: OutletId) -> Option<f32> {
        let value = self.konst(outlet)?.cast_to::<f32>().ok()?;
        let view = value.try_as_plain_ram().ok()?;
        let values = view.as_slice::<f32>().ok()?;
        let first = *values.first()?;
        values.iter().all(|&value| value == first).then_some(first)
    }

    /// The node that alone reads `outlet`, where the model does not give it out too.
    pub(crate) fn sole_reader(&self, outlet: OutletId) -> Option<&'a TypedNode> {
        let [reader] = self.model.outlet_successors(outlet) else { return None };
        (!self.model.outputs.contains(&outlet)).then(|| self.model.node(reader.node))
    }

    /// Constants, weights or biases behind `outlet`, with the scale of a DequantizeLinear.
    pub(crate) fn constant(&self, outlet: OutletId) -> Option<Constant> {
        let node = self.node(outlet);
        if let Some(values) = self.konst(outlet) {
            let whole = self.quantised.behind(&node.name, values);
            return Some(whole.unwrap_or(Constant { values: values.clone(), scale: None }));
        }
        let first = || node.inputs.first().copied();
        if let Some(op) = node.op_as::<DequantizeLinearF32>() {
            let raw = self.konst(first()?)?;
            return symmetric(raw, op.zero_point, vec![op.scale]);
        }
        // Casts of what floats hold exactly, and shapes of the same order.
        let keeps_order = |op: &AxisOp| !matches!(op, AxisOp::Move(..));
        if node.op_is::<Cast>() || node.op_as::<AxisOp>().is_some_and(keeps_order) {
            return self.constant(first()?);
        }
        // Scales by channel: `(cast(x) - zero) * scale`.
        let [difference, scale] = self.binary::<Mul>(node)?;
        let [cast, zero] = self.binary::<Sub>(self.node(difference))?;
        let cast = self.node(cast);
        let raw = self.konst(cast.op_is::<Cast>().then(|| cast.inputs[0])?)?;
        let zero = self.scalar(zero)? as i32;
        let scale = self.konst(scale)?;
        let scale = scale.try_as_plain_ram().ok()?.as_slice::<f32>().ok()?.to_vec();
        symmetric(raw, zero, scale)
    }

    /// Both inputs of a `Operation`.
    pub(crate) fn binary<Operation: tract_core::ops::binary::BinMiniOp>(
        &self,
        node: &TypedNode,
    ) -> Option<[OutletId; 2]> {
        node.op_as::<TypedBinOp>()?.0.downcast_ref::<Operation>()?;
        Some([*node.inputs.first()?, *node.inputs.get(1)?])
    }

    /// Quantisation that a QuantizeLinear stores in, and whether its bytes are signed. The
    /// kernels count from 0: a signed byte is taken 128 higher.
    pub(crate) fn quantise(&self, node: &TypedNode) -> Option<(QuantParams, bool)> {
        let op = &node.op_as::<ElementWiseOp>()?.0;
        let (inverse, zero, signed) = if let Some(op) = op.downcast_ref::<QuantizeLinearU8>() {
            (op.scale, op.zero_point, false)
        } else {
            let op = op.downcast_ref::<QuantizeLinearI8>()?;
            (op.scale, shifted(op.zero_point), true)
        };
        // tract keeps the inverse; a DequantizeLinear behind it has the number itself.
        let readers = self.model.outlet_successors(OutletId::new(node.id, 0));
        let exact = readers.iter().find_map(|reader| {
            let (params, _) = self.dequantise(self.model.node(reader.node))?;
            (params.scale.recip() == inverse).then_some(params.scale)
        });
        let scale = exact.unwrap_or(inverse.recip());
        (scale.is_normal() && scale > 0.0)
            .then_some((QuantParams { scale, zero_point: zero }, signed))
    }

    /// Quantisation that a DequantizeLinear of a computed value reads, and whether its bytes
    /// are signed.
    pub(crate) fn dequantise(&self, node: &TypedNode) -> Option<(QuantParams, bool)> {
        let op = node.op_as::<DequantizeLinearF32>()?;
        let signed = match self.kind(*node.inputs.first()?)? {
            DatumType::U8 => false,
            DatumType::I8 => true,
            _ => return None,
        };
        let zero = op.zero_point + if signed { 128 } else { 0 };
        let zero_point = u8::try_from(zero).ok()?;
        let scale = op.scale;
        (scale.is_normal() && scale > 0.0).then_some((QuantParams { scale, zero_point }, signed))
    }
}

fn shifted(zero: i8) -> u8 {
    zero.cast_unsigned() ^ 0x80
}

/// Whole numbers about `zero`, where they then fit what they are stored in.
fn symmetric(raw: &Arc<Tensor>, zero: i32, scale: Vec<f32>) -> Option<Constant> {
    let scale = Some(scale);
    match (raw.datum_type(), zero) {
        (DatumType::I8 | DatumType::I32, 0) => Some(Constant { values: raw.clone(), scale }),
        (DatumType::U8, 128) => {
            let view = raw.try_as_plain_ram().ok()?;
            let lower = |&value: &u8| (value ^ 0x80).cast_signed();
            let values: Vec<i8> = view.as_slice::<u8>().ok()?.iter().map(lower).collect();
            let values = Tensor::from_shape(raw.shape(), &values).ok()?;
            Some(Constant { values: values.into_arc_tensor(), scale })
        }
        _ => None,
    }
}
