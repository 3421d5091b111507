//! A model's graph onto the project's own kernels.
//!
//! Owns which groups of operators are recognised. A graph that holds anything else is
//! refused as a whole, and tract runs it. In QDQ models (QuantizeLinear, DequantizeLinear)
//! `x -> Q -> DQ` is a picture in steps; read for floats they are left out.

use super::graph::{Graph, Values, attribute, int, ints, word};
use super::pb::{GraphProto, NodeProto};
use super::tail::Part;
use std::collections::{HashMap, HashSet};
use verge_kernels::{Builder, Conv, Isa, Net, Shape, Steps, Tensor, Weights};

/// A net on the kernels, and what its raw output means.
#[derive(Debug)]
pub(super) struct Lowered {
    pub(super) net: Net,
    /// The input's shape in the file.
    pub(super) input: [usize; 4],
    /// Outputs, in the order of their cells.
    pub(super) levels: usize,
    pub(super) parts: Vec<Part>,
}

/// What a name stands for.
#[derive(Clone, Debug)]
enum Value {
    Picture(Tensor),
    /// Two halves that will be shuffled.
    Halves(Tensor, Tensor),
    /// Cells of several pictures.
    Rows(Rows),
}

/// Cells of several pictures, one behind the other, with what happens to their columns.
#[derive(Clone, Debug)]
struct Rows {
    levels: Vec<Tensor>,
    parts: Vec<Part>,
    /// Which axis the columns are: 1 as they come, 2 when turned.
    axis: i64,
}

impl Rows {
    fn columns(&self) -> usize {
        self.parts.iter().map(Part::columns).sum()
    }
}

/// Why a graph stays with tract.
type Refusal = String;

struct Lowering<'a> {
    graph: &'a Graph<'a>,
    float: bool,
    builder: Builder,
    values: HashMap<&'a str, Value>,
    /// Slices of pictures: whole and first channel.
    parts_of: HashMap<Tensor, (Tensor, usize)>,
    done: HashSet<usize>,
}

/// Puts `proto` onto the kernels of `isa`. With `float` its steps are left out and weights
/// are turned into floats; without, a graph without steps is one of floats too.
///
/// # Errors
/// The first thing that is not recognised.
pub(super) fn lower(proto: &GraphProto, float: bool, isa: Isa) -> Result<Lowered, Refusal> {
    let graph = &Graph::new(proto);
    let constants: HashSet<_> = proto.initializer.iter().map(|t| t.name.as_str()).collect();
    let input = proto.input.iter().find(|input| !constants.contains(input.name.as_str()));
    let input = input.ok_or("no input")?;
    let shape = input_shape(input).ok_or("an input that is no picture of known size")?;
    let steps = match graph.sole_reader(&input.name) {
        Some((_, node)) if !float && node.op_type == "QuantizeLinear" => Some(steps(graph, node)?),
        _ => None,
    };
    let (builder, picture) = Builder::new(isa, shape, steps);
    let values = HashMap::from([(input.name.as_str(), Value::Picture(picture))]);
    let (parts_of, done) = (HashMap::new(), HashSet::new());
    let mut lowering = Lowering { graph, float, builder, values, parts_of, done };
    for (i, node) in proto.node.iter().enumerate() {
        if !lowering.done.contains(&i) && node.op_type != "Constant" {
            lowering.node(node).map_err(|why| format!("{} {}: {why}", node.op_type, node.name))?;
        }
    }
    let output = proto.output.first().ok_or("no output")?;
    match lowering.values.remove(output.name.as_str()) {
        Some(Value::Rows(Rows { levels, parts, axis: 2 })) => {
            let net = lowering.builder.finish(&levels).map_err(|error| error.to_string())?;
            let input = [1, shape.channels, shape.height, shape.width];
            Ok(Lowered { net, input, levels: levels.len(), parts })
        }
        _ => Err("an output that is no list of cells".to_owned()),
    }
}

fn input_shape(input: &super::pb::ValueInfoProto) -> Option<Shape> {
    use super::pb::tensor_shape_proto::dimension::Value;
    use super::pb::type_proto;
    let type_proto::Value::TensorType(tensor) = input.r#type.as_ref()?.value.as_ref()?;
    let dims: Option<Vec<usize>> = tensor
        .shape
        .as_ref()?
        .dim
        .iter()
        .map(|dim| match dim.value {
            Some(Value::DimValue(n)) => usize::try_from(n).ok(),
            _ => None,
        })
        .collect();
    match dims?[..] {
        [1, channels, height, width] => Some(Shape { height, width, channels }),
        _ => None,
    }
}

