//! Putting a network together, operator by operator.

mod conv;
mod finish;

use crate::isa::Isa;
use crate::moves::Rescale;
use crate::net::Shape;
use crate::op::Op;
use crate::pack::QuantParams;
use crate::pixels::Window;

/// An activation of the network that is put together: pixels with their channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Tensor(usize);

/// A net that the kernels cannot run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlanError {
    reason: String,
}

impl std::fmt::Display for PlanError {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(&self.reason)
    }
}

impl std::error::Error for PlanError {}

fn refuse<T>(reason: impl Into<String>) -> Result<T, PlanError> {
    Err(PlanError { reason: reason.into() })
}

#[derive(Clone, Debug)]
struct Activation {
    shape: Shape,
    /// `None`: floats.
    quant: Option<QuantParams>,
    /// Some channels of another activation, from one on.
    part_of: Option<(Tensor, usize)>,
}

impl Activation {
    fn width(&self) -> usize {
        if self.quant.is_some() { 1 } else { 4 }
    }
}

/// A network that is put together, step by step in the order of execution.
#[derive(Debug)]
pub struct Builder {
    isa: Isa,
    activations: Vec<Activation>,
    inputs: Vec<Tensor>,
    ops: Vec<(Op, [Tensor; 2], Tensor)>,
    scratch: usize,
}

impl Builder {
    /// Starts with nothing.
    pub fn on(isa: Isa) -> Self {
        let isa = if isa.is_here() { isa } else { Isa::Portable };
        let (activations, inputs, ops) = (Vec::new(), Vec::new(), Vec::new());
        Self { isa, activations, inputs, ops, scratch: 0 }
    }

    /// Starts with an input. `quant`: bytes; without: floats.
    pub fn new(isa: Isa, input: Shape, quant: Option<QuantParams>) -> (Self, Tensor) {
        let mut builder = Self::on(isa);
        let input = builder.input(input, quant);
        (builder, input)
    }

    /// An input, which is filled before each run.
    pub fn input(&mut self, shape: Shape, quant: Option<QuantParams>) -> Tensor {
        let input = self.activation(shape, quant);
        self.inputs.push(input);
        input
    }

    /// Shape of an activation.
    pub fn shape(&self, of: Tensor) -> Shape {
        self.activations[of.0].shape
    }

    /// Quantisation of an activation of bytes.
    pub fn quant_params(&self, of: Tensor) -> Option<QuantParams> {
        self.activations[of.0].quant
    }

    fn activation(&mut self, shape: Shape, quant: Option<QuantParams>) -> Tensor {
        self.activations.push(Activation { shape, quant, part_of: None });
        Tensor(self.activations.len() - 1)
    }

    fn push(
        &mut self,
        op: Op,
        from: [Tensor; 2],
        shape: Shape,
        quant: Option<QuantParams>,
    ) -> Tensor {
        let to = self.activation(shape, quant);
        self.ops.push((op, from, to));
        to
    }

    fn window(
        &self,
        input: Tensor,
        [kernel, stride, pad]: [usize; 3],
    ) -> Result<Window, PlanError> {
        let shape = self.shape(input);
        let from = [shape.height, shape.width];
        if kernel == 0 || stride == 0 || pad >= kernel || from.iter().any(|n| n + 2 * pad < kernel)
        {
            return refuse(format!(
                "a window of {kernel}, stride {stride}, pad {pad} over {from:?} pixels"
            ));
        }
        let to = from.map(|n| (n + 2 * pad - kernel) / stride + 1);
        Ok(Window { kernel, stride, pad, from, to })
    }

    /// The largest value under each window.
    ///
    /// # Errors
    /// [`PlanError`] where the window does not fit.
    pub fn pool(
        &mut self,
        input: Tensor,
        kernel: usize,
        stride: usize,
        pad: usize,
    ) -> Result<Tensor, PlanError> {
        let window = self.window(input, [kernel, stride, pad])?;
        let channels = self.shape(input).channels;
        let [height, width] = window.to;
        let op = match self.quant_params(input) {
            Some(_) => Op::Pool { window, channels },
            None => Op::PoolF { window, channels },
        };
        let shape = Shape { height, width, channels };
        Ok(self.push(op, [input; 2], shape, self.quant_params(input)))
    }

    /// Channels `first` to `first + channels` of an activation. Costs nothing.
    ///
    /// # Errors
    /// [`PlanError`] where it has fewer.
    pub fn slice(
        &mut self,
        input: Tensor,
        first: usize,
        channels: usize,
    ) -> Result<Tensor, PlanError> {
        let Activation { shape, quant, .. } = self.activations[input.0].clone();
        if first + channels > shape.channels {
            return refuse(format!(
                "channels {first} to {} of {}",
                first + channels,
                shape.channels
            ));
        }
        let part = self.activation(Shape { channels, ..shape }, quant);
        self.activations[part.0].part_of = Some((input, first));
        Ok(part)
    }

