//! Weights from the order of model files into the order of the kernels.

use crate::isa::{Isa, traits};

/// The scale that an activation of bytes counts in: `value = (byte - zero_point) * scale`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuantParams {
    /// Value of one step, over 0.
    pub scale: f32,
    /// The byte that means 0.
    pub zero_point: u8,
}

/// Weights and biases of a convolution, in the order output, input, row, column.
#[derive(Clone, Copy, Debug)]
pub enum Weights<'a> {
    /// For an input of bytes.
    Int8 {
        /// Steps of -128 to 127.
        values: &'a [i8],
        /// Value of a step, by output channel.
        scales: &'a [f32],
        /// In steps of the input's scale times the weight's.
        bias: &'a [i32],
    },
    /// For an input of floats.
    Float {
        /// The weights.
        values: &'a [f32],
        /// By output channel.
        bias: &'a [f32],
    },
}

/// A convolution with what follows it up to the next stored activation.
#[derive(Clone, Copy, Debug)]
pub struct Conv<'a> {
    /// Weights and biases.
    pub weights: Weights<'a>,
    /// Channels of the output.
    pub channels: usize,
    /// Side of the square window.
    pub kernel: usize,
    /// Pixels from window to window.
    pub stride: usize,
    /// Pixels of nothing around the input.
    pub pad: usize,
    /// Each output channel sees its own input channel only.
    pub depthwise: bool,
    /// Quantisation of the sums before the activation, where the model has one there.
    pub before: Option<QuantParams>,
    /// Leaky rectifier: the factor below 0. 0 is the plain rectifier.
    pub slope: Option<f32>,
    /// Quantisation of the output; `None` for floats.
    pub out: Option<QuantParams>,
}

/// Scaling, bias and activation, applied to a sum before it is stored.
#[derive(Clone, Debug)]
pub(crate) struct Finish {
    /// Steps of the output that one of the sum is worth, by channel, filled up with 0.
    pub factors: Vec<f32>,
    /// Rounded before the activation: least and largest step, from the zero point.
    pub before: Option<(f32, f32)>,
    /// Factor below 0 and elsewhere.
    pub slopes: Option<(f32, f32)>,
    /// The output's zero point; `None`: 32-bit floats.
    pub zero: Option<f32>,
}

/// Integer weights, packed for one width of vectors.
#[derive(Clone, Debug)]
pub(crate) struct Packed {
    /// Vectors of channels that are worked on together: `(first channel, vectors)`.
    pub panels: Vec<(usize, usize)>,
    /// By panel, four inputs, channel: four bytes. Depthwise: by tap column, group of four
    /// rows, channel.
    pub weights: Vec<u8>,
    /// Initial value of the sums, by channel.
    pub start: Vec<i32>,
    /// Channels of the output.
    pub channels: usize,
    /// Inputs of each output, in fours.
    pub fours: usize,
    pub finish: Finish,
}

/// Float weights, packed alike with one input in place of four.
#[derive(Clone, Debug)]
pub(crate) struct PackedF {
    pub panels: Vec<(usize, usize)>,
    pub weights: Vec<f32>,
    pub start: Vec<f32>,
    pub channels: usize,
    pub inputs: usize,
    /// Factor below 0.
    pub slope: Option<f32>,
}