/// The steps of a QuantizeLinear or DequantizeLinear of a picture.
fn steps(graph: &Graph<'_>, node: &NodeProto) -> Result<Steps, Refusal> {
    let scale = node.input.get(1).and_then(|name| graph.floats(name));
    let zero = node.input.get(2).and_then(|name| graph.constant(name));
    match (scale, zero.map(|zero| &zero.values)) {
        (Some([scale]), Some(Values::U8(zero))) if zero.len() == 1 && scale.is_normal() => {
            Ok(Steps { scale: *scale, zero: zero[0] })
        }
        _ => Err("steps that are not one scale and one unsigned byte".to_owned()),
    }
}

impl<'a> Lowering<'a> {
    fn node(&mut self, node: &'a NodeProto) -> Result<(), Refusal> {
        let Some(output) = node.output.first() else { return Err("no output".to_owned()) };
        let value = match node.op_type.as_str() {
            "Conv" => return self.conv(node),
            "DequantizeLinear" if self.input(node, 0).is_err() => return Ok(()),
            "QuantizeLinear" | "DequantizeLinear" => self.quantise(node)?,
            "MaxPool" => self.pool(node)?,
            "Concat" => self.concat(node)?,
            "Reshape" => self.reshape(node)?,
            "Transpose" => self.transpose(node)?,
            "Slice" => self.slice(node)?,
            "Split" => return self.split(node),
            "Resize" => self.resize(node)?,
            "Add" => self.add(node)?,
            "Sigmoid" | "Exp" | "ReduceMax" | "Sub" | "Mul" => self.cell_wise(node)?,
            _ => return Err("no kernel for it".to_owned()),
        };
        self.values.insert(output, value);
        Ok(())
    }

    fn input(&self, node: &NodeProto, index: usize) -> Result<Value, Refusal> {
        let name = node.input.get(index).ok_or("an input is missing")?;
        self.values.get(name.as_str()).cloned().ok_or_else(|| format!("input {name} is unknown"))
    }

    fn picture(&self, node: &NodeProto, index: usize) -> Result<Tensor, Refusal> {
        match self.input(node, index)? {
            Value::Picture(picture) => Ok(picture),
            other => Err(format!("input {index} is {other:?}")),
        }
    }

    /// The steps that the node's output is stored in: those of the QuantizeLinear behind it.
    fn out_steps(&self, output: &str) -> Result<Option<Steps>, Refusal> {
        match self.graph.sole_reader(output) {
            Some((_, reader)) if !self.float && reader.op_type == "QuantizeLinear" => {
                steps(self.graph, reader).map(Some)
            }
            _ => Ok(None),
        }
    }

    fn quantise(&mut self, node: &NodeProto) -> Result<Value, Refusal> {
        match self.input(node, 0)? {
            Value::Picture(picture) if !self.float && node.op_type == "QuantizeLinear" => {
                let to = steps(self.graph, node)?;
                let done = self.builder.requantise(picture, to).map_err(|e| e.to_string())?;
                Ok(Value::Picture(done))
            }
            Value::Halves(a, b) if !self.float && node.op_type == "QuantizeLinear" => {
                let to = steps(self.graph, node)?;
                let mut one = |half| self.builder.requantise(half, to).map_err(|e| e.to_string());
                Ok(Value::Halves(one(a)?, one(b)?))
            }
            same => Ok(same),
        }
    }