    fn alike(&self, a: Tensor, b: Tensor) -> Result<(), PlanError> {
        let (a, b) = (&self.activations[a.0], &self.activations[b.0]);
        if a.shape != b.shape || a.quant.is_some() != b.quant.is_some() {
            return refuse(format!("{:?} and {:?} together", a.shape, b.shape));
        }
        Ok(())
    }

    /// Channels of `a` and `b` in turn.
    ///
    /// # Errors
    /// [`PlanError`] where shapes or steps differ.
    pub fn interleave(&mut self, a: Tensor, b: Tensor) -> Result<Tensor, PlanError> {
        self.alike(a, b)?;
        let (shape, quant) = (self.shape(a), self.quant_params(a));
        if quant != self.quant_params(b) {
            return refuse("a shuffle of halves with different scales");
        }
        let (channels, count) = (shape.channels, shape.pixels());
        let op = match quant {
            Some(_) => Op::Interleave { channels, count },
            None => Op::InterleaveF { channels, count },
        };
        Ok(self.push(op, [a, b], Shape { channels: 2 * channels, ..shape }, quant))
    }

    /// Activations behind one another, channel-wise. Costs nothing for activations that can be
    /// written where they will lie.
    ///
    /// # Errors
    /// [`PlanError`] where sizes differ.
    pub fn concat(
        &mut self,
        parts: &[Tensor],
        quant: Option<QuantParams>,
    ) -> Result<Tensor, PlanError> {
        let Some(&first) = parts.first() else { return refuse("a concatenation of nothing") };
        let shape = self.shape(first);
        for &part in parts {
            let Shape { height, width, .. } = self.shape(part);
            let floats = self.quant_params(part).is_none();
            if (height, width) != (shape.height, shape.width) || floats != quant.is_none() {
                return refuse(format!("{shape:?} and {:?} together", self.shape(part)));
            }
        }
        let channels = parts.iter().map(|&part| self.shape(part).channels).sum();
        let whole = self.activation(Shape { channels, ..shape }, quant);
        let mut at = 0;
        for &part in parts {
            let place = &self.activations[part.0];
            let (channels, own) = (place.shape.channels, place.part_of.is_none());
            if own && place.quant == quant && !self.inputs.contains(&part) {
                self.activations[part.0].part_of = Some((whole, at));
            } else {
                let to = self.slice(whole, at, channels)?;
                let op = self.carry(part, quant);
                self.ops.push((op, [part; 2], to));
            }
            at += channels;
        }
        Ok(whole)
    }

    /// The work of copying an activation to other steps.
    fn carry(&self, part: Tensor, quant: Option<QuantParams>) -> Op {
        let activation = &self.activations[part.0];
        let (channels, count) = (activation.shape.channels, activation.shape.pixels());
        match (activation.quant, quant) {
            (Some(from), Some(to)) if from != to => {
                Op::Rescale { scale: rescale(from, to), channels, count }
            }
            _ => Op::Copy { bytes: channels * activation.width(), count },
        }
    }

    /// The activation in other steps.
    ///
    /// # Errors
    /// [`PlanError`] for floats.
    pub fn requantise(&mut self, input: Tensor, quant: QuantParams) -> Result<Tensor, PlanError> {
        match self.quant_params(input) {
            None => refuse("floats into steps"),
            Some(from) if from == quant => Ok(input),
            Some(_) => {
                let op = self.carry(input, Some(quant));
                Ok(self.push(op, [input; 2], self.shape(input), Some(quant)))
            }
        }
    }

    /// The sum of two activations.
    ///
    /// # Errors
    /// [`PlanError`] where shapes differ.
    pub fn add(
        &mut self,
        a: Tensor,
        b: Tensor,
        quant: Option<QuantParams>,
    ) -> Result<Tensor, PlanError> {
        self.alike(a, b)?;
        let shape = self.shape(a);
        let (channels, count) = (shape.channels, shape.pixels());
        let op = match (self.quant_params(a), self.quant_params(b), quant) {
            (Some(from), Some(other), Some(to)) => {
                let scales = [rescale(from, to), rescale(other, to)];
                Op::Add { scales, channels, count }
            }
            (None, None, None) => Op::AddF { channels, count },
            _ => return refuse("a sum of bytes and floats"),
        };
        Ok(self.push(op, [a, b], shape, quant))
    }

    /// Twice as wide and high, linear between aligned pixel centres.
    pub fn double(&mut self, input: Tensor) -> Tensor {
        let Activation { shape, quant, .. } = self.activations[input.0].clone();
        let (size, channels) = ([shape.height, shape.width], shape.channels);
        let op = match quant {
            Some(_) => Op::Double { size, channels },
            None => Op::DoubleF { size, channels },
        };
        let shape = Shape { height: 2 * shape.height, width: 2 * shape.width, channels };
        self.push(op, [input; 2], shape, quant)
    }
}

fn rescale(from: QuantParams, to: QuantParams) -> Rescale {
    Rescale {
        factor: from.scale / to.scale,
        zero_from: f32::from(from.zero_point),
        zero_to: f32::from(to.zero_point),
    }
}
