//! The operators that tract is given: those that convolutional detectors are made of.
//!
//! Owns how ONNX writes them. tract's own list has all of ONNX, and 10 MB of program with it
//! (docs/inference.md); a model with another operator is refused by its name.

use super::pb::{GraphProto, NodeProto};
use super::{hir, onnx};
use hir::internal::*;
use hir::ops;
use hir::tract_core::ops::nn::resize::{CoordTransformer, Interpolator, Nearest, Resize};
use onnx::model::{OnnxOpRegister, ParsingContext};
use ops::cnn::{Conv, HirMaxPool, HirSumPool, PaddingSpec, PoolSpec};
use ops::nn::{DataFormat, Reducer};

type Built = TractResult<(Box<dyn InferenceOp>, Vec<String>)>;

/// The reader of model files.
pub(super) fn reader() -> onnx::Onnx {
    let mut known = OnnxOpRegister::default();
    known.insert("Constant", |context, node| done(value(context, node)?));
    known.insert("Identity", |_, _| done(Box::<ops::identity::Identity>::default()));
    known.insert("Add", |_, _| done(ops::math::Add.into_hir()));
    known.insert("Sub", |_, _| done(ops::math::Sub.into_hir()));
    known.insert("Mul", |_, _| done(ops::math::Mul.into_hir()));
    known.insert("Div", |_, _| done(ops::math::Div.into_hir()));
    known.insert("Exp", |_, _| done(ops::math::exp().into_hir()));
    known.insert("Tanh", |_, _| done(ops::math::tanh().into_hir()));
    known.insert("Sigmoid", |_, _| done(ops::nn::sigmoid().into_hir()));
    known.insert("HardSwish", |_, _| done(ops::nn::hard_swish().into_hir()));
    known.insert("HardSigmoid", hard_sigmoid);
    known.insert("Relu", |_, _| done(expand(ops::activations::Clip::new(Some(0.0), None))));
    known.insert("LeakyRelu", leaky_relu);
    known.insert("Clip", clip);
    known.insert("Conv", conv);
    known.insert("MaxPool", |_, node| done(expand(HirMaxPool::new(pool(node)?, None))));
    known.insert("AveragePool", average_pool);
    known.insert("GlobalAveragePool", |_, _| done(expand(ops::nn::GlobalAvgPool)));
    known.insert("ReduceMax", |context, node| reduce(context, node, Reducer::Max));
    known.insert("ReduceMean", |context, node| reduce(context, node, Reducer::Mean));
    known.insert("Softmax", softmax);
    known.insert("Concat", |_, node| done(expand(ops::array::Concat::new(node.get_attr("axis")?))));
    known.insert("Reshape", |_, _| done(expand(ops::array::Reshape::new(false))));
    known.insert("Flatten", |_, node| {
        done(expand(ops::array::Flatten::new(node.get_attr_opt("axis")?.unwrap_or(1))))
    });
    known.insert("Transpose", |_, node| {
        let order: Option<Vec<usize>> = node.get_attr_opt_vec("perm")?;
        done(expand(ops::array::PermuteAxes::new(order.map(Into::into))))
    });
    known.insert("Slice", slice);
    known.insert("Split", split);
    known.insert("Resize", resize);
    onnx::Onnx { op_register: known, ..onnx::Onnx::default() }
}

/// The operators of `graph` that tract is not given, each once.
pub(super) fn unknown(reader: &onnx::Onnx, graph: &GraphProto) -> Vec<String> {
    let mut names: Vec<String> = graph
        .node
        .iter()
        .filter(|node| !reader.op_register.0.contains_key(&node.op_type))
        .map(|node| node.op_type.clone())
        .collect();
    names.sort_unstable();
    names.dedup();
    names
}

fn done(operator: Box<dyn InferenceOp>) -> Built {
    Ok((operator, Vec::new()))
}

