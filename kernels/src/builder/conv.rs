//! Convolutions: which kernel, and what it needs.

use super::{Activation, Builder, PlanError, Tensor, refuse};
use crate::isa::traits;
use crate::net::Shape;
use crate::op::Op;
use crate::pack::{Conv, Weights};

impl Builder {
    /// A convolution.
    ///
    /// # Errors
    /// [`PlanError`] where there is no kernel for it or lengths do not fit.
    pub fn conv(&mut self, input: Tensor, conv: &Conv<'_>) -> Result<Tensor, PlanError> {
        let Activation { shape, quant, .. } = self.activations[input.0].clone();
        let window = self.window(input, [conv.kernel, conv.stride, conv.pad])?;
        if conv.depthwise && (conv.channels != shape.channels || ![3, 5].contains(&conv.kernel)) {
            return refuse(format!(
                "depthwise over {} channels with {} outputs and a window of {}",
                shape.channels, conv.channels, conv.kernel
            ));
        }
        let expected = conv.weight_count(shape.channels);
        let (weights, biases) = match conv.weights {
            Weights::Int8 { values, bias, scales } => (values.len(), bias.len().min(scales.len())),
            Weights::Float { values, bias } => (values.len(), bias.len()),
        };
        if weights != expected || biases != conv.channels {
            return refuse(format!("{weights} weights and {biases} biases for {expected}"));
        }
        let [height, width] = window.to;
        let out = Shape { height, width, channels: conv.channels };
        let one = conv.kernel == 1 && conv.stride == 1 && conv.pad == 0;
        let (channels, count) = (shape.channels, out.pixels());
        let lanes = traits(self.isa).0;
        let (op, scratch) = match (conv.weights, quant) {
            (Weights::Int8 { values, scales, bias }, Some(quant)) => {
                let packed = conv.pack(self.isa, quant, channels, values, scales, bias);
                let outside = quant.zero_point;
                if conv.depthwise {
                    let padded = channels.next_multiple_of(lanes);
                    let column = conv.kernel.div_ceil(4) * 4 * padded;
                    let scratch = (shape.width + 2 * conv.pad) * column;
                    (Op::Depthwise { packed, window, outside }, scratch)
                } else if one {
                    (Op::Product { packed, count }, 0)
                } else {
                    let scratch = width * 4 * packed.fours;
                    (Op::Dense { packed, window, channels, outside }, scratch)
                }
            }
            (Weights::Float { values, bias }, None) if conv.out.is_none() => {
                let packed = conv.pack_f(self.isa, channels, values, bias);
                if conv.depthwise {
                    (Op::DepthwiseF { packed, window }, 0)
                } else if one {
                    (Op::ProductF { packed, count }, 0)
                } else {
                    let scratch = width * 4 * packed.inputs;
                    (Op::DenseF { packed, window, channels }, scratch)
                }
            }
            _ => return refuse("weights of another kind than the activation"),
        };
        self.scratch = self.scratch.max(scratch);
        Ok(self.push(op, [input; 2], out, conv.out))
    }
}
