//! A region of a typed model onto the kernels.
//!
//! Owns which groups of operators are recognised. `conv` has convolutions and pooling,
//! `layout` what moves or joins activations, `cells` what follows the last convolutions. In QDQ
//! models (QuantizeLinear, DequantizeLinear) `x -> Q -> DQ` is an activation of bytes.

mod cells;
mod conv;
mod layout;

use crate::graph::{Refusal, View};
use crate::tail::Part;
use std::collections::{HashMap, HashSet};
use tract_core::internal::*;
use tract_core::ops::array::{Slice, StridedSlice, TypedConcat};
use tract_core::ops::cnn::{Conv, MaxPool};
use tract_core::ops::element_wise::ElementWiseOp;
use tract_core::ops::math::{Add, Exp, Mul, Sub};
use tract_core::ops::nn::{Reduce, Sigmoid};
use tract_core::ops::quant::DequantizeLinearF32;
use tract_onnx_opl::resize::Resize;
use verge_kernels::{Builder, Isa, Plan, QuantParams, Shape, Tensor as Activation};

/// Cells of several activations, one behind the other, with what happens to their columns.
#[derive(Clone, Debug)]
pub(crate) struct Rows {
    pub(crate) levels: Vec<Activation>,
    pub(crate) parts: Vec<Part>,
    /// Axis of the columns: 1 as they come, 2 when transposed.
    pub(crate) axis: usize,
    /// Whether height and width have become one axis.
    pub(crate) flat: bool,
}

/// The meaning of an outlet, as far as the lowering has followed it.
#[derive(Clone, Debug)]
pub(crate) enum Value {
    Activation(Activation),
    /// Two halves on their way through a shuffle: joined (0), grouped (1), turned (2).
    Halves(Activation, Activation, u8),
    /// Cells of several activations.
    Rows(Rows),
}

/// An input of a region: an outlet of the model around it.
#[derive(Clone, Debug)]
pub(crate) struct Entry {
    pub(crate) outlet: OutletId,
    pub(crate) kind: DatumType,
}

/// An output of a region.
#[derive(Clone, Debug)]
pub(crate) struct Exit {
    pub(crate) outlet: OutletId,
    /// Indices of the net's outputs.
    pub(crate) levels: Vec<usize>,
    pub(crate) form: Form,
}

/// How an exit is written.
#[derive(Clone, Debug)]
pub(crate) enum Form {
    /// As planes of floats, unsigned bytes, or signed ones.
    Planes(DatumType),
    /// As rows of cells, or where `turned` as columns of them.
    Rows { parts: Vec<Part>, turned: bool },
}

/// A region on the kernels.
#[derive(Debug)]
pub(crate) struct Lowered {
    pub(crate) plan: Plan,
    pub(crate) entries: Vec<Entry>,
    pub(crate) exits: Vec<Exit>,
}

pub(crate) struct Lowering<'a> {
    pub(crate) view: View<'a>,
    /// Nodes whose values follow from the model's input.
    computed: &'a HashSet<usize>,
    inside: HashSet<usize>,
    builder: Builder,
    values: HashMap<OutletId, Value>,
    entries: Vec<Entry>,
    /// Entries of bytes whose DequantizeLinear lies outside.
    bytes: HashMap<OutletId, (Activation, QuantParams)>,
    /// Slices of activations: whole and first channel.
    parts_of: HashMap<Activation, (Activation, usize)>,
    done: HashSet<usize>,
    /// Convolutions.
    pub(crate) convolutions: usize,
    /// Nodes that were not recognised; their outputs count as given from outside.
    pub(crate) refused: Vec<(usize, Refusal)>,
}

impl<'a> Lowering<'a> {
    /// Goes through `nodes`, a region in the order of evaluation.
    pub(crate) fn new(
        view: View<'a>,
        computed: &'a HashSet<usize>,
        nodes: &[usize],
        isa: Isa,
    ) -> Self {
        let mut lowering = Self {
            view,
            computed,
            inside: nodes.iter().copied().collect(),
            builder: Builder::on(isa),
            values: HashMap::new(),
            entries: Vec::new(),
            bytes: HashMap::new(),
            parts_of: HashMap::new(),
            done: HashSet::new(),
            convolutions: 0,
            refused: Vec::new(),
        };
        for &id in nodes {
            if lowering.done.contains(&id) {
                continue;
            }
            if let Err(why) = lowering.node(view.model.node(id)) {
                lowering.inside.remove(&id);
                lowering.refused.push((id, why));
            }
        }
        lowering
    }