/// The value of a Constant.
fn value(context: &ParsingContext<'_>, node: &NodeProto) -> TractResult<Box<dyn InferenceOp>> {
    let tensor = context.load_tensor(node.get_attr("value")?)?;
    Ok(Box::new(ops::konst::Const::new(tensor.into_arc_tensor())?))
}

/// Input `index`, which must be a constant; `None` where it is left out.
fn constant(
    context: &ParsingContext<'_>,
    node: &NodeProto,
    index: usize,
) -> TractResult<Option<Tensor>> {
    let Some(name) = node.input.get(index).filter(|name| !name.is_empty()) else {
        return Ok(None);
    };
    for graph in context.parent_graphs.iter().rev() {
        if let Some(tensor) = graph.initializer.iter().find(|tensor| tensor.name == *name) {
            return context.load_tensor(tensor).map(Some);
        }
        if let Some(node) = graph.node.iter().find(|node| node.output.contains(name)) {
            ensure!(node.op_type == "Constant", "input {name} is computed");
            return context.load_tensor(node.get_attr("value")?).map(Some);
        }
    }
    bail!("input {name} is unknown")
}

fn longs(tensor: &Tensor) -> TractResult<Vec<i64>> {
    Ok(tensor.cast_to::<i64>()?.try_as_plain_ram()?.as_slice::<i64>()?.to_vec())
}

fn hard_sigmoid(_: &ParsingContext<'_>, node: &NodeProto) -> Built {
    let slope = node.get_attr_opt("alpha")?.unwrap_or(0.2);
    let middle = node.get_attr_opt("beta")?.unwrap_or(0.5);
    done(expand(ops::activations::HardSigmoid(slope, middle)))
}

fn leaky_relu(_: &ParsingContext<'_>, node: &NodeProto) -> Built {
    done(expand(ops::activations::LeakyRelu(node.get_attr_opt("alpha")?.unwrap_or(0.01))))
}

/// Bounds are attributes before version 11 of the operators, inputs since then.
fn clip(context: &ParsingContext<'_>, node: &NodeProto) -> Built {
    let bound = |name: &str, index: usize| -> TractResult<Option<f32>> {
        match constant(context, node, index)? {
            Some(tensor) => tensor.cast_to_scalar::<f32>().map(Some),
            None => node.get_attr_opt(name),
        }
    };
    done(expand(ops::activations::Clip::new(bound("min", 1)?, bound("max", 2)?)))
}

/// Pixels of nothing around a picture, as `kind` has them written one by one.
fn padding(
    node: &NodeProto,
    kind: fn(TVec<usize>, TVec<usize>) -> PaddingSpec,
) -> TractResult<PaddingSpec> {
    Ok(match node.get_attr_opt("auto_pad")?.unwrap_or("NOTSET") {
        "NOTSET" => {
            let pads: TVec<usize> = node.get_attr_opt_tvec("pads")?.unwrap_or(tvec![0; 4]);
            let (before, after) = pads.split_at(pads.len() / 2);
            kind(before.into(), after.into())
        }
        "VALID" => PaddingSpec::Valid,
        "SAME_UPPER" => PaddingSpec::SameUpper,
        "SAME_LOWER" => PaddingSpec::SameLower,
        other => bail!("auto_pad {other}"),
    })
}

fn conv(_: &ParsingContext<'_>, node: &NodeProto) -> Built {
    let mut conv = Conv::default().padding(padding(node, PaddingSpec::Explicit)?);
    conv = conv.group(node.get_attr_opt("group")?.unwrap_or(1));
    if let Some(shape) = node.get_attr_opt_tvec("kernel_shape")? {
        conv = conv.kernel_shape(shape);
    }
    if let Some(dilations) = node.get_attr_opt_tvec("dilations")? {
        conv = conv.dilations(dilations);
    }
    if let Some(strides) = node.get_attr_opt_tvec("strides")? {
        conv = conv.strides(strides);
    }
    if node.input.len() > 2 {
        conv = conv.bias_input(2);
    }
    done(expand(conv))
}