impl Conv<'_> {
    /// Weights that a convolution over `inputs` channels has.
    pub(crate) fn weight_count(&self, inputs: usize) -> usize {
        let inputs = if self.depthwise { 1 } else { inputs };
        self.channels * inputs * self.kernel * self.kernel
    }

    fn finish(&self, input: QuantParams, scales: &[f32], padded: usize) -> Finish {
        let unit = self.before.or(self.out).map_or(1.0, |steps| steps.scale);
        let mut factors: Vec<f32> = scales.iter().map(|w| input.scale * w / unit).collect();
        factors.resize(padded, 0.0);
        let zero = |steps: QuantParams| f32::from(steps.zero_point);
        let onward = match (self.before, self.out) {
            (Some(before), Some(out)) => before.scale / out.scale,
            (Some(before), None) => before.scale,
            _ => 1.0,
        };
        let slopes = (self.slope.is_some() || onward != 1.0)
            .then(|| (self.slope.unwrap_or(1.0) * onward, onward));
        let before = self.before.map(|steps| (-zero(steps), 255.0 - zero(steps)));
        Finish { factors, before, slopes, zero: self.out.map(zero) }
    }

    /// Packs for bytes. `inputs` channels.
    pub(crate) fn pack(
        &self,
        isa: Isa,
        input: QuantParams,
        inputs: usize,
        values: &[i8],
        scales: &[f32],
        bias: &[i32],
    ) -> Packed {
        let (lanes, wide, shifted) = traits(isa);
        let padded = self.channels.next_multiple_of(lanes);
        let taps = self.kernel * self.kernel;
        let seen = if self.depthwise { 1 } else { inputs };
        // The input's zero point, and what `dot` leaves out, in the sum's start.
        let away = i32::from(input.zero_point) - if shifted { 128 } else { 0 };
        let mut start: Vec<i32> = values
            .chunks_exact(seen * taps)
            .zip(bias)
            .map(|(w, bias)| bias.wrapping_sub(away * w.iter().map(|&w| i32::from(w)).sum::<i32>()))
            .collect();
        start.resize(padded, 0);
        let (fours, panels, weights) = if self.depthwise {
            let groups = self.kernel.div_ceil(4);
            let mut weights = vec![0; self.kernel * groups * padded * 4];
            for (channel, w) in values.chunks_exact(taps).enumerate() {
                for (i, &w) in w.iter().enumerate() {
                    let (row, column) = (i / self.kernel, i % self.kernel);
                    let four = (column * groups + row / 4) * padded + channel;
                    weights[four * 4 + row % 4] = w.cast_unsigned();
                }
            }
            (0, Vec::new(), weights)
        } else {
            // Windows lie row by row, pixel by pixel, channels last.
            let fours = (seen * taps).div_ceil(4);
            let panels = panels(self.channels, lanes, wide);
            let mut weights = vec![0; padded * fours * 4];
            for &(first, vectors) in &panels {
                let width = vectors * lanes;
                for channel in first..(first + width).min(self.channels) {
                    let w = &values[channel * seen * taps..][..seen * taps];
                    for (i, &w) in w.iter().enumerate() {
                        let place = i % taps * seen + i / taps;
                        let four = first * fours + place / 4 * width + channel - first;
                        weights[four * 4 + place % 4] = w.cast_unsigned();
                    }
                }
            }
            (fours, panels, weights)
        };
        let finish = self.finish(input, scales, padded);
        Packed { panels, weights, start, channels: self.channels, fours, finish }
    }

    /// Packs for floats. `inputs` channels.
    pub(crate) fn pack_f(&self, isa: Isa, inputs: usize, values: &[f32], bias: &[f32]) -> PackedF {
        let (lanes, wide, _) = traits(isa);
        let padded = self.channels.next_multiple_of(lanes);
        let taps = self.kernel * self.kernel;
        let mut start = bias.to_vec();
        start.resize(padded, 0.0);
        let (inputs, panels, weights) = if self.depthwise {
            let mut weights = vec![0.0; taps * padded];
            for (channel, w) in values.chunks_exact(taps).enumerate() {
                for (i, &w) in w.iter().enumerate() {
                    weights[i * padded + channel] = w;
                }
            }
            (1, Vec::new(), weights)
        } else {
            let panels = panels(self.channels, lanes, wide);
            let mut weights = vec![0.0; padded * inputs * taps];
            for &(first, vectors) in &panels {
                let width = vectors * lanes;
                for channel in first..(first + width).min(self.channels) {
                    let w = &values[channel * inputs * taps..][..inputs * taps];
                    for (i, &w) in w.iter().enumerate() {
                        let place = i % taps * inputs + i / taps;
                        weights[first * inputs * taps + place * width + channel - first] = w;
                    }
                }
            }
            (inputs * taps, panels, weights)
        };
        PackedF { panels, weights, start, channels: self.channels, inputs, slope: self.slope }
    }
}

/// Panels of at most four (or two) vectors, as even as can be.
fn panels(channels: usize, lanes: usize, wide: bool) -> Vec<(usize, usize)> {
    let vectors = channels.div_ceil(lanes);
    let count = vectors.div_ceil(if wide { 4 } else { 2 });
    let mut first = 0;
    (0..count)
        .map(|i| {
            let width = (vectors - first).div_ceil(count - i);
            first += width;
            ((first - width) * lanes, width)
        })
        .collect()
}
