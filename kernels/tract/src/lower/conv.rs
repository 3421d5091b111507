//! Convolutions, with the rounding and the activation function behind them, and pooling.

use super::{Lowering, Value};
use crate::constant::Constant;
use crate::graph::Refusal;
use tract_core::internal::*;
use tract_core::ops::cnn::{Conv, KernelFormat, MaxPool, PoolSpec};
use tract_core::ops::element_wise::ElementWiseOp;
use tract_core::ops::math::Max;
use tract_core::ops::nn::{DataFormat, LeakyRelu};
use verge_kernels::{Conv as Kernel, QuantParams, Shape, Weights};

/// Operators behind a convolution that are fused into it.
#[derive(Debug)]
struct Behind {
    before: Option<QuantParams>,
    slope: Option<f32>,
    out: Option<QuantParams>,
    /// The last value.
    outlet: OutletId,
    /// The nodes that are done with it.
    nodes: Vec<usize>,
}

impl<'a> Lowering<'a> {
    /// Window, stride and padding, the same along both axes.
    fn window(
        &self,
        spec: &PoolSpec,
        kernel: [usize; 2],
        size: [usize; 2],
    ) -> Result<[usize; 3], Refusal> {
        let same = |[a, b]: [usize; 2], what: &str| {
            if a == b { Ok(a) } else { Err(format!("{what} of {a} and {b}")) }
        };
        if spec.data_format != DataFormat::NCHW || spec.dilations().iter().any(|&d| d != 1) {
            return Err("dilation, or pixels in another order".to_owned());
        }
        let kernel = same(kernel, "a window")?;
        let stride = same([spec.stride(0), spec.stride(1)], "strides")?;
        let computed = spec.computed_padding(&size);
        let pad = same([computed[0].pad_before, computed[1].pad_before], "padding")?;
        for (length, computed) in size.iter().zip(&computed) {
            let count = (length + 2 * pad).checked_sub(kernel).map(|n| n / stride + 1);
            if count != Some(computed.convoluted) {
                return Err("padding that differs between the sides".to_owned());
            }
        }
        Ok([kernel, stride, pad])
    }

