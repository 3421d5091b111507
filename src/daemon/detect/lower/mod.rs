//! A model's graph onto the project's own kernels.
//!
//! Owns which groups of operators are recognised. A graph that holds anything else is
//! refused as a whole, and tract runs it. `conv` has convolutions and pooling, `layout` what
//! moves or joins pictures, `cells` what follows the last convolutions. In QDQ models (QuantizeLinear, DequantizeLinear)
//! `x -> Q -> DQ` is a picture in steps; read for floats they are left out.

mod cells;
mod conv;
mod layout;

pub(super) use conv::floats;

use super::graph::{Graph, Values};
use super::onnx::{GraphProto, NodeProto, ValueInfoProto};
use super::tail::Part;
use cells::Rows;
use std::collections::{HashMap, HashSet};
use verge_kernels::{Builder, Isa, Net, QuantParams, Shape, Tensor};

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
/// are turned into floats; without, a graph without steps is one of floats too. `size`, columns
/// and rows, takes the place of the file's input size: what follows from it is worked out from
/// the pictures themselves, never from a constant of the file.
///
/// # Errors
/// The first thing that is not recognised.
pub(super) fn lower(
    proto: &GraphProto,
    float: bool,
    isa: Isa,
    size: Option<[usize; 2]>,
) -> Result<Lowered, Refusal> {
    let graph = &Graph::new(proto);
    let constants: HashSet<_> = proto.initializer.iter().map(|t| t.name.as_str()).collect();
    let input = proto.input.iter().find(|input| !constants.contains(input.name.as_str()));
    let input = input.ok_or("no input")?;
    let stored = input_shape(input).ok_or("an input that is no picture of known size")?;
    let [width, height] = size.unwrap_or([stored.width, stored.height]);
    let shape = Shape { height, width, ..stored };
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
            if levels.iter().any(|&level| lowering.builder.quant_params(level).is_some()) {
                return Err("an output of bytes".to_owned());
            }
            let net = lowering.builder.finish(&levels).map_err(|error| error.to_string())?;
            let input = [1, stored.channels, stored.height, stored.width];
            Ok(Lowered { net, input, levels: levels.len(), parts })
        }
        _ => Err("an output that is no list of cells".to_owned()),
    }
}

fn input_shape(input: &ValueInfoProto) -> Option<Shape> {
    match input.shape()?[..] {
        [1, channels, height, width] => Some(Shape { height, width, channels }),
        _ => None,
    }
}

/// The steps of a QuantizeLinear or DequantizeLinear of a picture.
fn steps(graph: &Graph<'_>, node: &NodeProto) -> Result<QuantParams, Refusal> {
    let scale = node.input.get(1).and_then(|name| graph.floats(name));
    let zero = node.input.get(2).and_then(|name| graph.constant(name));
    match (scale, zero.map(|zero| &zero.values)) {
        (Some([scale]), Some(Values::U8(zero))) if zero.len() == 1 && scale.is_normal() => {
            Ok(QuantParams { scale: *scale, zero_point: zero[0] })
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
    fn out_steps(&self, output: &str) -> Result<Option<QuantParams>, Refusal> {
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
}