    /// A convolution with the rounding and the activation behind it.
    fn conv(&mut self, node: &'a NodeProto) -> Result<(), Refusal> {
        let input = self.picture(node, 0)?;
        let channels_in = self.builder.shape(input).channels;
        let weight = node.input.get(1).ok_or("no weights")?;
        let (weights, weight_scale) = self.graph.weight_source(weight).ok_or("unknown weights")?;
        let dims = self.graph.weight_dims(weight).ok_or("weights of unknown shape")?;
        let [channels, seen, kernel, kernel_width] = dims[..] else {
            return Err(format!("weights of {dims:?}"));
        };
        let same = |values: &[i64], default: usize| match values {
            [] => Some(default),
            [first, rest @ ..] if rest.iter().all(|v| v == first) => usize::try_from(*first).ok(),
            _ => None,
        };
        let stride = same(ints(node, "strides"), 1).ok_or("strides differ")?;
        let pad = same(ints(node, "pads"), 0).ok_or("pads differ")?;
        let groups = usize::try_from(int(node, "group", 1)).map_err(|e| e.to_string())?;
        let depthwise = groups > 1;
        let plain = same(ints(node, "dilations"), 1) == Some(1)
            && ["", "NOTSET"].contains(&word(node, "auto_pad"))
            && kernel == kernel_width
            && if depthwise { groups == channels_in && seen == 1 } else { seen == channels_in };
        if !plain {
            return Err("a convolution that is neither dense nor depthwise".to_owned());
        }
        let (behind, name, skipped) = self.behind(&node.output[0])?;
        let bias = node.input.get(2).and_then(|bias| self.graph.weight_source(bias));
        let spread = |scale: Option<&[f32]>, len: usize| match scale {
            Some([one]) => vec![*one; len],
            Some(many) => many.to_vec(),
            None => vec![1.0; len],
        };
        let steps_in = self.builder.steps(input);
        let conv = |weights| Conv {
            weights,
            channels,
            kernel,
            stride,
            pad,
            depthwise,
            before: behind.before,
            slope: behind.slope,
            out: behind.out,
        };
        let made = match (weights, steps_in) {
            (Values::I8(values), Some(steps_in)) => {
                let scales = spread(weight_scale, channels);
                let bias = match bias {
                    None => vec![0; channels],
                    Some((Values::I32(bias), Some(unit))) => {
                        let unit = spread(Some(unit), channels);
                        for (unit, scale) in unit.iter().zip(&scales) {
                            if (unit / (scale * steps_in.scale) - 1.0).abs() > 1e-4 {
                                return Err("a bias in other steps than its products".to_owned());
                            }
                        }
                        bias.clone()
                    }
                    Some(_) => return Err("a bias that is not whole".to_owned()),
                };
                let weights = Weights::Int8 { values, scales: &scales, bias: &bias };
                self.builder.conv(input, &conv(weights))
            }
            (values, None) => {
                let values = floats(values, weight_scale, channels)?;
                let bias = match bias {
                    None => vec![0.0; channels],
                    Some((bias, scale)) => floats(bias, scale, channels)?,
                };
                let weights = Weights::Float { values: &values, bias: &bias };
                self.builder.conv(input, &conv(weights))
            }
            _ => return Err("weights in floats for a picture in steps".to_owned()),
        };
        self.values.insert(name, Value::Picture(made.map_err(|error| error.to_string())?));
        self.done.extend(skipped);
        Ok(())
    }

    /// Rounding and activation behind a convolution: what they are, the name of the last
    /// value, and the nodes that are done with it.
    fn behind(&self, output: &'a str) -> Result<(Behind, &'a str, Vec<usize>), Refusal> {
        let mut behind = Behind::default();
        let (mut name, mut nodes) = (output, Vec::new());
        let next = |name: &str, kind: &str| {
            self.graph.sole_reader(name).filter(|(_, reader)| reader.op_type == kind)
        };
        let mut pending = None;
        if let Some((i, rounding)) = next(name, "QuantizeLinear") {
            let (quantised, steps) = (&rounding.output[0], steps(self.graph, rounding)?);
            let activated = next(quantised, "DequantizeLinear")
                .filter(|(_, back)| next(&back.output[0], "LeakyRelu").is_some());
            match activated {
                Some((j, back)) => {
                    behind.before = Some(steps);
                    (name, pending) = (&back.output[0], Some([i, j]));
                }
                None => {
                    behind.out = Some(steps);
                    nodes.push(i);
                    name = quantised;
                }
            }
        }
        nodes.extend(pending.into_iter().flatten());
        if behind.out.is_none() {
            for (kind, default) in [("LeakyRelu", 0.01), ("Relu", 0.0)] {
                if let Some((i, activation)) = next(name, kind) {
                    behind.slope =
                        Some(attribute(activation, "alpha").map_or(default, |alpha| alpha.f));
                    nodes.push(i);
                    name = &activation.output[0];
                    break;
                }
            }
            if let Some((i, rounding)) = next(name, "QuantizeLinear") {
                behind.out = Some(steps(self.graph, rounding)?);
                nodes.push(i);
                name = &rounding.output[0];
            }
        }
        if self.float {
            (behind.before, behind.out) = (None, None);
        }
        Ok((behind, name, nodes))
    }

    fn pool(&mut self, node: &NodeProto) -> Result<Value, Refusal> {
        let input = self.picture(node, 0)?;
        let (kernel, strides, pads) =
            (ints(node, "kernel_shape"), ints(node, "strides"), ints(node, "pads"));
        let same = |values: &[i64], default: i64| {
            let first = values.first().copied().unwrap_or(default);
            values
                .iter()
                .all(|&v| v == first)
                .then_some(first)
                .and_then(|v| usize::try_from(v).ok())
        };
        let (Some(kernel), Some(stride), Some(pad)) =
            (same(kernel, 1), same(strides, 1), same(pads, 0))
        else {
            return Err("a window that is not square".to_owned());
        };
        let odd = int(node, "ceil_mode", 0) != 0
            || !["", "NOTSET"].contains(&word(node, "auto_pad"))
            || ints(node, "dilations").iter().any(|&d| d != 1);
        if odd {
            return Err("rounding up, automatic padding or dilation".to_owned());
        }
        let made = self.builder.pool(input, kernel, stride, pad);
        made.map(Value::Picture).map_err(|error| error.to_string())
    }