fn pool(node: &NodeProto) -> TractResult<PoolSpec> {
    ensure!(node.output.len() == 1, "a pool that tells where its values were");
    let up = node.get_attr_opt("ceil_mode")?.unwrap_or(0) != 0;
    let padding = if up {
        padding(node, |before, after| PaddingSpec::ExplicitOnnxPool(before, after, true))?
    } else {
        padding(node, |before, after| PaddingSpec::ExplicitOnnxPool(before, after, false))?
    };
    let shape = node.get_attr_tvec("kernel_shape")?;
    let dilations = node.get_attr_opt_tvec("dilations")?;
    let strides = node.get_attr_opt_tvec("strides")?;
    Ok(PoolSpec::new(DataFormat::NCHW, shape, padding, dilations, strides, 0, 0))
}

fn average_pool(_: &ParsingContext<'_>, node: &NodeProto) -> Built {
    let with_padding = node.get_attr_opt("count_include_pad")?.unwrap_or(false);
    done(expand(HirSumPool::new(pool(node)?, with_padding, true)))
}

/// Axes are an attribute before version 18 of the operators, an input since then.
fn reduce(context: &ParsingContext<'_>, node: &NodeProto, by: Reducer) -> Built {
    let axes = match constant(context, node, 1)? {
        Some(axes) => Some(longs(&axes)?),
        None => node.get_attr_opt_vec("axes")?,
    };
    let keep = node.get_attr_opt("keepdims")?.unwrap_or(true);
    done(expand(ops::nn::Reduce::new(axes, keep, by)))
}

/// Over all axes from one on before version 13 of the operators, over one since then.
fn softmax(context: &ParsingContext<'_>, node: &NodeProto) -> Built {
    let old = context.onnx_operator_set_version < 13;
    let axis = node.get_attr_opt("axis")?.unwrap_or(if old { 1 } else { -1 });
    done(expand(ops::nn::LayerSoftmax::new(axis, old)))
}

fn slice(_: &ParsingContext<'_>, node: &NodeProto) -> Built {
    ensure!(node.input.len() > 2, "bounds that are attributes (version 9 of the operators)");
    let given = |index: usize| node.input.get(index).filter(|name| !name.is_empty());
    let axes = given(3).map(|_| 3);
    let steps = given(4).map(|_| if axes.is_some() { 4 } else { 3 });
    done(Box::new(ops::array::StridedSlice {
        begin_mask: 0,
        end_mask: 0,
        shrink_axis_mask: 0,
        optional_axes_input: axes,
        optional_steps_input: steps,
    }))
}

/// Lengths are an attribute before version 13 of the operators, an input since then.
fn split(context: &ParsingContext<'_>, node: &NodeProto) -> Built {
    let lengths = match constant(context, node, 1)? {
        Some(lengths) => Some(longs(&lengths)?.into_iter().map(|n| n as usize).collect()),
        None => node.get_attr_opt_vec("split")?,
    };
    let axis = node.get_attr_opt("axis")?.unwrap_or(0);
    done(expand(Parts(ops::array::Split::new(axis, node.output.len(), lengths))))
}

/// A Split whose lengths are known: a second input, which repeats them, is not looked at.
#[derive(Clone, Debug)]
struct Parts(ops::array::Split);

impl Expansion for Parts {
    fn name(&self) -> StaticName {
        "Split".into()
    }

    fn nboutputs(&self) -> TractResult<usize> {
        self.0.nboutputs()
    }

    fn rules<'r, 'p: 'r, 's: 'r>(
        &'s self,
        solver: &mut Solver<'r>,
        inputs: &'p [TensorProxy],
        outputs: &'p [TensorProxy],
    ) -> InferenceResult {
        self.0.rules(solver, &inputs[..1], outputs)
    }

    fn wire(
        &self,
        prefix: &str,
        model: &mut TypedModel,
        inputs: &[OutletId],
    ) -> TractResult<TVec<OutletId>> {
        self.0.wire(prefix, model, &inputs[..1])
    }
}

