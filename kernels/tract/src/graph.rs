//! Questions about a typed model: constants behind a value, quantisation, the readers of a value.
//!
//! Owns how tract writes these; knows nothing of the kernels but their [`QuantParams`].

use crate::constant::{Constant, Dequantised};
use tract_core::internal::*;
use tract_core::ops::binary::TypedBinOp;
use tract_core::ops::cast::Cast;
use tract_core::ops::element_wise::ElementWiseOp;
use tract_core::ops::math::{Mul, Sub};
use tract_core::ops::quant::{DequantizeLinearF32, QuantizeLinearI8, QuantizeLinearU8};
use verge_kernels::QuantParams;

/// Why a node stays with tract.
pub(crate) type Refusal = String;

/// A typed model with questions that recognising asks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View<'a> {
    pub(crate) model: &'a TypedModel,
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
        if let Some(op) = node.op_as::<Dequantised>() {
            return Some(op.0.clone());
        }
        if let Some(values) = self.konst(outlet) {
            return Some(Constant { values: values.clone(), scale: None });
        }
        let first = || node.inputs.first().copied();
        if let Some(op) = node.op_as::<DequantizeLinearF32>() {
            let raw = self.konst(first()?)?;
            return Constant::symmetric(raw, op.zero_point, vec![op.scale]);
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
        Constant::symmetric(raw, zero, scale)
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