    fn node(&mut self, node: &'a TypedNode) -> Result<(), Refusal> {
        let outlet = OutletId::new(node.id, 0);
        if node.outputs.len() != 1 {
            return Err("several outputs".to_owned());
        }
        let value = if node.op_is::<Conv>() {
            return self.conv(node);
        } else if self.view.quantise(node).is_some() || node.op_is::<DequantizeLinearF32>() {
            self.requantise(node)?
        } else if node.op_is::<MaxPool>() {
            self.pool(node)?
        } else if let Some(concat) = node.op_as::<TypedConcat>() {
            self.concat(node, concat.axis)?
        } else if let Some(op) = node.op_as::<AxisOp>() {
            self.axes(node, op)?
        } else if node.op_is::<Slice>() || node.op_is::<StridedSlice>() {
            self.slice(node)?
        } else if let Some(op) = node.op_as::<Resize>() {
            self.resize(node, op)?
        } else if self.view.binary::<Add>(node).is_some() {
            self.add(node)?
        } else if let Some(reduce) = node.op_as::<Reduce>() {
            self.reduce(node, reduce)?
        } else if self.view.binary::<Sub>(node).is_some() {
            self.sub_max(node)?
        } else if self.view.binary::<Mul>(node).is_some() {
            self.scale(node)?
        } else {
            match node.op_as::<ElementWiseOp>() {
                Some(op) if op.0.is::<Sigmoid>() => self.sigmoid(node)?,
                Some(op) if op.0.is::<Exp>() => self.exp(node)?,
                _ => return Err("no kernel for it".to_owned()),
            }
        };
        self.values.insert(outlet, value);
        Ok(())
    }

    /// The value at input `index` of `node`; one from outside the region becomes an entry.
    fn input(&mut self, node: &TypedNode, index: usize) -> Result<Value, Refusal> {
        let outlet = *node.inputs.get(index).ok_or("an input is missing")?;
        if let Some(value) = self.values.get(&outlet) {
            return Ok(value.clone());
        }
        if self.inside.contains(&outlet.node) {
            return Err("a value in the middle of a convolution".to_owned());
        }
        let value = Value::Activation(self.entry(outlet)?);
        self.values.insert(outlet, value.clone());
        Ok(value)
    }

    fn entry(&mut self, outlet: OutletId) -> Result<Activation, Refusal> {
        if !self.computed.contains(&outlet.node) {
            return Err("a constant among its inputs".to_owned());
        }
        // Bytes cross as bytes: what a DequantizeLinear outside makes floats of.
        let source = self.view.node(outlet);
        if let Some((quant, _)) = self.view.dequantise(source)
            && let (bytes, Some(&[1, channels, height, width])) =
                (source.inputs[0], self.view.shape(outlet))
            && self.computed.contains(&bytes.node)
        {
            let known = self.bytes.get(&bytes).filter(|known| known.1 == quant).copied();
            let made = known.map(|(activation, _)| activation);
            let activation = made.unwrap_or_else(|| {
                let kind = self.view.kind(bytes).unwrap_or(DatumType::U8);
                self.entries.push(Entry { outlet: bytes, kind });
                self.builder.input(Shape { height, width, channels }, Some(quant))
            });
            self.bytes.insert(bytes, (activation, quant));
            return Ok(activation);
        }
        let (shape, kind) = (self.view.shape(outlet), self.view.kind(outlet));
        let Some(&[1, channels, height, width]) = shape else {
            return Err("an input that is not one picture of known size".to_owned());
        };
        let readers = self.view.model.outlet_successors(outlet);
        let readers =
            readers.iter().map(|r| self.view.model.node(r.node)).filter(|n| self.is_inside(n));
        let all_alike = |params: Vec<Option<(QuantParams, bool)>>| match params[..] {
            [first, ref rest @ ..] if rest.iter().all(|other| *other == first) => first,
            _ => None,
        };
        let quant = match kind {
            Some(DatumType::F32) => all_alike(readers.map(|n| self.view.quantise(n)).collect()),
            Some(DatumType::U8 | DatumType::I8) => {
                let params = all_alike(readers.map(|n| self.view.dequantise(n)).collect());
                Some(params.ok_or("bytes that are read in several scales")?)
            }
            _ => return Err("an input that is neither floats nor bytes".to_owned()),
        };
        let shape = Shape { height, width, channels };
        let kind = kind.unwrap_or(DatumType::F32);
        self.entries.push(Entry { outlet, kind });
        Ok(self.builder.input(shape, quant.map(|(params, _)| params)))
    }

