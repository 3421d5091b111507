//! An ONNX graph as it is read: constants, attributes, who reads what.

use super::onnx::{AttributeProto, GraphProto, NodeProto, TensorProto};
use std::collections::HashMap;

/// Element types by their number in the ONNX standard, `TensorProto.DataType`.
pub(super) const FLOAT: i32 = 1;
pub(super) const UINT8: i32 = 2;
const INT8: i32 = 3;
const INT32: i32 = 6;
const INT64: i32 = 7;

/// Values of a constant.
#[derive(Clone, Debug)]
pub(super) enum Values {
    F32(Vec<f32>),
    U8(Vec<u8>),
    I8(Vec<i8>),
    I32(Vec<i32>),
    I64(Vec<i64>),
}

impl Values {
    fn read(tensor: &TensorProto) -> Option<Self> {
        let raw = &tensor.raw_data[..];
        let words = || raw.as_chunks::<4>().0.iter();
        Some(match tensor.data_type {
            FLOAT if raw.is_empty() => Self::F32(tensor.float_data.clone()),
            FLOAT => Self::F32(words().map(|b| f32::from_le_bytes(*b)).collect()),
            UINT8 if raw.is_empty() => {
                Self::U8(tensor.int32_data.iter().map(|&v| v as u8).collect())
            }
            UINT8 => Self::U8(raw.to_vec()),
            INT8 if raw.is_empty() => {
                Self::I8(tensor.int32_data.iter().map(|&v| v as i8).collect())
            }
            INT8 => Self::I8(raw.iter().map(|b| b.cast_signed()).collect()),
            INT32 if raw.is_empty() => Self::I32(tensor.int32_data.clone()),
            INT32 => Self::I32(words().map(|b| i32::from_le_bytes(*b)).collect()),
            INT64 if raw.is_empty() => Self::I64(tensor.int64_data.clone()),
            INT64 => {
                let longs = raw.as_chunks::<8>().0.iter();
                Self::I64(longs.map(|b| i64::from_le_bytes(*b)).collect())
            }
            _ => return None,
        })
    }

    fn len(&self) -> usize {
        match self {
            Self::F32(v) => v.len(),
            Self::U8(v) => v.len(),
            Self::I8(v) => v.len(),
            Self::I32(v) => v.len(),
            Self::I64(v) => v.len(),
        }
    }
}

/// A constant.
#[derive(Clone, Debug)]
pub(super) struct Constant {
    pub(super) dims: Vec<usize>,
    pub(super) values: Values,
}

impl Constant {
    fn read(tensor: &TensorProto) -> Option<Self> {
        let dims: Option<Vec<usize>> =
            tensor.dims.iter().map(|&d| usize::try_from(d).ok()).collect();
        let (dims, values) = (dims?, Values::read(tensor)?);
        let count = dims.iter().try_fold(1usize, |all, &d| all.checked_mul(d))?;
        (count == values.len()).then_some(Self { dims, values })
    }
}

/// A graph with its constants read and its links known.
#[derive(Debug)]
pub(super) struct Graph<'a> {
    pub(super) proto: &'a GraphProto,
    constants: HashMap<&'a str, Constant>,
    readers: HashMap<&'a str, Vec<usize>>,
}

impl<'a> Graph<'a> {
    pub(super) fn new(proto: &'a GraphProto) -> Self {
        let mut constants = HashMap::new();
        let mut readers: HashMap<&str, Vec<usize>> = HashMap::new();
        for tensor in &proto.initializer {
            if let Some(constant) = Constant::read(tensor) {
                constants.insert(tensor.name.as_str(), constant);
            }
        }
        for (i, node) in proto.node.iter().enumerate() {
            let value = attribute(node, "value").and_then(|a| a.t.as_ref());
            if let ("Constant", Some(name), Some(constant)) =
                (node.op_type.as_str(), node.output.first(), value.and_then(Constant::read))
            {
                constants.insert(name, constant);
            }
            for name in &node.input {
                readers.entry(name).or_default().push(i);
            }
        }
        Self { proto, constants, readers }
    }

    pub(super) fn constant(&self, name: &str) -> Option<&Constant> {
        self.constants.get(name)
    }

    pub(super) fn floats(&self, name: &str) -> Option<&[f32]> {
        match &self.constants.get(name)?.values {
            Values::F32(values) => Some(values),
            _ => None,
        }
    }

    pub(super) fn longs(&self, name: &str) -> Option<&[i64]> {
        match &self.constants.get(name)?.values {
            Values::I64(values) => Some(values),
            _ => None,
        }
    }

    /// Weights or biases behind a DequantizeLinear, or constants as they are.
    pub(super) fn weight_source(&self, name: &str) -> Option<(&Values, Option<&[f32]>)> {
        if let Some(constant) = self.constant(name) {
            return Some((&constant.values, None));
        }
        let node = self.writer(name)?;
        if node.op_type != "DequantizeLinear" {
            return None;
        }
        let zero = node.input.get(2).and_then(|zero| self.constant(zero));
        let symmetric = zero.is_none_or(|zero| match &zero.values {
            Values::I8(zero) => zero.iter().all(|&z| z == 0),
            Values::I32(zero) => zero.iter().all(|&z| z == 0),
            _ => false,
        });
        let scale = self.floats(node.input.get(1)?)?;
        let values = &self.constant(node.input.first()?)?.values;
        symmetric.then_some((values, Some(scale)))
    }

    /// Their shape.
    pub(super) fn weight_dims(&self, name: &str) -> Option<Vec<usize>> {
        if let Some(constant) = self.constant(name) {
            return Some(constant.dims.clone());
        }
        let node = self.writer(name)?;
        Some(self.constant(node.input.first()?)?.dims.clone())
    }

    fn writer(&self, name: &str) -> Option<&'a NodeProto> {
        self.proto.node.iter().find(|node| node.output.first().is_some_and(|o| o == name))
    }

    /// The node that alone reads `name`, where the graph does not give it out too.
    pub(super) fn sole_reader(&self, name: &str) -> Option<(usize, &'a NodeProto)> {
        let [reader] = self.readers.get(name)?[..] else { return None };
        let given_out = self.proto.output.iter().any(|output| output.name == name);
        (!given_out).then(|| (reader, &self.proto.node[reader]))
    }
}

pub(super) fn attribute<'a>(node: &'a NodeProto, name: &str) -> Option<&'a AttributeProto> {
    node.attribute.iter().find(|attribute| attribute.name == name)
}

/// A whole number, or what the standard says where it is missing.
pub(super) fn int(node: &NodeProto, name: &str, default: i64) -> i64 {
    attribute(node, name).map_or(default, |attribute| attribute.i)
}

/// Whole numbers; empty where they are missing.
pub(super) fn ints<'a>(node: &'a NodeProto, name: &str) -> &'a [i64] {
    attribute(node, name).map_or(&[], |attribute| &attribute.ints)
}

/// A word; empty where it is missing.
pub(super) fn word<'a>(node: &'a NodeProto, name: &str) -> &'a str {
    attribute(node, name).and_then(|a| std::str::from_utf8(&a.s).ok()).unwrap_or_default()
}
