//! A graph into tract: the operators that convolutional detectors are made of.
//!
//! Owns how ONNX writes them. tract's own reader keeps all of ONNX in the program
//! (docs/inference.md, Footprint); a model with another operator is refused by its name.

use super::graph::{Constant, Graph, Values, attribute, int, ints, word};
use super::onnx::{ModelProto, NodeProto};
use std::collections::HashMap;
use tract_hir::internal::*;
use tract_hir::ops::activations::{Clip, HardSigmoid};
use tract_hir::ops::array::{Concat, Flatten, PermuteAxes, Reshape, Slice, Split};
use tract_hir::ops::cnn::{Conv, HirMaxPool, HirSumPool, PaddingSpec, PoolSpec};
use tract_hir::ops::downsample::Downsample;
use tract_hir::ops::nn::{
    DataFormat, GlobalAvgPool, LayerSoftmax, Reduce, Reducer, hard_swish, sigmoid,
};
use tract_hir::ops::{binary::wire_rank_broadcast, math};
use tract_hir::tract_core::ops::nn::leaky_relu;
use tract_hir::tract_core::ops::nn::resize::{CoordTransformer, Interpolator, Nearest, Resize};

/// `proto` in tract, for an input of this shape.
///
/// # Errors
/// The first operator that is not known, or used as it is not known here.
pub(super) fn model(proto: &ModelProto, input: [usize; 4]) -> TractResult<TypedModel> {
    let graph = proto.graph.as_ref().context("a file without a graph")?;
    let (graph, version) = (&Graph::new(graph), proto.operators());
    let mut model = TypedModel::default();
    let mut outlets: HashMap<&str, OutletId> = HashMap::new();
    let given = graph.proto.input.iter().find(|input| graph.constant(&input.name).is_none());
    let given = given.context("no input")?;
    outlets.insert(&given.name, model.add_source(&given.name, f32::fact(input))?);
    for node in graph.proto.node.iter().filter(|node| node.op_type != "Constant") {
        let told = || format!("{} {}", node.op_type, node.name);
        let mut inputs: TVec<OutletId> = tvec![];
        for name in node.input.iter().filter(|name| !name.is_empty()) {
            let outlet = match (outlets.get(name.as_str()), graph.constant(name)) {
                (Some(outlet), _) => *outlet,
                (None, Some(constant)) => model.add_const(name, tensor(constant)?)?,
                (None, None) => bail!("{}: input {name} is unknown", told()),
            };
            outlets.insert(name, outlet);
            inputs.push(outlet);
        }
        let name = node.output.first().with_context(|| format!("{}: no output", told()))?;
        let mut wiring = Wiring { graph, version, node, name, model: &mut model };
        let made = wiring.wire(&inputs).with_context(told)?;
        outlets.extend(node.output.iter().map(String::as_str).zip(made));
    }
    let output = graph.proto.output.first().context("no output")?;
    let output = outlets.get(output.name.as_str()).context("an output that nothing makes")?;
    model.select_output_outlets(&[*output])?;
    Ok(model)
}

fn tensor(constant: &Constant) -> TractResult<Tensor> {
    let dims = &constant.dims;
    match &constant.values {
        Values::F32(values) => Tensor::from_shape(dims, values),
        Values::U8(values) => Tensor::from_shape(dims, values),
        Values::I8(values) => Tensor::from_shape(dims, values),
        Values::I32(values) => Tensor::from_shape(dims, values),
        Values::I64(values) => Tensor::from_shape(dims, values),
    }
}

/// One operator on its way into a model.
struct Wiring<'a> {
    graph: &'a Graph<'a>,
    /// Of the operators.
    version: i64,
    node: &'a NodeProto,
    name: &'a str,
    model: &'a mut TypedModel,
}

