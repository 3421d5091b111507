//! Other forms of a model file, for comparison with other runtimes.
//!
//! Owns two rewritings of a QDQ graph: the same weights in floats without any rounding, and
//! values rounded before the activation too. The second is what ONNX Runtime needs to
//! convolve in int8; it leaves convolutions in floats where an activation stands between
//! them and the rounding.

use super::ModelError;
use super::graph::{FLOAT, Graph, UINT8, Values, attribute};
use super::onnx::{GraphProto, ModelProto, NodeProto, TensorProto};
use prost::Message;
use std::collections::HashMap;
use std::path::Path;

/// A model file in forms that compute the same net.
#[derive(Clone, Debug)]
pub struct Forms {
    /// All in 32-bit floats.
    pub float: Vec<u8>,
    /// Rounded before activations too; `None` for a model that is not in int8.
    pub rounded_early: Option<Vec<u8>>,
}

/// Rewrites the model file at `path`.
///
/// # Errors
/// [`ModelError`] where it cannot be read, or is no model.
pub fn forms(path: &Path) -> Result<Forms, ModelError> {
    let bytes =
        std::fs::read(path).map_err(|source| ModelError::Read { path: path.to_owned(), source })?;
    let load = |reason: String| ModelError::Load { path: path.to_owned(), reason };
    let proto = ModelProto::decode(&bytes[..]).map_err(|error| load(error.to_string()))?;
    let graph = proto.graph.as_ref().ok_or_else(|| load("a file without a graph".to_owned()))?;
    let is_int8 = graph.node.iter().any(is_rounding);
    let read = Graph::new(graph);
    let float = float(&proto, &read).ok_or_else(|| load("unknown weights".to_owned()))?;
    let early = is_int8.then(|| rounded_early(&proto, &read).encode_to_vec());
    Ok(Forms { float: float.encode_to_vec(), rounded_early: early })
}

/// `proto` in 32-bit floats if it rounds and its weights are known, else as it is.
pub(super) fn unrounded(proto: ModelProto) -> ModelProto {
    let graph = proto.graph.as_ref();
    let rounds = |graph: &&GraphProto| graph.node.iter().any(is_rounding);
    let float = graph.filter(rounds).and_then(|graph| float(&proto, &Graph::new(graph)));
    float.unwrap_or(proto)
}

fn is_rounding(node: &NodeProto) -> bool {
    node.op_type == "QuantizeLinear"
}

fn float(proto: &ModelProto, read: &Graph<'_>) -> Option<ModelProto> {
    let mut out = proto.clone();
    let graph = out.graph.as_mut()?;
    // What stands for a value that rounding made.
    let mut same: HashMap<&str, &str> = HashMap::new();
    graph.node.clear();
    for node in &read.proto.node {
        let first =
            node.input.first().map(|name| *same.get(name.as_str()).unwrap_or(&name.as_str()));
        match (node.op_type.as_str(), first, node.output.first()) {
            ("DequantizeLinear", Some(from), Some(to)) if read.constant(from).is_some() => {
                let dims = read.weight_dims(to)?;
                let channels = *dims.first()?;
                let (values, scale) = read.weight_source(to)?;
                let values = super::lower::floats(values, scale, channels).ok()?;
                graph.initializer.push(constant(to, &dims, &values));
            }
            ("QuantizeLinear" | "DequantizeLinear", Some(from), Some(to)) => {
                same.insert(to, from);
            }
            _ => {
                let mut node = node.clone();
                for name in &mut node.input {
                    if let Some(from) = same.get(name.as_str()) {
                        *name = (*from).to_owned();
                    }
                }
                graph.node.push(node);
            }
        }
    }
    let used: std::collections::HashSet<&str> =
        graph.node.iter().flat_map(|node| node.input.iter().map(String::as_str)).collect();
    graph.initializer.retain(|tensor| used.contains(tensor.name.as_str()));
    Some(out)
}

fn rounded_early(proto: &ModelProto, read: &Graph<'_>) -> ModelProto {
    let mut out = proto.clone();
    let Some(graph) = out.graph.as_mut() else { return out };
    let mut nodes = Vec::with_capacity(graph.node.len());
    for mut node in std::mem::take(&mut graph.node) {
        let slope = match node.op_type.as_str() {
            "LeakyRelu" => Some(attribute(&node, "alpha").map_or(0.01, |alpha| alpha.f)),
            _ => None,
        };
        let rounding = node.output.first().and_then(|name| read.sole_reader(name));
        let from = node.input.first().cloned().unwrap_or_default();
        let made = |name: &str| {
            let writer = read.proto.node.iter().find(|n| n.output.iter().any(|o| o == name));
            writer.is_some_and(|writer| writer.op_type == "Conv")
        };
        if let (Some(slope), Some((_, rounding))) = (slope, rounding)
            && rounding.op_type == "QuantizeLinear"
            && made(&from)
            && let Some((scale, zero)) = early_steps(read, rounding, slope)
        {
            let name = |what: &str| format!("{from}.{what}");
            graph.initializer.push(constant(&name("scale"), &[], &[scale]));
            graph.initializer.push(TensorProto {
                name: name("zero"),
                data_type: UINT8,
                raw_data: vec![zero],
                ..TensorProto::default()
            });
            let link = |op: &str, from: String, to: String| NodeProto {
                op_type: op.to_owned(),
                input: vec![from, name("scale"), name("zero")],
                output: vec![to],
                ..NodeProto::default()
            };
            nodes.push(link("QuantizeLinear", from.clone(), name("steps")));
            nodes.push(link("DequantizeLinear", name("steps"), name("rounded")));
            node.input[0] = name("rounded");
        }
        nodes.push(node);
    }
    graph.node = nodes;
    out
}

/// Steps that hold everything that the steps behind the activation can come from.
fn early_steps(read: &Graph<'_>, rounding: &NodeProto, slope: f32) -> Option<(f32, u8)> {
    let scale = *read.floats(rounding.input.get(1)?)?.first()?;
    let Values::U8(zero) = &read.constant(rounding.input.get(2)?)?.values else { return None };
    let zero = f32::from(*zero.first()?);
    let (least, most) = (-zero * scale / slope, (255.0 - zero) * scale);
    let early = (most - least) / 255.0;
    (early.is_normal() && slope > 0.0).then(|| (early, (-least / early).round() as u8))
}

fn constant(name: &str, dims: &[usize], values: &[f32]) -> TensorProto {
    TensorProto {
        name: name.to_owned(),
        dims: dims.iter().map(|&n| n as i64).collect(),
        data_type: FLOAT,
        raw_data: values.iter().flat_map(|v| v.to_le_bytes()).collect(),
        ..TensorProto::default()
    }
}