/// By a known factor or to a known size.
fn resize(context: &ParsingContext<'_>, node: &NodeProto) -> Built {
    // Version 10 of the operators has factors as the second input, later ones a region there.
    let old = context.onnx_operator_set_version < 11;
    let given = |index: usize| -> TractResult<Option<Tensor>> {
        Ok(constant(context, node, index)?.filter(|tensor| tensor.len() == 4))
    };
    let word = |name: &str, default: &'static str| -> TractResult<String> {
        Ok(node.get_attr_opt(name)?.unwrap_or(default).to_owned())
    };
    let factors = given(if old { 1 } else { 2 })?;
    let sizes = if old { None } else { given(3)? };
    ensure!(factors.is_some() != sizes.is_some(), "neither a factor nor a size, or both");
    let places = word("coordinate_transformation_mode", "half_pixel")?;
    let places = if old { "asymmetric".to_owned() } else { places };
    let mode = word("mode", "nearest")?;
    let nearest_pixel = mode == "nearest";
    let doubled = |tensor: &Tensor| -> TractResult<bool> {
        Ok(tensor.try_as_plain_ram()?.as_slice::<f32>()?.iter().all(|&by| by == 1.0 || by == 2.0))
    };
    // From corner to corner a pixel falls half-way between two at twice the size, and is the
    // first one's; tract has no rounding that keeps to this at other factors.
    let nearest = match (&*word("nearest_mode", "round_prefer_floor")?, &*places) {
        ("floor", _) => Nearest::Floor,
        ("round_prefer_floor", "asymmetric") => {
            let known = factors.as_ref().map_or(Ok(false), doubled)?;
            ensure!(known || !nearest_pixel, "the nearest pixel at another factor than 2");
            Nearest::Floor
        }
        _ => Nearest::RoundPreferCeil,
    };
    let (scales_input, sizes_input) = (factors.as_ref().map(|_| 1), sizes.as_ref().map(|_| 1));
    let resize = Resize {
        coord_transformer: CoordTransformer::parse(&places)?,
        interpolator: Interpolator::parse(&mode)?,
        nearest,
        optional_scales_input: scales_input,
        optional_sizes_input: sizes_input,
    };
    let to = factors.or(sizes).context("neither a factor nor a size")?;
    done(expand(Enlarge { resize, to: to.into_arc_tensor() }))
}

/// A Resize with its factors or sizes.
#[derive(Clone, Debug)]
struct Enlarge {
    resize: Resize,
    to: Arc<Tensor>,
}

impl Expansion for Enlarge {
    fn name(&self) -> StaticName {
        "Resize".into()
    }

    fn rules<'r, 'p: 'r, 's: 'r>(
        &'s self,
        solver: &mut Solver<'r>,
        inputs: &'p [TensorProxy],
        outputs: &'p [TensorProxy],
    ) -> InferenceResult {
        solver.equals(&inputs[0].datum_type, &outputs[0].datum_type)?;
        solver.equals(&inputs[0].rank, &outputs[0].rank)?;
        solver.given(&inputs[0].shape, move |solver, shape| {
            let to = Some(&*self.to);
            let (factors, sizes) =
                if self.resize.optional_scales_input.is_some() { (to, None) } else { (None, to) };
            let shape = self.resize.compute_output_shape(&shape, factors, sizes)?;
            shape
                .into_iter()
                .enumerate()
                .try_for_each(|(axis, length)| solver.equals(&outputs[0].shape[axis], length))
        })
    }

    fn wire(
        &self,
        prefix: &str,
        model: &mut TypedModel,
        inputs: &[OutletId],
    ) -> TractResult<TVec<OutletId>> {
        let to = model.add_const(format!("{prefix}.to"), self.to.clone())?;
        model.wire_node(prefix, self.resize.clone(), &[inputs[0], to])
    }
}