impl Wiring<'_> {
    fn wire(&mut self, inputs: &[OutletId]) -> TractResult<TVec<OutletId>> {
        let node = self.node;
        match node.op_type.as_str() {
            "Identity" => Ok(inputs.into()),
            "Add" => self.pair(math::add(), inputs),
            "Sub" => self.pair(math::sub(), inputs),
            "Mul" => self.pair(math::mul(), inputs),
            "Div" => self.pair(math::div(), inputs),
            "Exp" => self.one(math::exp(), inputs),
            "Tanh" => self.one(math::tanh(), inputs),
            "Sigmoid" => self.one(sigmoid(), inputs),
            "HardSwish" => self.one(hard_swish(), inputs),
            "LeakyRelu" => self.one(leaky_relu(self.float("alpha", 0.01)), inputs),
            "HardSigmoid" => {
                self.expand(&HardSigmoid(self.float("alpha", 0.2), self.float("beta", 0.5)), inputs)
            }
            "Relu" => self.expand(&Clip::new(Some(0.0), None), inputs),
            "Clip" => {
                let clip = Clip::new(self.bound("min", 1)?, self.bound("max", 2)?);
                self.expand(&clip, &inputs[..1])
            }
            "Conv" => self.expand(&self.conv()?, inputs),
            "MaxPool" => self.expand(&HirMaxPool::new(self.pool()?, None), inputs),
            "AveragePool" => {
                let with_padding = int(node, "count_include_pad", 0) != 0;
                self.expand(&HirSumPool::new(self.pool()?, with_padding, true), inputs)
            }
            "GlobalAveragePool" => self.expand(&GlobalAvgPool, inputs),
            "ReduceMax" => self.expand(&self.reduce(Reducer::Max)?, &inputs[..1]),
            "ReduceMean" => self.expand(&self.reduce(Reducer::Mean)?, &inputs[..1]),
            "Softmax" => self.expand(&self.softmax()?, inputs),
            "Concat" => self.expand(&Concat::new(int(node, "axis", 0)), inputs),
            "Reshape" => self.expand(&Reshape::new(int(node, "allowzero", 0) != 0), inputs),
            "Flatten" => self.expand(&Flatten::new(int(node, "axis", 1)), inputs),
            "Transpose" => {
                let order: TVec<usize> = self.whole("perm")?;
                let order = (!order.is_empty()).then_some(order);
                self.expand(&PermuteAxes::new(order), inputs)
            }
            "Slice" => self.slice(inputs[0]),
            "Split" => self.expand(&self.split()?, &inputs[..1]),
            "Resize" | "Upsample" => self.resize(inputs[0]),
            _ => bail!("an operator that is not known here"),
        }
    }

    fn expand(
        &mut self,
        operator: &impl Expansion,
        inputs: &[OutletId],
    ) -> TractResult<TVec<OutletId>> {
        operator.wire(self.name, self.model, inputs)
    }

    fn one(
        &mut self,
        operator: impl Into<Box<dyn TypedOp>>,
        inputs: &[OutletId],
    ) -> TractResult<TVec<OutletId>> {
        self.model.wire_node(self.name, operator, &inputs[..1])
    }

    fn pair(
        &mut self,
        operator: impl Into<Box<dyn TypedOp>>,
        inputs: &[OutletId],
    ) -> TractResult<TVec<OutletId>> {
        ensure!(inputs.len() == 2, "{} inputs", inputs.len());
        let inputs = wire_rank_broadcast(self.name, self.model, inputs)?;
        self.model.wire_node(self.name, operator, &inputs)
    }

    fn float(&self, name: &str, default: f32) -> f32 {
        attribute(self.node, name).map_or(default, |attribute| attribute.f)
    }

    fn word(&self, name: &str, default: &'static str) -> &str {
        Some(word(self.node, name)).filter(|word| !word.is_empty()).unwrap_or(default)
    }

    /// Whole numbers of an attribute; none where it is missing.
    fn whole(&self, name: &str) -> TractResult<TVec<usize>> {
        ints(self.node, name).iter().map(|&n| Ok(usize::try_from(n)?)).collect()
    }

    /// Input `index`, which must be a constant; `None` where it is left out.
    fn constant(&self, index: usize) -> TractResult<Option<&Constant>> {
        match self.node.input.get(index).filter(|name| !name.is_empty()) {
            None => Ok(None),
            Some(name) => self.graph.constant(name).context("an input that is computed").map(Some),
        }
    }

    fn longs(&self, index: usize) -> TractResult<Option<&[i64]>> {
        match self.constant(index)?.map(|constant| &constant.values) {
            None => Ok(None),
            Some(Values::I64(values)) => Ok(Some(values)),
            Some(_) => bail!("input {index} is not of long numbers"),
        }
    }

    fn floats(&self, index: usize) -> TractResult<Option<&[f32]>> {
        match self.constant(index)?.map(|constant| &constant.values) {
            None => Ok(None),
            Some(Values::F32(values)) => Ok(Some(values)),
            Some(_) => bail!("input {index} is not of floats"),
        }
    }

    /// Bounds are attributes before version 11 of the operators, inputs since then.
    fn bound(&self, name: &str, index: usize) -> TractResult<Option<f32>> {
        let given = attribute(self.node, name).map(|attribute| attribute.f);
        Ok(self.floats(index)?.and_then(|values| values.first().copied()).or(given))
    }

    /// Pixels of nothing around a picture, as `kind` has them written one by one.
    fn padding(
        &self,
        kind: impl FnOnce(TVec<usize>, TVec<usize>) -> PaddingSpec,
    ) -> TractResult<PaddingSpec> {
        Ok(match self.word("auto_pad", "NOTSET") {
            "NOTSET" => {
                let given = self.whole("pads")?;
                let pads = if given.is_empty() { tvec![0; 4] } else { given };
                let (before, after) = pads.split_at(pads.len() / 2);
                kind(before.into(), after.into())
            }
            "VALID" => PaddingSpec::Valid,
            "SAME_UPPER" => PaddingSpec::SameUpper,
            "SAME_LOWER" => PaddingSpec::SameLower,
            other => bail!("auto_pad {other}"),
        })
    }

    fn conv(&self) -> TractResult<Conv> {
        let mut conv = Conv::default().padding(self.padding(PaddingSpec::Explicit)?);
        conv = conv.group(usize::try_from(int(self.node, "group", 1))?);
        let given = |name: &str| -> TractResult<Option<TVec<usize>>> {
            Ok(Some(self.whole(name)?).filter(|values| !values.is_empty()))
        };
        if let Some(shape) = given("kernel_shape")? {
            conv = conv.kernel_shape(shape);
        }
        if let Some(dilations) = given("dilations")? {
            conv = conv.dilations(dilations);
        }
        if let Some(strides) = given("strides")? {
            conv = conv.strides(strides);
        }
        Ok(if self.node.input.len() > 2 { conv.bias_input(2) } else { conv })
    }

    fn pool(&self) -> TractResult<PoolSpec> {
        ensure!(self.node.output.len() == 1, "a pool that tells where its values were");
        let up = int(self.node, "ceil_mode", 0) != 0;
        let padding = self.padding(|a, b| PaddingSpec::ExplicitOnnxPool(a, b, up))?;
        let given = |name: &str| -> TractResult<Option<TVec<usize>>> {
            Ok(Some(self.whole(name)?).filter(|values| !values.is_empty()))
        };
        let shape = self.whole("kernel_shape")?;
        let (dilations, strides) = (given("dilations")?, given("strides")?);
        Ok(PoolSpec::new(DataFormat::NCHW, shape, padding, dilations, strides, 0, 0))
    }

    /// Axes are an attribute before version 18 of the operators, an input since then.
    fn reduce(&self, by: Reducer) -> TractResult<Reduce> {
        let given = ints(self.node, "axes");
        let axes = self.longs(1)?.unwrap_or(given).to_vec();
        let axes = (!axes.is_empty()).then_some(axes);
        Ok(Reduce::new(axes, int(self.node, "keepdims", 1) != 0, by))
    }

    /// Over all axes from one on before version 13 of the operators, over one since then.
    fn softmax(&self) -> TractResult<LayerSoftmax> {
        let old = self.version < 13;
        let axis = int(self.node, "axis", if old { 1 } else { -1 });
        Ok(LayerSoftmax::new(isize::try_from(axis)?, old))
    }

    fn slice(&mut self, input: OutletId) -> TractResult<TVec<OutletId>> {
        let (starts, ends) = (self.longs(1)?, self.longs(2)?);
        let (Some(starts), Some(ends)) = (starts, ends) else { bail!("bounds that are missing") };
        let all: Vec<i64> = (0..starts.len() as i64).collect();
        let axes = self.longs(3)?.unwrap_or(&all);
        let ones = vec![1; starts.len()];
        let steps = self.longs(4)?.unwrap_or(&ones);
        ensure!(steps.iter().all(|&step| step > 0), "steps backwards");
        let same = |of: &[i64]| of.len() == starts.len();
        ensure!(same(ends) && same(axes) && same(steps), "bounds of other axes");
        let bounds: Vec<[i64; 4]> =
            (0..starts.len()).map(|i| [axes[i], starts[i], ends[i], steps[i]]).collect();
        let mut wire = input;
        for [axis, start, end, step] in bounds {
            let shape = self.model.outlet_fact(wire)?.shape.clone();
            let axis = if axis < 0 { axis + shape.rank() as i64 } else { axis };
            let axis = usize::try_from(axis).ok().filter(|&axis| axis < shape.rank());
            let axis = axis.context("an axis that there is not")?;
            let length = shape[axis].to_i64()?;
            let place = |at: i64| (if at < 0 { at + length } else { at }).clamp(0, length) as usize;
            let (start, end) = (place(start), place(end));
            ensure!(start < end, "{start}..{end} of {length}");
            let name = format!("{}.{axis}", self.name);
            wire = self.model.wire_node(&name, Slice::new(axis, start, end), &[wire])?[0];
            if step > 1 {
                let every = Downsample::new(axis, isize::try_from(step)?, 0);
                wire = self.model.wire_node(format!("{name}.every"), every, &[wire])?[0];
            }
        }
        Ok(tvec!(wire))
    }

    /// Lengths are an attribute before version 13 of the operators, an input since then.
    fn split(&self) -> TractResult<Split> {
        let given = ints(self.node, "split");
        let lengths = self.longs(1)?.unwrap_or(given);
        let lengths: Vec<usize> =
            lengths.iter().map(|&n| Ok(usize::try_from(n)?)).collect::<TractResult<_>>()?;
        let lengths = (!lengths.is_empty()).then_some(lengths);
        let axis = isize::try_from(int(self.node, "axis", 0))?;
        Ok(Split::new(axis, self.node.output.len(), lengths))
    }

    /// By a known factor or to a known size.
    fn resize(&mut self, input: OutletId) -> TractResult<TVec<OutletId>> {
        // Version 10 of the operators has factors as the second input, later ones a region.
        let old = self.version < 11;
        let factors = self.floats(if old { 1 } else { 2 })?.filter(|by| by.len() == 4);
        let sizes = if old { None } else { self.longs(3)?.filter(|to| to.len() == 4) };
        let places = if old {
            "asymmetric"
        } else {
            self.word("coordinate_transformation_mode", "half_pixel")
        };
        let mode = self.word("mode", "nearest");
        // From corner to corner a pixel falls half-way between two at twice the size, and is
        // the first one's; tract has no rounding that keeps to this at other factors.
        let nearest = match (self.word("nearest_mode", "round_prefer_floor"), places) {
            ("floor", _) => Nearest::Floor,
            ("round_prefer_floor", "asymmetric") => {
                let doubled = factors.is_some_and(|by| by.iter().all(|&by| by == 1.0 || by == 2.0));
                ensure!(doubled || mode != "nearest", "the nearest pixel at another factor than 2");
                Nearest::Floor
            }
            _ => Nearest::RoundPreferCeil,
        };
        let resize = Resize {
            coord_transformer: CoordTransformer::parse(places)?,
            interpolator: Interpolator::parse(mode)?,
            nearest,
            optional_scales_input: factors.map(|_| 1),
            optional_sizes_input: sizes.map(|_| 1),
        };
        let to = match (factors, sizes) {
            (Some(factors), None) => tensor1(factors),
            (None, Some(sizes)) => tensor1(sizes),
            _ => bail!("neither a factor nor a size, or both"),
        };
        let to = self.model.add_const(format!("{}.to", self.name), to)?;
        self.model.wire_node(self.name, resize, &[input, to])
    }
}
