//! Convolutions, with the rounding and the activation behind them, and pooling.

use super::super::graph::{Values, attribute, int, ints, word};
use super::super::onnx::NodeProto;
use super::{Lowering, Refusal, Value, steps};
use verge_kernels::{Conv, QuantParams, Weights};

/// What follows a convolution.
#[derive(Debug, Default)]
struct Behind {
    before: Option<QuantParams>,
    slope: Option<f32>,
    out: Option<QuantParams>,
}

impl<'a> Lowering<'a> {
    /// A convolution with the rounding and the activation behind it.
    pub(super) fn conv(&mut self, node: &'a NodeProto) -> Result<(), Refusal> {
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
        let steps_in = self.builder.quant_params(input);
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

    pub(super) fn pool(&mut self, node: &NodeProto) -> Result<Value, Refusal> {
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
}

/// Weights as floats, one scale an output channel.
pub(in super::super) fn floats(
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