    fn is_inside(&self, node: &TypedNode) -> bool {
        self.inside.contains(&node.id)
    }

    /// The node behind `outlet` that alone reads it, inside the region.
    fn next(&self, outlet: OutletId) -> Option<&'a TypedNode> {
        self.view.sole_reader(outlet).filter(|node| self.is_inside(node))
    }

    fn activation(&mut self, node: &TypedNode, index: usize) -> Result<Activation, Refusal> {
        match self.input(node, index)? {
            Value::Activation(activation) => Ok(activation),
            other => Err(format!("input {index} is {other:?}")),
        }
    }

    /// Quantisation of the output of `node`: its QuantizeLinear.
    fn out_quant(&self, node: &TypedNode) -> Option<QuantParams> {
        let next = self.next(OutletId::new(node.id, 0))?;
        self.view.quantise(next).map(|(params, _)| params)
    }

    fn requantise(&mut self, node: &TypedNode) -> Result<Value, Refusal> {
        let value = self.input(node, 0)?;
        let failed = |error: verge_kernels::PlanError| error.to_string();
        match (self.view.quantise(node), value) {
            (Some((to, _)), Value::Activation(activation)) => {
                let done = self.builder.requantise(activation, to).map_err(failed)?;
                Ok(Value::Activation(done))
            }
            (Some((to, _)), Value::Halves(a, b, stage)) => {
                let a = self.builder.requantise(a, to).map_err(failed)?;
                let b = self.builder.requantise(b, to).map_err(failed)?;
                Ok(Value::Halves(a, b, stage))
            }
            (None, value) => {
                let from = self.view.dequantise(node).ok_or("bytes of an unknown kind")?.0;
                let same = |a: &Activation| self.builder.quant_params(*a) == Some(from);
                let is_it = match &value {
                    Value::Activation(a) => same(a),
                    Value::Halves(a, b, _) => same(a) && same(b),
                    Value::Rows(_) => false,
                };
                if is_it { Ok(value) } else { Err("bytes read in another scale".to_owned()) }
            }
            (Some(_), Value::Rows(_)) => Err("cells into bytes".to_owned()),
        }
    }

    /// Outlets of the model around the region that it reads.
    pub(crate) fn entries(&self) -> impl Iterator<Item = OutletId> {
        self.entries.iter().map(|entry| entry.outlet)
    }

    /// The nodes of `outputs`, outlets that are read outside, whose values the kernels do not
    /// have: the middle of a shuffle that goes on elsewhere.
    pub(crate) fn unfinished(&self, outputs: &[OutletId]) -> Vec<usize> {
        let halves =
            |outlet: &&OutletId| matches!(self.values.get(*outlet), Some(Value::Halves(..)));
        outputs.iter().filter(halves).map(|outlet| outlet.node).collect()
    }

    /// The region as a net that gives `outputs`, outlets that are read outside.
    pub(crate) fn finish(self, outputs: &[OutletId]) -> Result<Lowered, Refusal> {
        let mut given: Vec<Activation> = Vec::new();
        let mut exits = Vec::new();
        for &outlet in outputs {
            let value = self.values.get(&outlet).ok_or("a value that was passed over")?;
            let (levels, form) = match value {
                Value::Activation(activation) => {
                    let kind = self.view.kind(outlet).unwrap_or(DatumType::F32);
                    (vec![*activation], Form::Planes(kind))
                }
                Value::Halves(..) => return Err("the middle of a shuffle".to_owned()),
                Value::Rows(rows) => {
                    let form = Form::Rows { parts: rows.parts.clone(), turned: rows.axis == 2 };
                    (rows.levels.clone(), form)
                }
            };
            let mut index = |level: &Activation| match given.iter().position(|g| g == level) {
                Some(index) => index,
                None => {
                    given.push(*level);
                    given.len() - 1
                }
            };
            let levels = levels.iter().map(&mut index).collect();
            exits.push(Exit { outlet, levels, form });
        }
        let plan = self.builder.finish(&given).map_err(|error| error.to_string())?;
        Ok(Lowered { plan, entries: self.entries, exits })
    }
}