    /// A convolution with the rounding and the activation function behind it.
    pub(super) fn conv(&mut self, node: &'a TypedNode) -> Result<(), Refusal> {
        let op = node.op_as::<Conv>().ok_or("not a convolution")?;
        if op.q_params.is_some() || op.kernel_fmt != KernelFormat::OIHW {
            return Err("a convolution in another form than QDQ".to_owned());
        }
        let input = self.activation(node, 0)?;
        let shape = self.builder.shape(input);
        let weight = node.inputs[1];
        let Some(&[channels, seen, kernel, kernel_width]) = self.view.shape(weight) else {
            return Err("weights of an unknown shape".to_owned());
        };
        let weights = self.view.constant(weight).ok_or("weights that are not constant")?;
        let size = [shape.height, shape.width];
        let [kernel, stride, pad] = self.window(&op.pool_spec, [kernel, kernel_width], size)?;
        let depthwise = op.group > 1;
        let plain = if depthwise {
            op.group == shape.channels && seen == 1
        } else {
            seen == shape.channels
        };
        if !plain {
            return Err("a convolution that is neither dense nor depthwise".to_owned());
        }
        let bias = self.view.constant(node.inputs[2]).ok_or("a bias that is not constant")?;
        let behind = self.behind(node);
        let conv = |weights| Kernel {
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
        let made = match self.builder.quant_params(input) {
            Some(quant) => {
                let values = weights.bytes().ok_or("weights in floats for an input of bytes")?;
                let scales = weights.scales(channels).ok_or("scales of other channels")?;
                let bias = whole_bias(&bias, channels, quant.scale, &scales)?;
                let weights = Weights::Int8 { values, scales: &scales, bias: &bias };
                self.builder.conv(input, &conv(weights))
            }
            None => {
                let values = weights.floats(channels).ok_or("weights of an unknown kind")?;
                let bias = float_bias(&bias, channels)?;
                let weights = Weights::Float { values: &values, bias: &bias };
                self.builder.conv(input, &conv(weights))
            }
        };
        let made = made.map_err(|error| error.to_string())?;
        self.values.insert(behind.outlet, Value::Activation(made));
        self.done.extend(behind.nodes);
        self.convolutions += 1;
        Ok(())
    }

    /// The slope below 0 of the rectifier that alone reads `outlet`, with its node.
    fn rectifier(&self, outlet: OutletId) -> Option<(f32, &'a TypedNode)> {
        let node = self.next(outlet)?;
        if let Some(op) = node.op_as::<ElementWiseOp>() {
            return Some((op.0.downcast_ref::<LeakyRelu>()?.alpha, node));
        }
        let [a, b] = self.view.binary::<Max>(node)?;
        let other = if a == outlet { b } else { a };
        (self.view.scalar(other) == Some(0.0)).then_some((0.0, node))
    }

    /// Rounding and activation function behind a convolution.
    fn behind(&self, node: &'a TypedNode) -> Behind {
        let first = OutletId::new(node.id, 0);
        let out = |node: &TypedNode| OutletId::new(node.id, 0);
        let mut behind =
            Behind { before: None, slope: None, out: None, outlet: first, nodes: Vec::new() };
        let rounding = |outlet: OutletId| {
            let next = self.next(outlet)?;
            Some((self.view.quantise(next)?.0, next))
        };
        if let Some((quant, quantise)) = rounding(first) {
            let back = self.next(out(quantise)).filter(|n| self.view.dequantise(n).is_some());
            let activated = back.filter(|back| self.rectifier(out(back)).is_some());
            match activated {
                Some(back) => {
                    behind.before = Some(quant);
                    behind.outlet = out(back);
                    behind.nodes.extend([quantise.id, back.id]);
                }
                None => {
                    behind.out = Some(quant);
                    behind.outlet = out(quantise);
                    behind.nodes.push(quantise.id);
                }
            }
        }
        if behind.out.is_none() {
            if let Some((slope, node)) = self.rectifier(behind.outlet) {
                behind.slope = Some(slope);
                behind.outlet = out(node);
                behind.nodes.push(node.id);
            }
            if let Some((quant, node)) = rounding(behind.outlet) {
                behind.out = Some(quant);
                behind.outlet = out(node);
                behind.nodes.push(node.id);
            }
        }
        behind
    }

    pub(super) fn pool(&mut self, node: &TypedNode) -> Result<Value, Refusal> {
        let op = node.op_as::<MaxPool>().ok_or("not a pool")?;
        let input = self.activation(node, 0)?;
        let Shape { height, width, .. } = self.builder.shape(input);
        let [kernel_height, kernel_width] = op.pool_spec.kernel_shape[..] else {
            return Err("a window that is not of two axes".to_owned());
        };
        let [kernel, stride, pad] =
            self.window(&op.pool_spec, [kernel_height, kernel_width], [height, width])?;
        let made = self.builder.pool(input, kernel, stride, pad);
        made.map(Value::Activation).map_err(|error| error.to_string())
    }
}

fn float_bias(bias: &Constant, channels: usize) -> Result<Vec<f32>, Refusal> {
    match bias.floats(channels).as_deref() {
        Some([one]) => Ok(vec![*one; channels]),
        Some(many) if many.len() == channels => Ok(many.to_vec()),
        _ => Err("a bias of other channels".to_owned()),
    }
}

/// A bias counted in products of an input's step and a weight's.
fn whole_bias(
    bias: &Constant,
    channels: usize,
    input: f32,
    scales: &[f32],
) -> Result<Vec<i32>, Refusal> {
    let unit = |channel: usize| input * scales[channel];
    if let (Some(own), DatumType::I32) = (bias.scales(channels), bias.values.datum_type()) {
        let same = |(channel, own): (usize, &f32)| (own / unit(channel) - 1.0).abs() < 1e-4;
        let view = bias.values.try_as_plain_ram().map_err(|error| error.to_string())?;
        let values = view.as_slice::<i32>().map_err(|error| error.to_string())?;
        if own.iter().enumerate().all(same) && values.len() == channels {
            return Ok(values.to_vec());
        }
    }
    // Half a product is far below the step of any output.
    let floats = float_bias(bias, channels)?;
    let round = |(channel, value): (usize, &f32)| {
        let value = (value / unit(channel)).round();
        (value.abs() < 1e9).then_some(value as i32).ok_or("a bias beyond all sums".to_owned())
    };
    floats.iter().enumerate().map(round).collect()
}