    fn concat(&mut self, node: &NodeProto) -> Result<Value, Refusal> {
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

    fn reshape(&mut self, node: &NodeProto) -> Result<Value, Refusal> {
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

    fn transpose(&mut self, node: &NodeProto) -> Result<Value, Refusal> {
        match (self.input(node, 0)?, ints(node, "perm")) {
            (halves @ Value::Halves(..), [0, 2, 1, 3, 4]) => Ok(halves),
            (Value::Rows(rows), [0, 2, 1]) => Ok(Value::Rows(Rows { axis: 3 - rows.axis, ..rows })),
            (value, order) => Err(format!("{value:?} to {order:?}")),
        }
    }

    /// A picture of floats as cells.
    fn rows(&self, value: Value) -> Result<Rows, Refusal> {
        match value {
            Value::Rows(rows) => Ok(rows),
            Value::Picture(picture) if self.builder.steps(picture).is_none() => {
                let channels = self.builder.shape(picture).channels;
                let (whole, first) = self.parts_of.get(&picture).copied().unwrap_or((picture, 0));
                let parts = vec![Part::Raw(first..first + channels)];
                Ok(Rows { levels: vec![whole], parts, axis: 1 })
            }
            other => Err(format!("{other:?} is no list of cells")),
        }
    }

    fn part(&mut self, value: &Value, first: usize, count: usize) -> Result<Value, Refusal> {
        match value {
            Value::Picture(picture) => {
                let made = self.builder.slice(*picture, first, count);
                let made = made.map_err(|error| error.to_string())?;
                self.parts_of.insert(made, (*picture, first));
                Ok(Value::Picture(made))
            }
            Value::Rows(rows) => {
                let mut at = 0;
                for part in &rows.parts {
                    if first >= at && first + count <= at + part.columns() {
                        let part = part.slice(first - at..first - at + count);
                        let parts = vec![part.ok_or("a part of shares")?];
                        return Ok(Value::Rows(Rows { parts, ..rows.clone() }));
                    }
                    at += part.columns();
                }
                Err("a slice across several parts".to_owned())
            }
            Value::Halves(..) => Err("a slice inside a shuffle".to_owned()),
        }
    }

    /// Values along the axis that is sliced: channels of a picture, columns of cells.
    fn width(&self, value: &Value) -> Option<(i64, usize)> {
        match value {
            Value::Picture(picture) => Some((1, self.builder.shape(*picture).channels)),
            Value::Rows(rows) => Some((rows.axis, rows.columns())),
            Value::Halves(..) => None,
        }
    }

    fn slice(&mut self, node: &NodeProto) -> Result<Value, Refusal> {
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

    fn split(&mut self, node: &'a NodeProto) -> Result<(), Refusal> {
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

    fn resize(&mut self, node: &NodeProto) -> Result<Value, Refusal> {
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

    fn add(&mut self, node: &NodeProto) -> Result<Value, Refusal> {
        let (a, b) = (self.picture(node, 0)?, self.picture(node, 1)?);
        let steps = self.out_steps(&node.output[0])?;
        let made = self.builder.add(a, b, steps);
        made.map(Value::Picture).map_err(|error| error.to_string())
    }

    /// What happens to cells behind the last convolutions.
    fn cell_wise(&mut self, node: &NodeProto) -> Result<Value, Refusal> {
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

/// What follows a convolution.
#[derive(Debug, Default)]
struct Behind {
    before: Option<Steps>,
    slope: Option<f32>,
    out: Option<Steps>,
}

/// Weights as floats, one scale an output channel.
pub(super) fn floats(
    values: &Values,
    scale: Option<&[f32]>,
    channels: usize,
) -> Result<Vec<f32>, Refusal> {
    let whole: Vec<f32> = match (values, scale) {
        (Values::F32(values), None) => return Ok(values.clone()),
        (Values::I8(values), Some(_)) => values.iter().map(|&v| f32::from(v)).collect(),
        (Values::I32(values), Some(_)) => values.iter().map(|&v| v as f32).collect(),
        _ => return Err("weights of an unknown kind".to_owned()),
    };
    let scale = scale.unwrap_or_default();
    if scale.len() != 1 && scale.len() != channels {
        return Err(format!("{} scales for {channels} channels", scale.len()));
    }
    let each = whole.len() / channels.max(1);
    let value = |(i, v): (usize, &f32)| v * scale[if scale.len() == 1 { 0 } else { i / each }];
    Ok(whole.iter().enumerate().map(value).collect())
}
